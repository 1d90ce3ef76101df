"""The numbers that somebody must give for a new vehicle: their units, their ranges, and questions in a terminal."""

import builtins
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.vehicles.spec import Drive
from mirdrake.yaml_io import to_si

BODIES = ("hatchback", "sedan", "suv", "buggy")

STEERING_LIMIT = 0.6
"""Of the inner wheel where nobody says otherwise [rad]: Bolt 0.6, MKZ 0.55, GEM e2 0.61."""


@dataclass(frozen=True)
class Quantity:
    """A number that a new vehicle needs.

    Attributes:
        key: argument of :func:`mirdrake.vehicles.scaffold.new_vehicle`.
        text: what it is.
        unit: its SI unit.
        low: least value allowed.
        high: largest value allowed.
        required: whether there is no estimate of it.
        example: what people may type.
    """

    key: str
    text: str
    unit: str
    low: float
    high: float
    required: bool = False
    example: str = ""


QUANTITIES: dict[str, Quantity] = {
    one.key: one
    for one in (
        Quantity("wheelbase", "wheelbase, between the axles", "m", 0.1, 10.0, True, "2.6, 102.4 in"),
        Quantity("track", "track, between the middles of the wheels of an axle", "m", 0.05, 4.0, True, "1.5, 59 in"),
        Quantity("mass", "mass, ready to drive", "kg", 0.1, 20000.0, True, "1450, 3200 lb"),
        Quantity("wheel_radius", "wheel radius", "m", 0.01, 1.0, True, "0.32, 12.7 in"),
        Quantity("wheel_width", "wheel width", "m", 0.003, 0.8, example="0.2, 8 in"),
        Quantity("steering_limit", "steering limit of the inner wheel", "rad", 0.05, 1.3, example="0.6, 35 deg"),
        Quantity("length", "length over all", "m", 0.1, 20.0, example="4.1"),
        Quantity("width", "width without mirrors", "m", 0.05, 5.0, example="1.8"),
        Quantity("height", "height", "m", 0.03, 6.0, example="1.5"),
    )
}
REQUIRED = tuple(one.key for one in QUANTITIES.values() if one.required)

_TYRE = re.compile(
    r"(?:P|LT|C)?\s*([0-9]{3})\s*/\s*([0-9]{2})\s*(?:Z?R|B|D|-)?\s*([0-9]{2}(?:\.5)?)(?:\s.*)?", re.IGNORECASE
)


def parse_tyre(text: str, *, where: str = "tyre") -> tuple[float, float]:
    """Radius and width [m] of a tyre from its size: ``215/50R17`` is 215 mm wide, half as high, on a 17 inch rim.

    Raises:
        ConfigError: not such a size.
    """
    match = _TYRE.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"{where} '{text}' is no tyre size; an example is 215/50R17 (width mm / height % R rim inch)")
    width, aspect, rim = (float(group) for group in match.groups())
    return rim * 0.0254 / 2.0 + width * aspect * 1e-5, width * 1e-3


def read_quantity(quantity: Quantity, value: Any, *, where: str | None = None) -> float:
    """A number in SI from a number or a text with a unit, within its range.

    Args:
        quantity: which one.
        value: for example ``2.6`` or ``"102.4 in"``.
        where: how errors call it, its key if left out.

    Raises:
        ConfigError: no number, an unknown unit, or out of range.
    """
    name = where or quantity.key
    try:
        number = to_si(value, quantity.unit)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from None
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ConfigError(f"{name}: '{value}' is no number; for example {quantity.example}")
    if not quantity.low <= number <= quantity.high:
        hint = ""
        if quantity.unit == "rad" and quantity.high < number <= 90.0:
            hint = f"; is it '{value} deg'?"
        elif quantity.unit == "m" and quantity.high < number and quantity.low <= number / 1000.0 <= quantity.high:
            hint = f"; is it '{value} mm'?"
        allowed = f"{quantity.low:g} to {quantity.high:g} {quantity.unit}"
        raise ConfigError(f"{name} {number:g} {quantity.unit} is not allowed; allowed: {allowed}{hint}")
    return float(number)


def check_plausible(values: Mapping[str, float]) -> None:
    """Refuse dimensions that fit no vehicle with two axles.

    Args:
        values: SI; wheelbase, track, mass, wheel_radius, and what is given of wheel_width, length, width, height.

    Raises:
        ConfigError: one line for each fault.
    """
    wheelbase, track, _, radius = (values[key] for key in REQUIRED)
    tread = values.get("wheel_width", 0.0)
    box = wheelbase * track * 4.0 * radius
    rules: list[tuple[str, float, float, str]] = [  # key, least, largest, in words
        ("wheel_radius", 0.0, 0.48 * wheelbase, "0.48 wheelbases, or front and rear wheels overlap"),
        ("track", max(0.1 * wheelbase, radius, 1.25 * tread), 2.0 * wheelbase, "2 wheelbases"),
        ("mass", 10.0 * box, 5000.0 * box, "10 to 5000 kg for each m³ of wheelbase x track x 4 wheel radii"),
        ("wheel_width", 0.1 * radius, 2.0 * radius, "2 wheel radii"),
        ("length", wheelbase, 3.0 * wheelbase, "1 to 3 wheelbases"),
        ("width", 0.7 * track, 2.0 * (track + tread), "0.7 tracks to twice track and wheel width"),
        ("height", 2.1 * radius, 15.0 * radius, "2.1 to 15 wheel radii"),
    ]
    faults = []
    for key, low, high, words in rules:
        value = values.get(key)
        if value is not None and not low <= value <= high:
            unit = QUANTITIES[key].unit
            faults.append(
                f"{key} {value:g} {unit} does not fit the other dimensions; allowed: {low:.3g} to {high:.3g} {unit} "
                f"({words})"
            )
    if faults:
        raise ConfigError("\n".join(dict.fromkeys(faults)))


# --- in a terminal -----------------------------------------------------------------------------------------------


def ask(
    answers: Mapping[str, Any],
    *,
    input: Callable[[str], str] = builtins.input,  # noqa: A002
    say: Callable[[str], object] = lambda _: None,
) -> dict[str, Any]:
    """Ask for what is missing, one line each; nonsense is asked again.

    Args:
        answers: what is known: arguments of :func:`mirdrake.vehicles.scaffold.new_vehicle`; None counts as missing.
        input: prints a question and returns the answer.
        say: told what was wrong with an answer.

    Returns:
        All answers, in SI. What was answered with nothing and has an estimate is left out.

    Raises:
        ConfigError: the input ended, or the answers do not fit one another.
    """
    known = {key: value for key, value in answers.items() if value is not None}

    def answer(prompt: str, read: Callable[[str], Any], *, optional: bool) -> Any:
        while True:
            try:
                text = input(prompt).strip()
            except EOFError:
                raise ConfigError(f"no more input at: {prompt.strip().rstrip(':')}") from None
            if not text and optional:
                return None
            try:
                return read(text)
            except ConfigError as error:
                say(str(error))

    def wheel(text: str) -> dict[str, Any]:
        if "/" in text:
            parse_tyre(text)
            return {"tyre": text}
        return {"wheel_radius": read_quantity(QUANTITIES["wheel_radius"], text)}

    for quantity in QUANTITIES.values():
        key = quantity.key
        if key in known or (key in {"wheel_radius", "wheel_width"} and "tyre" in known):
            continue
        span = f"{quantity.low:g} to {quantity.high:g} {quantity.unit}"
        if key == "wheel_radius":
            prompt = f"wheel radius, or tyre size such as 215/50R17 ({span}): "
            known |= answer(prompt, wheel, optional=False)
            continue
        default = "" if quantity.required else f" [{_default(key)}]"
        value = answer(
            f"{quantity.text} ({span}; for example {quantity.example}){default}: ",
            partial(read_quantity, quantity),
            optional=not quantity.required,
        )
        if value is not None:
            known[key] = value
    for key, words, usual in (("drive", get_args(Drive), "rear"), ("body", BODIES, "hatchback")):
        if key not in known:
            prompt = f"{key}: {', '.join(words)} [{usual}]: "
            known[key] = answer(prompt, _chooser(key, words), optional=True) or usual
    return known


def choose(key: str, word: str, *, allowed: tuple[str, ...]) -> str:
    """The word if it is allowed.

    Raises:
        ConfigError: it is not.
    """
    if word not in allowed:
        raise ConfigError(f"{key} '{word}' is not allowed; {did_you_mean(word, allowed)}")
    return word


def _default(key: str) -> str:
    return f"{STEERING_LIMIT:g} rad" if key == "steering_limit" else "estimated"


def _chooser(key: str, allowed: tuple[str, ...]) -> Callable[[str], str]:
    return lambda text: choose(key, text, allowed=allowed)
