"""All numbers of a new vehicle with their origin: the given ones are checked, the others estimated."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_args

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.vehicles.estimates import (
    HOW,
    ROBOT_MASS,
    ROBOT_STEERING,
    STEERING_MOST,
    TURNING_CIRCLE,
    estimate,
    estimate_steering_limit,
    steering_limit_of_circle,
)
from mirdrake.vehicles.questions import (
    BODIES,
    QUANTITIES,
    USUAL_SENSORS,
    check_plausible,
    choose,
    missing_keys,
    parse_sensors,
    parse_tyre,
    read_quantity,
)
from mirdrake.vehicles.spec import Drive

GIVEN = "given"

STYLES: dict[str, tuple[float, float, str]] = {
    "hatchback": (1.60, 4.9, "as the Bolt"),
    "sedan": (1.73, 4.5, "as the MKZ"),
    "suv": (1.69, 4.9, "length as the Escape, height as the Bolt"),
    "van": (1.60, 6.5, "as the Sprinter"),
    "truck": (1.65, 6.5, "as a lorry of 7.5 t with a box"),
    "robot": (1.50, 3.8, "Unior about 1.5 and 4.4, F1TENTH 1.7"),
}
"""Length over wheelbase, height over wheel radius and their origin, by body style."""

_OWN: dict[str, str] = {
    "wheel_radius": "estimated: 0.12 wheelbases (Bolt 0.124, MKZ 0.116); below 200 kg 0.17 (F1TENTH 0.15, "
    "AutoRally 0.17)",
    "wheel_width": "estimated: 0.665 wheel radii, as the Bolt",
    "steering_limit": f"estimated: turning circle of {TURNING_CIRCLE:g} wheelbases as of 32 road vehicles (standard "
    f"deviation 7 %), at most {STEERING_MOST:g} rad; below {ROBOT_MASS:g} kg {ROBOT_STEERING:g} rad (F1TENTH 0.42, "
    "AutoRally 0.37)",
}
ROBOT_BODY, VAN_BODY, TRUCK_BODY = 200.0, 2500.0, 5000.0
"""Masses at which the default body style changes [kg]: robot, hatchback, van, truck."""

_FRONT_SHARE = "estimated: 0.56, as the Bolt, which also has its motor over the driven front axle"

TABLES: tuple[tuple[str, str, tuple[tuple[str, str, str], ...]], ...] = (
    (
        "Dimensions",
        "properties.xacro",
        (
            ("wheelbase", "wheelbase", "m"),
            ("track", "track, front", "m"),
            ("track_rear", "track, rear", "m"),
            ("wheel_radius", "wheel radius, front", "m"),
            ("wheel_width", "wheel width, front", "m"),
            ("rear_wheel_radius", "wheel radius, rear", "m"),
            ("rear_wheel_width", "wheel width, rear", "m"),
            ("length", "length", "m"),
            ("width", "width", "m"),
            ("height", "height", "m"),
            ("ground_clearance", "ground clearance", "m"),
            ("kingpin_offset", "scrub radius: steering axis inside the middle plane of the wheel", "m"),
        ),
    ),
    (
        "Masses and inertia",
        "properties.xacro; the inertia of the whole vehicle is a result, not an input",
        (
            ("mass", "mass of the whole vehicle", "kg"),
            ("wheel_mass", "one wheel", "kg"),
            ("knuckle_mass", "one steering knuckle", "kg"),
            ("front_axle_share", "share of the weight on the front axle", "-"),
            ("com_height", "height of the centre of mass", "m"),
            ("inertia_edges", "box with the inertia of the body", "m"),
            ("roll_inertia", "roll inertia, whole vehicle", "kg m²"),
            ("pitch_inertia", "pitch inertia, whole vehicle", "kg m²"),
            ("yaw_inertia", "yaw inertia, whole vehicle", "kg m²"),
        ),
    ),
    (
        "Steering, drive and brakes",
        "properties.xacro and vehicle.yaml",
        (
            ("steering_limit", "steering limit of the inner wheel", "rad"),
            ("steering_rate", "steering rate at the road wheel", "rad/s"),
            ("steering_effort", "torque of a steering joint", "N m"),
            ("steering_motor_damping", "damping of a steering motor", "N m s/rad"),
            ("steering_motor_inertia", "rotor inertia of a steering motor, at the road wheel", "kg m²"),
            ("steering_ratio", "steering ratio", "-"),
            ("max_torque", "drive torque, sum over the driven wheels", "N m"),
            ("max_power", "power", "W"),
            ("brake_torque", "brake torque, sum over the four wheels", "N m"),
            ("brake_front_share", "share of the brake torque on the front axle", "-"),
            ("wheel_speed_limit", "wheel speed limit", "rad/s"),
            ("rolling_resistance", "rolling resistance", "-"),
            ("drag_area", "drag area", "m²"),
        ),
    ),
    (
        "Suspension",
        "suspension.xacro and variants/springs.yaml; referred to the wheel",
        (
            ("carrier_mass", "unsprung mass besides wheel and knuckle", "kg"),
            ("suspension_travel", "wheel travel in bump and rebound", "m"),
            ("front_stiffness", "front spring", "N/m"),
            ("front_damping", "front damper", "N s/m"),
            ("front_anti_roll", "front anti-roll bar, force over difference of travel", "N/m"),
            ("rear_stiffness", "rear spring", "N/m"),
            ("rear_damping", "rear damper", "N s/m"),
            ("rear_anti_roll", "rear anti-roll bar, force over difference of travel", "N/m"),
        ),
    ),
    (
        "Contact",
        "contact.xacro",
        (
            ("friction", "friction coefficient of the tyre", "-"),
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
            ("max_correction", "speed loop, limit of the correction", "m/s"),
            ("max_acceleration", "slope of the speed set-point when accelerating", "m/s²"),
            ("max_deceleration", "slope of the speed set-point when decelerating", "m/s²"),
            ("wheel_servo_gain", "servo of a driven wheel", "N m s/rad"),
            ("steering_stiffness", "steering servo", "N m/rad"),
            ("steering_damping", "steering servo", "N m s/rad"),
        ),
    ),
    (
        "Slip tyres",
        "variants/handling.yaml; each for one tyre at the load of its axle",
        (
            ("front_load", "load, front", "N"),
            ("rear_load", "load, rear", "N"),
            ("front_cornering_stiffness", "cornering stiffness, front", "N/rad"),
            ("rear_cornering_stiffness", "cornering stiffness, rear", "N/rad"),
            ("front_slip_stiffness", "longitudinal slip stiffness, front", "N"),
            ("rear_slip_stiffness", "longitudinal slip stiffness, rear", "N"),
            ("patch_half_length", "half length of the contact patch", "m"),
            ("relaxation_x", "relaxation length, longitudinal", "m"),
            ("relaxation_y", "relaxation length, lateral", "m"),
            ("assist_speed", "antilock, traction and stability control are active above", "m/s"),
            ("stability_gain", "gain of the stability control", "N m s/rad"),
            ("stability_dead_band", "yaw-rate error that the stability control ignores", "rad/s"),
            ("stability_torque", "brake torque of the stability control, one wheel", "N m"),
            ("handling_steering_stiffness", "steering servo", "N m/rad"),
            ("handling_steering_damping", "steering servo", "N m s/rad"),
            ("handling_steering_rate", "steering rate", "rad/s"),
        ),
    ),
)
"""Tables of the README: title, file, and key, label and unit of each number."""


@dataclass(frozen=True)
class Plan:
    """All numbers of a new vehicle.

    Attributes:
        values: SI numbers by key: the given ones and the fields of :class:`mirdrake.vehicles.estimates.Estimates`.
        sources: origin by key: "given", or how the number was estimated.
        body: style of the body.
        drive: driven axle.
        sensors: mounted sensors, of :data:`mirdrake.vehicles.questions.SENSORS`.
    """

    values: Mapping[str, Any]
    sources: Mapping[str, str]
    body: str
    drive: str
    sensors: tuple[str, ...] = ()

    def estimated(self) -> dict[str, str]:
        """Return how each number was estimated, by key, without the given ones."""
        return {key: text for key, text in self.sources.items() if not text.startswith(GIVEN)}

    def listed(self) -> list[str]:
        """Return the keys without those of the rear axle that equal the front axle."""
        pairs = {"track_rear": "track", "rear_wheel_radius": "wheel_radius", "rear_wheel_width": "wheel_width"}
        return [key for key in self.values if self.values[key] != self.values.get(pairs.get(key, ""))]


def plan_vehicle(
    *,
    drive: str = "rear",
    body: str | None = None,
    sensors: str = USUAL_SENSORS,
    tyre: str | None = None,
    tyre_front: str | None = None,
    tyre_rear: str | None = None,
    **sizes: float | str | None,
) -> Plan:
    """Check the given quantities and estimate the others.

    Args:
        drive: front, rear or all.
        body: style, one of :data:`mirdrake.vehicles.questions.BODIES`; by mass if None.
        sensors: list of :data:`mirdrake.vehicles.questions.SENSORS`, separated by commas; ``none`` for none.
        tyre: size such as ``215/50R17``, instead of wheel_radius and wheel_width.
        tyre_front: tyre size of the front axle.
        tyre_rear: tyre size of the rear axle.
        sizes: by key of :data:`mirdrake.vehicles.questions.QUANTITIES`; numbers in SI, or texts with a unit.

    Raises:
        ConfigError: quantities are missing or implausible; one line for each.
    """
    choose("drive", drive, allowed=get_args(Drive))
    if body is not None:
        choose("body", body, allowed=BODIES)
    given = {key: value for key, value in sizes.items() if value is not None}
    tyres = {key: text for key, text in (("tyre", tyre), ("tyre_front", tyre_front), ("tyre_rear", tyre_rear)) if text}
    _check_doubles(given, tyres)
    if missing := missing_keys(given):
        raise ConfigError(f"missing: {', '.join(missing)}")

    # Given quantities in SI units with their origin. A value without an axle is that of the front axle.
    values: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        try:
            values[key] = read_quantity(QUANTITIES[key], value)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(faults))
    sources = {key: GIVEN if _is_plain(given[key]) else f"{GIVEN}: {given[key]}" for key in values}
    for place, text in tyres.items():
        for axle in ("", "rear_") if place == "tyre" else ("rear_",) if place == "tyre_rear" else ("",):
            for part, size in zip(("wheel_radius", "wheel_width"), parse_tyre(text, where=place), strict=True):
                values[axle + part], sources[axle + part] = size, f"{GIVEN}: tyre {text.strip()}"
    for own, common in (("track", "track_front"), ("track_rear", "track")):
        if own not in values:
            values[own], sources[own] = values[common], sources[common]
    for known in (values, sources):
        known.pop("track_front", None)
    if "wheel_radius" not in values:
        ratio = 0.17 if values["mass"] < ROBOT_BODY else 0.12
        values["wheel_radius"], sources["wheel_radius"] = rounded(ratio * values["wheelbase"]), _OWN["wheel_radius"]
    check_plausible(values)

    # Input quantities that are not given.
    _estimate_sizes(values, sources, body := body or _usual_body(values["mass"]))
    share, share_text = (0.56, _FRONT_SHARE) if drive == "front" else (None, HOW["front_axle_share"])
    inputs: dict[str, Any] = {
        key: values.get(key)
        for key in (
            *("mass", "wheelbase", "steering_limit", "length", "height"),
            *("width", "com_height", "yaw_inertia", "power", "top_speed"),
        )
    }
    result = estimate(
        **inputs,
        track=(values["track"] + values["track_rear"]) / 2.0,
        wheel_radius=(values["wheel_radius"] + values["rear_wheel_radius"]) / 2.0,
        wheel_width=(values["wheel_width"] + values["rear_wheel_width"]) / 2.0,
        front_axle_share=values.get("front_axle_share", share),
        driven_wheels=4 if drive == "all" else 2,
    )
    for key, name in (("power", "max_power"), ("top_speed", "wheel_speed_limit")):
        if key in values:
            sources[name] = sources.pop(key) + (", over the wheel radius" if key == "top_speed" else "")
    for key, value in asdict(result).items():
        if key not in values:
            values[key] = tuple(map(rounded, value)) if isinstance(value, tuple) else rounded(value)
            sources.setdefault(key, share_text if key == "front_axle_share" else HOW[key])
    _check_power(values)
    values = {key: value for key, value in values.items() if key not in ("power", "top_speed", "turning_circle")}
    return Plan(values, {key: sources[key] for key in values}, body, drive, parse_sensors(sensors))


def _check_doubles(given: Mapping[str, Any], tyres: Mapping[str, str]) -> None:
    """Check that no quantity is given twice.

    Raises:
        ConfigError: a quantity is given twice.
    """
    for key, text in tyres.items():
        double = [part for part in ("wheel_radius", "wheel_width") if part in given]
        if double:
            raise ConfigError(f"{key} '{text}' and {' and '.join(double)} are both given; give one of them")
    pairs = [("steering_limit", "turning_circle"), ("track", "track_front")]
    present = {*given, *tyres}
    pairs += [("tyre", "tyre_front"), ("tyre", "tyre_rear")]
    for one, other in pairs:
        if one in present and other in present:
            raise ConfigError(f"{one} and {other} are both given; give one of them")
    if len(present & {"tyre_front", "tyre_rear"}) == 1:
        (one,) = present & {"tyre_front", "tyre_rear"}
        raise ConfigError(f"{one} is given alone; give tyre_front and tyre_rear, or tyre for both axles")


def _usual_body(mass: float) -> str:
    """Return the default body style for a mass [kg]."""
    for limit, style in ((ROBOT_BODY, "robot"), (VAN_BODY, "hatchback"), (TRUCK_BODY, "van")):
        if mass < limit:
            return style
    return "truck"


def _estimate_sizes(values: dict[str, Any], sources: dict[str, str], body: str) -> None:
    """Estimate wheel width, steering limit, length and height if not given, and complete the rear axle."""
    radius, wheelbase, track = values["wheel_radius"], values["wheelbase"], values["track"]
    long, high, why = STYLES[body]
    own = {
        "wheel_width": min(0.665 * radius, 0.8 * track),
        "length": max(long * wheelbase, wheelbase + 2.6 * radius),
        "height": high * radius,
    }
    texts = _OWN | {
        "length": f"estimated: {long:g} wheelbases ({body}: {why}), at least 2.6 wheel radii longer than one",
        "height": f"estimated: {high:g} wheel radii ({body}: {why})",
    }
    steering = {"wheelbase": wheelbase, "track": track, "wheel_radius": radius}
    if "turning_circle" in values:
        limit = QUANTITIES["steering_limit"]
        angle = steering_limit_of_circle(values["turning_circle"], **steering)
        if not limit.low <= angle <= limit.high:
            raise ConfigError(
                f"turning_circle {values['turning_circle']:g} m needs an inner wheel angle of {angle:.3g} rad; "
                f"allowed: {limit.low:g} to {limit.high:g} rad"
            )
        values["steering_limit"] = angle
        sources["steering_limit"] = f"{sources.pop('turning_circle')}: turning circle {values['turning_circle']:g} m"
    else:
        own["steering_limit"] = estimate_steering_limit(mass=values["mass"], **steering)
    for key, value in own.items():
        if key not in values:
            values[key], sources[key] = rounded(value), texts[key]
    for key in ("wheel_radius", "wheel_width"):
        if f"rear_{key}" not in values:
            values[f"rear_{key}"], sources[f"rear_{key}"] = values[key], sources[key]


def _check_power(values: Mapping[str, Any]) -> None:
    """Check that the power is sufficient for the top speed on a level road.

    Raises:
        ConfigError: it is not.
    """
    if "top_speed" not in values or "power" not in values:
        return
    speed = values["top_speed"]
    force = values["mass"] * GRAVITY * values["rolling_resistance"] + 0.6 * values["drag_area"] * speed**2
    if force * speed > values["power"]:
        raise ConfigError(
            f"top_speed {speed:g} m/s needs {force * speed:.3g} W against air and rolling resistance, and power is "
            f"{values['power']:g} W; lower the speed or raise the power"
        )


def rounded(value: float) -> float:
    """Return a number rounded to four digits, the precision of an estimate."""
    return float(f"{value:.4g}")


def _is_plain(value: float | str) -> bool:
    """Return whether a given number has no unit."""
    try:
        float(value)
    except ValueError:
        return False
    return True
