"""Centre lines from files of points: CSV and its relatives, one point with its widths per line."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import shown
from mirdrake.worlds.pieces import Array

_LARGEST = 20_000_000  # bytes
_FARTHEST = 1e8  # [m] from the origin
_JUMP = (100.0, 20.0)  # [m], [median spacing] that no point is from the one before


@dataclass(frozen=True)
class CsvTrack:
    """What a file of points says of a track."""

    points: Array
    """N x 2 [m], in driving order; a repeated last point is left out"""
    left: Array | None
    """distance [m] of the left edge from each point, N; None if the file has none"""
    right: Array | None
    """distance [m] of the right edge from each point, N; None if the file has none"""
    lines: list[int]
    """line of the file of each point, N"""
    closed_guess: bool
    """the last point is as near to the first as to its neighbour, or is the first again"""


def read_csv_track(
    path: str | Path,
    *,
    x: str | int = "x_m",
    y: str | int = "y_m",
    right: str | int | None = "w_tr_right_m",
    left: str | int | None = "w_tr_left_m",
    scale: float = 1.0,
) -> CsvTrack:
    """A centre line and its widths from a file of points, one per line.

    Values are separated by commas, semicolons (decimal commas are then understood), tabs or blanks. The names of the
    columns stand in the last line before the numbers, with or without a `#` before them; other lines that start with
    `#` are comments. Without names the columns are x, y, right and left, or x and y only. So are the files of the TUM
    racetrack database: ``# x_m,y_m,w_tr_right_m,w_tr_left_m``.

    Args:
        path: the file.
        x: name of the column of x, or its number counted from 1.
        y: likewise.
        right: of the distance of the right edge; None if there is none.
        left: of the distance of the left edge; None if there is none.
        scale: metres per unit of the file; multiplies places and widths.

    Raises:
        ConfigError: the file cannot be understood, or its points are no track.
    """
    path = Path(path)
    name = shown(path)
    if not 0.0 < scale < math.inf:
        raise ConfigError(f"{name}: scale {scale:g} makes no sense; give the metres per unit of the file, above 0")
    header, lines, rows = _read_rows(path, name)
    asked: dict[str, str | int | None] = {"x": x, "y": y, "right": right, "left": left}
    if header is None and len(rows[0]) == 2 and (right, left) == ("w_tr_right_m", "w_tr_left_m"):
        asked |= {"right": None, "left": None}
    columns = {
        key: _find_column(column, list(asked).index(key), header, len(rows[0]), where=f"{name}:{lines[0]}")
        for key, column in asked.items()
        if column is not None
    }

    # Numbers, then what makes them a track.
    values: dict[str, Array] = {}
    for key, column in columns.items():
        numbers = [_number(row[column], f"{name}:{line}: {key}") for line, row in zip(lines, rows, strict=True)]
        values[key] = scale * np.array(numbers)
        if not np.abs(values[key]).max() <= _FARTHEST:
            at = int(np.argmax(np.abs(values[key])))
            raise ConfigError(f"{name}:{lines[at]}: {key} is {values[key][at]:g} m; correct it, or set scale")
        if key in {"right", "left"} and values[key].min() <= 0.0:
            at = int(np.argmin(values[key]))
            raise ConfigError(
                f"{name}:{lines[at]}: {key} is {values[key][at]:g} m; widths are counted from the centre line to both "
                "sides and must be above 0"
            )
    points = np.column_stack((values["x"], values["y"]))
    if len(points) > 1 and math.dist(points[0], points[-1]) < 1e-6:
        points, repeated = points[:-1], True
    else:
        repeated = False
    if len(points) < 4:
        raise ConfigError(f"{name}: {len(points)} points; a track needs at least 4, one per line")
    chords = np.hypot(*np.diff(points, axis=0).T)
    median = float(np.median(chords))
    for at, chord in enumerate(chords.tolist()):
        where = f"{name}:{lines[at + 1]}"
        if chord < 1e-6:
            raise ConfigError(f"{where}: the point of line {lines[at]} is repeated; delete one of them")
        if chord > _JUMP[0] or chord > _JUMP[1] * median:
            raise ConfigError(
                f"{where}: jumps {chord:.4g} m from the point before; usual here are {median:.3g} m; sort the points "
                "in driving order, add the missing ones, or set scale"
            )
    closed = repeated or math.dist(points[0], points[-1]) <= 2.5 * max(median, chords[0], chords[-1])
    widths = {key: values[key][: len(points)] if key in values else None for key in ("left", "right")}
    return CsvTrack(points, widths["left"], widths["right"], lines[: len(points)], closed)


# --- the inner parts -------------------------------------------------------------------------------------------------


def _read_rows(path: Path, name: str) -> tuple[list[str] | None, list[int], list[list[str]]]:
    """Names of the columns if there are any, and of every row of values its line and its texts.

    Raises:
        ConfigError: the file cannot be read, holds no numbers, or its rows differ in length.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise ConfigError(f"{name}: more than {_LARGEST // 1_000_000} MB; no track needs that; thin it out")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{name}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{name}: no text in UTF-8; save it as a CSV file") from None
    kept = [(at, line.strip()) for at, line in enumerate(text.splitlines(), start=1) if line.strip()]
    first = next((i for i, (_, line) in enumerate(kept) if _is_data(line)), None)
    if first is None:
        raise ConfigError(f"{name}: no line of numbers; give x, y and the widths of a point per line")
    split = _separator(kept[first][1])
    data = [(at, _split(line, split)) for at, line in kept[first:] if not line.startswith("#")]
    count = len(data[0][1])
    for at, row in data:
        if len(row) != count:
            raise ConfigError(
                f"{name}:{at}: {len(row)} values, but line {data[0][0]} has {count}; give every point all its columns"
            )
    header = _split(kept[first - 1][1].lstrip("# "), split) if first else None
    if header is not None and len(header) != count:
        header = None
    return header, [at for at, _ in data], [row for _, row in data]


def _is_data(line: str) -> bool:
    """Whether a line is one of values: no comment, and at least one of its texts is a number."""
    return not line.startswith("#") and any(map(_is_number, _split(line, _separator(line))))


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _separator(line: str) -> str:
    """What separates the values of a line: the first of ; , tab that is in it, else blanks."""
    return next((mark for mark in (";", ",", "\t") if mark in line), " ")


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    texts = [text.strip().strip('"') for text in line.split(separator)]
    texts = texts[:-1] if len(texts) > 2 and not texts[-1] else texts  # a separator at the end of the line
    return [text.replace(",", ".") if _is_number(text) else text for text in texts]


def _find_column(column: str | int, default: int, header: Sequence[str] | None, count: int, *, where: str) -> int:
    """Index of a column by its name or its number from 1; without names by its usual place.

    Raises:
        ConfigError: there is no such column.
    """
    key = ("x", "y", "right", "left")[default]
    if header is not None and column in header:
        return header.index(str(column))
    if isinstance(column, int) or re.fullmatch(r"-?[0-9]+", column):
        if not 1 <= int(column) <= count:
            raise ConfigError(f"{where}: {key} is column {column} of {count}; columns are counted from 1")
        return int(column) - 1
    without = "" if key in {"x", "y"} else f", or set {key}: null if there is none"
    if header is not None:
        raise ConfigError(f"{where}: no column '{column}'; {did_you_mean(column, header)}; say which is {key}{without}")
    if column != ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")[default]:
        raise ConfigError(f"{where}: no column '{column}', for the columns have no names; give {key} a number from 1")
    if default >= count:
        raise ConfigError(f"{where}: {count} columns without names; x, y, right and left are expected{without}")
    return default


def _number(text: str, where: str) -> float:
    """A finite number.

    Raises:
        ConfigError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where} '{text[:40]}' is no finite number; correct it or delete the line")
    return value
