"""Many cars of the single-track model, each with its own parameters, in arrays."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats, Integers, Mask
from mirdrake.batched.ground import NO_GROUND, Ground
from mirdrake.batched.kernels import KERNEL_PARTS, Fleet, advance, advance_over_time
from mirdrake.batched.records import BatchRun
from mirdrake.batched.table import make_table
from mirdrake.core.checks import check_number
from mirdrake.core.compiled import Records, compiled, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signals, signals
from mirdrake.single_track.dynamics import Flags, Inputs, State, Variant, flags_of, lateral_force_of, record_of
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.signals import MOTION

if TYPE_CHECKING:
    from mirdrake.vehicles import Vehicle

STEP = 0.005
"""Default step of the integration [s]; the fastest pole of a car is near 100 1/s."""

STATES = signals(
    ("x", "m", "position of the rear axle centre"),
    ("y", "m", "position of the rear axle centre"),
    ("yaw", "rad", "heading, not wrapped"),
    ("vx", "m/s", "longitudinal velocity of the centre of mass"),
    ("vy", "m/s", "lateral velocity of the centre of mass"),
    ("yaw_rate", "rad/s", ""),
    ("front_slip", "", "effective slip tan α' of the front axle"),
    ("rear_slip", "", "the same at the rear"),
    ("roll", "rad", "roll angle"),
    ("roll_rate", "rad/s", ""),
    ("steering", "rad", "bicycle steering angle"),
)
"""All states of the model; a variant has some of them."""


class Batch:
    """Cars of one variant of the single-track model, each with its own parameters, which step together.

    A car whose state is not finite has diverged: it keeps its last finite state and the others continue. The result
    of each car is bit-identical to that of the single model with the same Runge-Kutta steps, and independent of the
    other cars and the number of threads.

    Attributes:
        variant: equations.
        nominal: parameters before those that differ between the cars.
        count: number of cars n.
        step_time: step of the integration [s].
        threads: number of threads that share the cars.
        time: time since the start [s].
        state: states (n, states) in the order of :attr:`state_names`; may be written.
        parameters: a record per car with the fields of :class:`SingleTrackParameters`; may be written.
        diverged: flags of the diverged cars (n).

    Args:
        parameters: parameters that the cars share.
        variant: equations.
        columns: values (n) of parameters that differ between the cars, by name.
        count: number of cars; by default the length of the columns.
        step: step of the integration [s].
        ground: friction, slope and wind as functions of the position; level and even if None.
        threads: number of threads; studies run one process per core, so that more than one thread there is slower.

    Raises:
        ConfigError: an unknown parameter, columns of different lengths, or a value out of range.
    """

    def __init__(
        self,
        parameters: SingleTrackParameters,
        variant: Variant,
        *,
        columns: Mapping[str, ArrayLike] | None = None,
        count: int | None = None,
        step: float = STEP,
        threads: int = 1,
        ground: Ground | None = None,
    ) -> None:
        variant.check()
        self.variant, self.nominal = variant, parameters
        self.step_time = check_number("batch", "step", step, unit="s", above=0.0)
        self.threads = _check_threads(threads)
        self.parameters: Records = record_of(make_table(parameters, columns or {}, count))
        self.count = len(self.parameters)
        # Loops overwrite the present parameters with those at the place of a car; without a ground nothing is
        # written, so a copy would only cost memory.
        self._present = self.parameters if ground is None else self.parameters.copy()
        self._ground = NO_GROUND if ground is None else (ground.frame, ground.grid)
        self.state_names = variant.state_names
        self.state: Floats = np.zeros((self.count, len(self.state_names)))
        self.diverged: Mask = np.zeros(self.count, dtype=bool)
        self.time = 0.0

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.variant.input_names

    @property
    def diverged_cars(self) -> Integers:
        """Indices of the diverged cars."""
        return np.flatnonzero(self.diverged)

    def __getitem__(self, name: str) -> Floats:
        """Return a state of all cars (n) by name, as a view of :attr:`state`.

        Raises:
            ConfigError: the variant has no such state.
        """
        if name not in self.state_names:
            raise ConfigError(f"batch: no state '{name}'; {did_you_mean(name, self.state_names)}")
        return self.state[:, self.state_names.index(name)]

    def reset(self, cars: ArrayLike | None = None, **values: ArrayLike) -> Self:
        """Set the states of cars by name and revive them; other states are zero. Without `cars`, time is zero again.

        Args:
            cars: indices or mask of the cars; all if None.
            **values: states, a number or one per car.

        Raises:
            ConfigError: the variant has no such state.
        """
        # All names are checked before any state changes, so that an error leaves the cars as they were.
        chosen: Any = slice(None) if cars is None else np.asarray(cars)
        for name in values:
            self[name]  # checks the name
        self.state[chosen] = 0.0
        for name, value in values.items():
            self.state[chosen, self.state_names.index(name)] = value
        self.diverged[chosen] = False
        if cars is None:
            self.time = 0.0
        return self

    def step(self, inputs: ArrayLike, steps: int = 1) -> None:
        """Advance all cars in place by `steps` steps under inputs that are held.

        Args:
            inputs: (inputs) for all cars, or (n, inputs), in the order of :attr:`input_names`.
            steps: number of steps.

        Raises:
            ConfigError: the shape of the inputs is wrong.
        """
        # A copy: a broadcast view has strides of zero and is read-only, a further type of argument to compile for.
        held = np.array(np.broadcast_to(self._pad(inputs, ndim=(1, 2)), (self.count, len(Inputs._fields))), order="C")
        self.share(self._advance, held, self.step_time, int(steps))
        self.time += steps * self.step_time

    def run(self, inputs: ArrayLike, *, hold: int = 1) -> BatchRun:
        """Advance all cars under inputs over time, and return states and motion.

        Args:
            inputs: (times, inputs) for all cars, or (n, times, inputs), in the order of :attr:`input_names`.
            hold: number of steps for which each row of inputs is held.

        Returns:
            States and motion (n, times + 1, ...) at the start and after each row of inputs.

        Raises:
            ConfigError: the shape of the inputs is wrong.
        """
        rows = self._pad(inputs, ndim=(2, 3))
        # Inputs for all cars stay one row: the kernel reads the last row that exists, which saves n - 1 copies.
        rows = np.ascontiguousarray(rows if rows.ndim == 3 else rows[None])
        if hold < 1:
            raise ConfigError(f"batch: hold is {hold}; it must be 1 step or more")
        times = rows.shape[1]
        contents = self.signals()
        values = np.empty((self.count, times + 1, len(contents)))
        self.share(self._advance_over_time, rows, self.step_time, int(hold), values)
        time = self.time + np.arange(times + 1) * (hold * self.step_time)
        self.time = float(time[-1])
        return BatchRun(time, values, contents, self.diverged_cars)

    def signals(self) -> Signals:
        """Return the signals that :meth:`run` returns: states of the variant, then the motion."""
        named = {signal.name: signal for signal in STATES}
        return (*(named[name] for name in self.state_names), *MOTION)

    def _pad(self, inputs: ArrayLike, *, ndim: tuple[int, int]) -> Floats:
        """Return inputs with all columns of :class:`Inputs`; the dimensions are those without and with cars."""
        given = np.asarray(inputs, dtype=float)
        names = self.input_names
        fits = given.ndim in ndim and given.shape[-1] == len(names)
        if not fits or (given.ndim == ndim[1] and given.shape[0] not in (1, self.count)):
            shape = f"(times, {len(names)})" if ndim[0] == 2 else f"({len(names)},)"
            raise ConfigError(
                f"batch: inputs have the shape {given.shape}; give {shape} for all {self.count} cars, or such an array "
                f"per car; the columns are {', '.join(names)}"
            )
        # A variant takes the first fields of Inputs; the others are zero, so that one compiled loop serves all of them.
        padded = np.zeros((*given.shape[:-1], len(Inputs._fields)))
        padded[..., : len(names)] = given
        return padded

    def share(self, kernel: Callable[..., Any], *arguments: Any) -> None:
        """Call a kernel, divided among the threads, with all cars, arguments, and the range of its cars."""
        cars = Fleet(
            self.flags, self.positions, self.parameters, self._present, *self._ground, self.state, self.diverged
        )
        # Contiguous ranges of cars: threads write to separate rows, so that no lock is needed (kernels release the
        # GIL).
        bounds = np.linspace(0, self.count, min(self.threads, self.count) + 1).astype(int).tolist()
        if len(bounds) == 2:
            kernel(cars, *arguments, 0, self.count)
            return
        calls = [self._pool.submit(kernel, cars, *arguments, first, last) for first, last in pairwise(bounds)]
        # The result is awaited to raise the exception of a thread here, which submit alone would hide.
        for call in calls:
            call.result()

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.threads)

    @cached_property
    def flags(self) -> Records:
        """Flags of the variant, for compiled loops."""
        return records(Flags, [flags_of(self.variant)])

    @cached_property
    def positions(self) -> Integers:
        """Column of each field of :class:`State` in :attr:`state`; -1: the variant does not have it."""
        names = self.state_names
        return np.array([names.index(name) if name in names else -1 for name in State._fields])

    @cached_property
    def _advance(self) -> Callable[..., None]:
        return compiled(advance, lateral_force_of(self.variant), parts=KERNEL_PARTS, nogil=True)

    @cached_property
    def _advance_over_time(self) -> Callable[..., None]:
        return compiled(advance_over_time, lateral_force_of(self.variant), parts=KERNEL_PARTS, nogil=True)


def batch(
    car: "Vehicle | SingleTrackParameters | str",
    variant: Variant | None = None,
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    count: int | None = None,
    step: float = STEP,
    threads: int = 1,
    ground: Ground | None = None,
) -> Batch:
    """Return many cars of the single-track model, each with its own parameters.

    Args:
        car: a vehicle, its name, or parameters of the single-track model.
        variant: equations; by default linear tyres without further states.
        parameters: values (n) of parameters that differ between the cars, by name.
        count: number of cars; by default the length of the values.
        step: step of the integration [s].
        threads: number of threads that share the cars.
        ground: friction, slope and wind as functions of the position; level and even if None.

    Raises:
        ConfigError: an unknown parameter, values of different lengths, or a value out of range.
        ModelError: the vehicle cannot be loaded.
    """
    variant = variant or Variant()
    if not isinstance(car, SingleTrackParameters):
        from mirdrake.single_track.from_vehicle import estimate_parameters
        from mirdrake.vehicles import load_vehicle

        # With roll states in the variant, the effect of roll on the slip of the axles must not be in their stiffness,
        # too.
        car = estimate_parameters(load_vehicle(car) if isinstance(car, str) else car, roll=variant.roll)
    return Batch(car, variant, columns=parameters, count=count, step=step, threads=threads, ground=ground)


def _check_threads(threads: int) -> int:
    processors = os.cpu_count() or 1
    if not 1 <= threads <= processors:
        raise ConfigError(f"batch: threads is {threads}; it must be from 1 to {processors}, the number of processors")
    return threads
