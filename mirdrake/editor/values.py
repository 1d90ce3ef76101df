"""Values of a world file as the editor reads and writes them: plain numbers, with their unit and precision.

A value that is a plain number, such as ``12.5`` or ``90 deg``, can be changed by a gesture. One that depends on
parameters, is random or computed can be changed only as text; :func:`lock_reason` states why.
"""

import math
import re
from typing import Any

from mirdrake.core.yaml_io import to_si
from mirdrake.worlds.values import is_random

_NUMBER = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*(.*?)\s*$", re.DOTALL)
_PARAMETER = re.compile(r"\$[A-Za-z_]\w*")
_DECIMALS = {"m": 3, "rad": 5}  # of SI units; fewer digits are left where they are zero
_DEGREE_DECIMALS = 2


def plain_number(raw: Any, unit: str) -> float | None:
    """Return a plain number in its SI unit; None if the value is an expression or of another kind."""
    if isinstance(raw, bool):
        return None
    if isinstance(raw, int | float):
        return float(raw)
    if isinstance(raw, str):
        try:
            value = to_si(raw, unit)
        except ValueError:
            return None
        return float(value) if isinstance(value, float) and math.isfinite(value) else None
    return None


def lock_reason(raw: Any) -> str:
    """Return why a value cannot be changed by a gesture."""
    text = str(raw)
    parameters = list(dict.fromkeys(_PARAMETER.findall(text)))
    if parameters:
        noun = "parameters" if len(parameters) > 1 else "parameter"
        return f"{text} depends on {', '.join(parameters)}; change the {noun}, or the value in the panel"
    if is_random(text):
        return f"{text} is drawn at random; change it in the panel"
    if isinstance(raw, list):
        return "a list of values; change them in the panel"
    return f"{text} is computed; change it in the panel"


def write_number(value: float, unit: str, *, like: Any = None) -> str:
    """Return a number as YAML, in the unit of the value that it replaces.

    Args:
        value: value in the SI unit.
        unit: SI unit, "m" or "rad".
        like: the value that is replaced; an angle without one is written in degrees.
    """
    match = _NUMBER.fullmatch(like) if isinstance(like, str) else None
    given = match.group(1) if match else ("deg" if unit == "rad" and like is None else "")
    if not given:
        return _digits(value, _DECIMALS[unit])
    scale = to_si(f"1 {given}", unit)
    decimals = _DEGREE_DECIMALS if given == "deg" else max(0, round(_DECIMALS[unit] + math.log10(scale)))
    return f"{_digits(value / scale, decimals)} {given}"


def _digits(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in {"-0", ""} else text
