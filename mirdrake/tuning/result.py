"""The folder of a tuning study: tuning.json, written last, and its Parquet tables; each file whole or not at all.

==================  ================================================================================================
tuning.json         models, candidates with figures and margins, robustness, acceptance, in the order they were found
responses.parquet   candidate, t [s], reference [y], output [y], effort [u]
trials.parquet      of the search: number, the gains, figures, cost, violation, feasible, status, reason
frequency.parquet   candidate, omega [rad/s], re, im of the open loop; the loop's own model as candidate ""
map.parquet         two gains, cost, ms, stable
monte_carlo.parquet candidate, run, conditions, figures, status
==================  ================================================================================================
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.core.files import replacing, write_errors, write_file
from mirdrake.tuning.result_folder import FORMAT, TuningResult, read_result

__all__ = ["FORMAT", "TuningResult", "load_result", "plain", "write_result", "write_table"]


def load_result(folder: Path | str) -> TuningResult:
    """The result in a folder.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    return read_result(folder)


def write_result(folder: Path, data: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> TuningResult:
    """Write a result; tuning.json comes last, so that a folder with it is complete.

    Raises:
        RunError: it cannot be written.
    """
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        write_table(folder / f"{name}.parquet", table)
    write_file(folder / "tuning.json", json.dumps(plain({"mirdrake": FORMAT, **data}), indent=1) + "\n")
    return read_result(folder)


def write_table(path: Path, table: pd.DataFrame) -> None:
    """A whole Parquet file or none.

    Raises:
        RunError: it cannot be written.
    """
    with replacing(path) as temporary:
        table.to_parquet(temporary, index=False)


def plain(value: Any) -> Any:
    """Data for JSON: numbers that are not finite become None, numpy's become Python's."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | str) or value is None:
        return value
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, int | bool | str) else str(value)
