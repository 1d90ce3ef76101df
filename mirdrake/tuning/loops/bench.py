"""The full plant as a bench: trials and experiments. Built once; gains and conditions go to a Context."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.constants import GRAVITY
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, RunError, did_you_mean
from mirdrake.core.pid import PidLimits
from mirdrake.execution.parameters import find_knobs
from mirdrake.plant.wheels import RoadFriction
from mirdrake.runs.telemetry import vehicle_states
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.blocks import LateActuator, NoisySensor
from mirdrake.tuning.loops.judge import AWAY, judge
from mirdrake.tuning.models import Floats
from mirdrake.vehicles import WHEELS

LOOK = 1.0
"""Simulated time between two looks whether a trial has run away [s]."""


def _bicycle_angles(left: Floats, right: Floats) -> Floats:
    from mirdrake.manoeuvres.record import bicycle_angles  # a worker that tunes speeds need not import manoeuvres

    return bicycle_angles(left, right)


class PlantBench:
    """A loop on the full plant.

    Args:
        spec: the loop.

    Raises:
        ConfigError, ModelError, WorldError: the diagram cannot be built.
    """

    def __init__(self, spec: LoopSpec) -> None:
        self.spec = spec
        self.assembly = assemble(make_spec(spec.diagram))
        self.simulator = Simulator(self.assembly.diagram)
        part = self.assembly.parts.vehicles[spec.vehicle]
        self.part = part
        self.period = float(spec.options["period"])
        plant = self.assembly.parts.plant
        self._step = float(plant.time_step())
        self._start: Context | None = None  # and that of the trials, which is set back to it
        self._context: Context | None = None
        knobs = find_knobs({spec.vehicle: part.vehicle}, self.assembly.parts.world)
        self._knobs = {name.removeprefix(f"{spec.vehicle}."): knob for name, knob in knobs.items()}
        self._late: LateActuator = self.assembly.diagram.GetSubsystemByName("late")
        self._noisy: NoisySensor | None = None
        if spec.options["noisy"]:
            self._noisy = self.assembly.diagram.GetSubsystemByName("noisy")
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        self._driven = [WHEELS.index(wheel) for wheel in part.vehicle.spec.driven_wheels()]
        front, rear = part.rolling_radii(plant)
        self.radius = front if self._driven[0] < 2 else rear  # rolling, of the first driven wheel [m]
        actuators = part.steering_actuators
        if spec.kind != "steering":
            actuators = tuple(part.wheel_actuators[i] for i in self._driven)
        self._channels = [int(actuator.input_start()) - first for actuator in actuators]
        limit = min(float(actuator.effort_limit()) for actuator in actuators)
        if spec.kind != "steering":
            limit = min(limit, part.vehicle.spec.powertrain.max_torque / len(self._driven))
        self.limits = PidLimits(-limit, limit) if math.isfinite(limit) else PidLimits()
        if spec.options["pedals"]:
            self.limits = PidLimits(-1.0, 1.0)
        friction = RoadFriction(self.assembly.parts, self.assembly.tyres)
        if friction.varies:
            raise ConfigError("a bench needs a road with the same friction everywhere")

    # --- Contexts ---------------------------------------------------------------------------------------------------

    def context(self, gains: Mapping[str, float], conditions: Conditions) -> Context:
        """A new Context with gains and conditions in it, the car at its start."""
        context = self.assembly.make_context()
        self._set(context, gains, conditions)
        return context

    def _context_again(self, gains: Mapping[str, float], conditions: Conditions) -> Context:
        """The same, but in the Context of the trial before."""
        if self._start is None:
            self._start = self.assembly.make_context()
        context, self._context = self._context, None  # whose trial breaks off is not used again
        if context is None:
            context = self._start.Clone()
            self.simulator.reset_context(context)
        context.SetTimeStateAndParametersFrom(self._start)
        for tap in self.assembly.taps.values():
            tap.sink.FindMutableLog(context).Clear()
        self._tilt(context, 0.0)
        self._set(context, gains, conditions)
        return context

    def _set(self, context: Context, gains: Mapping[str, float], conditions: Conditions) -> None:
        """Write gains and conditions into a Context."""
        spec, assembly = self.spec, self.assembly
        for name, value in gains.items():
            path = spec.paths.get(name)
            if path is None:
                raise ConfigError(f"no gain '{name}'; {did_you_mean(name, spec.paths)}")
            self._knobs[path].turn(assembly, context, float(value))
        if conditions.mass != 1.0:
            self._knobs["mass_scale"].turn(assembly, context, conditions.mass)
        if conditions.friction is not None and conditions.friction != spec.nominal["friction"]:
            self._knobs["road.friction"].turn(assembly, context, conditions.friction)
        delay = spec.nominal["delay"] if conditions.delay is None else conditions.delay
        delay = max(delay + 0.5 * self.period - self._step, 0.0)  # the plant's step is the first part of it
        self._late.set_delay(self._late.GetMyContextFromRoot(context), delay)
        if conditions.grade:
            self._tilt(context, conditions.grade)
        if conditions.noise and self._noisy is not None:
            count = round(spec.course["duration"] / self.period) + 2
            rows = np.random.default_rng(conditions.seed).normal(0.0, conditions.noise, count)
            self._noisy.set_noise(self._noisy.GetMyContextFromRoot(context), self._noisy_places(), rows)
        self.command(context, spec.course["speed"], 0.0)

    def _tilt(self, context: Context, grade: float) -> None:
        """What a grade changes of gravity, as a force on the centre of mass of every body."""
        plant = self.assembly.parts.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        forces = []
        for index in plant.GetBodyIndices(self.part.instance) if grade else ():
            body = plant.get_body(index)
            inertia = body.CalcSpatialInertiaInBodyFrame(plant_context)
            mass = float(inertia.get_mass())
            if mass <= 0.0:
                continue
            force = ExternallyAppliedSpatialForce()
            force.body_index = index
            force.p_BoBq_B = inertia.get_com()
            weight = mass * GRAVITY
            force.F_Bq_W = SpatialForce(
                tau=np.zeros(3), f=[-weight * math.sin(grade), 0.0, weight * (1.0 - math.cos(grade))]
            )
            forces.append(force)
        port = plant.get_applied_spatial_force_input_port()
        port.FixValue(plant_context, Value[list[ExternallyAppliedSpatialForce]](forces))

    def _noisy_places(self) -> list[int]:
        """Elements of the plant's state that the loop measures: angles or speeds of joints, or the car's velocity."""
        plant = self.assembly.parts.plant
        if self.spec.kind == "steering":
            return [int(joint.position_start()) for joint in self.part.steering]
        if self.spec.options["pedals"]:
            return [plant.num_positions() + int(self.part.base.floating_velocities_start_in_v()) + 3]
        return [plant.num_positions() + int(self.part.wheels[i].velocity_start()) for i in self._driven]

    def command(self, context: Context, speed: float, steering: float) -> None:
        """Give the control unit its set-points [m/s, rad]."""
        diagram, name = self.assembly.diagram, self.spec.vehicle
        for port, value in (("speed_reference", speed), ("steering_reference", steering), ("reference_stamp", 0.0)):
            diagram.GetInputPort(f"{name}.{port}").FixValue(context, [value])

    def _push(self, context: Context, setter: Any, value: float, *, apart: bool = False) -> None:
        values = [0.0] * self._late.size
        for at, channel in enumerate(self._channels):
            values[channel] = -value if apart and at else value
        setter(self._late.GetMyContextFromRoot(context), values)

    # --- trials -----------------------------------------------------------------------------------------------------

    def run(
        self,
        gains: Mapping[str, float],
        conditions: Conditions = NOMINAL,
        *,
        course: Mapping[str, Any] | None = None,
        margins: dict[str, float] | None = None,
    ) -> Evaluation:
        """One trial; see :class:`mirdrake.tuning.loops.base.Evaluation`.

        Raises:
            ConfigError: a gain is not known, or a condition out of range.
        """
        course = dict(self.spec.course) | dict(course or {})
        if not all(math.isfinite(value) for value in gains.values()):
            return Evaluation("unstable", reason="a gain is not finite")
        context = self._context_again(gains, conditions)
        try:
            away = self._advance(context, course, noise=conditions.noise)
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[0]
            if not is_divergence(reason):
                raise RunError(reason) from None
            return Evaluation("unstable", reason=reason)
        self._context = context
        t, reference, output, effort = self.signals(context)
        found = judge(
            t,
            reference,
            output,
            effort,
            course=course,
            limits=self.limits,
            noise=conditions.noise,
            margins=margins,
            others=self._others(context, output),
        )
        if away and found.status == "ok":
            return Evaluation("unstable", response=found.response, reason="the output runs away")
        return found

    def _others(self, context: Context, output: Floats) -> dict[str, Floats]:
        """What must not swing either, by what it is: two joints against each other, driven wheels against the road."""
        x = self.assembly.taps["plant_state"].sink.FindLog(context).data()
        if self.spec.kind == "steering":
            left, right = (x[joint.position_start()] for joint in self.part.steering)
            return {"the steered wheels, against each other": np.array(left - right, dtype=float)}
        if self.spec.kind != "speed":
            return {}
        first = self.assembly.parts.plant.num_positions()
        rates = {WHEELS[i]: x[first + self.part.wheels[i].velocity_start()] for i in self._driven}
        return {
            f"the {wheel.replace('_', ' ')} wheel, out of grip,": np.array(self.radius * rate - output, dtype=float)
            for wheel, rate in rates.items()
        }

    def _advance(self, context: Context, course: Mapping[str, Any], *, noise: float = 0.0) -> bool:
        """Drive the course, to its end or until the loop has run away, which no later moment can mend; whether."""
        simulator, spec, step = self.simulator, self.spec, course["step"]
        simulator.Initialize()
        simulator.AdvanceTo(course["step_time"])
        speed = course["speed"] + (step * self.radius if spec.kind == "wheel_speed" else step)
        self.command(context, *((course["speed"], step) if spec.kind == "steering" else (speed, 0.0)))
        start = {"steering": 0.0, "speed": course["speed"]}.get(spec.kind, course["speed"] / self.radius)
        far = (AWAY + 2.0) * abs(step) + 5.0 * noise + abs(start)  # a tiny step is for looking at where it settles
        ends = [course["load_time"], course["duration"]] if course["load"] else [course["duration"]]
        for end in ends:
            while (now := context.get_time()) < end:
                simulator.AdvanceTo(min(now + LOOK, end))
                if not abs(self.measure(context) - start) < far:
                    return True
            if end < course["duration"]:
                self._push(context, self._late.load, course["load"])
        return False

    def signals(self, context: Context) -> tuple[Floats, Floats, Floats, Floats]:
        """Time [s], reference [y], output [y] and effort [u] of a run, a row a period."""
        taps, name, plant = self.assembly.taps, self.spec.vehicle, self.assembly.parts.plant
        log = taps["plant_state"].sink.FindLog(context)
        x = log.data()
        status = taps[f"{name}.status"].sink.FindLog(context).data()
        positions = plant.num_positions()
        if self.spec.kind == "steering":
            left, right = (x[joint.position_start()] for joint in self.part.steering)
            output, reference = _bicycle_angles(left, right), status[1]
        elif self.spec.kind == "speed":
            pose = x[self.part.base.floating_positions_start() :][:7]
            twist = x[positions + self.part.base.floating_velocities_start_in_v() :][:6]
            output, reference = vehicle_states(pose, twist)[6], status[0]
        else:
            rows = [x[positions + self.part.wheels[i].velocity_start()] for i in self._driven]
            output, reference = np.mean(rows, axis=0), status[0] / self.radius
        if self.spec.options["pedals"]:
            late = taps["late.y"].sink.FindLog(context).data()
            effort = late[0] - late[1]
        else:
            effort = taps[f"{name}.joint_torques"].sink.FindLog(context).data()[self._channels[0]]
        return (
            np.array(log.sample_times(), dtype=float),
            np.array(reference, dtype=float),
            np.array(output, dtype=float),
            np.array(effort, dtype=float),
        )

    # --- experiments ------------------------------------------------------------------------------------------------

    def measure(self, context: Context, *, apart: bool = False) -> float:
        """The output now [y]; with `apart` half of what the left steered wheel is ahead of the right one."""
        plant = self.assembly.parts.plant
        x = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(context))
        positions = plant.num_positions()
        if self.spec.kind == "steering":
            left, right = (np.array([x[joint.position_start()]]) for joint in self.part.steering)
            if apart:
                return 0.5 * float(left[0] - right[0])
            return float(_bicycle_angles(left, right)[0])
        if self.spec.kind == "speed":
            pose = x[self.part.base.floating_positions_start() :][:7, None]
            twist = x[positions + self.part.base.floating_velocities_start_in_v() :][:6, None]
            return float(vehicle_states(pose, twist)[6, 0])
        return float(np.mean([x[positions + self.part.wheels[i].velocity_start()] for i in self._driven]))

    def excite(self, context: Context, value: float, *, apart: bool = False) -> None:
        """Add to the control of the loop [u], before the delay, from the next period on; `apart`: less on the right."""
        self._push(context, self._late.excite, value, apart=apart)

    def control_value(self, context: Context, *, apart: bool = False) -> float:
        """What the controller gives now [u], without excitation; with `apart` half of left minus right."""
        port = self._late.u
        values = port.Eval(self._late.GetMyContextFromRoot(context))
        first, second = float(values[self._channels[0]]), float(values[self._channels[-1]])
        return 0.5 * (first - second) if apart else first


class BenchProcess:
    """The plant with open loop: holds a control for a period, gives the output at its end; a process to experiment on.

    Args:
        bench: the plant.
        gains: feedback that stays on; all zero if left out.
        conditions: nominal if left out.
        apart: whether the two steered wheels are pushed, and measured, against each other.
    """

    def __init__(
        self,
        bench: PlantBench,
        gains: Mapping[str, float] | None = None,
        conditions: Conditions = NOMINAL,
        *,
        apart: bool = False,
    ) -> None:
        self.bench, self.period, self.apart = bench, bench.period, apart
        self.context = bench.context(gains or dict.fromkeys(bench.spec.gains, 0.0), conditions)
        self._simulator = Simulator(bench.assembly.diagram, self.context)
        self._simulator.Initialize()
        self._steps = 0
        self.measurement = bench.measure(self.context, apart=apart)

    def __call__(self, control: float) -> float:
        """Hold a control for a period [u]; the output at its end [y]."""
        self.bench.excite(self.context, control, apart=self.apart)
        self._steps += 1
        try:
            self._simulator.AdvanceTo(self._steps * self.period)
        except RuntimeError as error:
            raise RunError(f"experiment on the plant: {str(error).splitlines()[0]}") from None
        self.measurement = self.bench.measure(self.context, apart=self.apart)
        return self.measurement


class BenchLoop(BenchProcess):
    """The plant with closed loop; adds an excitation for a period and gives control and measurement."""

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
        """(control with excitation, measurement at the beginning of the period), both from rest."""
        measured = self.measurement
        self(excitation)
        control = self.bench.control_value(self.context, apart=self.apart) + excitation
        return control - self.rest[0], measured - self.rest[1]
