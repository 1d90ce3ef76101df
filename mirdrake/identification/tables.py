"""Files of recorded drives as tables of columns, whatever their format.

A format is one entry of :data:`FORMATS` in :mod:`mirdrake.identification.readers`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import shown


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    Attributes:
        name: of the file, for messages.
        names: of the columns, in order.
        columns: the columns (n each), numbers or not.
        units: of the columns that have one.
        lines: line of each row (n), of a text file.
        notes: what was found in the file and taken for granted.
    """

    name: str
    names: list[str]
    columns: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    lines: NDArray[np.int64] | None = None
    notes: list[str] = field(default_factory=list)

    def numbers(self, column: str, asked: str) -> NDArray[np.float64]:
        """One column as floats (n), NaN where a cell is empty or infinite.

        Args:
            column: its name.
            asked: where it is asked for, ``file:line: path``, for messages.

        Raises:
            ConfigError: there is none of that name, or a cell is no number.
        """
        if column not in self.columns and self.lines is not None and all(_is_number(name) for name in self.names):
            raise ConfigError(f"{asked}: {self.name} has no header; name its columns under 'csv: {{columns: […]}}'")
        if column not in self.columns:
            raise ConfigError(f"{asked}: {self.name} has no column '{column}'; {did_you_mean(column, self.names)}")
        if self.names.count(column) > 1:
            raise ConfigError(f"{asked}: {self.name} has {self.names.count(column)} columns '{column}'; rename one")
        values = pd.Series(np.asarray(self.columns[column]).ravel())
        numbers = pd.to_numeric(values, errors="coerce")
        bad = numbers.isna() & values.notna()
        if bad.any():
            row = int(np.argmax(bad.to_numpy()))
            line = f":{self.lines[row]}" if self.lines is not None else f": row {row + 1}"
            count = f" ({int(bad.sum())} cells in all)" if bad.sum() > 1 else ""
            raise ConfigError(f"{self.name}{line}: column '{column}': {str(values[row])[:40]!r} is not a number{count}")
        result = numbers.to_numpy(dtype=float, copy=True)
        result[~np.isfinite(result)] = np.nan
        return result

    def row(self, index: int) -> str:
        """``file:line`` of a row."""
        return f"{self.name}:{self.lines[index]}" if self.lines is not None else f"{self.name}: row {index + 1}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{shown(path)}: no such file") from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{shown(path)}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
