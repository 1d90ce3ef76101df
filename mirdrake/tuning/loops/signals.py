"""Loops of a diagram by the names of their signals: a user's own, and the tracking of a path.

Nothing is known of such a loop but what a run logs, so that it has no reduced model and no margins: its gains are
searched on the plant. Knobs are ``<block>.kp``, ``.ki``, ``.kd`` of blocks of kind pid, those of
:mod:`mirdrake.execution.parameters`, and of a driver that tracks a path ``<vehicle>.driver.convergence_time`` [s] and
``<vehicle>.driver.damping`` [1].
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, load_diagram, make_spec
from mirdrake.controllers import DiscretePid
from mirdrake.controllers.path_tracking import PathTracker
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, RunError, did_you_mean
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import where
from mirdrake.execution.parameters import find_knobs
from mirdrake.runs.simulation import Simulation
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.spec import DiagramLoop, TuningSpec
from mirdrake.worlds import load_world

LOOK = 0.2
"""Time for which a diagram is run to see which signals it has [s]."""

PID_GAINS = ("kp", "ki", "kd")
"""Gains of a block of kind pid that are tuned."""

PATH_GAINS = ("convergence_time", "damping")
"""Gains of a driver that tracks a path."""

PATH_RANGES = {
    "ego.driver.convergence_time": {"low": 0.3, "high": 3.0, "scale": "log"},
    "ego.driver.damping": {"low": 0.6, "high": 1.5, "scale": "linear"},
}
"""Where the gains of a path are searched unless the file says [s, 1]."""

Turn = Callable[[Context, float], None]


def make_signal_loop(spec: TuningSpec) -> LoopSpec:
    """The loop of a tuning file that names signals, or a path.

    Raises:
        ConfigError: the diagram cannot be built, as with an input that is not connected; or it has no such signal or
            knob.
    """
    loop = spec.loop if isinstance(spec.loop, DiagramLoop) else _path_loop(spec)
    own = isinstance(spec.loop, DiagramLoop)
    drawing = _own_diagram(spec, loop.diagram) if own else make_spec(_path_diagram(spec))
    drawing.record.meshcat = drawing.record.report = drawing.record.cameras = False
    assembly = assemble(drawing)  # of the file itself, so that its faults are told with their lines
    diagram = drawing.model_dump(mode="json")
    columns = Simulation(assembly).run(duration=LOOK).signals.columns
    wanted = {"output": loop.output, "effort": loop.effort}
    if isinstance(loop.reference, str):
        wanted["reference"] = loop.reference
    for key, name in wanted.items():
        if name not in columns:
            place = where(spec, "loop", key) if own else where(spec, "loop")
            raise ConfigError(f"{place}: no signal '{name}' is logged; {did_you_mean(name, columns)}")
    knobs = knobs_of(assembly)
    for index, name in enumerate(loop.knobs):
        if name not in knobs:
            place = where(spec, "loop", "knobs", index) if own else where(spec, "loop")
            raise ConfigError(f"{place}: no knob '{name}'; {did_you_mean(name, knobs)}")
    test = spec.test
    return LoopSpec(
        kind="diagram" if own else "path",
        diagram=diagram,
        vehicle=next(iter(diagram["vehicles"])),
        gains=dict.fromkeys(loop.knobs, ""),
        paths={},
        settings={},
        reference=str(loop.reference),
        output=loop.output,
        effort=loop.effort,
        output_unit="" if own else "m",
        effort_unit="" if own else "rad",
        course={
            "step": (1.0 if own else 0.5) if test.step is None else test.step,
            "step_time": test.step_time if own else 0.0,
            "load": 0.0,
            "load_time": test.duration,
            "duration": test.duration,
        },
        nominal={"delay": 0.0, "friction": math.nan},
        options={
            "signals": [loop.reference, loop.output, loop.effort],
            "noisy": False,
            "pedals": False,
            "friction": "road.friction" in knobs,
            "present": {name: value for name, value in present_gains(assembly).items() if name in loop.knobs},
            "ranges": {} if own else PATH_RANGES,
        },
    )


def knobs_of(assembly: Assembly) -> dict[str, Turn]:
    """What can be turned in a Context of a diagram, by name."""
    vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
    turns: dict[str, Turn] = {
        name: lambda context, value, knob=knob: knob.turn(assembly, context, value)  # type: ignore[misc]
        for name, knob in find_knobs(vehicles, assembly.parts.world).items()
    }
    for system in assembly.diagram.GetSystems():
        name = system.get_name()
        if isinstance(system, DiscretePid):
            for gain in PID_GAINS:
                turns[f"{name}.{gain}"] = lambda context, value, system=system, gain=gain: _set(  # type: ignore[misc]
                    system, context, gain, value
                )
        elif isinstance(system, PathTracker):
            for gain in PATH_GAINS:
                turns[f"{name}.{gain}"] = lambda context, value, system=system, gain=gain: _set(  # type: ignore[misc]
                    system, context, gain, value
                )
    return turns


def present_gains(assembly: Assembly) -> dict[str, float]:
    """Gains that the diagram's own blocks have, those of kind pid and of drivers that track a path, by knob."""
    found: dict[str, float] = {}
    context = assembly.make_context()
    for system in assembly.diagram.GetSystems():
        if isinstance(system, DiscretePid | PathTracker):
            gains = system.get_gains(system.GetMyContextFromRoot(context))
            names = PID_GAINS if isinstance(system, DiscretePid) else PATH_GAINS
            found |= {f"{system.get_name()}.{name}": float(getattr(gains, name)) for name in names}
    return found


def _set(system: Any, context: Context, gain: str, value: float) -> None:
    own = system.GetMyMutableContextFromRoot(context)
    system.set_gains(own, replace_gain(system.get_gains(own), gain, value))


def replace_gain(gains: Any, gain: str, value: float) -> Any:
    """The same gains but for one."""
    return replace(gains, **{gain: value})


def _own_diagram(spec: TuningSpec, name: str) -> DiagramSpec:
    """A user's diagram: beside the study, a path, or a name."""
    beside = Path(spec.folder or ".") / name
    if not beside.is_file():
        beside = find("diagrams", name, where=where(spec, "loop", "diagram"))
    return load_diagram(str(beside))


def _path_loop(spec: TuningSpec) -> DiagramLoop:  # noqa: ARG001
    return DiagramLoop(
        diagram="",
        reference=0.0,
        output="ego.lateral_error",
        effort="ego.steering_setpoint",
        knobs=["ego.driver.convergence_time", "ego.driver.damping"],
    )


def _path_diagram(spec: TuningSpec) -> dict[str, Any]:
    world = "test_track" if spec.world == "empty" else spec.world
    starts = load_world(world, where=where(spec, "world")).starts
    start = next(iter(starts.values()))
    aside = 0.5 if spec.test.step is None else spec.test.step
    place = {"x": start.x - aside * math.sin(start.yaw), "y": start.y + aside * math.cos(start.yaw), "yaw": start.yaw}
    return {
        "name": spec.name,
        "world": world,
        "vehicles": {"ego": {"model": str(spec.vehicle), "start": place, "speed": spec.test.speed or 5.0}},
        "control": {"ego": {"kind": "path_tracking", "speed": spec.test.speed or 5.0}},
        "plant": {"contact": "point", **spec.plant.model_dump(exclude_unset=True)},
        "duration": spec.test.duration,
        "seed": spec.seed,
    }


class SignalBench:
    """A loop of a diagram; built once.

    Args:
        spec: the loop.
    """

    def __init__(self, spec: LoopSpec) -> None:
        self.spec = spec
        self.assembly = assemble(make_spec(spec.diagram))
        self.simulation = Simulation(self.assembly)
        self._turns = knobs_of(self.assembly)

    def run(
        self,
        gains: Mapping[str, float],
        conditions: Conditions = NOMINAL,
        *,
        course: Mapping[str, Any] | None = None,
        margins: dict[str, float] | None = None,
    ) -> Evaluation:
        """One trial; mass and friction act, delay, grade and noise do not.

        Raises:
            ConfigError: a gain is not known.
        """
        course = dict(self.spec.course) | dict(course or {})
        values = dict(gains)
        if conditions.mass != 1.0:
            values[f"{self.spec.vehicle}.mass_scale"] = conditions.mass
        if conditions.friction is not None:
            values["road.friction"] = conditions.friction

        def change(context: Context) -> None:
            for name, value in values.items():
                if name not in self._turns:
                    raise ConfigError(f"no knob '{name}'; {did_you_mean(name, self._turns)}")
                self._turns[name](context, float(value))

        try:
            run = self.simulation.run(duration=course["duration"], change=change)
        except RunError as error:
            if not is_divergence(str(error)):
                raise
            return Evaluation("unstable", reason=str(error).splitlines()[0])
        if str(run.summary["stop_reason"]).startswith("diverged"):
            return Evaluation("unstable", reason=str(run.summary["stop_reason"]))
        signals, (reference, output, effort) = run.signals, self.spec.options["signals"]
        t = signals.index.to_numpy(dtype=float)
        wanted = signals[reference].to_numpy() if isinstance(reference, str) else np.full(len(t), float(reference))
        return judge(
            t,
            wanted,
            signals[output].to_numpy(dtype=float),
            signals[effort].to_numpy(dtype=float),
            course=course,
            noise=conditions.noise,
            margins=margins,
        )
