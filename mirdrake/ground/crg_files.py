"""Reader of OpenCRG files: heights of a road on a curved regular grid along a reference line.

A file has a header of plain text and a table, one row per step along the reference line. Columns are heading, slope and
banking of the line, each optional, and heights at lateral positions v. The height of the road at (u, v) is

    z(u, v) = z0 + ∫ slope du + banking(u) v + table(u, v)

(ASAM OpenCRG 1.2, sections 6.4 and 7; the table is bilinear). The heading of a row is that from the point before it.
Tables are plain text (LRFI, LDFI: 10 or 20 characters per number) or binary (KRBI, KDBI: big-endian floats of 4 or 8
bytes), in records of 80 bytes.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, first_line
from mirdrake.core.yaml_io import display_path

Array = NDArray[np.float64]

_FORMATS = {"LRFI": (10, ""), "LDFI": (20, ""), "KRBI": (4, ">f4"), "KDBI": (8, ">f8")}
_RECORD = 80  # length of a record of the table [B]
_CHANNELS = {"reference line phi": "phi", "reference line slope": "slope", "reference line banking": "banking"}
_LARGEST = 25_000_000  # heights


@dataclass(frozen=True)
class CrgRoad:
    """Road of an OpenCRG file.

    Attributes:
        x: reference line in the axes of the file [m] (N).
        y: the same (N).
        phi: heading of the line at its points [rad] (N).
        z: height of the line [m] (N).
        banking: rise to the left over distance [1] (N).
        step: distance of the points along the line [m].
        v: lateral positions of the columns, positive to the left, evenly spaced [m] (M).
        heights: table of heights above line and banking [m] (N, M).
    """

    x: Array
    y: Array
    phi: Array
    z: Array
    banking: Array
    step: float
    v: Array
    heights: Array


def read_crg(path: Path, *, place: str = "") -> CrgRoad:
    """Read an OpenCRG file.

    Args:
        path: the file.
        place: prefix of messages, ``file:line: key``.

    Raises:
        ConfigError: the file is missing, not an OpenCRG file, or uses modifiers or other files.
    """
    if not path.is_file():
        raise ConfigError(f"no such file: {display_path(path)}", where=place)
    # Damaged files raise different errors; all become one line with the place of the key.
    try:
        return _road(path.read_bytes())
    except (OSError, ValueError, KeyError, IndexError) as error:
        reason = f"{error.args[0]} is missing" if isinstance(error, KeyError) else first_line(error)
        raise ConfigError(f"{display_path(path)}: cannot be read as OpenCRG: {reason}", where=place) from None


def _road(content: bytes) -> CrgRoad:
    """Return the road of the content of a file."""
    sections, begin = _header(content)
    for name in ("ROAD_CRG_MODS", "ROAD_CRG_FILE"):
        if sections.get(name):
            raise ValueError(f"the section ${name} is not supported; apply it with the OpenCRG tools first")
    if "ROAD_CRG" not in sections or "KD_DEFINITION" not in sections:
        raise ValueError("it has no sections $ROAD_CRG and $KD_DEFINITION")
    head = _parameters(sections["ROAD_CRG"])
    kind, names, positions = _columns(sections["KD_DEFINITION"])
    table = _table(content[begin:], kind, len(names))
    step = head["REFERENCE_LINE_INCREMENT"]
    if step <= 0.0:
        raise ValueError("REFERENCE_LINE_INCREMENT is not positive")
    # The header may state the length; binary tables are padded, so that further rows are not data.
    if "REFERENCE_LINE_END_U" in head:
        count = round((head["REFERENCE_LINE_END_U"] - head.get("REFERENCE_LINE_START_U", 0.0)) / step) + 1
        if count > len(table):
            raise ValueError(f"{len(table)} rows; the header needs {count}")
        table = table[:count]
    else:
        table = table[: int(np.flatnonzero(np.isfinite(table).any(axis=1))[-1]) + 1]
    if len(table) < 2 or table.size > _LARGEST:
        raise ValueError(f"{len(table)} rows; at least 2, and at most 25 million numbers")

    # Channels of the reference line; constant values of the header without a channel.
    columns = {name: table[:, i] for i, name in enumerate(names) if name}
    phi = columns.get("phi", np.full(len(table), head.get("REFERENCE_LINE_START_PHI", 0.0)))
    slope = columns.get("slope", np.full(len(table), head.get("REFERENCE_LINE_START_S", 0.0)))
    banking = columns.get("banking", np.full(len(table), head.get("REFERENCE_LINE_START_B", 0.0)))
    # The first row of heading and slope has no piece before it.
    sides = np.unwrap(phi[1:])
    if not (np.isfinite(sides).all() and np.isfinite(slope[1:]).all() and np.isfinite(banking).all()):
        raise ValueError("a heading, slope or banking is not a number")
    start = head.get("REFERENCE_LINE_START_X", 0.0), head.get("REFERENCE_LINE_START_Y", 0.0)
    # At a point the line has the mean heading of the pieces before and behind it.
    heading = np.concatenate([sides[:1], 0.5 * (sides[1:] + sides[:-1]), sides[-1:]])
    v, heights = _sections(table[:, [not name for name in names]], positions, head)
    return CrgRoad(
        x=start[0] + np.concatenate([[0.0], np.cumsum(step * np.cos(sides))]),
        y=start[1] + np.concatenate([[0.0], np.cumsum(step * np.sin(sides))]),
        phi=heading,
        z=head.get("REFERENCE_LINE_START_Z", 0.0) + np.concatenate([[0.0], np.cumsum(step * slope[1:])]),
        banking=banking,
        step=step,
        v=v,
        heights=heights,
    )


def _header(content: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the sections of the header as lines, and the position of the table."""
    sections: dict[str, list[str]] = {}
    name, begin = "", 0
    while begin < len(content):
        end = content.find(b"\n", begin)
        end = len(content) if end < 0 else end
        line = content[begin:end].decode("latin-1").rstrip("\r")[:72]
        begin = end + 1
        if line.startswith("$$"):
            return sections, begin
        if line.startswith("$"):
            found = re.match(r"\$\s*([A-Za-z]\w*)", line)
            name = found[1].upper() if found else ""
            if name:
                sections.setdefault(name, [])
        elif name and not line.startswith("*") and line.split("!")[0].strip():
            sections[name].append(line.split("!")[0].strip())
    raise ValueError("its header has no end ($$)")


def _parameters(lines: list[str]) -> dict[str, float]:
    """Return the numbers of the section ROAD_CRG."""
    result = {}
    for line in lines:
        name, found, value = line.partition("=")
        if found:
            result[name.strip().upper()] = float(value)
    return result


def _columns(lines: list[str]) -> tuple[str, list[str], list[float]]:
    """Return format, channel of each column (empty for a height), and positions v of heights that have one."""
    kind, names, positions = "KRBI", [], []
    for line in lines:
        if line.startswith("#:"):
            kind = line[2:].strip().upper()
        elif line.upper().startswith("D:"):
            text = line[2:].split(",")[0].strip().lower()
            if text.startswith("long section"):
                names.append("")
                found = re.search(r"v\s*=\s*(\S+)", text)
                positions += [float(found[1])] if found else []
            elif text in _CHANNELS:
                names.append(_CHANNELS[text])
            else:
                raise ValueError(f"unknown channel '{text[:60]}'")
    if kind not in _FORMATS:
        raise ValueError(f"format '{kind[:20]}'; known are {', '.join(_FORMATS)}")
    if "" not in names:
        raise ValueError("it has no long section")
    return kind, names, positions


def _table(content: bytes, kind: str, count: int) -> Array:
    """Return the numbers of a table with a number of columns; missing ones are NaN."""
    width, binary = _FORMATS[kind]
    if binary:
        values = np.frombuffer(content[: len(content) // width * width], dtype=binary).astype(float)
        return values[: len(values) // count * count].reshape(-1, count)
    # Each row begins a new record, and goes on in further ones after 80 characters.
    each = _RECORD // width
    lines = [line for line in content.decode("latin-1").splitlines() if line.strip() and not line.startswith("$")]
    per_row = -(-count // each)
    rows = []
    for first in range(0, len(lines) - per_row + 1, per_row):
        fields: list[str] = []
        for index, line in enumerate(lines[first : first + per_row]):
            here = min(each, count - index * each)
            fields += [line[i * width : (i + 1) * width] for i in range(here)]
        rows.append([float("nan") if "*" in field else float(field) for field in fields])
    return np.array(rows).reshape(-1, count)


def _sections(values: Array, positions: list[float], head: dict[str, float]) -> tuple[Array, Array]:
    """Return evenly spaced lateral positions and the heights there, without gaps."""
    count = values.shape[1]
    if positions:
        if len(positions) != count:
            raise ValueError("only some long sections have a position")
        v = np.array(positions)
    else:
        right = head["LONG_SECTION_V_RIGHT"]
        v = right + head.get("LONG_SECTION_V_INCREMENT", 1.0) * np.arange(count)
        if "LONG_SECTION_V_LEFT" in head and count > 1:
            v = np.linspace(right, head["LONG_SECTION_V_LEFT"], count)
    if (np.diff(v) <= 0.0).any():
        raise ValueError("the long sections are not in order from right to left")
    if v[0] > 0.0 or v[-1] < 0.0:
        raise ValueError(f"the reference line is beside the road, which extends from {v[0]:g} to {v[-1]:g} m")
    # Missing heights at the borders get the next one in their row.
    filled = np.empty_like(values)
    for row, heights in enumerate(values):
        good = np.isfinite(heights)
        if not good.any():
            raise ValueError(f"row {row + 1} has no height")
        filled[row] = np.interp(v, v[good], heights[good])
    if count == 1:
        return np.array([v[0] - 0.5, v[0] + 0.5]), np.repeat(filled, 2, axis=1)
    spacing = float(np.diff(v).min())
    if np.ptp(np.diff(v)) < 1e-6 * spacing:
        return v, filled
    even = np.linspace(v[0], v[-1], int(np.ceil((v[-1] - v[0]) / spacing - 1e-9)) + 1)
    return even, np.array([np.interp(even, v, heights) for heights in filled])
