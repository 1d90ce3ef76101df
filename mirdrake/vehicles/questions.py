"""Input of a new vehicle: quantities with units and ranges, and the questions in a terminal."""

import builtins
import re
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import to_si
from mirdrake.vehicles.spec import Drive

BODIES = ("hatchback", "sedan", "suv", "van", "truck", "robot")

SENSORS = ("camera", "depth_camera", "lidar", "gps", "imu", "sonar")
"""Sensors that a new vehicle can have."""

USUAL_SENSORS = "camera,gps,imu"


@dataclass(frozen=True)
class Quantity:
    """Input quantity of a new vehicle.

    Attributes:
        key: argument of :func:`mirdrake.vehicles.scaffold.new_vehicle`.
        text: description.
        unit: SI unit.
        low: smallest allowed value.
        high: largest allowed value.
        required: whether it cannot be estimated.
        example: example input.
        instead: quantity that this one replaces, for the vehicle or one axle.
    """

    key: str
    text: str
    unit: str
    low: float
    high: float
    required: bool = False
    example: str = ""
    instead: str = ""


QUANTITIES: dict[str, Quantity] = {
    quantity.key: quantity
    for quantity in (
        Quantity("wheelbase", "wheelbase, between the axles", "m", 0.1, 10.0, True, "2.6, 102.4 in"),
        Quantity(
            "track", "track, between the middle planes of the wheels of an axle", "m", 0.05, 4.0, True, "1.5, 59 in"
        ),
        Quantity("track_front", "track of the front axle", "m", 0.05, 4.0, example="1.52", instead="track"),
        Quantity("track_rear", "track of the rear axle", "m", 0.05, 4.0, example="1.48", instead="track"),
        Quantity("mass", "mass, ready to drive", "kg", 0.1, 20000.0, True, "1450, 3200 lb"),
        Quantity("wheel_radius", "wheel radius", "m", 0.01, 1.0, example="0.32, 12.7 in"),
        Quantity("wheel_width", "wheel width", "m", 0.003, 0.8, example="0.2, 8 in"),
        Quantity("steering_limit", "steering limit of the inner wheel", "rad", 0.05, 1.3, example="0.6, 35 deg"),
        Quantity(
            "turning_circle",
            "turning circle between kerbs, at the outer front wheel",
            "m",
            0.3,
            100.0,
            example="10.8, 35.4 ft",
            instead="steering_limit",
        ),
        Quantity("length", "overall length", "m", 0.1, 20.0, example="4.1"),
        Quantity("width", "overall width without mirrors", "m", 0.05, 5.0, example="1.8"),
        Quantity("height", "overall height", "m", 0.03, 6.0, example="1.5"),
        Quantity("front_axle_share", "share of the weight on the front axle", "-", 0.15, 0.85, example="0.56"),
        Quantity("com_height", "height of the centre of mass above the road", "m", 0.005, 4.0, example="0.55"),
        Quantity("yaw_inertia", "yaw inertia of the whole vehicle", "kg m²", 1e-5, 1e7, example="2500"),
        Quantity("power", "power at the wheels", "W", 0.1, 2e6, example="110 kW"),
        Quantity("top_speed", "top speed", "m/s", 0.2, 120.0, example="45, 160 km/h"),
    )
}
REQUIRED = tuple(quantity.key for quantity in QUANTITIES.values() if quantity.required)
TYRES = ("tyre", "tyre_front", "tyre_rear")


def missing_keys(given: Container[str]) -> list[str]:
    """Return the required quantities that are neither given nor follow from what is given.

    Args:
        given: keys of the given quantities.
    """
    tracks = "track_front" in given and "track_rear" in given
    return [key for key in REQUIRED if key not in given and not (key == "track" and tracks)]


def parse_sensors(text: str) -> tuple[str, ...]:
    """Return the sensors of a list such as ``lidar,camera,imu``, without duplicates.

    Raises:
        ConfigError: one of them is not in :data:`SENSORS`.
    """
    names = [name.strip() for name in text.split(",") if name.strip() and name.strip() != "none"]
    return tuple(dict.fromkeys(choose("sensors", name, allowed=SENSORS) for name in names))


_TYRE = re.compile(
    r"(?:P|LT|C)?\s*([0-9]{3})\s*/\s*([0-9]{2})\s*(?:Z?R|B|D|-)?\s*([0-9]{2}(?:\.5)?)(?:\s.*)?", re.IGNORECASE
)


def parse_tyre(text: str, *, where: str = "tyre") -> tuple[float, float]:
    """Return radius and width [m] of a tyre from its size.

    ``215/50R17``: 215 mm wide, a sidewall of 50 % of the width, on a rim of 17 inches.

    Raises:
        ConfigError: the text is not a tyre size.
    """
    match = _TYRE.fullmatch(text.strip())
    if match is None:
        raise ConfigError(
            f"{where} '{text}' is not a tyre size; example: 215/50R17 (width in mm / height in % R rim in inches)"
        )
    # mm, percent of the width, inch.
    width, aspect, rim = (float(group) for group in match.groups())
    return rim * 0.0254 / 2.0 + width * aspect * 1e-5, width * 1e-3


def read_quantity(quantity: Quantity, value: Any) -> float:
    """Return a quantity in SI units from a number or a text with a unit, and check its range.

    Args:
        quantity: quantity to be read.
        value: for example ``2.6`` or ``"102.4 in"``.

    Raises:
        ConfigError: the value is not a number, has an unknown unit, or is out of range.
    """
    name = quantity.key
    try:
        number = to_si(value, quantity.unit)
    except ValueError as error:
        raise ConfigError(f"{error}", where=name) from None
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ConfigError(f"'{value}' is not a number; for example {quantity.example}", where=name)
    if not quantity.low <= number <= quantity.high:
        # Frequent mistakes: degrees for radians, millimetres for metres.
        hint = ""
        if quantity.unit == "rad" and quantity.high < number <= 90.0:
            hint = f"; is it '{value} deg'?"
        elif quantity.unit == "m" and quantity.high < number and quantity.low <= number / 1000.0 <= quantity.high:
            hint = f"; is it '{value} mm'?"
        unit = "" if quantity.unit == "-" else f" {quantity.unit}"
        allowed = f"{quantity.low:g} to {quantity.high:g}{unit}"
        raise ConfigError(f"{name} {number:g}{unit} is not allowed; allowed: {allowed}{hint}")
    return float(number)


def check_plausible(values: Mapping[str, float]) -> None:
    """Check that the dimensions fit a vehicle with two axles.

    Args:
        values: SI values of wheelbase, track, mass, wheel_radius, and of the other given quantities.

    Raises:
        ConfigError: one line for each fault.
    """
    wheelbase, track, radius = (values[key] for key in ("wheelbase", "track", "wheel_radius"))
    tread = values.get("wheel_width", 0.0)
    # A volume in which a vehicle has a known range of densities.
    box = wheelbase * track * 4.0 * radius
    rules: list[tuple[str, float, float, str]] = [  # key, smallest, largest, rule
        ("wheel_radius", 0.0, 0.48 * wheelbase, "0.48 wheelbases, or front and rear wheels overlap"),
        ("track", max(0.1 * wheelbase, radius, 1.25 * tread), 2.0 * wheelbase, "2 wheelbases"),
        ("track_rear", max(0.7 * track, 1.25 * tread), 1.4 * track, "0.7 to 1.4 tracks of the front axle"),
        ("mass", 10.0 * box, 5000.0 * box, "10 to 5000 kg for each m³ of wheelbase x track x 4 wheel radii"),
        ("wheel_width", 0.1 * radius, 2.0 * radius, "2 wheel radii"),
        ("length", wheelbase + 2.0 * radius, 3.0 * wheelbase, "from wheelbase and two wheel radii to 3 wheelbases"),
        ("width", 0.7 * track, 2.0 * (track + tread), "0.7 tracks to twice track and wheel width"),
        ("height", 2.1 * radius, 15.0 * radius, "2.1 to 15 wheel radii"),
        ("com_height", 0.3 * radius, 0.9 * values.get("height", 10.0 * radius), "0.3 wheel radii to 0.9 heights"),
    ]
    faults = []
    # All faults at once, so that the user corrects the dimensions in one pass.
    for key, low, high, words in rules:
        value = values.get(key)
        if value is not None and not low <= value <= high:
            unit = QUANTITIES[key].unit
            faults.append(
                ConfigError(
                    f"{key} {value:g} {unit} does not fit the other dimensions; allowed: {low:.3g} to {high:.3g} "
                    f"{unit} ({words})"
                )
            )
    if faults:
        raise ConfigError(faults=faults)


# --- in a terminal -----------------------------------------------------------------------------------------------


def ask(
    answers: Mapping[str, Any],
    *,
    input: Callable[[str], str] = builtins.input,  # noqa: A002
    print_line: Callable[[str], object] = lambda _: None,
) -> dict[str, float | str]:
    """Ask for the missing input in a terminal; an invalid answer is asked for again.

    Args:
        answers: known arguments of :func:`mirdrake.vehicles.scaffold.new_vehicle`; None counts as missing.
        input: prints a question and returns the answer.
        print_line: prints the message about an invalid answer.

    Returns:
        All answers in SI units, without the quantities to be estimated.

    Raises:
        ConfigError: the input ended, or the answers are inconsistent.
    """
    # Answers given on the command line are not asked for again.
    known = {key: value for key, value in answers.items() if value is not None}

    def answer(prompt: str, read: Callable[[str], Any], *, optional: bool) -> Any:
        while True:
            try:
                text = input(prompt).strip()
            except EOFError:
                raise ConfigError(f"the input ended at the question: {prompt.strip().rstrip(':')}") from None
            if not text and optional:
                return None
            try:
                return read(text)
            except ConfigError as error:
                print_line(str(error))

    def wheel(text: str) -> dict[str, float | str]:
        if "/" in text:
            parse_tyre(text)
            return {"tyre": text}
        return {"wheel_radius": read_quantity(QUANTITIES["wheel_radius"], text)}

    # A quantity is skipped if another answer determines it, such as a tyre size the wheel radius.
    for quantity in QUANTITIES.values():
        key = quantity.key
        tyres = "tyre" in known or {"tyre_front", "tyre_rear"} <= known.keys()
        if key in known or (key in {"wheel_radius", "wheel_width"} and tyres):
            continue
        if quantity.instead in known or (key == "track" and {"track_front", "track_rear"} <= known.keys()):
            continue
        span = f"{quantity.low:g} to {quantity.high:g} {quantity.unit}"
        # A tyre size answers the radius and the width at once.
        if key == "wheel_radius":
            prompt = f"wheel radius, or tyre size such as 215/50R17 ({span}) [estimated]: "
            known |= answer(prompt, wheel, optional=True) or {}
            continue
        default = "" if quantity.required else " [estimated]"
        value = answer(
            f"{quantity.text} ({span}; for example {quantity.example}){default}: ",
            partial(read_quantity, quantity),
            optional=not quantity.required,
        )
        if value is not None:
            known[key] = value
    # Choices come after quantities, with their defaults in brackets.
    for key, words, usual in (("drive", get_args(Drive), "rear"), ("body", BODIES, "by size")):
        if key not in known:
            value = answer(f"{key}: {', '.join(words)} [{usual}]: ", partial(choose, key, allowed=words), optional=True)
            if value is not None:
                known[key] = value
    if "sensors" not in known:
        prompt = f"sensors: {', '.join(SENSORS)}, or none [{USUAL_SENSORS}]: "
        value = answer(prompt, lambda text: ",".join(parse_sensors(text)), optional=True)
        if value is not None:
            known["sensors"] = value
    return known


def choose(key: str, word: str, *, allowed: tuple[str, ...]) -> str:
    """Return a word after checking that it is allowed.

    Raises:
        ConfigError: the word is not allowed.
    """
    if word not in allowed:
        raise ConfigError(f"{key} '{word}' is not allowed; {did_you_mean(word, allowed)}")
    return word
