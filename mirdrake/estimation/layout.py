"""Layout of the filters of one variant: elements of the vector z, their noise, and what they act on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import exp
from typing import Any

import numpy as np

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.core.compiled import compiled, records
from mirdrake.core.errors import ConfigError
from mirdrake.estimation import kernel
from mirdrake.estimation.kernel import Design, Memory
from mirdrake.estimation.spec import (
    ACCELERATIONS,
    GROUPS,
    OFFSETS,
    SENSORS,
    STATES,
    DisturbanceSpec,
    FilterSpec,
)
from mirdrake.single_track.dynamics import Flags, Inputs, State, Variant, flags_of, lateral_force_of
from mirdrake.single_track.parameters import PARAMETERS, POSITIVE, SingleTrackParameters


@dataclass(frozen=True)
class Group:
    """Filters of one variant, which one compiled call advances.

    Attributes:
        variant: equations.
        filters: their places in the bank (n).
        names: names of the elements of z.
        design: what they have in common.
        own: parameters (n, p).
        present: room for those of a sigma point (n, p).
        memory: their state.
    """

    variant: Variant
    filters: Integers
    names: tuple[str, ...]
    design: Design
    own: Floats
    present: Floats
    memory: Memory

    @cached_property
    def run(self) -> Callable[..., None]:
        """The compiled loop."""
        return compiled(kernel.filter_over_time, lateral_force_of(self.variant), parts=kernel.FILTER_PARTS, nogil=True)

    @cached_property
    def flags(self) -> Any:
        """Flags of the variant, for compiled loops."""
        return records(Flags, [flags_of(self.variant)])


def make_group(
    spec: FilterSpec, variant: Variant, filters: Sequence[int], parameters: Sequence[SingleTrackParameters]
) -> Group:
    """Return the filters of a variant."""
    states = [name for name in variant.state_names if name in STATES]
    if "steering" not in spec.sensors:
        raise ConfigError("filter bank: the sensors have no 'steering'; the motion cannot be estimated without it")
    disturbances = [name for name in ACCELERATIONS if _disturbance(spec, name, _CAR).sigma > 0.0]
    biases = [f"{name}_bias" for name, sensor in spec.sensors.items() if sensor.bias > 0.0]
    names = ("steering", "steering_rate", *states, *disturbances, *spec.estimate, *biases)
    for sensor in spec.sensors:
        if sensor in {"roll", "roll_rate"} and sensor not in names:
            raise ConfigError(
                f"filter bank: a filter without roll has no '{sensor}'; set roll: true, or remove the sensor"
            )
    effects = [
        (names.index(name), *effect)
        for name in (*spec.estimate, *biases)
        for effect in _effects(name, tuple(spec.sensors))
    ]
    n, k, size = len(filters), len(spec.sensors), len(names)
    base = parameters[filters[0]].wheelbase
    decays = [
        exp(-spec.period / _correlation_time(spec, name, base)) if name in disturbances else 1.0 for name in names
    ]
    rate = spec.period / spec.adaptation_time if spec.adaptation_time > 0.0 else 0.0
    design = Design(
        positions=np.array([names.index(name) if name in states else -1 for name in State._fields]),
        steering=np.array([0, 1]),
        accelerations=np.array([names.index(name) if name in names else -1 for name in ACCELERATIONS]),
        decays=np.array(decays),
        effects=np.array(effects, dtype=np.int64).reshape(-1, 3),
        sensors=np.array([list(SENSORS).index(name) for name in spec.sensors]),
        ahead=np.array([sensor.ahead for sensor in spec.sensors.values()]),
        rates=np.array([rate * _adaptation(spec, name)[0] for name in (*names, "acceleration")]),
        forgetting=np.array([_adaptation(spec, name)[1] for name in (*names, "innovation")]),
        limits=np.array(ADAPTATION_LIMITS),
        kinds=np.array([2 if name in spec.estimate else 1 for name in (*names, "acceleration")]),
        gains=np.array([rate, spec.period / spec.consistency_time, INITIAL_SAMPLES]),
    )
    own = np.array([parameters[i].values() for i in filters])
    memory = Memory(
        mean=np.zeros((n, size)),
        root=np.zeros((n, size, size)),
        process=np.zeros((n, size + 1)),
        noise=np.zeros((n, k)),
        first_process=np.zeros((n, size + 1)),
        first_noise=np.zeros((n, k)),
        inputs=np.zeros((n, len(Inputs._fields))),
        recent=np.zeros((n, k)),
        changes=np.zeros((n, size)),
        squares=np.zeros((n, k)),
        products=np.zeros((n, k)),
        counts=np.zeros((n, 1 + k)),
        diverged=np.zeros(n, dtype=np.int64),
    )
    return Group(variant, np.array(filters), names, design, own, own.copy(), memory)


ADAPTATION_LIMITS = ((1e-2, 1e2), (1e-4, 1e4), (1.0, 1e4))
"""Least and largest variance over the given one: of sensors, of accelerations, of the drift of slow quantities."""

INITIAL_SAMPLES = 100.0
"""Number of samples that the given noise counts for when it is adapted."""


MANOEUVRE_TIME = 1.0
"""Time over which the apparent changes of a parameter are correlated if the model lacks an effect [s]."""


def _adaptation(spec: FilterSpec, name: str) -> tuple[float, float]:
    """Return γ_j over γ, and the weight of the last value in ū_j, of an element of z.

    Products of successive changes say little about the noise: their rates are larger than that of the sensors. The
    steering changes from sample to sample, the accelerations over some samples, a parameter over a manoeuvre.
    """
    if name in spec.estimate:
        return 5.0, 1.0 - exp(-spec.period / MANOEUVRE_TIME)
    if name in ACCELERATIONS:
        return 10.0, 0.2
    return 10.0 if name == "acceleration" else 0.0, 0.5 if name == "steering_rate" else 0.2


def _effects(name: str, sensors: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return effect and column of what an element of z acts on."""
    if name in OFFSETS:
        return [(kernel.OFFSET, Inputs._fields.index(OFFSETS[name]))]
    if name.endswith("_bias"):
        return [(kernel.BIAS, sensors.index(name.removesuffix("_bias")))]
    parts = GROUPS.get(name, (name,))
    return [(kernel.FACTOR if part in POSITIVE else kernel.CHANGE, PARAMETERS.index(part)) for part in parts]


def process_noise(spec: FilterSpec, names: Sequence[str], sizes: Sequence[float], wheelbase: float) -> Floats:
    """Return the variances of the process noise of a period (z)."""
    variances = []
    for name, size in zip(names, sizes, strict=True):
        if name in STATES:
            density = STATES[name].density * (_CAR / wheelbase if name == "yaw_rate" else 1.0)
            variances.append(density**2 * spec.period)
        elif name in ACCELERATIONS:
            variances.append(size**2 * (1.0 - exp(-2.0 * spec.period / _correlation_time(spec, name, wheelbase))))
        else:
            variances.append(drift_of(spec, name) ** 2 * spec.period)
    # The acceleration of the steering, constant within a period.
    density = spec.steering_acceleration or STEERING_ACCELERATION * (_CAR / wheelbase) ** 0.75
    return np.array([*variances, density**2 / spec.period])


def drift_of(spec: FilterSpec, name: str) -> float:
    """Return the standard deviation of the change of an element of z in a second; 0 if it does not drift."""
    if name not in spec.estimate:
        return 0.0
    given = spec.estimate[name]
    return DRIFT * given.sigma if given.drift is None else given.drift


DRIFT = 0.06
"""Usual standard deviation of the change of a slow quantity in a second over that at the start [1]."""

STEERING_ACCELERATION = 1.0
"""Usual density of the angular acceleration of the steering of a car [rad/s² per √Hz]."""


def _correlation_time(spec: FilterSpec, name: str, wheelbase: float) -> float:
    # Times of similar motions are as the roots of lengths (Froude).
    return _disturbance(spec, name, wheelbase).time or CORRELATION_TIME * (wheelbase / _CAR) ** 0.5


CORRELATION_TIME = 0.5
"""Usual correlation time of the accelerations that the model of a car lacks [s]."""


def _disturbance(spec: FilterSpec, name: str, wheelbase: float) -> DisturbanceSpec:
    given: DisturbanceSpec | None = getattr(spec, name)
    if given is not None:
        return given
    # A force that acts at one of the axles.
    lateral = spec.lateral_disturbance
    return DisturbanceSpec(sigma=lateral.sigma / (0.5 * wheelbase), time=lateral.time)


def sensor_noise(spec: FilterSpec, name: str) -> float:
    """Return the standard deviation of the noise of a sensor, as given or usual."""
    noise = spec.sensors[name].noise
    return SENSORS[name][1] if noise is None else noise


def start_size(spec: FilterSpec, name: str, wheelbase: float, disturbance: float) -> float:
    """Return the standard deviation of an element of z at the start."""
    if name in STATES:
        return STATES[name].start * (_CAR / wheelbase if name == "yaw_rate" else 1.0)
    if name in ACCELERATIONS:
        return disturbance * _disturbance(spec, name, wheelbase).sigma
    return spec.estimate[name].sigma if name in spec.estimate else spec.sensors[name.removesuffix("_bias")].bias


_CAR = 2.7  # wheelbase of a car, for which the usual noise of the yaw rate is given [m]


_UNITS = {
    "vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "front_slip": "", "rear_slip": "", "roll": "rad",
    "roll_rate": "rad/s", "longitudinal_disturbance": "m/s²", "lateral_disturbance": "m/s²",
    "yaw_disturbance": "rad/s²", "steering": "rad", "steering_rate": "rad/s", "drive_offset": "N", "brake_offset": "N",
    "mass": "kg", "yaw_inertia": "kg m²",
    "front_stiffness": "N/rad", "rear_stiffness": "N/rad", "front_length": "m", "rear_length": "m", "com_height": "m",
    "rotating_mass": "kg", "front_relaxation": "m", "rear_relaxation": "m", "drag": "N s²/m²", "gravity_x": "m/s²",
    "gravity_y": "m/s²", "gravity_z": "m/s²",
}  # fmt: skip


def unit_of(name: str) -> str:
    """Return the unit of an element of z or its value."""
    sensor = name.removesuffix("_bias")
    return SENSORS[sensor][0] if name.endswith("_bias") else _UNITS.get(name, "")
