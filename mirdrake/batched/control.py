"""Control units of the cars of a batch: speed and steering loop of control.yaml in the compiled loop."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.batched.cars import Batch
from mirdrake.batched.control_kernel import DRIVE_PARTS, UnitNumbers, ackermann_rolling, drive, unior_rolling
from mirdrake.batched.path import NO_PATH, PathDriver
from mirdrake.batched.records import BatchRun
from mirdrake.controllers.ackermann import SteeringNumbers
from mirdrake.controllers.control_step import LAST, ControlSetup
from mirdrake.core.compiled import Records, compiled, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.pid import PidGains, PidNumbers
from mirdrake.core.signals import Signals, signals
from mirdrake.core.vectors import PATH_ERROR
from mirdrake.single_track.control import SingleTrackControl
from mirdrake.single_track.dynamics import lateral_force_of
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.joint_control.base import NoNumbers

STATUS = signals(
    ("speed_setpoint", "m/s", "set-point of the speed, before the trim"),
    ("steering_setpoint", "rad", "bicycle steering angle after limit and rate"),
    ("speed_trim", "m/s", "correction by the speed loop"),
)


COMMANDS = signals(
    ("speed_command", "m/s", "command that the unit received"),
    ("steering_command", "rad", "command that the unit received"),
)


class BatchControl:
    """Control units of the cars of a batch.

    Each car has the control unit of :func:`mirdrake.single_track.make_single_track_vehicle`, with gains, delay and
    noise of its own: watchdog, limits and rates of the set-points, steering actuator, speed loop, wheel loops. The
    batch has a variant with actuators. A unit runs at the rate of control.yaml and reads the state at the control
    instant; its outputs act after the delay.

    Attributes:
        cars: the batch.
        period: control period [s].

    Args:
        cars: the batch.
        vehicle: vehicle whose control.yaml is used.
        gains: values (n) of gains that differ between the cars: ``speed.kp``, ``speed.ki``, ``wheel_speed.kp``, ….
        delay: delay of the actuators [s], one for all or one per car; multiples of the control period.
        noise: standard deviation of the measured speed [m/s], one for all or one per car.
        seed: seed of the noise.

    Raises:
        ConfigError: the variant has no actuators, the vehicle is driven by pedals, an unknown gain, or a delay or step
            that does not fit the control period.
    """

    def __init__(
        self,
        cars: Batch,
        vehicle: Vehicle,
        *,
        gains: Mapping[str, ArrayLike] | None = None,
        delay: ArrayLike = 0.0,
        noise: ArrayLike = 0.0,
        seed: int = 0,
    ) -> None:
        wheel = vehicle.control.wheel_speed
        _check_vehicle(cars, vehicle)
        self.cars, self.period, self._seed = cars, 1.0 / vehicle.control.rate, np.uint64(seed)
        # The unit acts at whole steps only: a period between two steps would change its sampling and with it its delay.
        self._steps = round(self.period / cars.step_time)
        if self._steps < 1 or abs(self._steps * cars.step_time - self.period) > 1e-9:
            raise ConfigError(
                f"batch: a step of {cars.step_time:g} s does not divide the control period of {self.period:g} s; take "
                f"for example {self.period / max(self._steps, 1):g} s"
            )
        nominal = cars.nominal  # the unit does not know how the cars differ
        self._unit = SingleTrackControl(vehicle, mass=nominal.mass, rotating=nominal.rotating_mass)
        self._delays = self._delay_steps(delay)
        self._noise = self._per_car("noise", noise)
        self._numbers = self._make_numbers(vehicle, gains or {})
        # Steering and wheel laws are compiled into the loop, as Numba cannot call a method that is chosen at run time.
        rolling = ackermann_rolling if vehicle.spec.steering.law == "ackermann" else unior_rolling
        laws = (lateral_force_of(cars.variant), rolling, wheel.torque_law())
        self._drive: Callable[..., None] = compiled(
            drive, laws, parts=[*DRIVE_PARTS, *wheel.law_parts, rolling], nogil=True
        )
        self.start()

    def start(self) -> None:
        """Start the units from the present speeds and steering angles, so that the set-points do not jump."""
        # The memory of a unit at rest depends on its angle only; cars that share an angle share the computation.
        speeds, angles = self.cars["vx"], self.cars["steering"]
        memories: dict[float, Floats] = {}
        rows = []
        for speed, angle in zip(speeds.tolist(), angles.tolist(), strict=True):
            if angle not in memories:
                memories[angle] = self._unit.starting_memory(0.0, angle)
            row = memories[angle].copy()
            row[LAST] = speed
            rows.append(row)
        self._memory: Floats = np.array(rows)
        # Until the first delayed output acts, servos hold the present angle and speed; drive force and rate are zero.
        self._delayed: Floats = np.zeros((self.cars.count, int(self._delays.max()) + 1, 5))
        self._delayed[:, :, 0] = angles[:, None]
        self._delayed[:, :, 4] = speeds[:, None] * self._unit.true_over_believed
        self._tracked: Floats = np.zeros((self.cars.count, 9))
        self._periods = 0

    def run(self, commands: ArrayLike, *, outputs: Sequence[str] | None = None, every: int = 1) -> BatchRun:
        """Drive all cars under commands, one row per control period.

        Args:
            commands: speed [m/s] and steering [rad] (periods, 2) for all cars, or (n, periods, 2). A row with NaN
                counts as no message: the watchdog stops the car after its timeout.
            outputs: names of the signals that are returned; by default all of :meth:`signals`.
            every: control periods between two rows of the result.

        Returns:
            Signals at control instants, before the step of the unit; the status is that after it.

        Raises:
            ConfigError: wrong shape, or an unknown signal.
        """
        return self._run(self._check_commands(commands), NO_PATH, outputs, every)

    def follow(
        self, driver: PathDriver, *, periods: int, outputs: Sequence[str] | None = None, every: int = 1
    ) -> BatchRun:
        """Drive all cars along a track; further calls continue.

        Args:
            driver: path tracker of each car.
            periods: number of control periods.
            outputs: see :meth:`run`; the path error is that after the step of the tracker.
            every: see :meth:`run`.

        Raises:
            ConfigError: an unknown signal, or a driver that does not fit the cars.
        """
        # The kernel takes the number of periods from the shape of the commands, whose values are not read on a track.
        unused = np.zeros((1, check_count("periods", periods), 2))
        return self._run(unused, driver.numbers(self.cars.count, self.period), outputs, every)

    def _check_commands(self, commands: ArrayLike) -> Floats:
        """Return commands (1 or n, periods, 2)."""
        rows: Floats = np.asarray(commands, dtype=float)
        rows = rows[None] if rows.ndim == 2 else rows
        if rows.ndim != 3 or rows.shape[2] != 2 or rows.shape[0] not in (1, self.cars.count) or rows.shape[1] < 1:
            raise ConfigError(
                f"batch: commands have the shape {np.shape(commands)}; give (periods, 2), speed and steering, for all "
                f"{self.cars.count} cars, or such an array per car"
            )
        return rows

    def _run(self, rows: Floats, path: tuple[Any, ...], outputs: Sequence[str] | None, every: int) -> BatchRun:
        """Drive all cars under commands, or along a path."""
        periods = rows.shape[1]
        time = (self._periods + np.arange(periods)) * self.period
        # The stamp of a command is its own control instant: it is never old, and only rows with NaN are missing
        # messages.
        stamped = np.empty((*rows.shape[:2], 3))
        stamped[..., :2], stamped[..., 2] = rows, time
        contents = self._contents(outputs)
        names = [signal.name for signal in self.signals()]
        columns = np.array([names.index(signal.name) for signal in contents])
        # Rounded up: row 0 is the first period, and every further row `every` periods later.
        values = np.empty((self.cars.count, -(-periods // check_count("every", every)), len(columns)))
        cars = self.cars
        arguments = (
            *cars.model(), *self._numbers, *path, stamped, self._noise, self._seed,
            self._periods, int(every), cars.step_time, self._steps, columns,
        )  # fmt: skip
        changed = (cars.state, cars.diverged, self._memory, self._delayed, self._delays, self._tracked, values)
        cars.share(self._drive, arguments, changed)
        self._periods += periods
        cars.time += periods * self.period
        return BatchRun(np.array(time[::every], dtype=np.float64), values, contents, cars.diverged_cars)

    def signals(self) -> Signals:
        """Return the signals that a run can have: states, motion, status, path error, commands."""
        return (*self.cars.signals(), *STATUS, *PATH_ERROR, *COMMANDS)

    def _contents(self, outputs: Sequence[str] | None) -> Signals:
        """Return the signals of some names; all if None."""
        known = {signal.name: signal for signal in self.signals()}
        for name in outputs or ():
            if name not in known:
                raise ConfigError(f"batch: no signal '{name}'; {did_you_mean(name, known)}")
        return tuple(known[name] for name in (known if outputs is None else outputs))

    def _per_car(self, name: str, values: ArrayLike) -> Floats:
        """Return values as an array (n), checked to be numbers that are not negative."""
        given = np.asarray(values, dtype=float)
        if given.shape not in ((), (self.cars.count,)) or not (np.isfinite(given) & (given >= 0.0)).all():
            raise ConfigError(
                f"batch: {name} must be a number of 0 or more, or one per car; there are {self.cars.count} cars, and "
                f"the values have the shape {given.shape}"
            )
        return np.array(np.broadcast_to(given, (self.cars.count,)))

    def _delay_steps(self, delay: ArrayLike) -> Integers:
        """Return the delays in control periods (n)."""
        delays = self._per_car("delay", delay)
        # The ring of outputs has a place for each period, so a delay between two periods cannot be represented.
        steps: Integers = np.rint(delays / self.period).astype(np.int64)
        wrong = np.flatnonzero(np.abs(steps * self.period - delays) > 1e-9)
        if len(wrong):
            raise ConfigError(
                f"batch: the delay of car {wrong[0]} is {delays[wrong[0]]:g} s; it must be a multiple of the control "
                f"period, {self.period:g} s"
            )
        return steps

    def _make_numbers(self, vehicle: Vehicle, gains: Mapping[str, ArrayLike]) -> tuple[Any, ...]:
        """Return the records of unit, set-up, true steering geometry, and the gains of each car."""
        control, unit = vehicle.control, self._unit
        loops = {"speed": {"kp": control.speed.kp, "ki": control.speed.ki}}
        loops["wheel_speed"] = dict(zip(control.wheel_speed.gains, control.wheel_speed.gain_values(), strict=True))
        known = [f"{loop}.{name}" for loop, values in loops.items() for name in values]
        columns = {name: self._per_car(name, values) for name, values in gains.items()}
        for name in columns:
            if name not in known:
                raise ConfigError(f"batch: no gain '{name}'; {did_you_mean(name, known)}")
        # One row of gains per car; gains that are not given are those of control.yaml. A law without gains has empty
        # rows.
        rows: dict[str, list[list[float]]] = {}
        for loop, values in loops.items():
            table = [columns.get(f"{loop}.{name}", self._per_car(name, value)) for name, value in values.items()]
            rows[loop] = np.column_stack(table).tolist() if table else [[]] * self.cars.count
        # The laws make a record for each car, so that derived numbers (anti-windup) follow from its own gains.
        speed = [PidGains(*row).numbers() for row in rows["speed"]]
        wheel = [control.wheel_speed.numbers(row) for row in rows["wheel_speed"]]
        numbers = UnitNumbers(
            unit.constants.radii[0] * unit.true_over_believed, unit.true_over_believed,
            unit.force_per_torque, self.period,
        )  # fmt: skip
        return (
            records(UnitNumbers, [numbers]),
            records(ControlSetup, [unit.constants]),
            records(SteeringNumbers, [unit.true_steering.numbers]),
            records(PidNumbers, speed),
            *self._wheel_gains(vehicle, records(type(wheel[0]), wheel)),
            records(NoNumbers, [NoNumbers()]),
        )

    def _wheel_gains(self, vehicle: Vehicle, own: Records) -> tuple[Any, ...]:
        """Return the gains of the wheels and those at the present speed, both again as PID gains, and the schedule."""
        schedule = vehicle.control.wheel_speed.gain_schedule()
        if schedule is None:
            # Numba needs typed arrays also for arguments that are not read; a schedule without rows disables it.
            unused = records(PidNumbers, [])
            return own, own, unused, unused, np.empty((0, 4))
        table, present = schedule.table(), own.copy()
        # NaN marks gains that are not scheduled: the kernel then keeps the gain of the car.
        columns = [table.gains.get(name, [np.nan] * len(table.speeds)) for name in ("kp", "ki", "kd")]
        return own, present, own, present, np.column_stack([table.speeds, *columns])


def _check_vehicle(cars: Batch, vehicle: Vehicle) -> None:
    """Check that the control unit of a vehicle can run in a batch.

    Raises:
        ConfigError: the control unit cannot run in a batch.
    """
    control = vehicle.control
    if not cars.variant.actuators:
        raise ConfigError("batch: a control unit needs a variant with actuators; write Variant(..., actuators=True)")
    if control.wheel_speed.uses_pedals:
        raise ConfigError(
            f"batch: '{vehicle.name}' is driven by pedals, whose laws run in Python only; choose a variant of the "
            "vehicle with wheel_speed of kind servo or pid"
        )


def check_count(name: str, count: int) -> int:
    """Return a number of control periods, checked to be 1 or more.

    Raises:
        ConfigError: it is less.
    """
    if count < 1:
        raise ConfigError(f"batch: {name} is {count}; it must be 1 control period or more")
    return count
