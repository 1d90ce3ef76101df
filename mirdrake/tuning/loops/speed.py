"""Loops of speed: that of the driven wheels and that of the car, by wheel torque or by pedals."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydrake.multibody.tree import JointActuator
from pydrake.systems.framework import Context

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import where
from mirdrake.sensors.ground_truth import vehicle_state
from mirdrake.tuning.frequency_response import FrequencyResponse, measure_frequency_response
from mirdrake.tuning.identify import (
    Identification,
    failed_relay,
    fit_factors,
    fit_response,
    measure_step,
    relay_experiment,
    response_fit,
    simple_experiment,
    slow_model,
    step_fit,
)
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Course, LoopModel, LoopSpec, OuterLoop
from mirdrake.tuning.loops.bench import BenchLoop, BenchProcess, PlantBench
from mirdrake.tuning.loops.reduced import outer_factor
from mirdrake.tuning.loops.slip import fault_on_own_slopes, make_slip_model
from mirdrake.tuning.loops.vehicle_loop import VehicleLoop
from mirdrake.tuning.models import FirstOrder, Floats, Integrator, TransferFunction
from mirdrake.tuning.relay import RelayResult, run_relay_test
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.step_test import StepRecord, fit_first_order, fit_integrator
from mirdrake.vehicles import WHEELS, Vehicle, load_vehicle
from mirdrake.vehicles.traction import FRICTION_RESERVE
from mirdrake.worlds import World

SLOPE = 0.6
"""Default slope of the set-point of the speed [m/s²]: feasible for one driven axle at a friction of 0.3, 5° uphill."""

SETTLING = 2.15
"""Time after the ramp of the set-point in which the speed settles [s]; with it the test of a car takes 10 s."""

GRIP = 1.0 - FRICTION_RESERVE
"""Largest share of the grip that the vehicle's own slopes may need in the test [1]; no gains follow steeper ones."""

LEAST_SLOPE = 0.3
"""Smallest part of the vehicle's own slopes for which the largest one that gains follow is searched [1]."""

SLOPE_STEPS = 6
"""Tests of a slope in this search."""

SLOWEST_SPEED = 0.1
"""Speed from which the vehicle's own slopes are driven, over the largest speed of the test [1]."""

BANDWIDTH = 1.0
"""Bandwidth of the speed loop that is closed during the experiments [rad/s]."""

SLOWEST = 100.0
"""Time constant over delay above which a first-order model counts as an integrator: the experiment is too short."""


LINES = 24
"""Frequencies of the response: an experiment has all of them at once."""

LONG = 1.5
"""Duration of a run that measures the rolling radius; its last third counts [s]."""

HEAVY = 1.2
"""Factor on the mass in such a run."""


def spin_states(bench: PlantBench) -> list[int]:
    """Return the elements of the plant's state that are the spin rates of the driven wheels."""
    first = bench.plant.num_positions()
    return [first + int(bench.part.wheels[wheel].velocity_start()) for wheel in bench.driven]


def spin_rate(bench: PlantBench, state: Floats) -> Floats:
    """Return the mean spin rate of the driven wheels [rad/s] of each column of plant states."""
    return np.asarray(np.mean([state[row] for row in spin_states(bench)], axis=0))


def car_speed(bench: PlantBench, state: Floats) -> Floats:
    """Return the longitudinal velocity of the car [m/s] of each column of plant states."""
    base, first = bench.part.base, bench.plant.num_positions()
    pose = state[base.floating_positions_start() :][:7]
    twist = state[first + base.floating_velocities_start_in_v() :][:6]
    return np.asarray(vehicle_state(pose, twist)[6])


def radius_per_mass(bench: PlantBench, drag: float) -> float:
    """Measure the relative change of the rolling radius of the driven wheels per relative change of the mass [1].

    Args:
        bench: the bench; its loop is open.
        drag: effort that holds the speed [u].
    """

    def radius(conditions: Conditions) -> float:
        process = BenchProcess(bench, conditions=conditions)
        values = []
        for _ in range(round(LONG / bench.period)):
            process(drag)
            state = bench.state(process.context)[:, None]
            values.append(float(car_speed(bench, state)[0] / spin_rate(bench, state)[0]))
        return float(np.mean(values[2 * len(values) // 3 :]))

    return (radius(Conditions(mass=HEAVY)) / radius(NOMINAL) - 1.0) / (HEAVY - 1.0)


class WheelSpeedLoop(VehicleLoop):
    """Speed of the driven wheels, by the torque of their joints.

    In the test the speed loop around it is switched off (its gains are zero), so that its set-point passes through.
    """

    name: ClassVar[str] = "wheel_speed"
    uses_traction: ClassVar[bool] = True
    reference: ClassVar[str] = "wheel_speed_setpoint"
    output: ClassVar[str] = "driven wheels"
    output_unit: ClassVar[str] = "rad/s"

    def of_vehicle(
        self, study: TuningSpec, vehicle: Vehicle, world: World, *, noise: bool | None, speed: float | None
    ) -> LoopSpec:
        """See :meth:`VehicleLoop.of_vehicle`."""
        if vehicle.control.wheel_speed.uses_pedals:
            raise ConfigError(
                f"{where(study, 'loop')}: {vehicle.name} is driven by pedals and has no wheel-speed loop; "
                "write loop: speed"
            )
        return super().of_vehicle(study, vehicle, world, noise=noise, speed=speed)

    def test_control(self, study: TuningSpec) -> dict[str, dict[str, object]]:
        """Return the limits of the slope of the speed's set-point, and a speed loop that is switched off."""
        return {"speed": {**_slopes(study), "kp": 0.0, "ki": 0.0}}

    def default_step_and_load(self, vehicle: Vehicle, scale: float) -> tuple[float, float]:
        """Return a step of 2 m/s, or less for a small car, and the load of a grade of about 2.5 %."""
        driven = len(vehicle.spec.driven_wheels())
        return round(2.0 * scale, 2), -0.05 * vehicle.spec.powertrain.max_torque / driven

    def default_duration(self, study: TuningSpec, vehicle: Vehicle, step: float) -> float:
        """See :meth:`VehicleLoop.default_duration`; the load acts from 60 % of the time on."""
        slope = SLOPE if study.test.slope is None else study.test.slope
        ramp = abs(step) * self.speed_per_output(vehicle) / slope
        return (study.test.step_time + ramp + SETTLING) / 0.6

    def speed_per_output(self, vehicle: Vehicle) -> float:
        """Return the speed of the car over the output [m/s per y]."""
        geometry = vehicle.geometry
        front = vehicle.spec.driven_wheels()[0].startswith("front")
        return geometry.front_wheel_radius if front else geometry.rear_wheel_radius

    def at_own_slopes(self, loop: LoopSpec) -> LoopSpec:
        """Return a loop whose test is from a low speed to the largest speed of the study's test and back.

        The set-point has the slopes of the vehicle's control.yaml, as in a run, up to what the tyres can follow.
        """
        limits = load_vehicle(loop.diagram["vehicles"][loop.vehicle]["model"]).control.speed
        rise, fall = limits.max_acceleration, limits.max_deceleration
        if loop.model is not None and loop.model.slip is not None:
            rise = min(rise, GRIP * loop.model.slip.largest())
            fall = min(fall, GRIP * loop.model.slip.largest(backward=True))
        return self.at_slopes(loop, rise, fall)

    def followed_slopes(self, loop: LoopSpec, gains: Mapping[str, float]) -> dict[str, float]:
        """Return the largest slopes that gains follow on the slip model, by key of control.yaml.

        Slopes that they follow as they are, are left out; without a slope that they follow, there are none.

        Args:
            loop: the loop, with its slip model.
            gains: by name.
        """
        own = self.at_own_slopes(loop)
        limits = own.diagram["vehicles"][own.vehicle]["control"]["speed"]
        names = ("max_acceleration", "max_deceleration")
        slopes = {name: LEAST_SLOPE * limits[name] for name in names}
        if fault_on_own_slopes(self.at_slopes(loop, *slopes.values()), gains):
            return {}
        needed = {}
        for name in names:
            low, high = slopes[name], float(limits[name])
            tried = high
            for _ in range(SLOPE_STEPS):
                fails = bool(fault_on_own_slopes(self.at_slopes(loop, *(slopes | {name: tried}).values()), gains))
                low, high = (low, tried) if fails else (tried, high)
                if not fails and tried == limits[name]:
                    break
                tried = 0.5 * (low + high)
            slopes[name] = low
            if low < limits[name]:
                needed[name] = low
        return needed

    def at_slopes(self, loop: LoopSpec, rise: float, fall: float) -> LoopSpec:
        """See :meth:`LoopKind.at_slopes`."""
        entry = loop.diagram["vehicles"][loop.vehicle]
        scale = self.speed_per_output(load_vehicle(entry["model"]))
        top = max(loop.course.speed, loop.course.speed + loop.course.step * scale)
        low = SLOWEST_SPEED * top
        model = loop.model
        if model is not None:
            # The model of the loop is in its units.
            model = replace(model, start=low / scale, rise=rise / scale, fall=fall / scale)

        slopes = {"max_acceleration": rise, "max_deceleration": fall}

        def with_slopes(control: Json) -> Json:
            return {**control, "speed": {**control["speed"], **slopes}}

        changed = {**entry, "speed": low, "control": with_slopes(entry["control"])}
        back = loop.course.step_time + (top - low) / rise + SETTLING
        duration = back + (top - low) / fall + SETTLING
        return replace(
            loop,
            model=model,
            diagram={**loop.diagram, "vehicles": {**loop.diagram["vehicles"], loop.vehicle: changed}},
            # The present controllers have the same slopes.
            test_control=with_slopes(loop.test_control),
            course=replace(
                loop.course, speed=low, step=(top - low) / scale, load=0.0, return_time=back, duration=duration
            ),
        )

    def actuators(self, bench: PlantBench) -> tuple[JointActuator, ...]:
        """Return the actuators of the driven wheels."""
        return tuple(bench.part.wheel_actuators[wheel] for wheel in bench.driven)

    def effort_limit(self, bench: PlantBench, actuator_limit: float) -> float:
        """Return the limit of the actuators, or of the powertrain if that is smaller."""
        return min(actuator_limit, bench.part.vehicle.spec.powertrain.max_torque / len(bench.driven))

    def noisy_states(self, bench: PlantBench) -> list[int]:
        """Return the speeds of the driven wheels."""
        return spin_states(bench)

    def output_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the mean speed of the driven wheels."""
        return spin_rate(bench, state)

    def reference_from(self, bench: PlantBench, status: Floats) -> Floats:
        """Return the set-point of the speed as a wheel speed."""
        return np.asarray(status[0] / bench.radius)

    def initial_output(self, bench: PlantBench) -> float:
        """Return the wheel speed of the car before the step."""
        return bench.spec.course.speed / bench.radius

    def command_after_step(self, bench: PlantBench) -> tuple[float, float]:
        """Return the speed after a step of the wheel speed."""
        return bench.spec.course.speed + bench.spec.course.step * bench.radius, 0.0

    def model(self, bench: PlantBench, plant: TransferFunction, drag: float) -> LoopModel:
        """Return the model of the loop around an identified plant from wheel torque to wheel speed."""
        mass, speed = self._mass(bench), bench.part.vehicle.control.speed
        limit = bench.limits.maximum
        # Per driven wheel and in wheel speed: mass m r² / n as inertia, weight m g r / n.
        return LoopModel(
            {"main": plant},
            scale=self._scale(bench),
            start=bench.spec.course.speed * (1.0 / bench.radius),
            rise=speed.max_acceleration * (1.0 / bench.radius),
            fall=speed.max_deceleration * (1.0 / bench.radius),
            feedforward=mass * bench.radius / len(bench.driven) * bench.radius,
            weight=mass * GRAVITY * bench.radius / len(bench.driven),
            drag=drag,
            limit=limit if math.isfinite(limit) else None,
        )

    def _scale(self, bench: PlantBench) -> float:  # noqa: ARG002
        """Return wheel speed per output."""
        return 1.0

    def _outer(self, bench: PlantBench) -> OuterLoop | None:  # noqa: ARG002
        """Return the loop around this one; None without one."""
        return None

    def _inertia(self, bench: PlantBench) -> float:
        """Return the torque of a driven wheel per acceleration of the wheels [kg m²]."""
        return self._mass(bench) * bench.radius / len(bench.driven) * bench.radius

    def _mass(self, bench: PlantBench) -> float:
        return float(bench.plant.CalcTotalMass(bench.plant.CreateDefaultContext(), [bench.part.instance]))

    def identify(self, bench: PlantBench) -> Identification:
        """Identify the car from wheel torque to wheel speed, while it drives straight.

        In the frequency response the loop is closed by a bandwidth of 1 rad/s, from the mass.
        """
        spec, period = bench.spec, bench.period
        inertia = self._inertia(bench)
        # Kp = ω J gives an integrator 1 / (J s) the crossover ω.
        hold = {"kp": BANDWIDTH * inertia, "ki": 0.0, "kd": 0.0}
        limit = bench.limits.maximum

        # Eight seconds in closed loop; the torque that remains is that of the resistances.
        rest = BenchProcess(bench, hold)
        for _ in range(round(8.0 / period)):
            rest(0.0)
        drag, steady = bench.control_value(rest.context), rest.measurement

        # A tenth of the largest torque is visible, and far from the limits of grip.
        step, record = self._step(bench, 0.1 * limit, drag)
        experiments = [simple_experiment("step_test", step, fit_percent=step_fit(record, step))]
        relay: RelayResult | None = None
        try:
            relay = self._relay(bench, 0.2 * limit, drag)
            experiments.append(relay_experiment(relay))
        # Without a limit cycle the other experiments are sufficient.
        except MirdrakeError as error:
            experiments.append(failed_relay(error))

        # Deviations from rest: the spectra must not contain the torque of the resistances.
        responses = self._responses(bench, BenchLoop(bench, hold, rest=(drag, steady)), 0.1 * limit)
        # The controller sees the measurement, and the output through the proportional part of the speed loop.
        outer = self._outer(bench)
        kp = 0.0 if outer is None else outer.kp
        response = replace(responses[0], values=(responses[0].values + kp * responses[-1].values) / (1.0 + kp))
        # First guess: an inertia with a time constant of 2 s, and the dead time of actuator and control unit.
        plain, _ = fit_response(response, (1.0 / inertia, 2.0, spec.delay + period), order=1)
        main, factors = fit_factors(responses, plain)
        model = replace(
            self.model(bench, main, drag),
            slip=make_slip_model(bench),
            measured=factors[0],
            output=factors[1] if len(factors) > 1 else None,
            radius_per_mass=radius_per_mass(bench, drag),
        )

        # Rules use a first-order model; margins and tests also the motion of the car on its tyres.
        share = TransferFunction((1.0 / (1.0 + kp),), (1.0,))
        seen = slow_model(main, outer_factor(model, kp, 0.0) * share)
        first = FirstOrder(seen.numerator[0] / seen.denominator[1], 1.0 / seen.denominator[1], seen.delay)
        # The experiment is too short to tell so long a time constant from an integrator.
        slow = first.time_constant > SLOWEST * max(first.delay, 1e-3)
        ruled = Integrator(first.gain / first.time_constant, first.delay) if slow else first
        experiments.append(simple_experiment("frequency_response", ruled, fit_percent=response_fit(response, seen)))
        return Identification(
            replace(spec, model=model),
            tuple(experiments),
            first=ruled,
            relay=relay,
            frequency=response,
        )

    def _step(self, bench: PlantBench, size: float, drag: float) -> tuple[FirstOrder | Integrator, StepRecord]:
        """Fit a model to the response to a step of the torque [u], about the torque that holds the speed."""
        record = measure_step(bench, size, duration=6.0, control=drag)
        # A step of torque rarely settles within 6 s, as the mass is large: then an integrator.
        try:
            return fit_first_order(record), record
        except RunError:
            return fit_integrator(record), record

    def _relay(self, bench: PlantBench, size: float, drag: float) -> RelayResult:
        """Make a relay test about the torque that holds the speed.

        Raises:
            MirdrakeError: there is no limit cycle.
        """
        process = BenchProcess(bench)
        start = process.measurement
        return run_relay_test(
            process, period=bench.period, amplitude=size, reference=start, measurement=start, control=drag,
            duration=15.0, tolerance=0.1,
        )  # fmt: skip

    def _responses(self, bench: PlantBench, loop: BenchLoop, size: float) -> tuple[FrequencyResponse, ...]:
        """Measure the frequency response of the measurement and, if it is another signal, of the output times scale."""
        other, scale = self.output != WheelSpeedLoop.output, self._scale(bench)

        def excite(excitation: float) -> tuple[float, ...]:
            output = (bench.measure(loop.context) * scale,) if other else ()
            return (*loop.step(excitation), *output)

        # At the highest frequency the dead time turns the phase by 4 rad at most.
        top = min(0.4 * math.pi / bench.period, 4.0 / (bench.spec.delay + bench.period))
        frequencies = np.geomspace(0.5, top, LINES)
        return measure_frequency_response(
            excite, period=bench.period, frequencies=frequencies, amplitude=size, cycles=2, settle=1
        )


def _slopes(study: TuningSpec) -> dict[str, object]:
    """Return the limits of the slope of the speed's set-point in the test."""
    slope = SLOPE if study.test.slope is None else study.test.slope
    return {"max_acceleration": slope, "max_deceleration": slope}


class SpeedLoop(WheelSpeedLoop):
    """Speed of the car, by the torque of the wheel joints; of a car with pedals, by the pedals.

    The speed loop of control.yaml around that of the wheels is part of the loop and keeps its gains.
    """

    name: ClassVar[str] = "speed"
    reference: ClassVar[str] = "speed_setpoint"
    output: ClassVar[str] = "vx"
    output_unit: ClassVar[str] = "m/s"

    def of_vehicle(
        self, study: TuningSpec, vehicle: Vehicle, world: World, *, noise: bool | None, speed: float | None
    ) -> LoopSpec:
        """See :meth:`VehicleLoop.of_vehicle`."""
        if vehicle.control.wheel_speed.uses_pedals and self.selectable:
            return PedalSpeedLoop().of_vehicle(study, vehicle, world, noise=noise, speed=speed)
        return VehicleLoop.of_vehicle(self, study, vehicle, world, noise=noise, speed=speed)

    def test_control(self, study: TuningSpec) -> dict[str, dict[str, object]]:
        """Return the limits of the slope of the speed's set-point."""
        return {"speed": _slopes(study)}

    def speed_per_output(self, vehicle: Vehicle) -> float:  # noqa: ARG002
        """Return 1."""
        return 1.0

    def output_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the longitudinal velocity of the car."""
        return car_speed(bench, state)

    def measured_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the mean spin rate of the driven wheels."""
        return spin_rate(bench, state)

    def reference_from(self, bench: PlantBench, status: Floats) -> Floats:  # noqa: ARG002
        """Return the set-point of the speed."""
        return np.asarray(status[0])

    def other_signals(self, bench: PlantBench, state: Floats, output: Floats) -> dict[str, Floats]:
        """Return the slip speed of each driven wheel: a car whose wheel slip oscillates can have a smooth speed."""
        return {
            f"the slip of the {WHEELS[wheel].replace('_', ' ')} wheel": np.array(
                bench.radius * state[row] - output, dtype=float
            )
            for wheel, row in zip(bench.driven, spin_states(bench), strict=True)
        }

    def initial_output(self, bench: PlantBench) -> float:
        """Return the speed before the step."""
        return bench.spec.course.speed

    def command_after_step(self, bench: PlantBench) -> tuple[float, float]:
        """Return the speed after the step."""
        return bench.spec.course.speed + bench.spec.course.step, 0.0

    def model(self, bench: PlantBench, plant: TransferFunction, drag: float) -> LoopModel:
        """Return the model of the loop; its output is the speed of the car, its measurement that of the wheels."""
        speed = bench.part.vehicle.control.speed
        return replace(
            super().model(bench, plant, drag),
            start=bench.spec.course.speed,
            rise=speed.max_acceleration,
            fall=speed.max_deceleration,
            feedforward=self._mass(bench) * bench.radius / len(bench.driven),
            outer=self._outer(bench),
        )

    def _outer(self, bench: PlantBench) -> OuterLoop | None:
        """Return the speed loop of control.yaml."""
        speed = bench.part.vehicle.control.speed
        return OuterLoop(speed.kp, speed.ki, speed.max_correction) if speed.kp or speed.ki else None

    def _scale(self, bench: PlantBench) -> float:
        return 1.0 / bench.radius


class PedalSpeedLoop(SpeedLoop):
    """Speed of a car by its pedals."""

    name: ClassVar[str] = "speed_by_pedals"
    selectable: ClassVar[bool] = False
    effort: ClassVar[str] = "pedals"
    effort_unit: ClassVar[str] = "1"
    delayed_ports: ClassVar[tuple[str, str]] = ("pedals", "pedals_reference")

    def gain_units(self, vehicle: Vehicle) -> dict[str, str]:
        """Return the gains of the vehicle's pedal controller."""
        return vehicle.control.wheel_speed.gains

    def settings(self, filter_time: float) -> dict[str, float | str]:  # noqa: ARG002
        """Return nothing: the pedal controller has no other kind."""
        return {}

    def channels(self, vehicle: Vehicle) -> int:  # noqa: ARG002
        """Return the number of pedal signals."""
        return 3

    def course(self, study: TuningSpec, vehicle: Vehicle, speed: float | None) -> Course:
        """Return the test manoeuvre of a speed loop, without the load."""
        return replace(super().course(study, vehicle, speed), load=0.0)

    def effort_limit(self, bench: PlantBench, actuator_limit: float) -> float:  # noqa: ARG002
        """Return 1, a pedal to the floor."""
        return 1.0

    def noisy_states(self, bench: PlantBench) -> list[int]:
        """Return the longitudinal velocity of the car."""
        return [bench.plant.num_positions() + int(bench.part.base.floating_velocities_start_in_v()) + 3]

    def measured_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the longitudinal velocity of the car."""
        return car_speed(bench, state)

    def effort_from(self, bench: PlantBench, context: Context) -> Floats:
        """Return throttle minus brake."""
        pedals = bench.assembly.taps["delay.y"].data(context)
        return np.array(pedals[0] - pedals[1], dtype=float)

    def identify(self, bench: PlantBench) -> Identification:
        """Return the model that follows from the data of the vehicle.

        The pedal controller converts an acceleration to pedals by the powertrain's own maps, so that an integrator
        behind lag and delay of the actuators is left.
        """
        spec, speed = bench.spec, bench.part.vehicle.control.speed
        # Delays in series add: study, throttle, and one period of the unit.
        throttle = bench.part.vehicle.spec.actuators.throttle
        delay = spec.delay + throttle.delay + bench.period
        # (T s + 1) s: the pedal controller makes the acceleration the input; the floor keeps the order.
        main = TransferFunction((1.0,), (max(throttle.time_constant, 1e-3), 1.0, 0.0), delay)
        # The whole lag counts as dead time, which is more cautious than the half rule.
        first = Integrator(1.0, delay + throttle.time_constant)
        model = LoopModel(
            {"main": main},
            start=spec.course.speed,
            rise=speed.max_acceleration,
            fall=speed.max_deceleration,
            feedforward=1.0,
            weight=GRAVITY,
        )
        return Identification(replace(spec, model=model), (simple_experiment("vehicle_data", first),), first=first)
