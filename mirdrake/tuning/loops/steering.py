"""Steering loop: the angle of the steered wheels, by the torque of their joints."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydrake.multibody.tree import JointActuator

from mirdrake.core.errors import MirdrakeError
from mirdrake.tuning.frequency_response import measure_frequency_response
from mirdrake.tuning.identify import (
    LEAST_DEVIATION,
    Identification,
    failed_relay,
    fit_inertial_step,
    fit_joint,
    inertial_experiment,
    measure_step,
    relay_experiment,
)
from mirdrake.tuning.loops.base import NOMINAL, LoopModel
from mirdrake.tuning.loops.bench import BenchLoop, BenchProcess, PlantBench
from mirdrake.tuning.loops.vehicle_loop import VehicleLoop
from mirdrake.tuning.models import FirstOrder, Floats, Integrator, TransferFunction
from mirdrake.tuning.relay import RelayResult, run_relay_test
from mirdrake.tuning.rules import simc, simc_double_integrator
from mirdrake.tuning.spec import TuningSpec
from mirdrake.vehicles import Vehicle

_SLOWEST = 1e-9  # rate of a pole that is taken for zero [1/s]


class SteeringLoop(VehicleLoop):
    """Angle of the steered wheels, by the torque of their joints.

    Wheels that oscillate against each other have no steering angle on average, so their difference is watched as well,
    and identified.
    """

    name: ClassVar[str] = "steering"
    section: ClassVar[str] = "steering"
    reference: ClassVar[str] = "steering_setpoint"
    output: ClassVar[str] = "steering_angle"
    output_unit: ClassVar[str] = "rad"
    initial_speed: ClassVar[float] = 3.0

    def default_step_and_load(self, vehicle: Vehicle, scale: float) -> tuple[float, float]:  # noqa: ARG002
        """See :meth:`VehicleLoop.default_step_and_load`."""
        return min(0.1, 0.5 * vehicle.geometry.steering_limit), 0.0

    def default_duration(self, study: TuningSpec, vehicle: Vehicle, step: float) -> float:  # noqa: ARG002
        """Return 4 s and twenty delays, in which an oscillation at the limit of stability has several periods."""
        return 4.0 + 20.0 * study.test.delay

    def actuators(self, bench: PlantBench) -> tuple[JointActuator, ...]:
        """Return the actuators of the steering joints."""
        return bench.part.steering_actuators

    def noisy_states(self, bench: PlantBench) -> list[int]:
        """Return the angles of the steering joints."""
        return [int(joint.position_start()) for joint in bench.part.steering]

    def output_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the steering angle of the single-track model."""
        from mirdrake.manoeuvres.record import bicycle_angles  # workers that tune speeds need not import manoeuvres

        left, right = (state[joint.position_start()] for joint in bench.part.steering)
        return np.asarray(bicycle_angles(left, right))

    def reference_from(self, bench: PlantBench, status: Floats) -> Floats:  # noqa: ARG002
        """Return the set-point of the steering angle."""
        return np.asarray(status[1])

    def other_signals(self, bench: PlantBench, state: Floats, output: Floats) -> dict[str, Floats]:  # noqa: ARG002
        """Return the difference of the two angles."""
        left, right = (state[joint.position_start()] for joint in bench.part.steering)
        return {"the difference of the steered wheels": np.array(left - right, dtype=float)}

    def initial_output(self, bench: PlantBench) -> float:  # noqa: ARG002
        """Return 0."""
        return 0.0

    def command_after_step(self, bench: PlantBench) -> tuple[float, float]:
        """Return the initial speed and the step."""
        return bench.spec.course.speed, bench.spec.course.step

    def identify(self, bench: PlantBench) -> Identification:
        """Identify the joints, both wheels together and against each other.

        The loop is closed by SIMC from inertia and damping of a joint. A motor behind a gear damps its joint, so that a
        torque gives a speed and not an acceleration: if that lag is shorter than the delay, rules use an integrator,
        otherwise a double integrator.
        """
        spec, period = bench.spec, bench.period
        plant, joint = bench.plant, bench.part.steering[0]
        context = bench.context(dict.fromkeys(spec.gains, 0.0), NOMINAL)
        # Diagonal element of the mass matrix: inertia of the joint with all others held.
        matrix = plant.CalcMassMatrix(plant.GetMyContextFromRoot(context))
        index = int(joint.velocity_start())
        inertia, damping = float(matrix[index, index]), float(joint.default_damping())

        # Gains that hold the joint during the experiments, and a first guess of its model.

        delay = spec.delay + 1.5 * period
        # Damped: torque gives a rate (integrator); the half rule puts half of the lag J / d into the dead time.
        if damping * delay > inertia:
            hold = simc(Integrator(1.0 / damping, delay + 0.5 * inertia / damping))
            gains, start = {"kp": hold.kp, "ki": 0.0, "kd": 0.0}, (1.0 / inertia, damping / inertia, 1.0, delay)
        else:
            hold = simc_double_integrator(1.0 / inertia, delay)
            gains, start = {"kp": hold.kp - hold.ki * delay, "ki": 0.0, "kd": hold.kd}, (1.0 / inertia, 0.5, 1.0, delay)
        # Half of the torque that the proportional part has at the step of the test.
        size = 0.5 * hold.kp * spec.course.step

        # Step of the torque of both joints.
        record = measure_step(bench, size, duration=1.0)
        step, fit = fit_inertial_step(record, start)
        experiments = [inertial_experiment("step_test", step, fit)]

        relay: RelayResult | None = None
        # The relay takes the place of the proportional part; damping by the derivative part remains.
        process = BenchProcess(bench, {**gains, "kp": 0.0})
        try:
            relay = run_relay_test(
                process, period=period, amplitude=size, reference=0.0, duration=15.0, tolerance=0.1, refine=False
            )
            # The ultimate point then belongs to the loop with that derivative part, as the report states.
            experiments.append(replace(relay_experiment(relay), derivative_on=bool(gains["kd"])))
        except MirdrakeError as error:
            experiments.append(failed_relay(error))

        # The road couples the wheels differently if they turn together or against each other: two models.

        # From 1 rad/s to where the dead time takes about 170° of the phase, or 0.3 of the Nyquist frequency.
        wanted = np.geomspace(1.0, min(0.3 * np.pi / period, 3.0 / delay), 12)
        responses, plants = [], []
        for apart in (False, True):
            (response,) = measure_frequency_response(
                BenchLoop(bench, gains, apart=apart).step,
                period=period,
                frequencies=wanted,
                amplitude=size,
                cycles=3,
                settle=1,
            )
            fitted, fit = fit_joint(response, start)
            responses.append(response)
            plants.append(fitted)
            experiments.append(inertial_experiment("wheels_apart" if apart else "frequency_response", fitted, fit))
        main, opposed = plants
        limit = bench.limits.maximum
        model = LoopModel(
            {"main": main, "apart": opposed},
            rise=bench.part.vehicle.geometry.steering_rate,
            # Both directions of the steering have the same rate limit; the mass of the car does not act on the joints.
            fall=bench.part.vehicle.geometry.steering_rate,
            limit=limit if math.isfinite(limit) else None,
            mass_acts=False,
        )
        identified = replace(spec, model=model)

        # Rules take the faster and later of both.
        gain, delay = (max(main.numerator[0], opposed.numerator[0]), max(main.delay, opposed.delay))
        identification = Identification(identified, tuple(experiments), relay=relay, frequency=responses[0])
        first, lag = _damped_model(plants, delay)
        # Rules neglect the lag of the damped inertia if it is shorter than the dead time.
        if lag < delay:
            return replace(identification, first=first, lag=lag)
        return replace(identification, inertial=(gain, delay))


def _damped_model(plants: Sequence[TransferFunction], delay: float) -> tuple[FirstOrder | Integrator, float]:
    """Return the slow part of models of joints, and their fast lag, half of which is in its dead time.

    The slow part is a first order, as the road resists the angle of a rolling wheel (:mod:`mirdrake.tyres.coulomb`).
    It is an integrator if this does not matter: if a controller without integral part, by SIMC, had a static error
    below :data:`mirdrake.tuning.identify.LEAST_DEVIATION`. Half rule and zero as in S. Skogestad, Journal of Process
    Control 13 (2003) 291, section 2.

    Args:
        plants: both wheels together, and against each other, from :func:`mirdrake.tuning.identify.fit_joint`; the
            faster and the later one count.
        delay: dead time without the half rule [s].
    """
    slopes = []
    for plant in plants:
        # A pair of complex poles counts by its real part; the angle of a joint without stiffness has a pole at zero.
        rates = sorted(float(max(-pole.real, _SLOWEST)) for pole in np.roots(plant.denominator))
        slope = plant.numerator[0] / math.prod(rates[1:])
        if len(plant.numerator) > 1:
            # The zero of a relaxing spring is between both slow poles: (1 + T0 s) / (1 + T s) has the gain T0 / T.
            zero, lag = plant.numerator[0] / plant.numerator[1], 1.0 / rates[1]
            slope *= max(zero, delay) / max(lag, delay) / zero
        slopes.append((slope, 1.0 / rates[0], 1.0 / rates[-1]))
    slope = max(slope for slope, _, _ in slopes)
    slow, fast = min(slow for _, slow, _ in slopes), max(fast for _, _, fast in slopes)
    total = delay + 0.5 * fast
    # SIMC: K Kc = T / (2 L), and the static error is 1 / (1 + K Kc).
    if 1.0 / (1.0 + slow / (2.0 * total)) < LEAST_DEVIATION:
        return Integrator(slope, total), fast
    return FirstOrder(slope * slow, slow, total), fast
