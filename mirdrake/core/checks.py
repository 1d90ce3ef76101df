"""Checks of settings given from Python; settings from files are checked by their schema."""

import inspect
import math
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from mirdrake.core.errors import ConfigError, did_you_mean

P = ParamSpec("P")
T = TypeVar("T")


def checks_arguments(function: Callable[P, T], name: str = "") -> Callable[P, T]:
    """Decorate a function or a method so that unknown and missing arguments are a ConfigError.

    Python's own TypeError does not state what is allowed.

    Args:
        function: the function.
        name: its name in messages; that of the code by default.
    """
    signature = inspect.signature(function)
    name = name or function.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @wraps(function)
    def checked(*arguments: P.args, **options: P.kwargs) -> T:
        try:
            # Bound first, so that a TypeError raised inside the function itself is not taken for a wrong argument.
            signature.bind(*arguments, **options)
        except TypeError as error:
            known = [key for key in signature.parameters if key != "self"]
            unknown = [key for key in options if key not in known]
            text = f"unknown argument '{unknown[0]}'; {did_you_mean(unknown[0], known)}" if unknown else None
            raise ConfigError(f"{text or f'{error}; arguments: ' + ', '.join(known)}", where=name) from None
        return function(*arguments, **options)

    return checked


def whole_periods(delay: float, period: float) -> int | None:
    """Return the number of periods of a delay; None if it is not a multiple of the period [s]."""
    steps = round(delay / period)
    return steps if abs(steps * period - delay) <= 1e-9 else None


def check_number(
    owner: str,
    name: str,
    value: float,
    *,
    unit: str = "",
    at_least: float = -math.inf,
    above: float = -math.inf,
    at_most: float = math.inf,
    infinite: bool = False,
) -> float:
    """Return the value as a float if it is a number in the allowed range.

    Args:
        owner: the object that has the setting, for the message.
        name: name of the setting.
        value: value of the setting.
        unit: unit of the setting, for the message.
        at_least: smallest allowed value.
        above: the value must be larger than this.
        at_most: largest allowed value.
        infinite: whether plus or minus infinity is allowed.

    Raises:
        ConfigError: not a number, not finite, or out of range.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} must be a number, got {value!r}", where=owner) from None
    # `above` is strict; with its default of -inf, a strict comparison would reject an allowed -inf.
    good = number >= at_least and number > above if above > -math.inf else number >= at_least
    # Every comparison with NaN is false, so NaN must be tested by itself.
    if math.isnan(number) or not good or number > at_most or (math.isinf(number) and not infinite):
        limits = [f">= {at_least:g}"] if at_least > -math.inf else []
        limits += [f"> {above:g}"] if above > -math.inf else []
        limits += [f"<= {at_most:g}"] if at_most < math.inf else []
        limits += [] if infinite else ["finite"]
        allowed = " and ".join(limits) or "a number"
        given = f"{number:g} {unit}".strip()
        raise ConfigError(f"{name} must be {allowed}{f' [{unit}]' if unit else ''}, got {given}", where=owner)
    return number
