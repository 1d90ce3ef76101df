"""VBO files of VBOX loggers, as Racelogic describes them (VBO file format, en.racelogic.support).

Text in sections: ``[header]`` has a title of each channel in a line of its own, ``[column names]`` short names of them
in one line, ``[data]`` the rows, between blanks. A column is asked for by either name. The titles of what the logger
itself measures have units (``velocity kmh``); those of other channels must be told. The time of day is HHMMSS.SS.
"""

import re
from collections.abc import Collection
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown
from mirdrake.identification.csv_files import text_of
from mirdrake.identification.spec import CsvLayout
from mirdrake.identification.tables import Table, read_bytes
from mirdrake.identification.time_columns import seconds_of_day

_UNIT = re.compile(r".*\s(kmh|km/h|mph|knots|m/s|g)", re.IGNORECASE)
_SECTION = re.compile(r"\[([^\]]*)\]\s*")


def read_vbo(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:  # noqa: ARG001
    """A VBO file as a table; ``time`` in seconds of its day.

    Args:
        path: the file.
        wanted: names of columns that will be asked for: titles of the header where one of them is there.
        layout: of CSV files; not used.

    Raises:
        ConfigError: it has no column names or no data, or a row has other cells than there are names.
    """
    name, notes = shown(path), list[str]()
    lines = text_of(read_bytes(path), name, notes).splitlines()
    marks = [
        (at, match.group(1).strip().lower()) for at, line in enumerate(lines) if (match := _SECTION.fullmatch(line))
    ]
    ends = [at for at, _ in marks[1:]] + [len(lines)]
    sections = {title: (at + 1, end) for (at, title), end in zip(marks, ends, strict=False)}
    for needed in ("column names", "data"):
        if needed not in sections:
            raise ConfigError(f"{name}: has no section [{needed}]; a VBO file of a VBOX is expected")
    titles = [line.strip() for line in lines[slice(*sections.get("header", (0, 0)))] if line.strip()]
    names = " ".join(lines[slice(*sections["column names"])]).split()
    rows = [at for at in range(*sections["data"]) if lines[at].strip()]
    if not rows or not names:
        raise ConfigError(f"{name}: has no {'rows' if names else 'column names'}")
    for at in rows:
        if len(cells := lines[at].split()) != len(names):
            raise ConfigError(f"{name}:{at + 1}: has {len(cells)} cells, and there are {len(names)} column names")
    units: dict[str, str] = {}
    if len(titles) == len(names):
        names = [title if title in wanted else short for title, short in zip(titles, names, strict=True)]
        units = {
            called: match.group(1)
            for called, title in zip(names, titles, strict=True)
            if (match := _UNIT.fullmatch(title)) is not None
        }
    frame = pd.read_csv(StringIO("\n".join(lines[at] for at in rows)), sep=r"\s+", header=None, names=range(len(names)))
    columns = {called: frame[index] for index, called in enumerate(names)}
    if "time" in columns:
        columns["time"] = pd.Series(seconds_of_day(pd.to_numeric(columns["time"], errors="coerce").to_numpy(float)))
        units["time"] = "s"
    return Table(name, names, columns, units, np.array(rows) + 1, notes)
