"""CSV files as people and instruments write them.

Comment lines and text before the header are skipped; the header itself may be a comment (``# time, v`` of NumPy,
``%time,field.x`` of ROS), and so may the units below it. The delimiter, the decimal mark and the units in the header
(``speed [km/h]``, ``speed (km/h)``, ``"speed"|"km/h"``) or in a row below it are detected, and so are files with a
channel in each line, and files without a header, whose columns are numbered from 1.
What was detected is noted in the table.
"""

import gzip
import re
import zlib
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from io import StringIO

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.core.wording import plural
from mirdrake.readers.tables import PLACE, Request, Table, read_bytes
from mirdrake.readers.time_columns import seconds_of_texts
from mirdrake.readers.units import is_unit

_DELIMITERS = ("\t", ";", ",", "|")
_UNIT = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*")
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|nan|inf|-inf|", re.IGNORECASE)
_MISSING = [
    "", "-", "--", "---", "n/a", "N/A", "#N/A", "NA", "<NA>", "NaN", "nan", "NAN", "-nan", "-nan(ind)", "1.#QNAN",
    "null", "NULL", "None",
]  # fmt: skip
_MAX_TRANSPOSED_LINES, _MIN_TRANSPOSED_CELLS = 60, 200
"""At most this many lines, of at least this many cells, are channels rather than rows."""
_SAMPLE = 50  # rows that are looked at before the whole file is parsed
_MAX_PREAMBLE, _MAX_HEAD = 100, 6
"""At most this many lines before the rows, and so many between the header and the rows, with the header."""
_ENCODINGS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_OTHER_FORMATS = {
    b"PK\x03\x04": "a workbook or another zip file",
    b"\xd0\xcf\x11\xe0": "an Excel workbook",
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF file",
    b"PAR1": "a Parquet file (suffix .parquet)",
    b"\x89HDF": "an HDF5 file",
    b"SQLite format 3": "a database (a bag has the suffix .db3)",
}
"""First bytes of formats that are mistaken for CSV."""


@dataclass(frozen=True)
class _Text:
    """Lines of a file and how they are split.

    Attributes:
        request: the request.
        lines: all lines.
        kept: indices of lines that are not empty and not comments.
        notes: what was detected.
    """

    request: Request
    lines: list[str]
    kept: list[int]
    notes: list[str]

    def cells(self, at: int, delimiter: str | None = None) -> list[str]:
        """Return the cells of a line, split by a delimiter, that of the layout, or the line's own."""
        mark = delimiter or self.request.layout.delimiter or _find_delimiter(self.lines[at])
        return _split(self.lines[at], mark)


@dataclass(frozen=True)
class _Header:
    """Names and units of the columns, and where the rows begin.

    Attributes:
        names: names of the columns.
        units: units by name.
        delimiter: delimiter of the rows.
        line: index of the line of the header; None without one.
        rows: indices of the lines of the rows.
    """

    names: list[str]
    units: dict[str, str]
    delimiter: str
    line: int | None
    rows: list[int]


def read_csv(request: Request) -> Table:
    """Read a CSV file as a table.

    The header is the first line that contains a requested column; without one, the first line, unless the rows below
    show that it is something else.

    Raises:
        ConfigError: the file cannot be read, is empty, or a row has more cells than the header.
    """
    name, notes = request.name, list[str]()
    lines = decode_text(read_bytes(request.path), name, notes).splitlines()
    comments = tuple(request.layout.comment)
    # Lines of comments may stand anywhere; numbers of lines for messages are those of the file.
    data_lines = [index for index, line in enumerate(lines) if (bare := line.strip()) and not bare.startswith(comments)]
    if not data_lines:
        raise ConfigError("is empty; a header and rows of numbers are expected", where=name)
    text = _Text(request, lines, data_lines, notes)
    # A file of few long lines may have its channels in rows.
    if len(data_lines) <= _MAX_TRANSPOSED_LINES:
        rows = [text.cells(index) for index in data_lines]
        if _is_transposed(rows):
            return _transpose(name, rows, request.layout.columns, notes)
    header = _with_units(text, _find_header(text))
    if not header.rows:
        raise ConfigError("has a header and no rows", where=name)
    _check_widths(text, header)
    return _parse_rows(text, header)


def _find_header(text: _Text) -> _Header:
    """Find names and delimiter: in the layout, in a comment line above numbers, or in the first suitable line."""
    columns, data_lines = text.request.layout.columns, text.kept
    # Stated columns replace any header.
    if columns:
        return _Header(list(columns), {}, _delimiter_of(text, data_lines[0]), None, data_lines)
    # Some loggers write the header as a comment.
    above = _commented_header(text)
    if above is not None:
        delimiter = _delimiter_of(text, data_lines[0])
        names = _without_comment_mark(text.cells(above, delimiter), text.request)
        return _Header(names, {}, delimiter, above, data_lines)
    head = _header_index(text)
    delimiter = _delimiter_of(text, data_lines[head or 0])
    if head is None:
        head, delimiter = _header_by_rows(text, delimiter)
    if head < 0:
        rows = data_lines[-head - 1 :]
        text.notes.append("has no header: its columns are numbered from 1")
        names = [str(number) for number in range(1, len(text.cells(rows[0], delimiter)) + 1)]
        return _Header(names, {}, delimiter, None, rows)
    if head:
        text.notes.append(f"{head} lines before the header in line {data_lines[head] + 1} are skipped")
    return _Header(text.cells(data_lines[head], delimiter), {}, delimiter, data_lines[head], data_lines[head + 1 :])


def _with_units(text: _Text, header: _Header) -> _Header:
    """Add the units in the names, ``speed [km/h]``, and those of a row of units below the header."""
    names, units, rows = list(header.names), dict[str, str](), header.rows
    matches = [_UNIT.fullmatch(title) for title in names]
    bare = Counter(match.group(1) if match else title for title, match in zip(names, matches, strict=True))
    for index, (title, match) in enumerate(zip(names, matches, strict=True)):
        if match is not None and match.group(1):
            # A number is an index, and brackets that tell columns apart are a part of the name.
            unit, apart = match.group(2).strip(), bare[match.group(1)] > 1
            if unit.isdigit() or (apart and not is_unit(unit)):
                continue
            # A title that is requested with its brackets keeps them.
            names[index] = title if apart or title in text.request.columns else match.group(1)
            units[names[index]] = unit
        elif "|" in title and header.delimiter != "|":
            # Name, unit and limits of a channel with bars between them.
            names[index], units[names[index]] = (part.strip('" ') for part in title.split("|")[:2])
    # The row of units is a comment below the header, or the first row.
    below = [] if header.line is None or not rows else [*range(header.line + 1, rows[0]), rows[0]]
    for index in below:
        cells = _without_comment_mark(text.cells(index, header.delimiter), text.request, ())
        if len(cells) <= len(names) and _is_unit_row(cells):
            units |= {
                title: unit.strip("[]()") for title, unit in zip(names, cells, strict=False) if unit.strip("[]()-")
            }
            text.notes.append(f"line {index + 1} is a row of units")
            rows = rows[1:] if index == rows[0] else rows
            break
    # Further lines without a number, such as the devices of the channels, are no rows.
    first = next((at for at, index in enumerate(rows[:_MAX_HEAD]) if not _is_words(text, index, header.delimiter)), 0)
    if first and header.line is not None:
        text.notes.append(f"{plural(first, 'line')} without numbers below the header, skipped")
        rows = rows[first:]
    return replace(header, names=names, units=units, rows=rows)


def _check_widths(text: _Text, header: _Header) -> None:
    """Reject rows with more cells than there are names."""
    count = len(header.names)
    for index in header.rows[:_SAMPLE]:
        cells = text.cells(index, header.delimiter)
        if len(cells) > count and any(cells[count:]):
            source = "names in 'csv: {columns: […]}'"
            if header.line is not None:
                source = f"names in the header in line {header.line + 1}"
            raise ConfigError(
                f"has {plural(len(cells), 'cell')}, but there are {count} {source}",
                file=text.request.name,
                line=index + 1,
            )


def _parse_rows(text: _Text, header: _Header) -> Table:
    """Parse the rows."""
    name, layout, rows = text.request.name, text.request.layout, header.rows
    sample = [text.cells(index, header.delimiter) for index in rows[:_SAMPLE]]
    decimal = layout.decimal or _find_decimal(sample, header.delimiter)
    if decimal == "," and layout.decimal is None:
        text.notes.append("has decimal commas")
    numbers = np.array(rows) + 1
    try:
        # Columns are numbered, because pandas renames repeated titles; `Table.numbers` reports them.
        frame = pd.read_csv(
            StringIO("\n".join(text.lines[index] for index in rows)),
            sep=r"\s+" if header.delimiter == "space" else header.delimiter,
            header=None,
            names=range(len(header.names)),
            # Otherwise pandas takes the first column as index if rows end with a delimiter.
            index_col=False,
            decimal=decimal,
            na_values=_MISSING,
            keep_default_na=False,
            skipinitialspace=True,
            # In chunks, pandas could give one column several types.
            low_memory=False,
            engine="c",
        )
    except (pd.errors.ParserError, ValueError):
        count = len(header.names)
        line = next((index + 1 for index in rows if len(text.cells(index, header.delimiter)) > count), None)
        raise ConfigError(f"does not have the {count} cells of the header", file=name, line=line) from None
    # Columns of one name get their places in their names.
    counts = Counter(header.names)
    names = [f"{title} (column {at})" if counts[title] > 1 else title for at, title in enumerate(header.names, start=1)]
    units = {new: header.units[old] for new, old in zip(names, header.names, strict=True) if old in header.units}
    columns = {title: frame[index] for index, title in enumerate(names)}
    for title, cells in columns.items():
        if not pd.api.types.is_numeric_dtype(cells) and (seconds := seconds_of_texts(cells)) is not None:
            columns[title], units[title] = pd.Series(seconds), "s"
            text.notes.append(f"column '{title}' has dates or times of day: converted to seconds")
    return Table(name, names, columns, units, numbers, text.notes)


def _is_transposed(rows: list[list[str]]) -> bool:
    """Whether each line is a channel: few lines of many numbers each, with or without a name."""
    width = len(rows[0])
    if width < _MIN_TRANSPOSED_CELLS or any(len(row) != width for row in rows):
        return False
    return all(_NUMBER.fullmatch(cell) for row in rows for cell in row[1:])


def _transpose(name: str, rows: list[list[str]], columns: list[str] | None, notes: list[str]) -> Table:
    """Return the table of lines that are channels; without names they are numbered from 1."""
    named = not all(_NUMBER.fullmatch(row[0]) for row in rows)
    names = columns or [row[0] if named else str(number) for number, row in enumerate(rows, start=1)]
    if len(names) != len(rows):
        raise ConfigError(
            f"has {len(rows)} lines, each a channel, but 'csv: {{columns: […]}}' has {len(names)} names", where=name
        )
    numbered = "" if named or columns else ", and numbered from 1"
    notes.append(f"has a channel in each of its {len(rows)} lines: transposed{numbered}")
    values = {title: np.array(row[named:], dtype=object) for title, row in zip(names, rows, strict=True)}
    series = {title: pd.Series(cells).replace("", np.nan) for title, cells in values.items()}
    return Table(name, names, series, {}, None, notes)


def decode_text(raw: bytes, name: str, notes: list[str]) -> str:
    """Return the text of a file; its encoding is detected, and assumptions are noted.

    Raises:
        ConfigError: the file is not text.
    """
    if raw[:2] == b"\x1f\x8b":
        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error):
            raise ConfigError("is a damaged gzip file", where=name) from None
        notes.append("is compressed with gzip")
    known = next((kind for head, kind in _OTHER_FORMATS.items() if raw.startswith(head)), None)
    if known is not None:
        raise ConfigError(f"is {known}, not text; export it as CSV", where=name)
    encoding = next((known_encoding for head, known_encoding in _ENCODINGS.items() if raw.startswith(head)), None)
    if encoding is None and b"\0" in raw[:4000]:  # UTF-16 without a byte order mark
        # Latin text in UTF-16 has zeros as every second byte; their place gives the byte order.
        even, odd = raw[0:4000:2].count(0), raw[1:4000:2].count(0)
        encoding = "utf-16-le" if odd > 0.4 * len(raw[1:4000:2]) > even else "utf-16-be" if even > odd else None
    try:
        # utf-8-sig removes a byte order mark and needs none.
        text = raw.decode(encoding or "utf-8-sig")
    except UnicodeDecodeError:
        # Every byte is a character of Latin-1, so that this cannot fail.
        text, encoding = raw.decode("latin-1"), "Latin-1"
    if encoding is not None:
        notes.append(f"is not UTF-8; read as {encoding}")
    sample = text[:4000]
    strange = sum((char < " " and char not in "\t\n\r\f\v") or "\x7f" <= char < "\xa0" for char in sample)
    if strange > 0.02 * len(sample):
        raise ConfigError("is not text; CSV is expected", where=name)
    return text


def _split(line: str, delimiter: str) -> list[str]:
    parts = line.split() if delimiter == "space" else line.split(delimiter)
    return [part.strip().strip('"').strip() for part in parts]


def _delimiter_of(text: _Text, at: int) -> str:
    return text.request.layout.delimiter or _find_delimiter(text.lines[at])


def _find_delimiter(line: str) -> str:
    # In a row of numbers the most frequent mark may be the decimal comma: the delimiter leaves numbers.
    for mark in (*_DELIMITERS, "space"):
        cells = _split(line, mark)
        if len(cells) > 1 and any(cells) and all(_NUMBER.fullmatch(cell) for cell in cells):
            return mark
    counts = {mark: line.count(mark) for mark in _DELIMITERS}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] else "space" if len(line.split()) > 1 else ","


def _header_index(text: _Text) -> int | None:
    """Return the position among the kept lines of the first one that names a requested column; None for none."""
    # A number is no name: it is the column's place in a file without header.
    wanted = {PLACE.sub("", name) for name in text.request.columns if not _NUMBER.fullmatch(name)}
    for index, line in enumerate(text.kept[:_MAX_PREAMBLE]):
        cells = text.cells(line)
        bare = {match.group(1) if (match := _UNIT.fullmatch(cell)) else cell for cell in cells}
        if len(cells) > 1 and (bare | set(cells)) & wanted:
            return index
    return None


def _header_by_rows(text: _Text, delimiter: str) -> tuple[int, str]:
    """Return the position of the header among the kept lines, and the delimiter, as the rows of numbers show them.

    Without a header, the position is -1 less that of the first row. Lines in doubt are left as they are: the first one
    is the header.
    """
    kept = text.kept
    # A line in the middle is a row; cells that are text there are text in other rows as well.
    middle = min(len(kept) // 2, 2 * _MAX_PREAMBLE)
    mark = _delimiter_of(text, kept[middle])
    near = [_trimmed(text.cells(index, mark)) for index in kept[max(middle - 5, 1) : middle + 6]]
    if not near or not _count_numbers(near[len(near) // 2]):
        return 0, delimiter
    width = max(map(len, near))
    words = {at for cells in near for at, cell in enumerate(cells) if _is_word(cell)}

    def is_row(index: int) -> bool:
        cells = _trimmed(text.cells(index, mark))
        return (
            _count_numbers(cells) > 0
            and len(cells) <= width
            and {at for at, cell in enumerate(cells) if _is_word(cell)} <= words
        )

    head = _trimmed(text.cells(kept[0], mark))
    numbers = _count_numbers(head)
    plain = numbers == 0 and 2 * sum(map(bool, head)) > len(head)
    if plain and len(head) >= width >= 2:
        return 0, mark
    if width < 2 or _counts_up(head):
        return 0, delimiter
    first = next(
        (at for at in range(min(len(kept), _MAX_PREAMBLE)) if all(is_row(index) for index in kept[at : at + 3])), None
    )
    if first is None:
        return 0, delimiter
    # The header is the fullest line of the block of lines above the rows, with a name for almost each column.
    found, most = None, 0
    for at in reversed(range(max(0, first - _MAX_HEAD), first)):
        # An empty line may separate the rows from the header, and the header from what is above it.
        if at + 1 < first and kept[at + 1] - kept[at] > 1:
            break
        cells = _trimmed(text.cells(kept[at], mark))
        filled = sum(map(bool, cells))
        if _count_numbers(cells) == 0 and not _is_unit_row(cells) and filled >= max(most, 2) and len(cells) <= width:
            found, most = at, filled
    if found is None or 2 * most < width:
        return (-1 - first, mark) if numbers or first else (0, delimiter)
    return found, mark


def _trimmed(cells: list[str]) -> list[str]:
    """Return cells without the empty ones at the end."""
    count = max((at + 1 for at, cell in enumerate(cells) if cell), default=0)
    return cells[:count]


def _is_word(cell: str) -> bool:
    return not _NUMBER.fullmatch(cell) and cell not in _MISSING


def _count_numbers(cells: list[str]) -> int:
    return sum(bool(_NUMBER.fullmatch(cell)) and any(char.isdigit() for char in cell) for cell in cells)


def _counts_up(cells: list[str]) -> bool:
    """Whether cells are 0, 1, 2 … or 1, 2, 3 …, as numbered columns are called."""
    first = int(cells[0]) if cells and cells[0] in {"0", "1"} else None
    return first is not None and len(cells) > 2 and cells == [str(first + at) for at in range(len(cells))]


def _is_words(text: _Text, index: int, delimiter: str) -> bool:
    cells = text.cells(index, delimiter)
    return _count_numbers(cells) == 0 and any(map(_is_word, cells))


def _commented_header(text: _Text) -> int | None:
    """Return the comment line that names the columns of a file whose first other line has numbers; None without."""
    first = text.kept[0]
    delimiter = _delimiter_of(text, first)
    numbers = text.cells(first, delimiter)
    if len(numbers) < 2 or np.mean([bool(_NUMBER.fullmatch(cell)) for cell in numbers]) < 0.5:
        return None
    # The comment nearest to the numbers is the header, others may look like one; but its units may lie between.
    units = None
    for index in reversed(range(first)):
        names = _without_comment_mark(_split(text.lines[index].strip(), delimiter), text.request, ())
        if len(names) != len(numbers) or any(_NUMBER.fullmatch(name) for name in names):
            continue
        if units is not None or not _is_unit_row(names):
            return index
        units = index
    return units


def _without_comment_mark(names: list[str], request: Request, wanted: Collection[str] | None = None) -> list[str]:
    """Return the names of a header without the comment mark before the first of them."""
    bare, marks = names[0], tuple(request.layout.comment)
    while bare not in (request.columns if wanted is None else wanted) and bare.startswith(marks):
        bare = bare.removeprefix(next(mark for mark in marks if bare.startswith(mark))).strip()
    return [name.rstrip(",;") for name in ([bare] if bare else []) + names[1:]]


def _is_unit_row(cells: list[str]) -> bool:
    if not any(cells) or any(cell and _NUMBER.fullmatch(cell) for cell in cells):
        return False
    # Names such as t, m or g are units as well: in a row of units, most cells are.
    units = [is_unit(bare) for cell in cells if (bare := cell.strip("[]()")) not in {"", "-"}]
    return any(units) and 2 * sum(units) >= len(units)


def _find_decimal(rows: list[list[str]], delimiter: str) -> str:
    return "," if delimiter != "," and any(_COMMA.fullmatch(cell) for row in rows for cell in row) else "."
