"""Loop of path tracking: from a start beside the path, the driver returns to it.

The law of :mod:`mirdrake.controllers.path_tracking` makes the offset e obey ``e'' = u``, with distance as the
independent variable and ``u = -(2 zeta / d) e' - e / d^2``: at a speed v, a double integrator with a PD controller of
the gains kp = 1/T^2 and kd = 2 zeta/T, T = d/v. So rules for a double integrator with dead time give T and zeta. The
dead time is that of the loop at the frequency where its phase reaches -180 degrees.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, make_spec
from mirdrake.core.contacts import STUDY_CONTACT
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.tuning.identify import Experiment, Identification, Parameter
from mirdrake.tuning.loops.base import Conditions, Course, LoopSpec
from mirdrake.tuning.loops.blocks import DelayedActuator
from mirdrake.tuning.loops.cut import CutLoop, cut_loop
from mirdrake.tuning.loops.signals import DURATION, PATH_GAINS, SignalBench, SignalLoop, find_trackers
from mirdrake.tuning.margins import margins_of
from mirdrake.tuning.search_range import Range
from mirdrake.tuning.spec import DiagramLoop, TuningSpec
from mirdrake.worlds import load_world

DELAY = "steering_delay"
"""Name of the block that delays the steering."""

PERIOD = 0.02
"""Of the delay, that of the driver [s]."""

SETTLED = 1.0
"""Time after which a car that starts on the path drives steadily [s]."""


class PathLoop(SignalLoop):
    """Tracking of a path: from a start beside the path, the driver returns to it."""

    name: ClassVar[str] = "path"
    identifiable: ClassVar[bool] = True
    has_reduced_test: ClassVar[bool] = False
    conditions: ClassVar[tuple[str, ...]] = ("delay",)
    ranges: ClassVar[Mapping[str, Range]] = {
        "ego.driver.convergence_time": Range(0.3, 3.0),
        "ego.driver.damping": Range(0.6, 1.5, "linear"),
    }

    def signals(self, study: TuningSpec) -> DiagramLoop:  # noqa: ARG002
        """Return cross-track error and steering."""
        return DiagramLoop(
            diagram="",
            reference=0.0,
            output="ego.lateral_error",
            effort="ego.steering_command",
            parameters=[f"ego.driver.{name}" for name in PATH_GAINS],
        )

    def diagram(self, study: TuningSpec) -> DiagramSpec:
        """Return a diagram in which the vehicle starts beside the path."""
        # Path tracking needs a track; the empty world has none.
        world = "test_track" if study.world == "empty" else study.world
        # A start beside the path: the offset is the step to which the loop responds.
        start = next(iter(load_world(world, where=where(study, "world")).starts.values()))
        offset, speed = self.course(study).step, study.test.speed or 5.0
        pose = {
            # Left of the path: (-sin, cos) of the heading.
            "x": start.x - offset * math.sin(start.yaw),
            "y": start.y + offset * math.cos(start.yaw),
            "yaw": start.yaw,
        }
        return make_spec(
            {
                "name": study.name,
                "world": world,
                "vehicles": {"ego": {"model": str(study.vehicle), "start": pose, "speed": speed}},
                "control": {"ego": {"kind": "path_tracking", "speed": speed}},
                # The steering passes through a delay that the Monte Carlo changes.
                "systems": {
                    DELAY: {"kind": f"{DelayedActuator.__module__}:DelayedActuator", "size": 1, "period": PERIOD}
                },
                "connect": [["ego.steering_command", f"{DELAY}.u"], [f"{DELAY}.y", "ego.steering_reference"]],
                "plant": {"contact": STUDY_CONTACT, **study.plant.model_dump(exclude_unset=True)},
                "duration": self.course(study).duration,
                "seed": study.seed,
            }
        )

    def course(self, study: TuningSpec) -> Course:
        """Return the test manoeuvre, which begins with the step."""
        test = study.test
        duration = test.duration or DURATION
        return Course(0.5 if test.step is None else test.step, 0.0, 0.0, duration, duration)

    def place(self, study: TuningSpec, *path: str | int) -> str:  # noqa: ARG002
        """See :meth:`SignalLoop.place`."""
        return where(study, "loop")

    def make_bench(self, spec: LoopSpec) -> "PathBench":
        """See :meth:`LoopKind.make_bench`."""
        return PathBench(spec)


class PathBench(SignalBench):
    """Test bench of path tracking; built once."""

    @cached_property
    def cut(self) -> CutLoop | None:
        """The loop cut at the steering command, of a car that starts on the path."""
        start = self.spec.diagram["vehicles"][self.spec.vehicle]["start"]
        offset, yaw = self.spec.course.step, start["yaw"]
        on_path = start | {"x": start["x"] + offset * math.sin(yaw), "y": start["y"] - offset * math.cos(yaw)}
        vehicle = self.spec.diagram["vehicles"][self.spec.vehicle] | {"start": on_path}
        on_path_diagram = make_spec(self.spec.diagram | {"vehicles": {self.spec.vehicle: vehicle}})
        # A continuous plant cannot be linearised: the periods of the linear model begin just before one of its steps.
        return cut_loop(assemble(on_path_diagram, continuous=False), self.spec.effort)

    @property
    def operating_time(self) -> float:
        """Time of the operating point [s]."""
        return SETTLED

    def _apply(self, context: Context, conditions: Conditions) -> None:
        """Write the delay of the steering."""
        system: DelayedActuator = self.assembly.diagram.GetSubsystemByName(DELAY)
        system.set_delay(system.GetMyMutableContextFromRoot(context), conditions.delay or 0.0)

    def identify(self) -> Identification:
        """Return the dead time of the loop as that of a double integrator.

        Raises:
            ConfigError: the steering does not act on the offset.
        """
        loops = self.open_loops(self.spec.present)
        crossing = margins_of(*loops[0]).phase_crossover if loops else math.nan
        if not math.isfinite(crossing):
            raise ConfigError("the path is not tracked with the present gains; is the vehicle too fast for it?")
        # -pi + lead - crossing * delay = -pi, with the lead of the PD controller with the present gains.
        (tracker,) = find_trackers(self.assembly)
        gains = tracker.get_gains(tracker.GetMyContextFromRoot(self.assembly.make_context()))
        time = max(gains.convergence_time, gains.convergence_distance / gains.speed)
        delay = math.atan2(2.0 * gains.damping / time * crossing, 1.0 / time**2) / crossing
        parameters = {"gain": Parameter(1.0, "1/s²"), "delay": Parameter(delay, "s")}
        experiment = Experiment("linear_model", "inertia", parameters)
        return Identification(self.spec, (experiment,), inertial=(1.0, delay))
