"""CSV files as people and instruments write them.

Comment lines and lines of text before the header are passed over; the header itself may be a comment (``# time, v`` of
NumPy, ``%time,field.x`` of ROS). The delimiter, the decimal mark, and units in the
header (``speed [km/h]``, ``speed (km/h)``) or in a row of their own below it are found, and files with a channel in
each line. What was found is noted.
"""

import gzip
import re
import zlib
from collections.abc import Collection
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown
from mirdrake.identification.channels import CHANNELS, unit_factor
from mirdrake.identification.spec import CsvLayout
from mirdrake.identification.tables import Table, read_bytes

_DELIMITERS = ("\t", ";", ",", "|")
_UNIT = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*")
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|nan|inf|-inf|", re.IGNORECASE)
_MISSING = [
    "", "-", "--", "---", "n/a", "N/A", "#N/A", "NA", "<NA>", "NaN", "nan", "NAN", "-nan", "-nan(ind)", "1.#QNAN",
    "null", "NULL", "None",
]  # fmt: skip
_MOST_LYING, _LEAST_LYING = 60, 200
"""At most so many lines, of at least so many cells, are channels and not rows."""
_CODES = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_OTHERS = {
    b"PK\x03\x04": "a workbook or another zip file",
    b"\xd0\xcf\x11\xe0": "an Excel workbook",
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF file",
    b"PAR1": "a Parquet file (suffix .parquet)",
    b"\x89HDF": "an HDF5 file",
    b"SQLite format 3": "a database (a bag has the suffix .db3)",
}
"""What files begin with that are given for CSV by mistake."""
_UNITS = {channel.unit for channel in CHANNELS.values()} | {"s", "m/s^2", "rad", "m"}


def read_csv(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:
    """A CSV file as a table.

    Args:
        path: the file.
        wanted: names of columns that will be asked for; the header is the first line that has one of them.
        layout: what the user says of the file.

    Raises:
        ConfigError: the file cannot be read, is empty, or rows have other cells than the header.
    """
    name = shown(path)
    notes: list[str] = []
    text = text_of(read_bytes(path), name, notes)
    comments = tuple(layout.comment)
    lines = text.splitlines()
    kept = [at for at, line in enumerate(lines) if (bare := line.strip()) and not bare.startswith(comments)]
    if not kept:
        raise ConfigError(f"{name}: is empty; a header and rows of numbers are expected")
    if len(kept) <= _MOST_LYING:
        rows = [_cells(lines[at], layout.delimiter or _delimiter(lines[at])) for at in kept]
        if _lies(rows):
            return _stand_up(name, rows, layout.columns, notes)
    above = None if layout.columns else _header_above(lines, kept[0], comments, layout)
    if above is not None:
        kept = [above, *kept]
    head = 0 if layout.columns or above is not None else _header(lines, kept, wanted, layout)
    delimiter = layout.delimiter or _delimiter(lines[kept[head if above is None else 1]])
    names = layout.columns or _cells(lines[kept[head]], delimiter)
    if above is not None:
        names = _uncommented(names, comments, wanted)
    first = head if layout.columns else head + 1
    if head:
        notes.append(f"{head} lines before the header in line {kept[head] + 1} are passed over")
    units = {}
    for index, title in enumerate(names):
        match = _UNIT.fullmatch(title)
        if match is not None and match.group(1):
            names[index] = title if title in wanted else match.group(1)
            units[names[index]] = match.group(2).strip()
    if not layout.columns and len(kept) > first and _is_units(below := _cells(lines[kept[first]], delimiter)):
        units |= {title: unit.strip("[]()") for title, unit in zip(names, below, strict=False) if unit.strip("[]()-")}
        notes.append(f"line {kept[first] + 1} is a row of units")
        first += 1
    if len(kept) <= first:
        raise ConfigError(f"{name}: has a header and no rows")
    decimal = layout.decimal or _decimal([_cells(lines[at], delimiter) for at in kept[first : first + 50]], delimiter)
    if decimal == "," and layout.decimal is None:
        notes.append("has decimal commas")
    numbers = np.array(kept[first:]) + 1
    for at in kept[first : first + 50]:
        cells = _cells(lines[at], delimiter)
        if len(cells) > len(names) and any(cells[len(names) :]):
            asked = (
                "names of 'csv: {columns: […]}'" if layout.columns else f"names of the header in line {kept[head] + 1}"
            )
            raise ConfigError(f"{name}:{at + 1}: has {len(cells)} cells, and there are {len(names)} {asked}")
    try:
        frame = pd.read_csv(
            StringIO("\n".join(lines[at] for at in kept[first:])),
            sep=r"\s+" if delimiter == "space" else delimiter,
            header=None,
            names=range(len(names)),
            index_col=False,
            decimal=decimal,
            na_values=_MISSING,
            keep_default_na=False,
            skipinitialspace=True,
            low_memory=False,
            engine="c",
        )
    except (pd.errors.ParserError, ValueError) as error:
        match = re.search(r"line (\d+)", str(error))
        line = f":{numbers[min(int(match.group(1)), len(numbers)) - 1]}" if match else ""
        raise ConfigError(f"{name}{line}: does not have the {len(names)} cells of the header") from None
    return Table(name, names, {title: frame[index] for index, title in enumerate(names)}, units, numbers, notes)


def _lies(rows: list[list[str]]) -> bool:
    """Whether each line is a channel: few lines of many numbers each, after a name or none."""
    width = len(rows[0])
    if width < _LEAST_LYING or any(len(row) != width for row in rows):
        return False
    return all(_NUMBER.fullmatch(cell) for row in rows for cell in row[1:])


def _stand_up(name: str, rows: list[list[str]], columns: list[str] | None, notes: list[str]) -> Table:
    """The table of lines that are channels; without names they are counted from 1."""
    named = not all(_NUMBER.fullmatch(row[0]) for row in rows)
    names = columns or [row[0] if named else str(at) for at, row in enumerate(rows, start=1)]
    if len(names) != len(rows):
        raise ConfigError(
            f"{name}: has {len(rows)} lines, each a channel, and 'csv: {{columns: […]}}' {len(names)} names"
        )
    notes.append(
        f"has a channel in each of its {len(rows)} lines: turned" + ("" if named or columns else ", and counted from 1")
    )
    values = {title: np.array(row[named:], dtype=object) for title, row in zip(names, rows, strict=True)}
    return Table(
        name, names, {title: pd.Series(cells).replace("", np.nan) for title, cells in values.items()}, {}, None, notes
    )


def text_of(raw: bytes, name: str, notes: list[str]) -> str:
    """The text of a file in whatever code it is written; what was taken for granted is noted.

    Raises:
        ConfigError: it is no text.
    """
    if raw[:2] == b"\x1f\x8b":
        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error):
            raise ConfigError(f"{name}: is a gzip file, and is broken") from None
        notes.append("is compressed with gzip")
    known = next((what for head, what in _OTHERS.items() if raw.startswith(head)), None)
    if known is not None:
        raise ConfigError(f"{name}: is {known} and no text; export it as CSV")
    code = next((code for head, code in _CODES.items() if raw.startswith(head)), None)
    if code is None and b"\0" in raw[:4000]:
        even, odd = raw[0:4000:2].count(0), raw[1:4000:2].count(0)
        code = "utf-16-le" if odd > 0.4 * len(raw[1:4000:2]) > even else "utf-16-be" if even > odd else None
    try:
        text = raw.decode(code or "utf-8-sig")
    except UnicodeDecodeError:
        text, code = raw.decode("latin-1"), "Latin-1"
    if code is not None:
        notes.append(f"is not UTF-8; read as {code}")
    sample = text[:4000]
    strange = sum((char < " " and char not in "\t\n\r\f\v") or "\x7f" <= char < "\xa0" for char in sample)
    if strange > 0.02 * len(sample):
        raise ConfigError(f"{name}: is no text; CSV is expected")
    return text


def _cells(line: str, delimiter: str) -> list[str]:
    parts = line.split() if delimiter == "space" else line.split(delimiter)
    return [part.strip().strip('"').strip() for part in parts]


def _delimiter(line: str) -> str:
    counts = {mark: line.count(mark) for mark in _DELIMITERS}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] else "space" if len(line.split()) > 1 else ","


def _header(lines: list[str], kept: list[int], wanted: Collection[str], layout: CsvLayout) -> int:
    """Index into `kept` of the header."""
    for index, at in enumerate(kept[:100]):
        cells = _cells(lines[at], layout.delimiter or _delimiter(lines[at]))
        bare = {match.group(1) if (match := _UNIT.fullmatch(cell)) else cell for cell in cells}
        if len(cells) > 1 and (bare | set(cells)) & set(wanted):
            return index
    return 0


def _header_above(lines: list[str], first: int, comments: tuple[str, ...], layout: CsvLayout) -> int | None:
    """The comment line that names the columns of a file whose first other line has numbers; None: there is none."""
    delimiter = layout.delimiter or _delimiter(lines[first])
    numbers = _cells(lines[first], delimiter)
    if len(numbers) < 2 or np.mean([bool(_NUMBER.fullmatch(cell)) for cell in numbers]) < 0.5:
        return None
    for at in reversed(range(first)):
        names = _uncommented(_cells(lines[at].strip(), delimiter), comments, ())
        if len(names) == len(numbers) and not any(_NUMBER.fullmatch(name) for name in names):
            return at
    return None


def _uncommented(names: list[str], comments: tuple[str, ...], wanted: Collection[str]) -> list[str]:
    """Names of a header without the mark of a comment before the first of them."""
    bare = names[0]
    while bare not in wanted and bare.startswith(comments):
        bare = bare.removeprefix(next(mark for mark in comments if bare.startswith(mark))).strip()
    return [name.rstrip(",;") for name in ([bare] if bare else []) + names[1:]]


def _is_units(cells: list[str]) -> bool:
    if not any(cells) or any(cell and _NUMBER.fullmatch(cell) for cell in cells):
        return False
    return any(_fits(cell.strip("[]()"), si) for cell in cells if cell for si in _UNITS if si != "1")


def _fits(unit: str, si: str) -> bool:
    try:
        unit_factor(unit, si)
    except ValueError:
        return False
    return bool(unit)


def _decimal(rows: list[list[str]], delimiter: str) -> str:
    return "," if delimiter != "," and any(_COMMA.fullmatch(cell) for row in rows for cell in row) else "."
