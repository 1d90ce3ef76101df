"""Centre lines from CSV files: one point with its widths per line."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path
from mirdrake.readers.csv_files import read_csv
from mirdrake.readers.tables import CsvLayout, Request, Table, as_numbers
from mirdrake.worlds.pieces import Array

DEFAULT_COLUMNS = {"x": "x_m", "y": "y_m", "right": "w_tr_right_m", "left": "w_tr_left_m"}
"""Columns in the format of the TUM racetrack database, and their order in a file without header."""

_LARGEST = 20_000_000  # bytes
_FARTHEST = 1e8  # [m] from the origin
JUMP = (100.0, 20.0)
"""Largest distance between neighbours [m] and [median distance]."""


@dataclass(frozen=True)
class CsvTrack:
    """Points and widths of a file."""

    points: Array
    """N x 2 [m], in driving order, without a repeated last point"""
    left: Array | None
    """distance [m] of the left edge from each point, N; None if the file has none"""
    right: Array | None
    """distance [m] of the right edge from each point, N; None if the file has none"""
    lines: list[int]
    """line of the file of each point, N"""
    looks_closed: bool
    """the last point is as near to the first as to its neighbour, or is the first again"""


def read_csv_track(
    path: str | Path,
    *,
    x: str | int = DEFAULT_COLUMNS["x"],
    y: str | int = DEFAULT_COLUMNS["y"],
    right: str | int | None = DEFAULT_COLUMNS["right"],
    left: str | int | None = DEFAULT_COLUMNS["left"],
    scale: float = 1.0,
) -> CsvTrack:
    """Read a centre line and its widths.

    The layout of the file is detected as for recorded data, see :mod:`mirdrake.readers.csv_files`. Without a header the
    columns are x, y, right and left, or x and y only.

    Args:
        path: the file.
        x: name of the column of x, or its number counted from 1.
        y: likewise.
        right: column of the distance to the right edge; None if there is none.
        left: column of the distance to the left edge; None if there is none.
        scale: metres per unit of the file; multiplies points and widths.

    Raises:
        ConfigError: the file cannot be read, or its points do not form a track.
    """
    path = Path(path)
    name = display_path(path)
    # Written as `not ... <` so that NaN is rejected, too; it fails every comparison.
    if not 0.0 < scale < math.inf:
        raise ConfigError(f"scale {scale:g} is not allowed; give the metres per unit of the file, above 0", where=name)
    columns: dict[str, str | int | None] = {"x": x, "y": y, "right": right, "left": left}

    # A file without header and with two columns has no widths.
    table, has_header = _read_table(path, name, [str(column) for column in columns.values() if column is not None])
    lines = [] if table.lines is None else table.lines.tolist()
    if (
        not has_header
        and len(table.names) == 2
        and (right, left) == (DEFAULT_COLUMNS["right"], DEFAULT_COLUMNS["left"])
    ):
        columns |= {"right": None, "left": None}

    # Numbers, scaled; widths must be positive.
    values: dict[str, Array] = {}
    for key, column in columns.items():
        if column is None:
            continue
        title = _find_column(key, column, table, has_header=has_header)
        values[key] = scale * _finite_numbers(key, title, table)
        # Checked after scaling: a file in mm has large numbers, and becomes a track only with its scale.
        if not np.abs(values[key]).max() <= _FARTHEST:
            row = int(np.argmax(np.abs(values[key])))
            raise ConfigError(f"{key} is {values[key][row]:g} m; correct it, or set scale", where=table.row(row))
        if key in {"right", "left"} and values[key].min() <= 0.0:
            row = int(np.argmin(values[key]))
            raise ConfigError(
                f"{key} is {values[key][row]:g} m; widths are distances from the centre line to the "
                "edges and must be above 0",
                where=table.row(row),
            )

    # Points in driving order, without repeated ones and jumps.
    points = np.column_stack((values["x"], values["y"]))
    # Closed tracks of many sources repeat the first point at the end, which would be a chord of length zero.
    is_repeated = len(points) > 1 and math.dist(points[0], points[-1]) < 1e-6
    points = points[:-1] if is_repeated else points
    if len(points) < 4:
        raise ConfigError(f"{plural(len(points), 'point')}; a track needs at least 4, one per line", where=name)
    chords = np.hypot(*np.diff(points, axis=0).T)
    # The median is robust against the jump that is searched for; the mean would grow with it.
    median = float(np.median(chords))
    for index, chord in enumerate(chords.tolist()):
        where = table.row(index + 1)
        if chord < 1e-6:
            raise ConfigError(f"the point of line {lines[index]} is repeated; delete one of them", where=where)
        if chord > JUMP[0] or chord > JUMP[1] * median:
            raise ConfigError(
                f"jumps {chord:.4g} m from the point before; the median here is {median:.3g} m; sort the "
                "points in driving order, add the missing ones, or set scale",
                where=where,
            )

    # Compared with both neighbouring chords as well, because points are often sparser on straights.
    looks_closed = is_repeated or math.dist(points[0], points[-1]) <= 2.5 * max(median, chords[0], chords[-1])
    widths = {key: values[key][: len(points)] if key in values else None for key in ("left", "right")}
    return CsvTrack(points, widths["left"], widths["right"], lines[: len(points)], looks_closed)


def _read_table(path: Path, name: str, columns: list[str]) -> tuple[Table, bool]:
    """Return the table of a file, and whether it has a header; without one the columns are named ``1``, ``2``, ….

    Raises:
        ConfigError: the file cannot be read or is too large.
    """
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        size = 0
    if size > _LARGEST:
        raise ConfigError(f"more than {_LARGEST // 1_000_000} MB; reduce the number of points", where=name)
    table = read_csv(Request(path, columns))
    if table.has_header:
        return table, True
    layout = CsvLayout(columns=[str(number) for number in range(1, len(table.names) + 1)])
    return read_csv(Request(path, (), layout)), False


def _find_column(key: str, column: str | int, table: Table, *, has_header: bool) -> str:
    """Return the title of a column by its name or its number from 1; without a header by its usual position.

    Raises:
        ConfigError: the column does not exist.
    """
    where, count = table.row(0), len(table.names)
    if has_header and column in table.names:
        return str(column)
    # Numbers select columns also where titles exist.
    if isinstance(column, int) or re.fullmatch(r"-?[0-9]+", column):
        if not 1 <= int(column) <= count:
            raise ConfigError(f"{key} is column {column} of {count}; columns are counted from 1", where=where)
        return table.names[int(column) - 1]
    without = "" if key in {"x", "y"} else f", or set {key}: null if there is none"
    if has_header:
        hint = did_you_mean(column, table.names)
        raise ConfigError(f"no column '{column}'; {hint}; give the column of {key}{without}", where=where)
    if column != DEFAULT_COLUMNS[key]:
        raise ConfigError(
            f"no column '{column}', because the file has no header; give {key} a number from 1", where=where
        )
    position = list(DEFAULT_COLUMNS).index(key)
    if position >= count:
        raise ConfigError(f"{count} columns without header; x, y, right and left are expected{without}", where=where)
    return table.names[position]


def _finite_numbers(key: str, title: str, table: Table) -> Array:
    """Return a column as finite numbers.

    Raises:
        ConfigError: a cell is not a finite number.
    """
    if table.names.count(title) > 1:
        raise ConfigError(f"{table.names.count(title)} columns '{title}'; rename one", where=table.name)
    cells = pd.Series(np.asarray(table.columns[title]).ravel())
    numbers = as_numbers(cells)
    bad = ~np.isfinite(numbers)
    if bad.any():
        row = int(np.argmax(bad))
        text: str = "" if pd.isna(cells[row]) else f" '{str(cells[row])[:40]}'"
        raise ConfigError(f"{key}{text} is not a finite number; correct it or delete the line", where=table.row(row))
    return numbers
