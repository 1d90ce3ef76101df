"""The channels a log can have: their names, SI units and signs.

Axes and signs are those of ISO 8855: x forward, y to the left, z up; angles and rates are positive to the left (yaw),
to the right (roll) and nose down (pitch). Velocities and accelerations are those of the sensor's place, in the frame
of the vehicle; an accelerometer's gravity is not taken out here. A quantity that was measured twice has a source
behind its name: ``yaw_rate`` and ``yaw_rate@imu``.
"""

from typing import NamedTuple

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import to_si


class Channel(NamedTuple):
    """What is known of a channel.

    Attributes:
        unit: SI unit; "1" for a pure number.
        meaning: what it is, positive in which direction.
        limit: no road vehicle or robot reaches this magnitude [unit].
        moves: a measured motion, which changes from sample to sample; commands, pedals and codes may stand still.
    """

    unit: str
    meaning: str
    limit: float
    moves: bool = True


WHEELS = ("front_left", "front_right", "rear_left", "rear_right")

CHANNELS: dict[str, Channel] = {
    "speed": Channel("m/s", "over the ground, along the way", 150.0),
    "vx": Channel("m/s", "velocity forward", 150.0),
    "vy": Channel("m/s", "velocity to the left", 60.0),
    "yaw_rate": Channel("rad/s", "to the left", 30.0),
    "roll_rate": Channel("rad/s", "to the right", 30.0),
    "pitch_rate": Channel("rad/s", "nose down", 30.0),
    "longitudinal_acceleration": Channel("m/s^2", "forward", 200.0),
    "lateral_acceleration": Channel("m/s^2", "to the left", 200.0),
    "vertical_acceleration": Channel("m/s^2", "up", 500.0),
    "yaw": Channel("rad", "to the left", 1e4),
    "roll": Channel("rad", "to the right", 4.0),
    "pitch": Channel("rad", "nose down", 4.0),
    "sideslip": Channel("rad", "to the left", 4.0),
    "x": Channel("m", "position on the ground", 1e8),
    "y": Channel("m", "position on the ground, 90 degrees left of x", 1e8),
    "steering_wheel_angle": Channel("rad", "of the hand wheel, to the left", 40.0),
    "road_wheel_angle": Channel("rad", "of the front wheels, to the left", 4.0),
    "steering_command": Channel("1", "in units of its own, to the left", 1e6),
    "steering_torque": Channel("N m", "at the hand wheel, to the left", 1e4),
    "throttle": Channel("1", "pedal, 0 to 1", 10.0, moves=False),
    "brake": Channel("1", "pedal, 0 to 1", 10.0, moves=False),
    "gear": Channel("1", "code of the gear", 100.0, moves=False),
    "engine_speed": Channel("rad/s", "of the engine or motor", 1e4),
    "drive_torque": Channel("N m", "at the wheels, forward", 1e6),
    "brake_torque": Channel("N m", "at the wheels, as logged", 1e6),
    "grade": Channel("rad", "of the road, upward", 1.6),
    **{f"wheel_speed_{wheel}": Channel("m/s", "of the wheel's rim, forward", 300.0) for wheel in WHEELS},
    **{f"wheel_rate_{wheel}": Channel("rad/s", "of the wheel, forward", 3e3) for wheel in WHEELS},
}

_MORE_UNITS: dict[str, dict[str, float]] = {
    "1": {"1": 1.0, "-": 1.0, "": 1.0, "%": 0.01},
    "rad": {"mrad": 1e-3},
    "rad/s": {"1/min": 0.10471975511965977, "mrad/s": 1e-3},
    "m/s": {"ft/s": 0.3048, "kn": 1852.0 / 3600.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "m/s^2": {"mg": 1e-3 * GRAVITY, "ft/s^2": 0.3048},
}

_ANY_CASE = {"deg", "rad", "km/h", "m/s", "mph", "deg/s", "rad/s", "rpm", "1/min", "m/s^2", "m/s²", "ms", "g", "mg"}


_SPELLINGS = {
    "m/s2": "m/s^2", "m/s/s": "m/s^2", "m/s**2": "m/s^2", "m s-2": "m/s^2", "m*s^-2": "m/s^2", "mps2": "m/s^2",
    "meter/s^2": "m/s^2", "g0": "g", "m/sec": "m/s", "mps": "m/s", "m s-1": "m/s", "m*s^-1": "m/s", "meter/s": "m/s",
    "kt": "kn", "kts": "kn", "knot": "kn", "knots": "kn", "fps": "ft/s", "ft/sec": "ft/s", "ft/s2": "ft/s^2",
    "m/sec^2": "m/s^2", "m/s^-2": "m/s^2", "radian/s": "rad/s", "radians/s": "rad/s", "radps": "rad/s",
    "kph": "km/h", "kmh": "km/h", "km/hr": "km/h", "kmph": "km/h", "mi/h": "mph",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad",
    "°/s": "deg/s", "deg/sec": "deg/s", "degree/s": "deg/s", "degrees/s": "deg/s", "dps": "deg/s", "deg s-1": "deg/s",
    "rad/sec": "rad/s", "rad s-1": "rad/s", "1/s": "rad/s", "u/min": "rpm", "r/min": "rpm", "rev/min": "rpm",
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us", "µs": "us", "nsec": "ns",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "n m": "N m", "nm": "N m", "n*m": "N m",
    "percent": "%", "pct": "%", "none": "-", "unitless": "-",
}  # fmt: skip
"""How instruments and people spell units, in small letters."""


def plain_unit(unit: str) -> str:
    """A unit as it is spelt here: ``m/s^2`` of ``m/s2``, ``km/h`` of ``kph``, ``deg`` of ``degrees``."""
    bare = unit.strip().replace("·", " ").replace("⁻¹", "-1").replace("\N{MASCULINE ORDINAL INDICATOR}", "°")
    small = bare.lower()
    known = _SPELLINGS.get(small)
    if known is not None:
        return known
    return small if small in _ANY_CASE else bare


def quantity(name: str) -> str:
    """The name of a channel without its source: ``yaw_rate`` of ``yaw_rate@imu``."""
    return name.partition("@")[0]


def channel(name: str) -> Channel:
    """What is known of a channel.

    Raises:
        ValueError: there is none of that name.
    """
    known = CHANNELS.get(quantity(name))
    if known is None:
        raise ValueError(f"unknown channel '{name}'; {did_you_mean(quantity(name), CHANNELS)}")
    return known


def unit_factor(unit: str, si: str) -> float:
    """How many of the SI unit one of a unit is.

    Raises:
        ValueError: the unit is not known, or is one of another quantity.
    """
    more = _MORE_UNITS.get(si, {})
    unit = unit if unit in more else plain_unit(unit)
    if unit in more:
        return more[unit]
    if si == "1":
        raise ValueError(f"unit '{unit}' does not fit a pure number; allowed: {', '.join(filter(None, more))}")
    return float(to_si(f"1 {unit}", si))
