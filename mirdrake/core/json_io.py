"""JSON from files that a user may have edited."""

import json
from typing import Any

_MOST_DIGITS = 300
"""Digits of a whole number; one with more is read as a float, which may be infinite."""


def parse_json(text: str) -> Any:
    """A JSON text as plain data.

    Raises:
        ValueError: it is not JSON (:class:`json.JSONDecodeError`), or is nested too deeply.
    """
    try:
        return json.loads(text, parse_int=_whole_number)
    except RecursionError:
        raise ValueError("is nested too deeply") from None


def _whole_number(text: str) -> float:
    return int(text) if len(text) <= _MOST_DIGITS else float(text)
