"""JSON objects, plain data for JSON and YAML, and a reader of JSON files that a user may have edited."""

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from mirdrake.core.errors import ConfigError

Json = dict[str, Any]
"""A JSON object, or a mapping of a YAML file before it is validated."""

_Record = TypeVar("_Record")

_MOST_DIGITS = 300
"""Digits of an integer; a longer one is read as a float, which may be infinite."""


def parse_json(text: str) -> Any:
    """Parse a JSON text.

    Raises:
        ValueError: the text is not JSON (:class:`json.JSONDecodeError`), or nested too deeply.
    """
    try:
        return json.loads(text, parse_int=_whole_number)
    except RecursionError:
        raise ValueError("is nested too deeply") from None


def _whole_number(text: str) -> float:
    return int(text) if len(text) <= _MOST_DIGITS else float(text)


def plain_data(value: Any, real: Callable[[float], Any] = float) -> Any:
    """Return data of mappings, lists, numbers and texts, as JSON and YAML have them; other objects become texts.

    Args:
        value: numbers of NumPy become those of Python; arrays, tuples and sets become lists.
        real: conversion of each float, e.g. :func:`finite_or_none`.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain_data(item, real) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain_data(item, real) for item in value]
    if isinstance(value, float):
        return real(value)
    return value if isinstance(value, bool | int | str) or value is None else str(value)


def finite_or_none(value: Any) -> float | None:
    """Return a number as a float, or None if it is infinite or missing: JSON has neither infinity nor NaN."""
    number = float(value)
    return number if math.isfinite(number) else None


def finite_or_text(number: float) -> float | str | None:
    """Return a number; an infinite one as text, a missing one as None."""
    return str(number) if math.isinf(number) else finite_or_none(number)


def read_record(kind: type[_Record], data: object, place: str) -> _Record:
    """Return a dataclass from the plain data that its fields were written as; lists become tuples and dataclasses.

    Raises:
        ConfigError: a field is missing or of another type; the message begins with `place` and names the first one.
    """
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(str(part) for part in fault["loc"])[:80]
        message = "is missing" if fault["type"] == "missing" else str(fault["msg"]).removeprefix("Input ").lower()
        raise ConfigError(f"{key}: {message}; run the study again", where=place) from None
    except ConfigError as error:  # a value that a class does not allow
        raise ConfigError(f"{error}; run the study again", where=place) from None
