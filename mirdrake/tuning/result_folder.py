"""The folder of a tuning result, read back: tuning.json and its Parquet tables."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.json_io import parse_json
from mirdrake.core.yaml_io import read_text, shown

FORMAT = "tuning-result/1"
TABLES = ("responses", "trials", "frequency", "map", "monte_carlo")


class _Part(BaseModel):
    """A mapping of tuning.json; only what is read back for writing gains is checked."""

    model_config = ConfigDict(strict=True, extra="ignore")


ControlPath = Annotated[str, Field(pattern=r"^(\w+(\.\w+)+)?$")]
"""A dotted path in control.yaml; empty for a gain that has no place there."""


class _Gain(_Part):
    path: ControlPath | None = None


class _Loop(_Part):
    gains: dict[str, _Gain]
    settings: dict[ControlPath, float | str] | None = None


class _Candidate(_Part):
    name: str
    gains: dict[str, float | None]
    status: str = "ok"
    feasible: bool = False
    cost: float | None = None
    reason: str | None = None


class _ScheduleRow(_Part):
    speed: float
    gains: dict[str, float | None]


class _Acceptance(_Part):
    what: str
    met: bool | None = None


class _Spread(_Part):
    failures: int | None = None


class _Robustness(_Part):
    runs: int
    candidates: dict[str, _Spread] | None = None


class _File(_Part):
    name: str
    loop: _Loop
    candidates: list[_Candidate]
    baseline: str | None
    best: str | None
    vehicle: str | None = None
    spec: dict[str, Any] | None = None
    spec_sha256: str | None = None
    schedule: list[_ScheduleRow] | None = None
    acceptance: list[_Acceptance] | None = None
    robustness: _Robustness | None = None


@dataclass(frozen=True)
class TuningResult:
    """What a tuning study left in its folder.

    Attributes:
        folder: of the result.
        data: tuning.json as plain data.
    """

    folder: Path
    data: dict[str, Any]
    _tables: dict[str, pd.DataFrame | None] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """Name of the study."""
        return str(self.data["name"])

    @property
    def loop(self) -> dict[str, Any]:
        """Names and units of the loop's signals, its gains with unit and path."""
        loop: dict[str, Any] = self.data["loop"]
        return loop

    @property
    def candidates(self) -> list[dict[str, Any]]:
        """All candidates in the order of the file."""
        candidates: list[dict[str, Any]] = self.data["candidates"]
        return candidates

    def candidate(self, name: str | None = None) -> dict[str, Any]:
        """A candidate by name; by default the best.

        Raises:
            ConfigError: no such candidate, or no best one.
        """
        wanted = self.data["best"] if name is None else name
        for one in self.candidates:
            if one["name"] == wanted:
                return one
        place = shown(self.folder / "tuning.json")
        if wanted is None:
            raise ConfigError(f"{place}: best: the study found no candidate that meets its constraints; name another")
        raise ConfigError(
            f"{place}: no candidate '{wanted}'; {did_you_mean(wanted, [str(one['name']) for one in self.candidates])}"
        )

    def table(self, name: str) -> pd.DataFrame | None:
        """One of :data:`TABLES`; None where the study has none.

        Raises:
            ConfigError: it cannot be read.
        """
        if name not in self._tables:
            path = self.folder / f"{name}.parquet"
            try:
                self._tables[name] = pd.read_parquet(path) if path.is_file() else None
            except (OSError, ValueError) as error:  # pyarrow's errors are of both kinds
                raise ConfigError(f"{shown(path)}: cannot be read: {str(error).splitlines()[0]}") from None
        return self._tables[name]


def read_result(folder: Path | str) -> TuningResult:
    """The result in a folder; its tuning.json does as well.

    Raises:
        ConfigError: there is none, or it is damaged or of another format.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == "tuning.json" else folder
    path = folder / "tuning.json"
    place = shown(path)
    if not folder.is_dir():
        raise ConfigError(f"{shown(folder)}: no such folder; give the folder that mirdrake tune has written")
    if not path.is_file():
        raise ConfigError(f"{shown(folder)}: not a tuning result (it has no tuning.json); is the study finished?")
    try:
        data = parse_json(read_text(path))
    except json.JSONDecodeError as error:
        raise ConfigError(f"{place}:{error.lineno}: not valid JSON: {error.msg}; run the study again") from None
    except ValueError as error:
        raise ConfigError(f"{place}: {error}; run the study again") from None
    if not isinstance(data, dict) or data.get("mirdrake") != FORMAT:
        given = data.get("mirdrake") if isinstance(data, dict) else None
        raise ConfigError(f"{place}: mirdrake: is {given!r}; '{FORMAT}' is expected")
    try:
        _File.model_validate(data)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(str(part) for part in fault["loc"])[:80]
        message = "is missing" if fault["type"] == "missing" else str(fault["msg"]).removeprefix("Input ").lower()
        raise ConfigError(f"{place}: {key}: {message}; run the study again") from None
    return TuningResult(folder, data)
