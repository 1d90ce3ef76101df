"""All numbers of a new vehicle with their origin: the given ones are checked, the others estimated."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_args

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.vehicles.estimates import (
    HOW,
    LABELS,
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
    "robot": (1.50, 3.8, "Unior about 1.5 wheelbases long and 4.4 wheel radii high, F1TENTH 1.7 wheelbases long"),
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

_TABLES = (
    ("Dimensions", "properties.xacro",
     "wheelbase track track_rear wheel_radius wheel_width rear_wheel_radius rear_wheel_width length width height "
     "ground_clearance kingpin_offset"),
    ("Masses and inertia", "properties.xacro; the inertia of the whole vehicle is a result, not an input",
     "mass wheel_mass knuckle_mass front_axle_share com_height inertia_edges roll_inertia pitch_inertia yaw_inertia"),
    ("Steering, drive and brakes", "properties.xacro and vehicle.yaml",
     "steering_limit steering_rate steering_effort steering_motor_damping steering_motor_inertia steering_ratio "
     "max_torque max_power brake_torque brake_front_share wheel_speed_limit rolling_resistance drag_area"),
    ("Suspension", "suspension.xacro and variants/springs.yaml; referred to the wheel",
     "carrier_mass suspension_travel front_stiffness front_damping front_anti_roll rear_stiffness rear_damping "
     "rear_anti_roll"),
    ("Contact", "contact.xacro",
     "friction tyre_dissipation tyre_stiffness arch_half"),
    ("Control", "control.yaml",
     "speed_kp speed_ki max_correction max_speed max_acceleration max_deceleration wheel_servo_gain "
     "steering_stiffness steering_damping"),
    ("Slip tyres", "variants/handling.yaml; each for one tyre at the load of its axle",
     "front_load rear_load front_cornering_stiffness rear_cornering_stiffness front_slip_stiffness "
     "rear_slip_stiffness patch_half_length relaxation_x relaxation_y assist_speed stability_gain "
     "stability_dead_band stability_torque handling_steering_stiffness handling_steering_damping "
     "handling_steering_rate"),
)  # fmt: skip

_INPUT_LABELS = {
    "wheelbase": ("wheelbase", "m"),
    "track": ("track, front", "m"),
    "track_rear": ("track, rear", "m"),
    "wheel_radius": ("wheel radius, front", "m"),
    "wheel_width": ("wheel width, front", "m"),
    "rear_wheel_radius": ("wheel radius, rear", "m"),
    "rear_wheel_width": ("wheel width, rear", "m"),
    "mass": ("mass of the whole vehicle", "kg"),
    "steering_limit": ("steering limit of the inner wheel", "rad"),
}

TABLES: tuple[tuple[str, str, tuple[tuple[str, str, str], ...]], ...] = tuple(
    (title, file, tuple((key, *(_INPUT_LABELS | LABELS)[key]) for key in keys.split())) for title, file, keys in _TABLES
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

    def given_count(self) -> int:
        """Return how many numbers were given; one for both axles counts once."""
        return sum(text.startswith(GIVEN) for key, text in self.sources.items() if key in self.listed())

    def listed(self) -> list[str]:
        """Return the keys without those of the rear axle that equal the front axle."""
        pairs = {"track_rear": "track", "rear_wheel_radius": "wheel_radius", "rear_wheel_width": "wheel_width"}
        return [key for key in self.values if self.values[key] != self.values.get(pairs.get(key, ""))]


def plan_vehicle(
    *,
    drive: Drive = "rear",
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
        sizes: sizes by key of :data:`mirdrake.vehicles.questions.QUANTITIES`; numbers in SI, or texts with a unit.

    Raises:
        ConfigError: quantities are missing or implausible; one line for each.
    """
    choose("drive", drive, allowed=get_args(Drive))
    if body is not None:
        choose("body", body, allowed=BODIES)
    given = {key: value for key, value in sizes.items() if value is not None}
    if unknown := sorted(given.keys() - QUANTITIES):
        raise ConfigError(f"unknown quantity '{unknown[0]}'; {did_you_mean(unknown[0], QUANTITIES)}")
    tyres = {key: text for key, text in (("tyre", tyre), ("tyre_front", tyre_front), ("tyre_rear", tyre_rear)) if text}
    _check_doubles(given, tyres)
    if missing := missing_keys(given):
        raise ConfigError(f"missing: {', '.join(missing)}")

    # Given quantities in SI units with their origin. A value without an axle is that of the front axle.
    values: dict[str, float] = {}
    faults = []
    for key, value in given.items():
        try:
            values[key] = read_quantity(QUANTITIES[key], value)
        except ConfigError as error:
            faults.append(error)
    if faults:
        raise ConfigError(faults=faults)
    sources = {key: GIVEN if _is_plain(given[key]) else f"{GIVEN}: {given[key]}" for key in values}

    # A tyre size gives radius and width; `tyre` those of both axles.
    for place, text in tyres.items():
        for axle in ("", "rear_") if place == "tyre" else ("rear_",) if place == "tyre_rear" else ("",):
            for part, size in zip(("wheel_radius", "wheel_width"), parse_tyre(text, where=place), strict=True):
                values[axle + part], sources[axle + part] = size, f"{GIVEN}: tyre {text.strip()}"
    # Order matters: a front track given as `track_front` becomes `track`, which the rear axle may take.
    for axle_key, common in (("track", "track_front"), ("track_rear", "track")):
        if axle_key not in values:
            values[axle_key], sources[axle_key] = values[common], sources[common]
    for known in (values, sources):
        known.pop("track_front", None)
    if "wheel_radius" not in values:
        ratio = 0.17 if values["mass"] < ROBOT_BODY else 0.12
        values["wheel_radius"], sources["wheel_radius"] = rounded(ratio * values["wheelbase"]), _OWN["wheel_radius"]
    check_plausible(values)

    # Input quantities that are not given.
    _estimate_sizes(values, sources, body := body or _usual_body(values["mass"]))
    # Front-driven cars carry engine and gearbox in front: share of the Bolt.
    share, share_text = (0.56, _FRONT_SHARE) if drive == "front" else (None, HOW["front_axle_share"])
    result = estimate(
        mass=values["mass"],
        wheelbase=values["wheelbase"],
        steering_limit=values["steering_limit"],
        length=values["length"],
        height=values["height"],
        width=values.get("width"),
        com_height=values.get("com_height"),
        yaw_inertia=values.get("yaw_inertia"),
        power=values.get("power"),
        top_speed=values.get("top_speed"),
        # The estimates know one axle; where axles differ they get the mean.
        track=(values["track"] + values["track_rear"]) / 2.0,
        wheel_radius=(values["wheel_radius"] + values["rear_wheel_radius"]) / 2.0,
        wheel_width=(values["wheel_width"] + values["rear_wheel_width"]) / 2.0,
        front_axle_share=values.get("front_axle_share", share),
        drive=drive,
    )

    # Given power and top speed are inputs; the files have the limits that follow from them, with their origin.
    if "power" in values:
        sources["max_power"] = sources.pop("power")
    if "top_speed" in values:
        sources["max_speed"] = sources.pop("top_speed")
        sources["wheel_speed_limit"] = "top speed over the wheel radius"
    _check_power(asdict(result) | values)
    # Given values stay as they are; only estimates are rounded to their precision.
    numbers: dict[str, float | tuple[float, ...]] = {**values}
    for key, value in asdict(result).items():
        if key not in numbers:
            numbers[key] = tuple(map(rounded, value)) if isinstance(value, tuple) else rounded(value)
            sources.setdefault(key, share_text if key == "front_axle_share" else HOW[key])
    numbers = {key: value for key, value in numbers.items() if key not in ("power", "top_speed", "turning_circle")}
    return Plan(numbers, {key: sources[key] for key in numbers}, body, drive, parse_sensors(sensors))


def _check_doubles(given: Mapping[str, Any], tyres: Mapping[str, str]) -> None:
    """Check that no quantity is given twice.

    Raises:
        ConfigError: a quantity is given twice.
    """
    for key, text in tyres.items():
        double = [part for part in ("wheel_radius", "wheel_width") if part in given]
        if double:
            raise ConfigError(f"{key} '{text}' and {' and '.join(double)} are both given; give one of them")
    # Each pair determines the same quantity.
    pairs = [("steering_limit", "turning_circle"), ("track", "track_front")]
    present = {*given, *tyres}
    pairs += [("tyre", "tyre_front"), ("tyre", "tyre_rear")]
    for first, other in pairs:
        if first in present and other in present:
            raise ConfigError(f"{first} and {other} are both given; give one of them")
    if len(present & {"tyre_front", "tyre_rear"}) == 1:
        (first,) = present & {"tyre_front", "tyre_rear"}
        raise ConfigError(f"{first} is given alone; give tyre_front and tyre_rear, or tyre for both axles")


def _usual_body(mass: float) -> str:
    """Return the default body style for a mass [kg]."""
    for limit, style in ((ROBOT_BODY, "robot"), (VAN_BODY, "hatchback"), (TRUCK_BODY, "van")):
        if mass < limit:
            return style
    return "truck"


def _estimate_sizes(values: dict[str, float], sources: dict[str, str], body: str) -> None:
    """Estimate wheel width, steering limit, length and height if not given, and complete the rear axle."""
    radius, wheelbase, track = values["wheel_radius"], values["wheelbase"], values["track"]
    long, high, why = STYLES[body]
    estimates = {
        "wheel_width": min(0.665 * radius, 0.8 * track),
        "length": max(long * wheelbase, wheelbase + 2.6 * radius),
        "height": high * radius,
    }
    texts = _OWN | {
        "length": f"estimated: {long:g} wheelbases ({body}: {why}), at least 2.6 wheel radii longer than one",
        "height": f"estimated: {high:g} wheel radii ({body}: {why})",
    }
    steering = {"wheelbase": wheelbase, "track": track, "wheel_radius": radius}
    # A turning circle determines the steering limit, which must be one that a joint can have.
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
        estimates["steering_limit"] = estimate_steering_limit(mass=values["mass"], **steering)
    # Values of the user are never replaced, and each estimate states its formula as its source.
    for key, value in estimates.items():
        if key not in values:
            values[key], sources[key] = rounded(value), texts[key]
    # The rear axle has the wheels of the front one unless given, with the same origin.
    for key in ("wheel_radius", "wheel_width"):
        if f"rear_{key}" not in values:
            values[f"rear_{key}"], sources[f"rear_{key}"] = values[key], sources[key]


def _check_power(values: Mapping[str, Any]) -> None:
    """Check that the power is sufficient for the top speed on a level road.

    Raises:
        ConfigError: the power is too low.
    """
    if "top_speed" not in values or "power" not in values:
        return
    speed = values["top_speed"]
    # Rolling resistance and drag, ρ / 2 = 0.6 kg/m³.
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
