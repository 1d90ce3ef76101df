"""Lines of JSON: an object in each line, as loggers of robots and of web services write them."""

import json

import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.readers.tables import Request, Table, read_bytes


def read_json_lines(request: Request) -> Table:
    """Read lines of JSON, or one list of objects, as a table; entries of nested objects are ``outer.inner``.

    Raises:
        ConfigError: the file cannot be read, or has something else than objects in it.
    """
    text = read_bytes(request.path).decode("utf-8-sig", errors="replace")
    rows: list[tuple[int, object]] = []
    if text.lstrip().startswith("["):
        rows = [(1, row) for row in _parse(request, 1, text)]  # type: ignore[attr-defined]
    else:
        rows = [(at, _parse(request, at, line)) for at, line in enumerate(text.splitlines(), start=1) if line.strip()]
    records = []
    for at, row in rows:
        if not isinstance(row, dict):
            raise ConfigError('is no object; a line of JSON is {"time": 0.0, …}', file=request.name, line=at)
        records.append(_flat(row))
    if not records:
        raise ConfigError("is empty; lines of JSON are expected", where=request.name)
    # Lines may have different keys, so that each topic has its own; missing ones are empty cells.
    frame = pd.DataFrame.from_records(records)
    return Table(request.name, list(frame.columns), {name: frame[name] for name in frame.columns})


def _parse(request: Request, at: int, text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"is not JSON: {str(error)[:80]}", file=request.name, line=at) from None


def _flat(row: dict[str, object], prefix: str = "") -> dict[str, object]:
    """Return an object with the entries of its objects and lists in one level; elements of a list from 0."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        name = f"{prefix}{key}"
        if isinstance(value, list) and len(value) <= _LONGEST:
            value = {str(index): item for index, item in enumerate(value)}
        if isinstance(value, dict):
            flat |= _flat(value, f"{name}.")
        else:
            flat[name] = value
    return flat


_LONGEST = 12
"""Longest list whose elements are columns; longer ones, such as scans, are no measurement of a vehicle."""
