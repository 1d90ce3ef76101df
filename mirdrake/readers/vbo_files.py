"""VBO files of VBOX loggers, as described by Racelogic (VBO file format, en.racelogic.support).

Text in sections: ``[header]`` has the title of each channel in a line, ``[column names]`` their short names in one
line, ``[data]`` the rows, separated by blanks. A column is requested by either name. The titles of the logger's own
channels have units (``velocity kmh``); those of other channels must be given. The time of day is HHMMSS.SS.
"""

import re
from io import StringIO

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.core.wording import plural
from mirdrake.readers.csv_files import decode_text
from mirdrake.readers.tables import Request, Table, as_numbers, read_bytes
from mirdrake.readers.time_columns import seconds_of_day

_UNIT = re.compile(r".*\s(kmh|km/h|mph|knots|m/s|g)", re.IGNORECASE)
_SECTION = re.compile(r"\[([^\]]*)\]\s*")


def read_vbo(request: Request) -> Table:
    """Read a VBO file as a table; ``time`` in seconds of its day.

    Raises:
        ConfigError: the file has no column names or no data, or a row has another number of cells.
    """
    path, requested = request.path, request.columns
    name, notes = request.name, list[str]()
    lines = decode_text(read_bytes(path), name, notes).splitlines()
    # A VBO file has sections with titles in brackets; their order varies.
    marks = [
        (index, match.group(1).strip().lower())
        for index, line in enumerate(lines)
        if (match := _SECTION.fullmatch(line))
    ]
    ends = [index for index, _ in marks[1:]] + [len(lines)]
    sections = {title: (index + 1, end) for (index, title), end in zip(marks, ends, strict=False)}
    for needed in ("column names", "data"):
        if needed not in sections:
            raise ConfigError(f"has no section [{needed}]; a VBO file of a VBOX is expected", where=name)
    # Titles in the header have units, the short names above the data do not.
    titles = [line.strip() for line in lines[slice(*sections.get("header", (0, 0)))] if line.strip()]
    names = " ".join(lines[slice(*sections["column names"])]).split()
    rows = [index for index in range(*sections["data"]) if lines[index].strip()]
    if not rows or not names:
        raise ConfigError(f"has no {'rows' if names else 'column names'}", where=name)
    # pandas would fill short rows with NaN.
    for row in rows:
        if len(cells := lines[row].split()) != len(names):
            raise ConfigError(
                f"has {plural(len(cells), 'cell')}, but there are {len(names)} column names", file=name, line=row + 1
            )
    units: dict[str, str] = {}
    # The header of some files has further lines, which are not titles.
    if len(titles) == len(names):
        names = [title if title in requested else short for title, short in zip(titles, names, strict=True)]
        units = {
            called: match.group(1)
            for called, title in zip(names, titles, strict=True)
            if (match := _UNIT.fullmatch(title)) is not None
        }
    # Any white space separates cells.
    frame = pd.read_csv(
        StringIO("\n".join(lines[index] for index in rows)), sep=r"\s+", header=None, names=range(len(names))
    )
    columns = {called: frame[index] for index, called in enumerate(names)}
    if "time" in columns:
        columns["time"] = pd.Series(seconds_of_day(as_numbers(columns["time"])))
        units["time"] = "s"
    return Table(name, names, columns, units, np.array(rows) + 1, notes)
