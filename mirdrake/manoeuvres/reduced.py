"""Runs of manoeuvres with the single-track model, many at once as one batch of cars."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from mirdrake.batched import STEP, Batch, BatchControl
from mirdrake.batched.arrays import Floats
from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres.base import Diverged
from mirdrake.manoeuvres.pilots import PERIOD, PILOTING, make_pilots
from mirdrake.plant.powertrain.system import RATE as POWERTRAIN_RATE
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import estimate_parameters, has_roll, tyres_of
from mirdrake.single_track.parameters import PARAMETERS, SingleTrackParameters
from mirdrake.vehicles import Vehicle

Stop = Callable[[float, Sequence[float]], str | None]
"""Stop condition: function of time [s] and state (12) of the vehicle that returns why the run ends, or None."""

RATE = 200.0
"""Rate of the logs [Hz]: a steering that moves for a tenth of a second needs it."""

STOP_SAMPLES = 10
"""Samples between two evaluations of the stop condition."""

_CHUNK = 1.0
"""Simulated time between two looks at which runs have ended [s]."""

_STATUS = ("speed_setpoint", "steering_setpoint", "speed_trim", "speed_command", "steering_command")
_OUTPUTS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "steering", *_STATUS)
_SIGNALS = (*(signal.name for signal in STATE), "steering_angle", *_STATUS)


@dataclass(frozen=True)
class ReducedCar:
    """Single-track model of a vehicle.

    Attributes:
        vehicle: the vehicle.
        changes: parameters of the model in place of those of the vehicle, by name; its control unit does not know them.
        gains: gains of the control unit in place of those of control.yaml, by name, as ``speed.kp``.
    """

    vehicle: Vehicle
    changes: Mapping[str, float]
    gains: Mapping[str, float]


@dataclass(frozen=True)
class ReducedRun:
    """A run that is to be simulated.

    Attributes:
        label: name of the run.
        car: the car.
        friction: friction of the road [1].
        gravity: gravity in the world [m/s²].
        driver: driver, as under ``control`` of a diagram file.
        x: position of the start [m].
        y: position of the start [m].
        speed: speed at the start [m/s].
        duration: longest simulated time [s].
        stop: stop condition.
    """

    label: str
    car: ReducedCar
    friction: float
    gravity: tuple[float, float, float]
    driver: Mapping[str, Any]
    x: float
    y: float
    speed: float
    duration: float
    stop: Stop | None


@dataclass(frozen=True)
class ReducedLog:
    """Signals of a run.

    Attributes:
        time: times of the samples (n) [s].
        columns: signals (n) by the names that they have in runs of the full plant, and ``steering_angle`` [rad].
        reason: why the run ended.
    """

    time: Floats
    columns: dict[str, Floats]
    reason: str


class ReducedParameters:
    """Parameters of single-track models; those of a vehicle are measured on its model once for each road."""

    def __init__(self) -> None:
        # Vehicles are kept with their parameters, so that the id of one is not that of another one later.
        self._known: dict[tuple[int, float, tuple[float, ...]], tuple[Vehicle, SingleTrackParameters]] = {}

    def find(self, vehicle: Vehicle, friction: float, gravity: tuple[float, float, float]) -> SingleTrackParameters:
        """Return the parameters of a vehicle on a road."""
        key = id(vehicle), friction, gravity
        if key not in self._known:
            parameters = estimate_parameters(vehicle, friction=friction, gravity=gravity, roll=has_roll(vehicle))
            self._known[key] = vehicle, parameters
        return self._known[key][1]


def simulate(
    runs: Sequence[ReducedRun], known: ReducedParameters, *, longest_step: float = STEP
) -> list[ReducedLog | Diverged]:
    """Simulate runs of one vehicle, all as one batch; the result of a run does not depend on the others.

    Args:
        runs: the runs; their cars have the same vehicle.
        known: parameters that are kept.
        longest_step: longest step of the integration [s].

    Returns:
        The log of each run, or why it diverged.

    Raises:
        ConfigError: a parameter, a gain or a setting of a driver is out of range.
    """
    vehicle = runs[0].car.vehicle
    control = _make_control(runs, vehicle, known, longest_step)
    pilots = make_pilots([run.driver for run in runs], vehicle, [run.duration for run in runs])
    # Ticks of the logs in a control period; a chunk is a whole number of both.
    every = round(1.0 / (RATE * control.cars.step_time))
    samples_per_period = Fraction(round(control.period / control.cars.step_time), every)
    periods = samples_per_period.denominator * max(round(_CHUNK / control.period / samples_per_period.denominator), 1)
    watches = [_Watch(run) for run in runs]
    rear_lengths = np.array(control.cars.parameters["rear_length"])
    outputs = _OUTPUTS + _roll_output(control)
    while running := [k for k, watch in enumerate(watches) if watch.runs]:
        chunk = control.drive(PILOTING, pilots, PERIOD, periods=periods, outputs=outputs, every=every)
        # Of cars that have ended nothing is kept.
        rows = chunk.values if len(running) == len(runs) else chunk.values[running]
        samples = _samples(rows, rear_lengths[running])
        for place, k in enumerate(running):
            watches[k].add(samples[:, place], control.cars.diverged[k].item())
            # A run that has ended costs no more time; its car counts as diverged for the batch.
            control.cars.diverged[k] = not watches[k].runs
    return [watch.result() for watch in watches]


def alone(known: ReducedParameters) -> Callable[[ReducedRun], ReducedLog]:
    """Return a function that simulates a run as a batch of one car.

    Args:
        known: parameters that are kept.
    """

    def simulate_one(run: ReducedRun) -> ReducedLog:
        (result,) = simulate([run], known)
        if isinstance(result, Diverged):
            raise result
        return result

    return simulate_one


def _roll_output(control: BatchControl) -> tuple[str, ...]:
    return ("roll", "roll_rate") if control.cars.variant.roll else ()


def _make_control(
    runs: Sequence[ReducedRun], vehicle: Vehicle, known: ReducedParameters, longest_step: float
) -> BatchControl:
    """Return the cars at their starts with their control units."""
    own = [known.find(vehicle, run.friction, run.gravity) for run in runs]
    rows = []
    for run, parameters in zip(runs, own, strict=True):
        rows.append(replace(parameters, **run.car.changes).values())
    # Parameters that differ from those of the first car's vehicle.
    table, nominal = np.array(rows), np.array(own[0].values())
    columns = {name: table[:, k] for k, name in enumerate(PARAMETERS) if (table[:, k] != nominal[k]).any()}
    # A gain that only some cars have differently is that of control.yaml for the others.
    loop, wheel = vehicle.control.speed, vehicle.control.wheel_speed
    usual = {"speed.kp": loop.kp, "speed.ki": loop.ki}
    usual |= {f"wheel_speed.{name}": value for name, value in zip(wheel.gains, wheel.gain_values(), strict=True)}
    names = sorted({name for run in runs for name in run.car.gains})
    gains = {name: np.array([run.car.gains.get(name, usual.get(name, 0.0)) for run in runs]) for name in names}

    # The longest step that divides the periods of all events.
    rate = Fraction(vehicle.control.rate).limit_denominator(1000)
    base = 1.0 / float(np.lcm.reduce([rate.numerator, round(1.0 / PERIOD), round(POWERTRAIN_RATE), round(RATE)]))
    step = base / math.ceil(base / longest_step - 1e-9)
    variant = Variant(tyres_of(vehicle), relaxation=True, actuators=True, roll=has_roll(vehicle))
    cars = Batch(own[0], variant, columns=columns, count=len(runs), step=step)
    start = {name: np.array([getattr(run, name) for run in runs]) for name in ("x", "y")}
    # Only the speed is set; the control unit starts from it, so that a run starts in steady motion.
    cars.reset(**start, vx=np.array([run.speed for run in runs]))
    return BatchControl(cars, vehicle, gains=gains)


def _samples(rows: Floats, rear_lengths: Floats) -> Floats:
    """Return the samples of a chunk (signals, cars, samples): the states as an output port has them, then the others.

    Args:
        rows: outputs (cars, samples, outputs).
        rear_lengths: from the centre of mass to the rear axle, of each car [m].
    """
    signal = dict(zip(_OUTPUTS, np.moveaxis(rows, 2, 0), strict=False))
    zero = np.zeros(rows.shape[:2])
    roll, roll_rate = np.moveaxis(rows[:, :, len(_OUTPUTS) :], 2, 0) if rows.shape[2] > len(_OUTPUTS) else (zero, zero)
    # In [-π, π], as that of the full vehicle; the velocity is that of the rear axle's centre.
    wrapped = np.remainder(signal["yaw"] + math.pi, 2.0 * math.pi) - math.pi
    across = signal["vy"] - rear_lengths[:, None] * signal["yaw_rate"]
    return np.array(
        [
            signal["x"], signal["y"], zero, roll, zero, wrapped, signal["vx"], across, zero, roll_rate, zero,
            signal["yaw_rate"], *(signal[name] for name in ("steering", *_STATUS)),
        ]
    )  # fmt: skip


class _Watch:
    """Collects the samples of a run until it ends.

    Attributes:
        runs: whether the run has not ended.
    """

    def __init__(self, run: ReducedRun) -> None:
        self.runs = True
        self._run = run
        self._parts: list[Floats] = []
        self._count, self._last = 0, int(run.duration * RATE + 1e-6)
        self._reason = "duration"
        self._diverged = False

    def add(self, samples: Floats, diverged: bool) -> None:
        """Add the samples of a chunk (signals, samples)."""
        samples = samples[:, : self._last + 1 - self._count]
        if diverged and not np.isfinite(samples).all():
            self._diverged, self.runs = True, False
            # The run may have ended before.
            samples = samples[:, np.isfinite(samples).all(axis=0)]
        if self._run.stop is not None:
            first = -self._count % STOP_SAMPLES
            states = samples[: len(STATE), first::STOP_SAMPLES].T.tolist()
            for number, state in enumerate(states):
                sample = first + number * STOP_SAMPLES
                reason = self._run.stop((self._count + sample) / RATE, state)
                if reason is not None:
                    self._reason, self._diverged, self.runs = reason, False, False
                    samples = samples[:, : sample + 1]
                    break
        self._parts.append(samples)
        self._count += samples.shape[1]
        if self._count > self._last:
            self.runs = False

    def result(self) -> "ReducedLog | Diverged":
        """Return the log, or why the run diverged."""
        if self._diverged:
            return Diverged(f"{self._run.label}: a state is not finite")
        samples = np.concatenate(self._parts, axis=1)
        return ReducedLog(np.arange(self._count) / RATE, dict(zip(_SIGNALS, samples, strict=True)), self._reason)
