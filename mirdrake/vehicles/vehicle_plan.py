"""All numbers of a new vehicle: what was given is checked, the rest estimated, and each knows where it is from."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_args

from mirdrake.errors import ConfigError
from mirdrake.vehicles.estimates import HOW, estimate
from mirdrake.vehicles.questions import (
    BODIES,
    QUANTITIES,
    REQUIRED,
    STEERING_LIMIT,
    check_plausible,
    choose,
    parse_tyre,
    read_quantity,
)
from mirdrake.vehicles.spec import Drive

GIVEN = "given"

STYLES: dict[str, tuple[float, float, str]] = {
    "hatchback": (1.60, 4.9, "as the Bolt"),
    "sedan": (1.73, 4.5, "as the MKZ"),
    "suv": (1.69, 4.9, "length as the Escape, height as the Bolt"),
    "buggy": (1.50, 3.8, "Unior about 1.5 and 4.4, a roll cage instead of a roof"),
}
"""Of a body: length over wheelbase, height over wheel radius, why."""

_OWN: dict[str, str] = {
    "wheel_width": "estimated: 0.665 wheel radii, as the Bolt",
    "steering_limit": f"estimated: {STEERING_LIMIT:g} rad, as many cars (Bolt 0.6, MKZ 0.55, GEM e2 0.61)",
}
_FRONT_SHARE = (0.56, "estimated: 0.56, as the Bolt, which has its motor over the driven front axle, too")

TABLES: tuple[tuple[str, str, tuple[tuple[str, str, str], ...]], ...] = (
    (
        "Dimensions",
        "properties.xacro",
        (
            ("wheelbase", "wheelbase", "m"),
            ("track", "track, front and rear", "m"),
            ("wheel_radius", "wheel radius", "m"),
            ("wheel_width", "wheel width", "m"),
            ("length", "length", "m"),
            ("width", "width", "m"),
            ("height", "height", "m"),
            ("ground_clearance", "ground clearance", "m"),
            ("kingpin_offset", "steering axis inside the wheel's middle plane", "m"),
        ),
    ),
    (
        "Masses and inertia",
        "properties.xacro; the whole vehicle's inertia is no input, it follows",
        (
            ("mass", "mass of the whole vehicle", "kg"),
            ("wheel_mass", "one wheel", "kg"),
            ("knuckle_mass", "one steering knuckle", "kg"),
            ("front_axle_share", "part of the weight on the front axle", "-"),
            ("com_height", "height of the centre of mass", "m"),
            ("inertia_edges", "box with the body's inertia", "m"),
            ("roll_inertia", "roll inertia, whole vehicle", "kg m²"),
            ("pitch_inertia", "pitch inertia, whole vehicle", "kg m²"),
            ("yaw_inertia", "yaw inertia, whole vehicle", "kg m²"),
        ),
    ),
    (
        "Steering, drive and brakes",
        "properties.xacro and vehicle.yaml",
        (
            ("steering_limit", "limit of the inner wheel", "rad"),
            ("steering_rate", "rate at the road wheel", "rad/s"),
            ("steering_effort", "torque of a steering joint", "N m"),
            ("steering_motor_damping", "resistance of a steering motor", "N m s/rad"),
            ("steering_motor_inertia", "its rotor, at the wheel", "kg m²"),
            ("steering_ratio", "hand wheel to road wheel", "-"),
            ("max_torque", "drive torque at the wheels, together", "N m"),
            ("max_power", "power", "W"),
            ("brake_torque", "brake torque of the four wheels", "N m"),
            ("brake_front_share", "front axle's part of it", "-"),
            ("wheel_speed_limit", "wheel speed limit", "rad/s"),
            ("rolling_resistance", "rolling resistance", "-"),
            ("drag_area", "drag area", "m²"),
        ),
    ),
    (
        "Suspension",
        "suspension.xacro and variants/springs.yaml; all at the wheel",
        (
            ("carrier_mass", "what moves up and down besides wheel and knuckle", "kg"),
            ("suspension_travel", "travel, up and down", "m"),
            ("front_stiffness", "front spring", "N/m"),
            ("front_damping", "front damper", "N s/m"),
            ("front_anti_roll", "front anti-roll bar, over the difference of travel", "N/m"),
            ("rear_stiffness", "rear spring", "N/m"),
            ("rear_damping", "rear damper", "N s/m"),
            ("rear_anti_roll", "rear anti-roll bar, over the difference of travel", "N/m"),
        ),
    ),
    (
        "Contact",
        "contact.xacro",
        (
            ("friction", "friction of the tyre", "-"),
            ("tyre_modulus", "hydroelastic modulus", "Pa"),
            ("tyre_resolution", "mesh hint", "m"),
            ("tyre_dissipation", "dissipation", "s/m"),
            ("tyre_point_stiffness", "stiffness in point contact", "N/m"),
            ("arch_half", "half length of a wheel arch", "m"),
        ),
    ),
    (
        "Control",
        "control.yaml",
        (
            ("speed_kp", "speed loop, kp", "-"),
            ("speed_ki", "speed loop, ki", "1/s"),
            ("max_correction", "speed loop, limit of the trim", "m/s"),
            ("max_acceleration", "slope of the speed set-point, faster", "m/s²"),
            ("max_deceleration", "the same, slower", "m/s²"),
            ("wheel_servo_gain", "servo of a driven wheel", "N m s/rad"),
            ("steering_stiffness", "steering servo", "N m/rad"),
            ("steering_damping", "steering servo", "N m s/rad"),
        ),
    ),
)
"""Tables of the README: title, file, and key, label, unit of each number."""


@dataclass(frozen=True)
class Plan:
    """All numbers of a new vehicle, before anything is written.

    Attributes:
        values: SI numbers by key: the given ones and the fields of :class:`mirdrake.vehicles.estimates.Estimates`.
        sources: for each key, "given" or how it was estimated.
        body: style of the body.
        drive: driven axle.
    """

    values: Mapping[str, Any]
    sources: Mapping[str, str]
    body: str
    drive: str

    def estimated(self) -> dict[str, str]:
        """Keys of what was not given, with how it was estimated."""
        return {key: text for key, text in self.sources.items() if not text.startswith(GIVEN)}


def plan_vehicle(
    *, drive: str = "rear", body: str = "hatchback", tyre: str | None = None, **sizes: float | str | None
) -> Plan:
    """Check what is given and estimate the rest.

    Args:
        drive: front, rear or all.
        body: style, one of :data:`mirdrake.vehicles.questions.BODIES`.
        tyre: size such as ``215/50R17``, instead of wheel_radius and wheel_width.
        sizes: by key of :data:`mirdrake.vehicles.questions.QUANTITIES`; numbers in SI, or texts with a unit.

    Raises:
        ConfigError: something is missing or implausible; one line for each fault.
    """
    choose("drive", drive, allowed=get_args(Drive))
    choose("body", body, allowed=BODIES)
    given = {key: value for key, value in sizes.items() if value is not None}
    if tyre is not None:
        double = [key for key in ("wheel_radius", "wheel_width") if key in given]
        if double:
            raise ConfigError(f"tyre '{tyre}' says {' and '.join(double)} as well; give one or the other")
        given["wheel_radius"], given["wheel_width"] = parse_tyre(tyre)
    missing = [key for key in REQUIRED if key not in given]
    if missing:
        words = [f"{key} (or tyre)" if key == "wheel_radius" else key for key in missing]
        raise ConfigError(f"missing: {', '.join(words)}")
    values: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        try:
            values[key] = read_quantity(QUANTITIES[key], value)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(faults))
    check_plausible(values)

    sources = {key: GIVEN if _is_plain(given[key]) else f"{GIVEN}: {given[key]}" for key in values}
    if tyre is not None:
        sources |= dict.fromkeys(("wheel_radius", "wheel_width"), f"{GIVEN}: tyre {tyre.strip()}")
    radius, wheelbase = values["wheel_radius"], values["wheelbase"]
    own = {"wheel_width": min(0.665 * radius, 0.8 * values["track"]), "steering_limit": STEERING_LIMIT}
    long, high, why = STYLES[body]
    own |= {"length": max(long * wheelbase, wheelbase + 2.6 * radius), "height": high * radius}
    texts = _OWN | {
        "length": f"estimated: {long:g} wheelbases ({body}: {why}), at least 2.6 wheel radii longer than one",
        "height": f"estimated: {high:g} wheel radii ({body}: {why})",
    }
    for key, value in own.items():
        if key not in values:
            values[key], sources[key] = rounded(value), texts[key]
    share, share_text = _FRONT_SHARE if drive == "front" else (None, HOW["front_axle_share"])
    inputs = {key: values[key] for key in (*REQUIRED, "wheel_width", "steering_limit", "length", "height")}
    result = estimate(
        **inputs, width=values.get("width"), front_axle_share=share, driven_wheels=4 if drive == "all" else 2
    )
    for key, value in asdict(result).items():
        if key not in values:
            values[key] = tuple(map(rounded, value)) if isinstance(value, tuple) else rounded(value)
            sources[key] = share_text if key == "front_axle_share" else HOW[key]
    return Plan(values, sources, body, drive)


def rounded(value: float) -> float:
    """Four digits: an estimate has no more."""
    return float(f"{value:.4g}")


def _is_plain(value: float | str) -> bool:
    """Whether a given number stands without unit."""
    try:
        float(value)
    except ValueError:
        return False
    return True
