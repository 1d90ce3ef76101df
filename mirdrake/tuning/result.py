"""Result of a tuning study and its folder: tuning.json, written last, and Parquet tables, each file whole or absent.

==================  ================================================================================================
tuning.json         :class:`TuningResult`; infinite numbers are the texts ``inf`` and ``-inf``
responses.parquet   candidate, t [s], reference [y], output [y], effort [u]
trials.parquet      of the search: number, the gains, figures, cost, violation, feasible, status, reason, fidelity
frequency.parquet   candidate, omega [rad/s], re, im of the open loop
map.parquet         two gains, cost, ms, stable, feasible
monte_carlo.parquet candidate, run, conditions, figures, status, reason
==================  ================================================================================================
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import pandas as pd

from mirdrake.core.errors import ConfigError, did_you_mean, first_line
from mirdrake.core.files import write_errors, write_file
from mirdrake.core.json_io import Json, finite_or_text, parse_json, plain_data, read_record
from mirdrake.core.yaml_io import display_path, read_text
from mirdrake.tuning.acceptance import AGAINST_BASELINE, Criterion, StepEffect
from mirdrake.tuning.confirm import MarginCheck
from mirdrake.tuning.designs import Kind, OmittedDesign
from mirdrake.tuning.identify import Experiment
from mirdrake.tuning.loops.base import LoopSpec, Status
from mirdrake.tuning.robustness import Robustness
from mirdrake.tuning.selection import RejectedTrial
from mirdrake.tuning.trials import Rejection

FORMAT = "tuning-result/1"
FILE = "tuning.json"
TABLES = ("responses", "trials", "frequency", "map", "monte_carlo")


@dataclass(frozen=True)
class CandidateResult:
    """A candidate of a study.

    Attributes:
        name: its name.
        kind: baseline, rule, shaped (loop shaping) or searched.
        gains: by name.
        status: ok, unstable or failed.
        figures: by name, margins included; undefined ones are missing.
        cost: weighted sum of figures; None if it is not finite.
        feasible: whether it is stable and meets the constraints.
        rule: name in :data:`mirdrake.tuning.designs.DESIGN_RULES`; empty for other kinds.
        parameter: of the rule.
        reason: one line; empty if ok.
        rejections: reasons why it was rejected; empty for a candidate that is feasible and passed its checks.
        margins: gain and delay margin as far as the plant confirms them; the figures have the claimed ones.
    """

    name: str
    kind: Kind
    gains: dict[str, float]
    status: Status = "ok"
    figures: dict[str, float] = field(default_factory=dict)
    cost: float | None = None
    feasible: bool = False
    rule: str = ""
    parameter: float | None = None
    reason: str = ""
    rejections: tuple[Rejection, ...] = ()
    margins: tuple[MarginCheck, ...] = ()


@dataclass(frozen=True)
class ScheduleRow:
    """Gains at a speed [m/s]."""

    speed: float
    gains: dict[str, float]


@dataclass(frozen=True)
class ScheduleTest:
    """Test of a gain schedule, or of constant gains, at a speed.

    Attributes:
        speed: [m/s].
        candidate: ``scheduled``, or the name of the candidate with the constant gains.
        place: whether the speed is in the schedule or between two of its speeds.
        gains: at this speed.
        status: ok, unstable or failed.
        cost: None if it is not finite.
        feasible: whether it is stable and meets the constraints.
        reason: one line; empty if ok.
    """

    speed: float
    candidate: str
    place: Literal["tuned", "between"]
    gains: dict[str, float]
    status: Status
    cost: float | None
    feasible: bool
    reason: str = ""


@dataclass(frozen=True)
class Schedule:
    """Gain schedule over speed.

    Attributes:
        rows: increasing speeds; none if no gains were found for one of them.
        tests: at the speeds and between them.
        failed_speed: at which no gains were found [m/s]; None if there are rows.
    """

    rows: tuple[ScheduleRow, ...]
    tests: tuple[ScheduleTest, ...] = ()
    failed_speed: float | None = None


@dataclass(frozen=True)
class TuningResult:
    """Result of a tuning study.

    Attributes:
        name: of the study.
        vehicle: name or path.
        spec: the study as plain data.
        spec_sha256: digest of the study.
        seed: of all random numbers.
        versions: of the packages.
        loop: the loop, with its model.
        candidates: in the order in which they were tested.
        baseline: name of the candidate to compare with.
        best: name of the best candidate; None if none meets the constraints.
        best_rule: name of the best rule; None without one.
        cost: weights of figures.
        constraints: limits of figures.
        experiments: of the identification.
        omitted: designs without a solution.
        rejected: trials of the search that cost less than the best and were rejected.
        step_effect: effect of a finer step of the plant; None if it was not tested.
        repeated_for: effect for which the study was repeated with the finer step; None if it was not.
        schedule: gain schedule; None if the study has none.
        robustness: Monte Carlo; None if the study has none.
        acceptance: criteria.
        wall_s: duration of the study [s].
        folder: of the result.
    """

    name: str
    vehicle: str
    spec: Json
    spec_sha256: str
    seed: int
    versions: dict[str, str]
    loop: LoopSpec
    candidates: tuple[CandidateResult, ...]
    baseline: str
    best: str | None
    best_rule: str | None
    cost: dict[str, float]
    constraints: dict[str, float]
    experiments: tuple[Experiment, ...] = ()
    omitted: tuple[OmittedDesign, ...] = ()
    rejected: tuple[RejectedTrial, ...] = ()
    step_effect: StepEffect | None = None
    repeated_for: StepEffect | None = None
    schedule: Schedule | None = None
    robustness: Robustness | None = None
    acceptance: tuple[Criterion, ...] = ()
    wall_s: float | None = None
    folder: Path = Path()

    def candidate(self, name: str | None = None) -> CandidateResult:
        """Return a candidate by name; by default the best.

        Raises:
            ConfigError: no such candidate, or no best one.
        """
        wanted = self.best if name is None else name
        for candidate in self.candidates:
            if candidate.name == wanted:
                return candidate
        place = display_path(self.folder / FILE)
        if wanted is None:
            raise ConfigError(
                f"{place}: best: the study found no candidate that meets its constraints; choose one by name"
            )
        names = [candidate.name for candidate in self.candidates]
        raise ConfigError(f"{place}: no candidate '{wanted}'; {did_you_mean(wanted, names)}")

    @property
    def is_accepted(self) -> bool:
        """Whether all criteria are met."""
        return all(criterion.met for criterion in self.acceptance)

    @property
    def is_better(self) -> bool:
        """Whether the best candidate costs less than the baseline."""
        compared = [criterion for criterion in self.acceptance if criterion.name in AGAINST_BASELINE]
        return self.best is not None and all(criterion.met for criterion in compared)

    @cached_property
    def _tables(self) -> dict[str, pd.DataFrame | None]:
        return {}

    def table(self, name: str) -> pd.DataFrame | None:
        """Return one of :data:`TABLES`, read from the folder when it is first asked for; None if there is none.

        Raises:
            ConfigError: it cannot be read.
        """
        if name not in self._tables:
            path = self.folder / f"{name}.parquet"
            try:
                self._tables[name] = pd.read_parquet(path) if path.is_file() else None
            except (OSError, ValueError) as error:  # pyarrow raises both
                raise ConfigError(f"{display_path(path)}: cannot be read: {first_line(error)}") from None
        return self._tables[name]


def write_result(result: TuningResult, tables: Mapping[str, pd.DataFrame]) -> TuningResult:
    """Write a result to its folder; tuning.json comes last, so that a folder with it is complete.

    Returns:
        The result, with the tables in memory.

    Raises:
        RunError: it cannot be written.
    """
    with write_errors(result.folder):
        result.folder.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        write_file(result.folder / f"{name}.parquet", table.to_parquet(index=False))
    write_file(result.folder / FILE, result_text(result))
    result._tables.update(dict.fromkeys(TABLES), **tables)
    return result


def result_text(result: TuningResult) -> str:
    """Return the text of tuning.json."""
    content = asdict(result)
    del content["folder"]
    data = plain_data({"mirdrake": FORMAT, **content}, finite_or_text)
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_result(folder: Path | str) -> TuningResult:
    """Read the result in a folder, or of its tuning.json.

    Raises:
        ConfigError: there is none, or it is damaged or of another format.
    """
    folder = Path(folder)
    # The folder or its file may be named.
    folder = folder.parent if folder.name == FILE else folder
    path = folder / FILE
    place = display_path(path)
    if folder.is_file():
        wrong = "not the study" if folder.suffix == ".yaml" else "not a file of it"
        raise ConfigError(f"{display_path(folder)}: give the folder that mirdrake tune has written, {wrong}")
    if not folder.is_dir():
        raise ConfigError(f"{display_path(folder)}: no such folder; give the folder that mirdrake tune has written")
    if not path.is_file():
        # tuning.json is written last: without it the study was interrupted.
        raise ConfigError(f"{display_path(folder)}: not a tuning result (it has no {FILE}); is the study finished?")
    try:
        data = parse_json(read_text(path))
    except json.JSONDecodeError as error:
        raise ConfigError(f"{place}:{error.lineno}: not valid JSON: {error.msg}; run the study again") from None
    except ValueError as error:
        raise ConfigError(f"{place}: {error}; run the study again") from None
    # The format is checked before the fields, so that a file of another format is not reported as damaged.
    given = data.get("mirdrake") if isinstance(data, dict) else None
    if not isinstance(data, dict) or given != FORMAT:
        raise ConfigError(f"{place}: mirdrake: is {given!r}; '{FORMAT}' is expected")
    return read_record(TuningResult, {**data, "folder": folder}, place)
