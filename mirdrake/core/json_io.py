"""JSON objects, and a reader of JSON files that a user may have edited."""

import json
from typing import Any

Json = dict[str, Any]
"""A JSON object, or a mapping of a YAML file before it is validated."""

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
