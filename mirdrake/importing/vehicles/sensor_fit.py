"""Corrections of a sensor to the schema of sensors.yaml."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import copysign, inf, isfinite, pi, radians
from types import MappingProxyType

from pydantic import ValidationError

from mirdrake.core.json_io import Json
from mirdrake.sensors.ranging.mount import MAX_RAYS, ROUNDED_TURN
from mirdrake.vehicles.mount import Mount
from mirdrake.vehicles.mounts import SENSOR_KINDS

NEAREST, FARTHEST = 1e-3, 1e5
"""Distances [m] in place of zero or less, and of infinity or more."""

WIDEST = 3.13
"""Widest field of view of a camera without a fisheye lens [rad]."""

_ANGLES = (("start_angle", "end_angle"), ("horizontal_start", "horizontal_end"), ("vertical_start", "vertical_end"),
           ("horizontal_fov",), ("cone",))  # fmt: skip
_FANS = _ANGLES[:2]
_RANGES = (("near", "far"), ("depth_near", "depth_far"))


MountData = Json
"""A mount as in sensors.yaml."""


@dataclass(frozen=True)
class Correction:
    """A corrected value: key of the mount, old and new value, and the reason."""

    key: str
    old: str
    new: str
    reason: str


def fit_mount(
    mount: MountData, defaults: Mapping[str, float] = MappingProxyType({})
) -> tuple[MountData | None, list[Correction], str]:
    """Correct the values of a mount that the schema does not allow and that have an unambiguous correction.

    Args:
        mount: entry of sensors.yaml with a known kind; its numbers may be anything.
        defaults: what replaces required values that are out of range, by key.

    Returns:
        the valid mount, its corrections and ""; or None, the corrections so far and the schema's reason.
    """
    cls, mount = SENSOR_KINDS[mount["kind"]], dict(mount)
    corrections: list[Correction] = []
    _convert_degrees(cls, mount, corrections)
    _bound(cls, mount, defaults, corrections)
    _order(mount, corrections)
    _narrow(mount, corrections)
    if "rows" in mount and mount["columns"] * mount["rows"] > MAX_RAYS:
        _set(mount, "columns", MAX_RAYS // mount["rows"], f"at most {MAX_RAYS} rays a scan are cast", corrections)
    # Each pass removes one optional value, so that the loop ends.
    for _ in range(len(mount)):
        try:
            cls.model_validate({"frame": "any", **mount})
            return mount, corrections, ""
        except ValidationError as error:
            first = error.errors()[0]
        key, reason = str(first["loc"][0]) if first["loc"] else "", first["msg"].removeprefix("Value error, ")
        if key not in mount or cls.model_fields[key].is_required():
            break
        corrections.append(Correction(key, str(mount.pop(key))[:60], "left out", reason))
    return None, corrections, f"{key}: {reason}" if key else reason


def limits_of(cls: type[Mount], key: str) -> tuple[float, float, bool]:
    """Return the smallest and largest value that the schema allows, and whether the smallest is excluded."""
    low, high, strict = -inf, inf, False
    if key == "horizontal_fov":  # whose upper limit is a validator of its own
        high = WIDEST
    for item in cls.model_fields[key].metadata:
        if (bound := getattr(item, "ge", None)) is not None:
            low = float(bound)
        if (bound := getattr(item, "gt", None)) is not None:
            low, strict = float(bound), True
        for name in ("le", "lt"):
            if (bound := getattr(item, name, None)) is not None:
                high = float(bound)
    return low, high, strict


def _set(mount: MountData, key: str, value: float, why: str, corrections: list[Correction]) -> None:
    corrections.append(Correction(key, f"{mount[key]:.6g}", f"{value:.6g}", why))
    mount[key] = value


def _convert_degrees(cls: type[Mount], mount: MountData, corrections: list[Correction]) -> None:
    """Convert angles that are impossible in radians from degrees, both ends of a fan together."""
    # 90 as a limit of a fan can only mean degrees.
    for keys in _ANGLES:
        if any(key not in mount for key in keys):
            continue
        single = len(keys) == 1
        # A field of view between 180 degrees and 2 pi may be a fisheye's in radians.
        highest = 2.0 * pi if single else limits_of(cls, keys[0])[1]
        if max(abs(mount[key]) for key in keys) > highest:
            turned = [radians(mount[key]) for key in keys]
            if all(abs(angle) <= min(highest, pi if single else highest) for angle in turned):
                for key, angle in zip(keys, turned, strict=True):
                    _set(mount, key, angle, "in degrees: no such angle in radians", corrections)


def _bound(cls: type[Mount], mount: MountData, defaults: Mapping[str, float], corrections: list[Correction]) -> None:
    """Limit counts and distances to the ranges of the schema, and remove invalid optional values."""
    for key, value in list(mount.items()):
        if isinstance(value, str | dict | bool):
            continue
        # The ranges are those of the mount's schema: a mount that is written here has to load.
        low, high, strict = limits_of(cls, key)
        field, distance = cls.model_fields[key], any(key in pair for pair in _RANGES)
        allowed = f"above {low:g}" if strict else f"{low:g} and more"
        allowed += f", up to {high:g}, is allowed" if isfinite(high) else " is allowed"
        if distance and value > FARTHEST:
            _set(mount, key, FARTHEST, f"at most {FARTHEST:g} m", corrections)
        elif key == "cone" and value >= high and isfinite(value):
            _set(mount, key, WIDEST, "a cone is narrower than half a turn", corrections)
        elif value > high and field.annotation is int:
            _set(mount, key, int(high), f"at most {high:g}", corrections)
        elif value < low or value > high or (strict and value == low) or not isfinite(value):
            if key in defaults:
                _set(mount, key, defaults[key], f"{allowed}; Gazebo's default", corrections)
            elif key in ("near", "depth_near"):
                _set(mount, key, NEAREST, "above 0", corrections)
            elif not field.is_required():
                del mount[key]
                default = field.get_default(call_default_factory=True)
                text = f"{default:g}" if isinstance(default, int | float) else "0"
                corrections.append(Correction(key, f"{value:.6g}", text, allowed))
    # Noise is a mapping in the schema: a plain number is its standard deviation.
    for key in [key for key, value in mount.items() if key.endswith("noise") and not isinstance(value, str | dict)]:
        if not (isfinite(mount[key]) and mount[key] >= 0.0):
            corrections.append(Correction(key, f"{mount[key]:.6g}", "0", "a standard deviation is 0 or more"))
            del mount[key]


def _order(mount: MountData, corrections: list[Correction]) -> None:
    """Exchange a nearest and a farthest distance in the wrong order."""
    for near, far in _RANGES:
        if near in mount and far in mount and mount[near] > mount[far] > 0.0:
            was = f"{mount[near]:.6g} to {mount[far]:.6g} m"
            mount[near], mount[far] = mount[far], mount[near]
            became = f"{mount[near]:.6g} to {mount[far]:.6g} m"
            corrections.append(Correction(f"{near} and {far}", was, became, "exchanged: near should be below far"))


def _narrow(mount: MountData, corrections: list[Correction]) -> None:
    """Limit a fan to one turn."""
    for start, end in _FANS:
        if start not in mount or end not in mount:
            continue
        span = mount[end] - mount[start]
        if abs(span) > ROUNDED_TURN:
            was = f"{mount[start]:.6g} to {mount[end]:.6g} rad"
            # A symmetric fan stays symmetric about x.
            if abs(mount[start] + mount[end]) < 1e-3 * abs(span):
                mount[start] = -copysign(pi, span)
            mount[end] = mount[start] + copysign(2.0 * pi, span)
            became = f"{mount[start]:.6g} to {mount[end]:.6g} rad"
            corrections.append(Correction(f"{start} and {end}", was, became, "a fan of beams is at most one turn"))
