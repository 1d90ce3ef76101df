"""Units of recorded data: how instruments and people spell them, and their size in SI."""

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import to_si

_MORE_UNITS: dict[str, dict[str, float]] = {
    "1": {"1": 1.0, "-": 1.0, "": 1.0, "%": 0.01},
    "rad": {"mrad": 1e-3},
    "rad/s": {"1/min": 0.10471975511965977, "mrad/s": 1e-3},
    "m/s": {"ft/s": 0.3048, "kn": 1852.0 / 3600.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "m/s^2": {"mg": 1e-3 * GRAVITY, "ft/s^2": 0.3048},
}

_ANY_CASE = {"deg", "rad", "km/h", "m/s", "mph", "deg/s", "rad/s", "rpm", "1/min", "m/s^2", "m/s²", "ms", "g", "mg"}


QUANTITIES = ("s", "m", "m/s", "m/s^2", "rad", "rad/s", "N", "N m")
"""SI units of the quantities in logs."""

_SPELLINGS = {
    "m/s2": "m/s^2", "m/s/s": "m/s^2", "m/s**2": "m/s^2", "m s-2": "m/s^2", "m*s^-2": "m/s^2", "mps2": "m/s^2",
    "meter/s^2": "m/s^2", "g0": "g", "m/sec": "m/s", "mps": "m/s", "meters/s": "m/s", "metres/s": "m/s",
    "meters/second": "m/s", "metres/second": "m/s", "meters per second": "m/s",
    "m s-1": "m/s", "m*s^-1": "m/s", "meter/s": "m/s",
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
"""Spellings of units in lower case, with their usual form here."""


def format_unit(unit: str) -> str:
    """Return a unit with superscripts: ``kg m^2`` → ``kg m²``."""
    return unit.replace("^2", "²").replace("^3", "³")


def plain_unit(unit: str) -> str:
    """Return the usual spelling of a unit: ``m/s^2`` for ``m/s2``, ``km/h`` for ``kph``, ``deg`` for ``degrees``."""
    bare = unit.strip().replace("·", " ").replace("⁻¹", "-1").replace("\N{MASCULINE ORDINAL INDICATOR}", "°")
    small = bare.lower()
    known = _SPELLINGS.get(small)
    if known is not None:
        return known
    return small if small in _ANY_CASE else bare


def unit_factor(unit: str, si: str) -> float:
    """Return the size of a unit in SI.

    Raises:
        ValueError: unknown unit, or a unit of another quantity.
    """
    more = _MORE_UNITS.get(si, {})
    unit = unit if unit in more else plain_unit(unit)
    if unit in more:
        return more[unit]
    if si == "1":
        raise ValueError(f"unit '{unit}' does not fit a pure number; allowed: {', '.join(filter(None, more))}")
    return float(to_si(f"1 {unit}", si))


def is_unit(text: str) -> bool:
    """Whether a text is a unit of a quantity of vehicle motion."""
    return bool(text) and any(_fits(text, si) for si in QUANTITIES)


def _fits(unit: str, si: str) -> bool:
    try:
        unit_factor(unit, si)
    except ValueError:
        return False
    return True
