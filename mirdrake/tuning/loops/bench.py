"""Test bench of the full plant: tests and experiments. Built once; gains and conditions are written to a Context."""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.parts.taps import clear_logs
from mirdrake.core.constants import GRAVITY
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, RunError, did_you_mean, first_line
from mirdrake.core.pid import PidLimits
from mirdrake.execution.parameters import find_context_parameters
from mirdrake.plant.wheels import RoadFriction
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.blocks import DelayedActuator, NoisySensor
from mirdrake.tuning.loops.judge import DIVERGED, judge
from mirdrake.tuning.models import Floats
from mirdrake.vehicles import WHEELS

if TYPE_CHECKING:
    from mirdrake.tuning.identify import Identification
    from mirdrake.tuning.loops.vehicle_loop import VehicleLoop

WAIT = 0.5
"""Mean time that a control waits for the actuator [periods].

Control unit and actuator have the same period and are not synchronised: between two cycles of the actuator, a control
arrives at a time with uniform distribution, and waits for the rest of the cycle. The hold of the control by the
actuator, which delays it by another half a period on average, is simulated.
"""

CHECK_INTERVAL = 1.0
"""Simulated time between two checks for divergence [s]."""


class PlantBench:
    """A loop of a vehicle on the full plant.

    Args:
        spec: the loop.
        kind: its kind.

    Attributes:
        driven: indices of the driven wheels.
        radius: rolling radius of the first driven wheel [m].
        channels: channels of the command that the effort acts on.
        limits: of the effort.

    Raises:
        ConfigError, ModelError, WorldError: the diagram cannot be built.
    """

    def __init__(self, spec: LoopSpec, kind: "VehicleLoop") -> None:
        self.spec, self.kind = spec, kind
        # Assembled once; tests change values in a Context only.
        self.assembly = assemble(make_spec(spec.diagram))
        self.simulator = self.assembly.make_simulator()
        self.plant = plant = self.assembly.parts.plant
        self.part = part = self.assembly.parts.vehicles[spec.vehicle]
        self.period = float(spec.period or 0.0)
        self._initial: Context | None = None  # Context at the start of a test, to which the working one is reset
        self._context: Context | None = None
        # Gains and conditions are parameters of the Context, under the names of the vehicle.
        parameters = find_context_parameters({spec.vehicle: part.vehicle}, self.assembly.parts.world)
        self._parameters = {name.removeprefix(f"{spec.vehicle}."): parameter for name, parameter in parameters.items()}
        self._delay: DelayedActuator = self.assembly.diagram.GetSubsystemByName("delay")
        self._noise: NoisySensor | None = self.assembly.diagram.GetSubsystemByName("noise") if spec.noisy else None

        # Channels of the command count from the vehicle's first actuator.
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        self.driven = [WHEELS.index(wheel) for wheel in part.vehicle.spec.driven_wheels()]
        # One radius converts wheel speed and car speed; driven wheels of both axles use that of the first.
        front, rear = part.rolling_radii(plant)
        self.radius = front if self.driven[0] < 2 else rear
        actuators = kind.actuators(self)
        self.channels = [int(actuator.input_start()) - first for actuator in actuators]
        # The smallest limit of the actuators, so that all of them can follow.
        limit = kind.effort_limit(self, min(float(actuator.effort_limit()) for actuator in actuators))
        self.limits = PidLimits(-limit, limit) if math.isfinite(limit) else PidLimits()
        # A patch of other friction would make the result depend on where the car drives.
        if RoadFriction(self.assembly.parts, self.assembly.tyres).varies:
            raise ConfigError("a test bench needs a road with the same friction everywhere")

    def identify(self) -> "Identification":
        """Return the loop with the model of its kind."""
        return self.kind.identify(self)

    # --- Contexts ---------------------------------------------------------------------------------------------------

    def context(self, gains: Mapping[str, float], conditions: Conditions) -> Context:
        """Return a new Context for experiments, without the speed loop: gains and conditions, the car at its start."""
        context = self.assembly.make_context()
        self._apply(context, gains, conditions)
        for name in ("speed.kp", "speed.ki"):
            if name in self._parameters:
                self._parameters[name].apply(self.assembly, context, 0.0)
        return context

    def _reset_context(self, gains: Mapping[str, float], conditions: Conditions) -> Context:
        """Return the same as :meth:`context`, in the Context of the previous test."""
        # The initial Context is made once; every test starts from its values.
        if self._initial is None:
            self._initial = self.assembly.make_context()
        context, self._context = self._context, None  # the Context of a test that raises is not used again
        if context is None:
            context = self._initial.Clone()
            self.simulator.reset_context(context)
        # Copied into the Context that the simulator holds; fixed inputs and logs are not part of the copy.
        context.SetTimeStateAndParametersFrom(self._initial)
        # Logs are not part of the state and have to be cleared.
        clear_logs(self.assembly.taps.values(), context)
        # Fixed input ports are not reset with the state: remove the forces of the last grade.
        self._set_grade(context, 0.0)
        self._apply(context, gains, conditions)
        return context

    def _apply(self, context: Context, gains: Mapping[str, float], conditions: Conditions) -> None:
        """Write gains and conditions to a Context."""
        spec, assembly = self.spec, self.assembly
        for name, value in gains.items():
            if name not in spec.gains:
                raise ConfigError(f"no gain '{name}'; {did_you_mean(name, spec.gains)}")
            self._parameters[spec.gains[name].path].apply(assembly, context, float(value))
        if conditions.mass != 1.0:
            self._parameters["mass_scale"].apply(assembly, context, conditions.mass)
        # The friction of the loop itself is in the Context already.
        if conditions.friction is not None and conditions.friction != spec.friction:
            self._parameters["road.friction"].apply(assembly, context, conditions.friction)
        delay = spec.delay if conditions.delay is None else conditions.delay
        delay = max(delay + WAIT * self.period, 0.0)
        self._delay.set_delay(self._delay.GetMyContextFromRoot(context), delay)
        if conditions.grade:
            self._set_grade(context, conditions.grade)
        # Own random numbers per test, by the seed of the conditions: equal for all candidates.
        if conditions.noise and self._noise is not None:
            count = round(spec.course.duration / self.period) + 2
            rows = np.random.default_rng(conditions.seed).normal(0.0, conditions.noise, count)
            self._noise.set_noise(self._noise.GetMyContextFromRoot(context), self.kind.noisy_states(self), rows)
        # Commands of the start; the step follows during the run.
        self._command(context, spec.course.speed, 0.0)

    def _set_grade(self, context: Context, grade: float) -> None:
        """Apply the change of gravity by a grade [rad] as a force on the centre of mass of every body."""
        plant = self.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        # The list stays empty on level ground: the port needs a value in any case.
        forces = []
        for index in plant.GetBodyIndices(self.part.instance) if grade else ():
            body = plant.get_body(index)
            inertia = body.CalcSpatialInertiaInBodyFrame(plant_context)
            mass = float(inertia.get_mass())
            # Frames without mass have no weight.
            if mass <= 0.0:
                continue
            force = ExternallyAppliedSpatialForce()
            force.body_index = index
            # At the centre of mass, so that the force has no moment.
            force.p_BoBq_B = inertia.get_com()
            weight = mass * GRAVITY
            # On a grade θ uphill along x, the weight is (-mg sin θ, 0, -mg cos θ). The plant has (0, 0, -mg) already:
            # the force is the difference.
            force.F_Bq_W = SpatialForce(
                tau=np.zeros(3), f=[-weight * math.sin(grade), 0.0, weight * (1.0 - math.cos(grade))]
            )
            forces.append(force)
        port = plant.get_applied_spatial_force_input_port()
        port.FixValue(plant_context, Value[list[ExternallyAppliedSpatialForce]](forces))

    def _command(self, context: Context, speed: float, steering: float) -> None:
        """Set the set-points of the control unit [m/s, rad]."""
        diagram, name = self.assembly.diagram, self.spec.vehicle
        for port, value in (("speed_reference", speed), ("steering_reference", steering), ("reference_stamp", 0.0)):
            diagram.GetInputPort(f"{name}.{port}").FixValue(context, [value])

    def _write_effort(
        self, context: Context, setter: Callable[[Context, list[float]], None], value: float, *, apart: bool = False
    ) -> None:
        """Write an addition to the effort of all channels; with `apart`, of opposite sign after the first."""
        values = [0.0] * self._delay.size
        for place, channel in enumerate(self.channels):
            values[channel] = -value if apart and place else value
        setter(self._delay.GetMyContextFromRoot(context), values)

    # --- tests ------------------------------------------------------------------------------------------------------

    def run(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, *, margins: Mapping[str, float]
    ) -> Evaluation:
        """Run the test manoeuvre with gains.

        Args:
            gains: by name.
            conditions: of the test.
            margins: added to the figures.

        Raises:
            ConfigError: unknown gain, or a condition out of range.
        """
        # NaN in a Context would raise errors far from their cause.
        if not all(math.isfinite(value) for value in gains.values()):
            return Evaluation("unstable", reason="a gain is not finite")
        context = self._reset_context(gains, conditions)
        try:
            diverged = self._advance(context, conditions.noise)
        # Drake reports a plant that diverges as RuntimeError; other errors are not the fault of the gains.
        except RuntimeError as error:
            reason = first_line(error)
            if not is_divergence(reason):
                raise RunError(reason) from None
            return Evaluation("unstable", reason=reason)
        # Kept for the next test only after a run without errors.
        self._context = context
        log = self.assembly.taps["plant_state"]
        status = self.assembly.taps[f"{self.spec.vehicle}.status"].data(context)
        output = np.array(self.kind.output_from(self, log.data(context)), dtype=float)
        result = judge(
            np.array(log.times(context), dtype=float),
            np.array(self.kind.reference_from(self, status), dtype=float),
            output,
            self.kind.effort_from(self, context),
            course=self.spec.course,
            limits=self.limits,
            noise=conditions.noise,
            margins=margins,
            others=self.kind.other_signals(self, log.data(context), output),
        )
        # judge() sees the end of the record; a bound that was exceeded within the run decides as well.
        if diverged and result.status == "ok":
            return Evaluation("unstable", response=result.response, reason="the output diverges")
        return result

    def _advance(self, context: Context, noise: float) -> bool:
        """Simulate the test manoeuvre to its end, or until the loop has diverged; return whether it has."""
        simulator, course = self.simulator, self.spec.course
        # Set-points change after the step time has been reached, so that samples before it are those of the start.
        simulator.Initialize()
        simulator.AdvanceTo(course.step_time)
        self._command(context, *self.kind.command_after_step(self))

        # A tiny step, which shows the steady state only, may not count as divergence: the start is added.
        start = self.kind.initial_output(self)
        bound = (DIVERGED + 2.0) * abs(course.step) + 5.0 * noise + abs(start)
        # Parts of the test, as load and set-point are written between them.
        changes: list[tuple[float, Callable[[], None]]] = []
        if course.load:
            changes.append((course.load_time, lambda: self._write_effort(context, self._delay.set_load, course.load)))
        if course.return_time is not None:
            changes.append((course.return_time, lambda: self._command(context, course.speed, 0.0)))
        changes.sort(key=lambda change: change[0])
        for end, change in [*changes, (course.duration, lambda: None)]:
            # In pieces, so that a diverging run ends early.
            while (now := context.get_time()) < end:
                simulator.AdvanceTo(min(now + CHECK_INTERVAL, end))
                # Negated, so that NaN counts as divergence.
                if not abs(self.measure(context) - start) < bound:
                    return True
            change()
        return False

    # --- experiments ------------------------------------------------------------------------------------------------

    def state(self, context: Context) -> Floats:
        """Return positions and velocities of the plant."""
        return np.asarray(self.plant.GetPositionsAndVelocities(self.plant.GetMyContextFromRoot(context)))

    def measure(self, context: Context) -> float:
        """Return the present output [y]."""
        return float(self.kind.output_from(self, self.state(context)[:, None])[0])

    def measured(self, context: Context, *, apart: bool = False) -> float:
        """Return what the controller measures; with `apart`, half the angle of the left less the right wheel."""
        state = self.state(context)
        if apart:
            left, right = (float(state[joint.position_start()]) for joint in self.part.steering)
            return 0.5 * (left - right)
        return float(self.kind.measured_from(self, state[:, None])[0])

    def excite(self, context: Context, value: float, *, apart: bool = False) -> None:
        """Add to the effort of the loop [u], before the delay, from the next period on."""
        self._write_effort(context, self._delay.set_excitation, value, apart=apart)

    def control_value(self, context: Context, *, apart: bool = False) -> float:
        """Return the present output of the controller [u], without excitation; `apart`: half of left minus right."""
        values = self._delay.u.Eval(self._delay.GetMyContextFromRoot(context))
        first, second = float(values[self.channels[0]]), float(values[self.channels[-1]])
        return 0.5 * (first - second) if apart else first


class BenchProcess:
    """The plant as a process for experiments: holds a control for a period and returns the measurement at its end.

    Args:
        bench: the plant.
        gains: of a feedback that stays closed; by default all zero.
        apart: whether the two steered wheels are driven, and measured, against each other.
        conditions: of the experiment.
    """

    def __init__(
        self,
        bench: PlantBench,
        gains: Mapping[str, float] | None = None,
        *,
        apart: bool = False,
        conditions: Conditions = NOMINAL,
    ) -> None:
        self.bench, self.period, self.apart = bench, bench.period, apart
        self.context = bench.context(gains or dict.fromkeys(bench.spec.gains, 0.0), conditions)
        self._simulator = bench.assembly.make_simulator(self.context)
        self._simulator.Initialize()
        self._steps = 0
        self.measurement = bench.measured(self.context, apart=apart)

    def __call__(self, control: float) -> float:
        """Hold a control for a period [u] and return the measurement at its end."""
        self.bench.excite(self.context, control, apart=self.apart)
        self._steps += 1
        try:
            self._simulator.AdvanceTo(self._steps * self.period)
        except RuntimeError as error:
            raise RunError(f"experiment on the plant: {first_line(error)}") from None
        self.measurement = self.bench.measured(self.context, apart=self.apart)
        return self.measurement


class BenchLoop(BenchProcess):
    """The plant in closed loop, for a measurement of its frequency response.

    Args:
        bench: the plant.
        gains: of the feedback.
        rest: control [u] and measurement at rest, which are subtracted.
        apart: as for :class:`BenchProcess`.
    """

    def __init__(
        self,
        bench: PlantBench,
        gains: Mapping[str, float],
        *,
        rest: tuple[float, float] = (0.0, 0.0),
        apart: bool = False,
    ) -> None:
        super().__init__(bench, gains, apart=apart)
        self.rest = rest

    def step(self, excitation: float) -> tuple[float, float]:
        """Add an excitation for a period; return control with excitation and measurement at its beginning."""
        measured = self.measurement
        self(excitation)
        control = self.bench.control_value(self.context, apart=self.apart) + excitation
        return control - self.rest[0], measured - self.rest[1]
