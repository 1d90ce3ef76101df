"""Effects that the structure search may add to a model where the study leaves them open."""

from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.data import DataSet
from mirdrake.identification.models.base import Addition
from mirdrake.identification.models.single_track_parameters import DELAYS
from mirdrake.identification.parameters import Setting

SATURATION_ACCELERATION, DRY_FRICTION = 3.0, 0.9
"""Lateral acceleration above which tyre saturation may be visible [m/s²]; friction of a dry road [1]."""

MIN_ACCELERATION_RANGE = 2.0
"""Range from braking to acceleration in turns above which load transfer is tried [m/s²]."""

SMOOTHING = 0.2
"""Smoothing of the speed before it is differentiated [s]."""

SATURATED = (
    {"cornering_stiffness_front": 1.4, "cornering_stiffness_rear": 1.4, "friction_front": 0.7, "friction_rear": 0.7},
)
"""Factors on the initial values of saturating tyres: linear ones have too little stiffness where tyres saturate."""

_FREE = Setting(free=True)

STEERING_LAG = Addition("a lag of the steering", {"steering_lag": _FREE}, is_nonlinear=True)
"""To first order a lag acts as a delay, which is free, so the gradient does not show it."""


def is_angle_measured(data: DataSet) -> bool:
    """Whether all logs have the road wheel angle."""
    return all("road_wheel_angle" in log.channels for log in data.logs)


def single_track_additions(
    data: DataSet,
    settings: Mapping[str, Setting],
    *,
    open_options: set[str],
    outputs: Sequence[str] | None,
    rolls: bool,
) -> Iterator[Addition]:
    """Yield what a single track may need.

    The front axle's share of drive and braking is never tried: once free, the shares imitate tyre saturation.

    Args:
        data: training and validation logs.
        settings: settings of the study.
        open_options: names of the options that the study leaves open.
        outputs: channels to compare, if the study names them.
        rolls: whether the model has roll anyway.
    """
    if "load_transfer" not in settings and _acceleration_range(data) > MIN_ACCELERATION_RANGE:
        yield Addition("load transfer in braking", {"load_transfer": _FREE})
    if "steering_lag" not in settings:
        yield STEERING_LAG
    if "relaxation" in open_options and not any(name.startswith("relaxation") for name in settings):
        yield Addition("tyre relaxation", options={"relaxation": "shared"})

    # The files of a vehicle give the values of roll, for a study that asks for it.
    has_vehicle = "yaw_inertia" in settings and settings["yaw_inertia"].given is not None
    compared = [
        name
        for name in outputs or ("lateral_acceleration", "vy")
        if name in {"lateral_acceleration", "vy"} and all(name in log.channels for log in data.logs)
    ]
    if not rolls and "roll" in open_options and compared and not has_vehicle:
        # A sensor rolls with the body that it is mounted on.
        by_sensor = {
            "lateral_acceleration": {
                "accelerometer_tilt": Setting(free=True, guess=1.0), "accelerometer_height": _FREE,
            },
            "vy": {"velocity_height": _FREE},
        }  # fmt: skip
        positions = dict(ChainMap(*(by_sensor[name] for name in compared)))
        yield Addition("roll of the body", positions, {"roll": True})
    # Delays are those against the yaw rate.
    has_yaw_rate = "yaw_rate" in (outputs or ("yaw_rate",)) and all("yaw_rate" in log.channels for log in data.logs)
    for channel, name, words in DELAYS:
        if has_yaw_rate and channel in compared and name not in settings:
            yield Addition(f"a delay of {words}", {name: _FREE})

    largest = _largest_lateral_acceleration(data)
    if "tyres" in open_options and largest > SATURATION_ACCELERATION:
        # With a friction below what the vehicle reached, the model would spin.
        grip = Setting(free=True, guess=max(DRY_FRICTION, 1.5 * largest / GRAVITY))
        frictions = {name: grip for name in ("friction_front", "friction_rear") if name not in settings}
        for law in ("magic_formula", "fiala"):  # the former stays linear for longer, as measured tyres do
            yield Addition(f"tyres: {law}", frictions, {"tyres": law}, SATURATED, is_nonlinear=True)


def _largest_lateral_acceleration(data: DataSet) -> float:
    """Return the lateral acceleration that the training logs reach [m/s²]."""
    largest = 0.0
    for log in data.train:
        forward = log.channels.get("vx", log.channels.get("speed"))
        rate, lateral = log.channels.get("yaw_rate"), log.channels.get("lateral_acceleration")
        if forward is not None and rate is not None:
            # v r is preferred to the sensor, whose reading contains roll, bank and shocks.
            lateral = forward * rate
        if lateral is not None:
            largest = max(largest, float(np.nanpercentile(np.abs(lateral), 99.0)))
    return largest


def _acceleration_range(data: DataSet) -> float:
    """Return the range from the hardest braking to the hardest acceleration in turns of the training logs [m/s²]."""
    largest = 0.0
    for log in data.train:
        forward, turn = log.channels.get("vx", log.channels.get("speed")), log.channels.get("yaw_rate")
        if forward is None:
            continue
        lateral = log.channels.get("lateral_acceleration") if turn is None else forward * turn
        good, step = np.isfinite(forward), float(np.median(np.diff(log.time)))
        # Braking in turns is what load transfer shows in; on straights it has no lateral effect.
        speed = np.interp(log.time, log.time[good], forward[good])
        rate = np.gradient(gaussian_filter1d(speed, max(SMOOTHING / step, 1e-3)), step)
        if lateral is not None:
            size = np.abs(np.nan_to_num(lateral))
            rate = rate[size >= 0.3 * float(np.percentile(size, 99.0))]
        largest = max(largest, float(np.ptp(np.percentile(rate, (5.0, 95.0)))))
    return largest
