"""Control units of the cars of a batch: speed and steering loop of control.yaml in the compiled loop."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.batched.cars import Batch
from mirdrake.batched.control_kernel import (
    DRIVE_PARTS,
    DRIVER_MEMORY,
    OUTPUTS,
    Clock,
    DriverLaw,
    Memories,
    UnitNumbers,
    Units,
    ackermann_rolling,
    drive,
    no_driver,
    unior_rolling,
)
from mirdrake.batched.path import TRACKER_PARTS, PathDriver, track
from mirdrake.batched.records import BatchRun
from mirdrake.controllers.ackermann import SteeringNumbers
from mirdrake.controllers.control_step import LAST, ControlSetup
from mirdrake.core.compiled import Records, as_arrays, compiled, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.pid import PidGains, PidNumbers
from mirdrake.core.signals import Signals, signals
from mirdrake.core.vectors import PATH_ERROR
from mirdrake.plant.powertrain.system import RATE
from mirdrake.single_track.control import SingleTrackControl
from mirdrake.single_track.dynamics import lateral_force_of
from mirdrake.single_track.powertrain import make_single_track_law
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.joint_control.base import NoNumbers
from mirdrake.vehicles.joint_control.pedals import PedalControl, PedalLaw

STATUS = signals(
    ("speed_setpoint", "m/s", "set-point of the speed, before the trim"),
    ("steering_setpoint", "rad", "bicycle steering angle after limit and rate"),
    ("speed_trim", "m/s", "correction by the speed loop"),
)


COMMANDS = signals(
    ("speed_command", "m/s", "command that the unit received"),
    ("steering_command", "rad", "command that the unit received"),
)

ROAD_FORCES = signals(
    ("drive_force", "N", "at the road, in addition to wheel servos"),
    ("brake_force", "N", "at the road, positive"),
)

COMMANDED: tuple[DriverLaw, tuple[Any, ...]] = (no_driver, ())
"""Driver law, and functions that it calls, of cars that follow commands."""

FOLLOWING: tuple[DriverLaw, tuple[Any, ...]] = (track, TRACKER_PARTS)
"""The same of path trackers."""


class BatchControl:
    """Control units of the cars of a batch.

    Each car has the control unit of :func:`mirdrake.single_track.make_single_track_vehicle`, with gains, delay and
    noise of its own: watchdog, limits and rates of the set-points, steering actuator, speed loop, wheel loops. The
    batch has a variant with actuators. A unit runs at the rate of control.yaml and reads the state at the control
    instant; its outputs act after the delay. Pedals act on the powertrain, which runs at its own rate.

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
        ConfigError: the variant has no actuators, the pedals have a controller of the user, an unknown gain, or a delay
            or step that does not fit the control period or the period of the powertrain.
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
        _check_vehicle(cars, vehicle)
        self.cars, self.period, self._seed = cars, 1.0 / vehicle.control.rate, np.uint64(seed)
        # The unit acts at whole steps only: a period between two steps would change its sampling and with it its delay.
        self._control_steps = self._whole_steps(self.period, "control period")
        nominal = cars.nominal  # the unit does not know how the cars differ
        mass, rotating = nominal.mass, nominal.rotating_mass
        self._unit = SingleTrackControl(vehicle, mass=mass, rotating=rotating)
        self._powertrain = make_single_track_law(vehicle, mass=mass, rotating=rotating)
        self._pedals = self._unit.pedal_law is not None
        self._train_steps = self._whole_steps(1.0 / RATE, "period of the powertrain") if self._pedals else 0
        self._delays = self._delay_steps(delay)
        self._noise = self._per_car("noise", noise)
        self._numbers = self._make_numbers(vehicle, gains or {})
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
        # Until the first delayed output acts, servos hold the present angle and speed; drive force and rate are zero.
        count = self.cars.count
        delayed: Floats = np.zeros((count, int(self._delays.max()) + 1, OUTPUTS))
        delayed[:, :, 0] = angles[:, None]
        # Pedals are released, in drive.
        delayed[:, :, 4] = 1.0 if self._pedals else speeds[:, None] * self._unit.true_over_assumed
        self._memories = Memories(
            unit=np.array(rows),
            delayed=delayed,
            delays=self._delays,
            driver=np.zeros((count, DRIVER_MEMORY)),
            powertrain=np.array([self._powertrain.rest(speed) for speed in speeds.tolist()]),
            forces=np.zeros((count, 3)),
        )
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
        rows = self._check_commands(commands)
        times = (self._periods + np.arange(rows.shape[1])) * self.period
        # The stamp of a command is its own control instant: it is never old, and only rows with NaN are missing
        # messages.
        stamped = np.empty((*rows.shape[:2], 3))
        stamped[..., :2], stamped[..., 2] = rows, times
        steps = check_count("every", every) * self._control_steps
        return self._run(stamped, COMMANDED, (), rows.shape[1], outputs, steps)

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
        # The tracker runs at control instants, as the unit reads its command there.
        multiple = round(driver.period / self.period)
        if multiple < 1 or abs(multiple * self.period - driver.period) > 1e-9:
            raise ConfigError(
                f"path driver: a period of {driver.period:g} s is not a multiple of the control period, "
                f"{self.period:g} s"
            )
        trackers = driver.numbers(self.cars.count)
        steps = check_count("every", every) * self._control_steps
        return self.drive(FOLLOWING, trackers, driver.period, periods=periods, outputs=outputs, every=steps)

    def drive(
        self,
        law: tuple[DriverLaw, tuple[Any, ...]],
        drivers: Any,
        driver_period: float,
        *,
        periods: int,
        outputs: Sequence[str] | None = None,
        every: int = 1,
    ) -> BatchRun:
        """Drive all cars by a compiled driver law; further calls continue.

        Args:
            law: the driver law, and functions that it calls.
            drivers: its numbers for all cars.
            driver_period: time between two of its steps [s].
            periods: number of control periods.
            outputs: see :meth:`run`.
            every: steps of the integration between two rows of the result.

        Raises:
            ConfigError: an unknown signal, or a period that the step of the integration does not divide.
        """
        unused = np.zeros((1, 1, 3))  # the commands are those of the driver
        return self._run(
            unused, law, drivers, check_count("periods", periods), outputs, every, driver_period=driver_period
        )

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

    def _run(
        self,
        commands: Floats,
        law: tuple[DriverLaw, tuple[Any, ...]],
        drivers: Any,
        periods: int,
        outputs: Sequence[str] | None,
        every: int,
        *,
        driver_period: float = 0.0,
    ) -> BatchRun:
        """Drive all cars under commands, or by drivers."""
        cars, contents = self.cars, self._contents(outputs)
        names = [signal.name for signal in self.signals()]
        columns = np.array([names.index(signal.name) for signal in contents])
        # A tick is the longest time that divides the periods of all events.
        driver_steps = self._whole_steps(driver_period, "period of the driver") if driver_period else 0
        tick = math.gcd(self._control_steps, self._train_steps, driver_steps, every)
        clock = Clock(
            begin=self._periods * self._control_steps // tick,
            ticks=periods * self._control_steps // tick,
            control=self._control_steps // tick,
            powertrain=max(self._train_steps // tick, 1),
            driver=driver_steps // tick,
            output=every // tick,
            driver_period=driver_period,
            steps=tick,
            step=cars.step_time,
        )
        # Rounded up: row 0 is the first tick, and every further row `every` steps later.
        time: Floats = (clock.begin + np.arange(0.0, clock.ticks, clock.output)) * (self.period / clock.control)
        values = np.empty((cars.count, len(time), len(columns)))
        cars.share(
            self._kernel(law), self._numbers, drivers, commands, self._noise, self._seed, clock, columns,
            self._memories, values,
        )  # fmt: skip
        self._periods += periods
        cars.time += periods * self.period
        return BatchRun(time, values, contents, cars.diverged_cars)

    def _kernel(self, law: tuple[DriverLaw, tuple[Any, ...]]) -> Callable[..., None]:
        """Return the compiled loop with the laws of steering, wheels and driver."""
        # Laws are compiled into the loop, as Numba cannot call a method that is chosen at run time.
        vehicle, (driver_law, parts) = self._unit.vehicle, law
        wheel = vehicle.control.wheel_speed
        rolling = ackermann_rolling if vehicle.spec.steering.law == "ackermann" else unior_rolling
        laws = (lateral_force_of(self.cars.variant), rolling, wheel.torque_law(), driver_law)
        return compiled(drive, laws, parts=[*DRIVE_PARTS, *parts, *wheel.law_parts, rolling], nogil=True)

    def _whole_steps(self, period: float, name: str) -> int:
        """Return the number of integration steps in a period [s].

        Raises:
            ConfigError: the period is not a multiple of the step.
        """
        step = self.cars.step_time
        steps = round(period / step)
        if steps < 1 or abs(steps * step - period) > 1e-9:
            raise ConfigError(
                f"batch: a step of {step:g} s does not divide the {name} of {period:g} s; take for example "
                f"{period / max(steps, 1):g} s"
            )
        return steps

    def signals(self) -> Signals:
        """Return the signals that a run can have: states, motion, status, path error, commands, forces."""
        return (*self.cars.signals(), *STATUS, *PATH_ERROR, *COMMANDS, *ROAD_FORCES)

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

    def _make_numbers(self, vehicle: Vehicle, gains: Mapping[str, ArrayLike]) -> Units:
        """Return control units and powertrains of all cars."""
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
        pedals, period = unit.pedal_law, self.period
        wheel = [(control.wheel_speed if pedals is None else pedals).numbers(row) for row in rows["wheel_speed"]]
        # Without pedals the compiled loop still needs numbers of their type.
        law = pedals or PedalControl(kind="pedals").make_pedal_controller(self._powertrain, vehicle.spec, period)
        assert isinstance(law, PedalLaw)
        numbers = UnitNumbers(
            unit.constants.radii[0] * unit.true_over_assumed, unit.true_over_assumed, unit.force_per_torque, period
        )
        own, present, own_pid, present_pid, schedule = self._wheel_gains(
            vehicle, records(type(wheel[0]), wheel), law.pedal_numbers.inertia if pedals is not None else 1.0
        )
        return Units(
            units=records(UnitNumbers, [numbers]),
            setups=records(ControlSetup, [unit.constants]),
            true_steering=records(SteeringNumbers, [unit.true_steering.numbers]),
            speed_gains=records(PidNumbers, speed),
            wheel_gains=own,
            present_gains=present,
            own_pid=own_pid,
            present_pid=present_pid,
            pedal_gains=present if pedals is not None else records(PidNumbers, []),
            schedule=schedule,
            joint_gains=records(NoNumbers, [NoNumbers()]),
            pedals=as_arrays(law.pedal_numbers),
            pedal_memory=unit.pedal_memory,
            powertrain=as_arrays(self._powertrain.numbers),
            radii=self._unit.vehicle.geometry.wheel_radii,
        )

    def _wheel_gains(self, vehicle: Vehicle, own: Records, scale: float) -> tuple[Any, ...]:
        """Return the gains of the wheels and those at the present speed, both again as PID gains, and the schedule.

        `scale` is a gain of the loop over that of control.yaml.
        """
        schedule = vehicle.control.wheel_speed.gain_schedule()
        if schedule is None:
            # Numba needs typed arrays also for arguments that are not read; a schedule without rows disables it.
            unused = records(PidNumbers, [])
            return own, own, unused, unused, np.empty((0, 4))
        table, present = schedule.table(), own.copy()
        # NaN marks gains that are not scheduled: the kernel then keeps the gain of the car.
        missing = [np.nan] * len(table.speeds)
        columns = [scale * np.array(table.gains.get(name, missing)) for name in ("kp", "ki", "kd")]
        return own, present, own, present, np.column_stack([table.speeds, *columns])


def _check_vehicle(cars: Batch, vehicle: Vehicle) -> None:
    """Check that the control unit of a vehicle can run in a batch.

    Raises:
        ConfigError: the control unit cannot run in a batch.
    """
    control = vehicle.control
    if not cars.variant.actuators:
        raise ConfigError("batch: a control unit needs a variant with actuators; write Variant(..., actuators=True)")
    if vehicle.spec.steering.rear is not None:
        raise ConfigError(
            f"batch: '{vehicle.name}' steers its rear wheels, the single-track model does not; use the plant"
        )
    if control.wheel_speed.uses_pedals and not isinstance(control.wheel_speed, PedalControl):
        raise ConfigError(
            f"batch: the pedals of '{vehicle.name}' have a controller of their own, which runs in Python only; choose "
            "wheel_speed of kind pedals, servo or pid"
        )


def check_count(name: str, count: int) -> int:
    """Return a number of control periods, checked to be 1 or more.

    Raises:
        ConfigError: it is less.
    """
    if count < 1:
        raise ConfigError(f"batch: {name} is {count}; it must be 1 control period or more")
    return count
