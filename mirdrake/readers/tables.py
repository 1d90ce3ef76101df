"""Tables of columns with units, and the request that a reader answers."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.errors import ConfigError, Place, did_you_mean
from mirdrake.core.yaml_io import Schema, display_path

PLACE = re.compile(r" \(column \d+\)$")
"""Remark after the name of a column of a text file whose name is not the only one."""


class CsvLayout(Schema):
    """Layout of a CSV file; it is detected where it is left out."""

    delimiter: str | None = Field(default=None, min_length=1, description="delimiter of cells, 'space' for blanks [-]")
    decimal: Literal[".", ","] | None = Field(default=None, description="decimal mark [-]")
    comment: list[str] = Field(default=["#", "%", "//"], description="beginnings of comment lines [-]")
    columns: list[str] | None = Field(default=None, description="names of the columns of a file without header [-]")


@dataclass(frozen=True)
class Request:
    """A file to read; a reader uses what its format needs.

    Attributes:
        path: file or folder.
        columns: names of the columns that will be used.
        layout: layout of a text file.
    """

    path: Path
    columns: Collection[str] = ()
    layout: CsvLayout = field(default_factory=CsvLayout)

    @property
    def name(self) -> str:
        """Path for messages."""
        return display_path(self.path)


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    Attributes:
        name: file name for messages.
        names: names of the columns, in order.
        columns: the columns (n each), numeric or not.
        units: units of the columns that state one.
        lines: line of each row (n), of a text file.
        notes: what was detected or assumed about the file.
    """

    name: str
    names: list[str]
    columns: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    lines: NDArray[np.int64] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def has_header(self) -> bool:
        """Whether one of its names is not a number; otherwise the first row of data was taken as header."""
        return not all(map(_is_number, filter(None, self.names)))

    def numbers(self, column: str, place: str) -> NDArray[np.float64]:
        """Return one column as floats (n), NaN where a cell is empty or infinite.

        Args:
            column: its name.
            place: position of the request, ``file:line: path``, for messages.

        Raises:
            ConfigError: the column does not exist, or a cell is not a number.
        """
        if column not in self.columns and self.lines is not None and not self.has_header:
            raise ConfigError(f"{self.name} has no header; name its columns under 'csv: {{columns: […]}}'", where=place)
        if self.names.count(column) > 1:
            raise ConfigError(f"{self.name} has {self.names.count(column)} columns '{column}'; rename one", where=place)
        same = [name for name in self.names if PLACE.sub("", name) == column]
        if column not in self.columns and same:
            names = " or ".join(f"'{name}'" for name in same)
            raise ConfigError(
                f"{self.name} has {len(same)} columns '{column}'; rename one, or use {names}", where=place
            )
        if column not in self.columns:
            raise ConfigError(f"{self.name} has no column '{column}'; {did_you_mean(column, self.names)}", where=place)
        values = pd.Series(np.asarray(self.columns[column]).ravel())
        numbers = as_numbers(values)
        # coerce turns texts into NaN; cells that were empty before are not faults.
        bad = np.isnan(numbers) & values.notna().to_numpy()
        if bad.any():
            row = int(np.argmax(bad))
            count = f" ({int(bad.sum())} cells in all)" if bad.sum() > 1 else ""
            raise ConfigError(
                f"column '{column}': {str(values[row])[:40]!r} is not a number{count}", where=self.row(row)
            )
        numbers[~np.isfinite(numbers)] = np.nan
        return numbers

    def row(self, index: int) -> Place:
        """Return ``file:line`` of a row."""
        if self.lines is None:
            return Place(self.name, path=(f"row {index + 1}",))
        return Place(self.name, int(self.lines[index]))


def vectors(content: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the vectors of numbers in nested mappings, sequences and arrays, by name.

    Entries of a mapping and fields of a structured array are ``outer.inner``; columns of a matrix are numbered from 1.

    Args:
        content: mapping, sequence or array; anything else has no vectors.
        prefix: name of the content.
    """
    columns: dict[str, NDArray[Any]] = {}
    dot = f"{prefix}." if prefix else ""
    if isinstance(content, list | tuple) and content and all(isinstance(row, Mapping) for row in content):
        # Records: the keys of the first one are the columns.
        content = {key: [row.get(key, np.nan) for row in content] for key in content[0]}
    if isinstance(content, Mapping):
        for key, item in content.items():
            columns |= vectors(item, f"{dot}{key}")
        return columns
    if isinstance(content, list | tuple):
        try:
            content = np.asarray(content)
        except ValueError:  # rows of several lengths
            return columns
    if not isinstance(content, np.ndarray) or content.size < 2:
        return columns
    if content.dtype.names:
        for key in content.dtype.names:
            columns |= vectors(content[key], f"{dot}{key}")
    elif content.dtype.kind in "biuf":
        # A vector, whichever way it lies.
        if content.size == max(content.shape):
            columns[prefix or "1"] = content.ravel()
        elif content.ndim == 2:
            # Samples run along the longer edge.
            tall = content if content.shape[0] >= content.shape[1] else content.T
            columns |= {f"{dot}{index + 1}": tall[:, index] for index in range(tall.shape[1])}
    return columns


def as_numbers(cells: "pd.Series[Any]") -> NDArray[np.float64]:
    """Return cells as numbers (n); NaN for those that are none, infinite for an integer of hundreds of digits."""
    try:
        numbers = pd.to_numeric(cells, errors="coerce")
    except OverflowError:  # float() of an integer fails, that of its text is infinite
        numbers = pd.to_numeric(cells.map(str), errors="coerce")
    return np.array(numbers, dtype=float)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))  # a decimal comma, as in files of a German locale
    except ValueError:
        return False
    return True


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises:
        ConfigError: the file cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigError("no such file", where=display_path(path)) from None
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"cannot be read: {getattr(error, 'strerror', None) or error}", where=display_path(path)
        ) from None
