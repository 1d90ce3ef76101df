"""A suite: cases whose results are written one by one, so that a suite that was killed can be resumed."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import read_errors, write_errors, write_file
from mirdrake.core.json_io import Json, parse_json
from mirdrake.execution.journal import Journal, Record, read_records
from mirdrake.suites.cases import Case, Judgement, OtherExpectations, Result
from mirdrake.suites.worker import open_case_workers

CASES_FILE, RESULTS_FILE = "suite.json", "results.jsonl"

SuiteProgress = Callable[[int, int, Result], None]
"""Called with the number of finished cases, of all cases, and the latest result."""


@dataclass(frozen=True)
class Suite:
    """Cases and their results.

    Attributes:
        cases: cases in the order of the world files.
        results: results of the finished cases, in the same order, whatever the number of workers.
        folder: folder of the suite; None if nothing was written.
    """

    cases: tuple[Case, ...]
    results: tuple[Result, ...]
    folder: Path | None = None

    @property
    def complete(self) -> bool:
        """Whether every case has a result."""
        return len(self.results) == len(self.cases)

    @property
    def counts(self) -> dict[str, int]:
        """Number of results by verdict."""
        verdicts = [result.verdict for result in self.results]
        return {verdict: verdicts.count(verdict) for verdict in ("pass", "fail", "error", "invalid")}

    @property
    def exit_code(self) -> int:
        """0: all passed; 1: a requirement failed; 2: a case could not be judged, or a world is invalid."""
        counts = self.counts
        # Errors take precedence: a suite that could not be judged must not look like one that was.
        return 2 if counts["error"] or counts["invalid"] else 1 if counts["fail"] else 0

    def ranked(self) -> list[tuple[Case, Result]]:
        """Return cases and results, the worst first; see :attr:`mirdrake.suites.cases.Result.place`."""
        cases = {case.name: case for case in self.cases}
        order = sorted(self.results, key=lambda result: result.place)
        return [(cases[result.name], result) for result in order]


def run_suite(
    cases: Sequence[Case],
    *,
    workers: int = 1,
    folder: Path | str | None = None,
    timeout: float | None = None,
    progress: SuiteProgress | None = None,
    resume: bool = False,
    keep_all: bool = False,
) -> Suite:
    """Run cases in worker processes.

    A case that hangs, crashes its process or raises an error has the verdict error; the others continue. Every result
    is immediately appended to results.jsonl. Ctrl-C ends the workers; the suite then has the finished cases.

    Args:
        cases: cases from :func:`mirdrake.suites.collect_cases`.
        workers: number of processes.
        folder: folder of the suite; it is created, and must be empty unless `resume`. None writes nothing.
        timeout: wall time that a case may take [s]; 60 s and ten times its simulated time if omitted.
        progress: see :data:`SuiteProgress`.
        resume: continue with the results that `folder` has of these cases.
        keep_all: also keep the run folders of cases that passed.

    Raises:
        RunError: the folder cannot be written, or worker processes cannot start.
    """
    target = Path(folder) if folder is not None else None
    if target is not None:
        with write_errors(target):
            target.mkdir(parents=True, exist_ok=True)
            # Checked before the list of cases is written, which would overwrite that of another suite.
            used = any(target.iterdir())
        if used and not resume:
            raise RunError(
                "is not empty; choose another folder with --out, or continue with --resume", file=str(target)
            )
        write_file(target / CASES_FILE, json.dumps({"cases": [case.data() for case in cases]}, indent=1) + "\n")

    # Results of cases that have changed since are removed from the journal.
    journal = Journal(target / RESULTS_FILE if target is not None else None, key="digest")
    digests = [case.digest() for case in cases]
    journal.keep([digest for digest in digests if digest in journal])
    missing = [case for case, digest in zip(cases, digests, strict=True) if digest not in journal]
    with (
        open_case_workers(workers, cases=len(missing), folder=target, timeout=timeout, keep_all=keep_all) as run_cases,
        suppress(KeyboardInterrupt),  # the finished cases are kept
    ):
        # Stored at once under the digest of its case: a killed suite loses only the cases that were running.
        for _, result in run_cases(missing):
            data = result.data()
            journal.add(data.pop("digest"), data)
            if progress is not None:
                progress(len(journal), len(cases), result)

    # Results are written in the order of the cases, whichever finished first.
    journal.keep([digest for digest in digests if digest in journal])
    return Suite(tuple(cases), _results(cases, journal.records, target), target)


def load_suite(folder: Path | str) -> Suite:
    """Load a suite from its folder, complete or not.

    Raises:
        ConfigError: the folder is not that of a suite, or is damaged.
    """
    folder = Path(folder)
    file = folder / CASES_FILE
    if not file.is_file():
        raise ConfigError(f"not the folder of a suite (it has no {CASES_FILE})", where=str(folder))
    with read_errors(file):
        cases = tuple(_case(data) for data in parse_json(file.read_text(encoding="utf-8"))["cases"])
    return Suite(cases, _results(cases, read_records(folder / RESULTS_FILE, key="digest"), folder), folder)


def _case(data: Json) -> Case:
    others = tuple(
        OtherExpectations(**(other | {"expect": tuple((text, target) for text, target in other["expect"])}))
        for other in data.get("others", ())
    )
    return Case(**(data | {"expect": tuple((text, target) for text, target in data["expect"]), "others": others}))


def _results(cases: Sequence[Case], records: Mapping[str, Record], folder: Path | None) -> tuple[Result, ...]:
    """Return the results of the cases that have one, in the order of the cases."""
    with read_errors(folder / RESULTS_FILE if folder is not None else Path(RESULTS_FILE)):
        digests = [case.digest() for case in cases]
        return tuple(_result(records[digest], digest) for digest in digests if digest in records)


def _result(record: Record, digest: str) -> Result:
    findings = tuple(Judgement(**finding) for finding in record["findings"])
    return Result(**{**record, "findings": findings}, digest=digest)
