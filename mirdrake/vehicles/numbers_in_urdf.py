"""Checks of numbers in a URDF for which Drake reports no line or fails an assertion."""

import math
from collections.abc import Callable
from xml.etree import ElementTree

from mirdrake.core.errors import ModelError
from mirdrake.vehicles.xacro_render import Urdf

_DRAKE = "{http://drake.mit.edu}"
Test = Callable[[float], bool]


FARTHEST = 1000.0
"""Largest position and size of a part of a vehicle [m]."""


def _any(value: float) -> bool:
    return math.isfinite(value)


def _length(value: float) -> bool:
    return abs(value) <= FARTHEST


def _size(value: float) -> bool:
    return 0.0 < value <= FARTHEST


def _positive(value: float) -> bool:
    return 0.0 < value < math.inf


def _not_negative(value: float) -> bool:
    return 0.0 <= value < math.inf


_MEANING: dict[Test, str] = {
    _any: "",
    _positive: " above zero",
    _not_negative: " not below zero",
    _length: f" within ±{FARTHEST:g} m",
    _size: f" above zero, at most {FARTHEST:g} m",
}
_RULES: tuple[tuple[str, str, int, Test], ...] = (  # element, attribute, how many numbers, which
    ("origin", "xyz", 3, _length),
    ("origin", "rpy", 3, _any),
    ("axis", "xyz", 3, _any),
    ("frame", "xyz", 3, _length),
    ("frame", "rpy", 3, _any),
    ("mesh", "scale", 3, _any),
    ("box", "size", 3, _size),
    ("cylinder", "radius", 1, _size),
    ("cylinder", "length", 1, _size),
    ("sphere", "radius", 1, _size),
    ("capsule", "radius", 1, _size),
    ("capsule", "length", 1, _size),
    (_DRAKE + "capsule", "radius", 1, _size),
    (_DRAKE + "capsule", "length", 1, _size),
    (_DRAKE + "ellipsoid", "a", 1, _size),
    (_DRAKE + "ellipsoid", "b", 1, _size),
    (_DRAKE + "ellipsoid", "c", 1, _size),
    ("limit", "lower", 1, _any),
    ("limit", "upper", 1, _any),
    ("limit", "velocity", 1, _not_negative),
    ("limit", "effort", 1, _not_negative),
    ("dynamics", "damping", 1, _not_negative),
    (_DRAKE + "hydroelastic_modulus", "value", 1, _positive),
    (_DRAKE + "mesh_resolution_hint", "value", 1, _positive),
    (_DRAKE + "mu_dynamic", "value", 1, _not_negative),
    (_DRAKE + "mu_static", "value", 1, _not_negative),
    (_DRAKE + "hunt_crossley_dissipation", "value", 1, _not_negative),
    (_DRAKE + "point_contact_stiffness", "value", 1, _positive),
    (_DRAKE + "relaxation_time", "value", 1, _not_negative),
    (_DRAKE + "rotor_inertia", "value", 1, _not_negative),
    (_DRAKE + "gear_ratio", "value", 1, _any),
)


def number(text: str | None) -> float:
    """Return the number in a text, or NaN for any other text."""
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


def check_numbers(urdf: Urdf) -> None:
    """Check that positions, axes, sizes, limits and contact properties are finite and in range.

    Raises:
        ModelError: a number is not; the message has its line.
    """
    for tag, attribute, count, fits in _RULES:
        for element in urdf.root.iter(tag):
            text = element.get(attribute)
            if text is None:
                continue
            values = [number(word) for word in text.split()]
            if len(values) != count or not all(map(fits, values)):
                expected = f"{count} finite numbers" if count > 1 else "a finite number"
                raise ModelError(
                    f"{_tag(element)} {attribute} '{text}' should be {expected}{_MEANING[fits]}",
                    where=urdf.where(element),
                )
    # NaN counts as true, so this finds zero vectors only; other faults are reported above.
    for axis in urdf.root.iter("axis"):
        if not any(number(word) for word in axis.get("xyz", "1 0 0").split()):
            raise ModelError(f"{_tag(axis)} xyz '{axis.get('xyz')}' has no direction", where=urdf.where(axis))
    for limit in urdf.root.iter("limit"):
        # Only one of the limits may be given.
        low, high = (number(limit.get(key, default)) for key, default in (("lower", "-inf"), ("upper", "inf")))
        if low > high:
            raise ModelError(f"{_tag(limit)} lower {low:g} is above upper {high:g}", where=urdf.where(limit))


def _tag(element: ElementTree.Element) -> str:
    return f"<{element.tag.replace(_DRAKE, 'drake:')}>"
