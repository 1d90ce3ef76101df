"""Loops known by their signals: a loop of a user's diagram with parameters anywhere in it.

Such a loop has no reduced model; its gains are searched on the plant. Its margins are those of the diagram linearised
with each candidate, cut at the effort: see :mod:`mirdrake.tuning.loops.cut`. Its gains are the numbers of blocks in the
diagram file, such as ``<block>.kp``, the parameters of :mod:`mirdrake.execution.parameters`, and for a driver that
tracks a path ``<vehicle>.driver.convergence_time`` [s] and ``<vehicle>.driver.damping`` [1].
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.blocks import all_parameters
from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, load_diagram, make_spec
from mirdrake.controllers.path_tracking import PathTracker
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, RunError, did_you_mean, first_line
from mirdrake.core.json_io import Json
from mirdrake.core.paths import find
from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.core.yaml_io import Source, where
from mirdrake.execution.parameters import find_context_parameters
from mirdrake.runs.simulation import Simulation
from mirdrake.tuning.identify import Identification
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Course, Evaluation, Gain, LoopSpec
from mirdrake.tuning.loops.controller_block import KIND, ControllerBlock, tuned_blocks
from mirdrake.tuning.loops.cut import CutLoop, cut_loop
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.loops.kind import LoopKind
from mirdrake.tuning.loops.reduced import OpenLoop, worst_margins
from mirdrake.tuning.spec import DiagramLoop, TuningSpec

DURATION = 10.0
"""Default duration of a test [s]."""

PROBE = 0.2
"""Simulated time of the run that lists the signals of a diagram [s]."""

PATH_GAINS = ("convergence_time", "damping")
"""Gains of a driver that tracks a path."""

Setter = Callable[[Context, float], None]


class SignalLoop(LoopKind):
    """A loop known by its signals only."""

    identifiable: ClassVar[bool] = False
    in_control_yaml: ClassVar[bool] = False
    has_own_plant: ClassVar[bool] = False
    conditions: ClassVar[tuple[str, ...]] = ()

    def make_bench(self, spec: LoopSpec) -> "SignalBench":
        """See :meth:`LoopKind.make_bench`."""
        return SignalBench(spec)

    def delays(self, study: TuningSpec) -> tuple[float, float]:
        """Return the delays of the study; without an entry the diagram has all delays."""
        return study.robustness.delay or (0.0, 0.0)

    @abstractmethod
    def signals(self, study: TuningSpec) -> DiagramLoop:
        """Return signals and gains of the loop."""

    @abstractmethod
    def diagram(self, study: TuningSpec) -> DiagramSpec:
        """Return the diagram of the loop."""

    @abstractmethod
    def course(self, study: TuningSpec) -> Course:
        """Return the test manoeuvre."""

    @abstractmethod
    def place(self, study: TuningSpec, *path: str | int) -> str:
        """Return file and line of an entry of ``loop:`` for an error."""

    def make_spec(self, study: TuningSpec, *, noise: bool | None = None, speed: float | None = None) -> LoopSpec:  # noqa: ARG002
        """Return the loop as plain data; its signals are looked up in a short run.

        Raises:
            ConfigError: the diagram cannot be built, or does not have a signal or gain.
        """
        loop, drawing = self.signals(study), self.diagram(study)
        # The short run is for names only: no files and no browser.
        drawing.record.meshcat = drawing.record.report = drawing.record.cameras = False
        assembly = assemble(drawing)  # built from the file, so that errors have its lines
        diagram = drawing.model_dump(mode="json")
        # Columns of a run are known only after it has run.
        columns = Simulation(assembly).run(duration=PROBE).signals.columns
        wanted = {"output": loop.output, "effort": loop.effort}
        if isinstance(loop.reference, str):
            wanted["reference"] = loop.reference
        for key, name in wanted.items():
            if name not in columns:
                raise ConfigError(
                    f"{self.place(study, key)}: no signal '{name}' is logged; {did_you_mean(name, columns)}"
                )
        # Parameters are those that a Context can change without building the diagram again.
        setters, numbers = find_setters(assembly), block_numbers(drawing)
        for index, name in enumerate(loop.parameters):
            if name not in setters and name not in numbers:
                place, known = self.place(study, "parameters", index), [*setters, *numbers]
                raise ConfigError(f"{place}: no parameter '{name}'; {did_you_mean(name, known)}")
        for name in loop.roles:
            if name not in loop.parameters:
                place = self.place(study, "roles", name)
                raise ConfigError(f"{place}: not one of the parameters; {did_you_mean(name, loop.parameters)}")
        present = path_gains(assembly) | numbers
        # Friction can be drawn if the road has one coefficient.
        uniform = "road.friction" in setters
        return LoopSpec(
            kind=self.name,
            diagram=_with_tuned_blocks(diagram, {name: numbers[name] for name in loop.parameters if name in numbers}),
            vehicle=next(iter(diagram["vehicles"])),
            gains={name: Gain(role=loop.roles.get(name, "")) for name in loop.parameters},
            reference=loop.reference,
            output=loop.output,
            effort=loop.effort,
            output_unit="m" if self.selectable else "",
            effort_unit="rad" if self.selectable else "",
            course=self.course(study),
            period=None if (cut := cut_loop(assembly, loop.effort)) is None else cut.period,
            friction=float(assembly.parts.world.ground.mu) if uniform else None,
            # Present gains are the baseline.
            present={name: present[name] for name in loop.parameters if name in present},
        )


class DiagramLoopKind(SignalLoop):
    """A loop of a user's diagram."""

    name: ClassVar[str] = "diagram"
    selectable: ClassVar[bool] = False

    def signals(self, study: TuningSpec) -> DiagramLoop:
        """Return what the study names."""
        if not isinstance(study.loop, DiagramLoop):
            raise ConfigError(f"{where(study, 'loop')}: must name a diagram and its signals")
        return study.loop

    def diagram(self, study: TuningSpec) -> DiagramSpec:
        """Load the diagram: a file beside the study, a path, or a name."""
        name = self.signals(study).diagram
        beside = Path(study.folder or ".") / name
        if not beside.is_file():
            beside = find("diagrams", name, where=where(study, "loop", "diagram"))
        return load_diagram(str(beside))

    def course(self, study: TuningSpec) -> Course:
        """Return the test manoeuvre; the diagram itself makes the step."""
        test = study.test
        step = 1.0 if test.step is None else test.step
        duration = test.duration or DURATION
        return Course(step, test.step_time, 0.0, duration, duration)

    def place(self, study: TuningSpec, *path: str | int) -> str:
        """See :meth:`SignalLoop.place`."""
        return where(study, "loop", *path)


def find_setters(assembly: Assembly) -> dict[str, Setter]:
    """Return functions that write a parameter to a Context of a diagram, by name of the parameter."""
    vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
    setters: dict[str, Setter] = {
        name: partial(parameter.apply, assembly)
        for name, parameter in find_context_parameters(vehicles, assembly.parts.world).items()
    }
    for name, block in tuned_blocks(assembly).items():
        setters |= {f"{name}.{key}": partial(_set_parameter, block.block, key) for key in block.block.parameters}
    for tracker in find_trackers(assembly):
        setters |= {f"{tracker.get_name()}.{gain}": partial(_set_gain, tracker, gain) for gain in PATH_GAINS}
    return setters


def path_gains(assembly: Assembly) -> dict[str, float]:
    """Return the present gains of the drivers of a diagram that track a path."""
    gains: dict[str, float] = {}
    context = assembly.make_context()
    for tracker in find_trackers(assembly):
        present = tracker.get_gains(tracker.GetMyContextFromRoot(context))
        gains |= {f"{tracker.get_name()}.{name}": float(getattr(present, name)) for name in PATH_GAINS}
    return gains


def block_numbers(drawing: DiagramSpec) -> dict[str, float]:
    """Return the numbers of the blocks of a diagram by name: those in its file, and defaults of the others."""
    numbers: dict[str, float] = {}
    for name, entry in drawing.systems.items():
        source = entry._source or Source("diagram", {}, ("systems", name))
        given = all_parameters(entry.kind, entry.parameters(), source=source, folder=drawing.folder)
        for key, value in given.items():
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                numbers[f"{name}.{key}"] = float(value)
    return numbers


def tuned_entry(entry: Json | None) -> Json | None:
    """Return the entry of a block in the diagram of the user, also of one that is tuned; None without a block."""
    return entry["entry"] if entry is not None and entry["kind"] == KIND else entry


def _with_tuned_blocks(diagram: Mapping[str, Any], parameters: Mapping[str, float]) -> Json:
    """Return data of a diagram with a tuned block in place of each block that has one of some parameters."""
    systems = dict(diagram.get("systems") or {})
    for block in {name.rpartition(".")[0]: None for name in parameters}:
        own = {name.rpartition(".")[2]: value for name, value in parameters.items() if name.rpartition(".")[0] == block}
        systems[block] = {"kind": KIND, "entry": systems[block], "parameters": own, "folder": diagram.get("folder")}
    return {**diagram, "systems": systems}


def find_trackers(assembly: Assembly) -> list[PathTracker]:
    """Return the drivers of a diagram that track a path."""
    return [system for system in assembly.diagram.GetSystems() if isinstance(system, PathTracker)]


def _set_gain(tracker: PathTracker, gain: str, context: Context, value: float) -> None:
    own = tracker.GetMyMutableContextFromRoot(context)
    tracker.set_gains(own, replace(tracker.get_gains(own), **{gain: value}))


def _set_parameter(block: ControllerBlock, name: str, context: Context, value: float) -> None:
    block.set_parameter(block.GetMyMutableContextFromRoot(context), name, value)


class SignalBench:
    """Test bench of a loop of signals; built once.

    Args:
        spec: the loop.
    """

    def __init__(self, spec: LoopSpec) -> None:
        self.spec = spec
        self.assembly = assemble(make_spec(spec.diagram))
        self.simulation = Simulation(self.assembly)
        self._setters = find_setters(self.assembly)
        self._known: tuple[dict[str, float], dict[str, float]] | None = None

    @cached_property
    def cut(self) -> CutLoop | None:
        """The loop cut at its effort, at the operating point; None if it cannot be cut."""
        return cut_loop(self.assembly, self.spec.effort)

    def open_loops(self, gains: Mapping[str, float]) -> list[OpenLoop]:
        """Return the open loop with gains at the operating point, just before the step; none if it cannot be cut.

        Raises:
            ConfigError: the effort does not respond at the operating point.
        """
        if self.cut is None:
            return []
        setters = self._setters if self.cut.assembly is self.assembly else find_setters(self.cut.assembly)

        def change(context: Context) -> None:
            for name, value in gains.items():
                setters[name](context, float(value))

        # A diagram that diverges before the step has no operating point.
        try:
            response = self.cut.response(self.operating_time, change)
        except RuntimeError as error:
            if not is_divergence(str(error)):
                raise
            return []
        # A loop without a response would have every margin.
        low, high = self.cut.frequencies
        if not np.abs(response(np.geomspace(low, high, 50))).any():
            raise ConfigError(
                f"the loop is open at {self.operating_time:g} s, where it is linearised: '{self.spec.effort}' is at a "
                "limit there, or the vehicle stands still; write another test: {step_time: ...}"
            )
        return [(response, low, high)]

    @cached_property
    def limits(self) -> PidLimits:
        """Limits of the effort: ``minimum`` and ``maximum`` of the block whose output it is; none for other signals."""
        block = tuned_entry(self.spec.diagram["systems"].get(self.spec.effort.partition(".")[0]))
        if block is None:
            return NO_LIMITS
        kind, given = block["kind"], {key: value for key, value in block.items() if key != "kind"}
        known = all_parameters(kind, given, source=Source("loop", {}), folder=self.spec.diagram.get("folder"))
        ends = [known.get(name) for name in ("minimum", "maximum")]
        low, high = (float(end) if isinstance(end, int | float) else math.nan for end in ends)
        return PidLimits(-math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high)

    @property
    def operating_time(self) -> float:
        """Time of the operating point [s]."""
        return self.spec.course.step_time

    def margins(self, gains: Mapping[str, float]) -> dict[str, float]:
        """Return the margins of the loop with gains by name; nan if unknown."""
        if self._known is None or self._known[0] != gains:
            self._known = dict(gains), worst_margins(self.open_loops(gains))
        return dict(self._known[1])

    def identify(self) -> Identification:
        """Return the loop without a model."""
        return Identification(self.spec)

    def _apply(self, context: Context, conditions: Conditions) -> None:
        """Write conditions other than mass and friction to a Context."""

    def run(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, *, margins: Mapping[str, float]
    ) -> Evaluation:
        """Run the diagram with gains; of the conditions, mass and friction have an effect.

        Without a model the margins are those of the linear diagram; the Monte Carlo does not need them.

        Raises:
            ConfigError: unknown gain.
        """
        # Conditions are parameters of the Context, too.
        values = dict(gains)
        if conditions.mass != 1.0:
            values[f"{self.spec.vehicle}.mass_scale"] = conditions.mass
        if conditions.friction is not None:
            values["road.friction"] = conditions.friction

        # Called with a fresh Context of each run.
        def change(context: Context) -> None:
            self._apply(context, conditions)
            for name, value in values.items():
                if name not in self._setters:
                    raise ConfigError(f"no parameter '{name}'; {did_you_mean(name, self._setters)}")
                self._setters[name](context, float(value))

        try:
            run = self.simulation.run(duration=self.spec.course.duration, change=change)
        # Only divergence is the fault of the gains.
        except RunError as error:
            if not is_divergence(str(error)):
                raise
            return Evaluation("unstable", reason=first_line(error))
        if run.diverged:
            return Evaluation("unstable", reason=str(run.stop))
        signals, reference = run.signals, self.spec.reference
        t = signals.index.to_numpy(dtype=float)
        return judge(
            t,
            # A constant reference has no signal.
            signals[reference].to_numpy() if isinstance(reference, str) else np.full(len(t), float(reference)),
            signals[self.spec.output].to_numpy(dtype=float),
            signals[self.spec.effort].to_numpy(dtype=float),
            course=self.spec.course,
            limits=self.limits,
            noise=conditions.noise,
            margins=self.margins(gains) if self.spec.model is None and conditions == NOMINAL else margins,
        )
