"""A suite: all cases in a folder, written down one by one, so that a suite that was killed can go on."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import write_file
from mirdrake.core.json_io import parse_json
from mirdrake.suites.cases import Case, Result
from mirdrake.suites.pool import Pool

CASES_FILE, RESULTS_FILE = "suite.json", "results.jsonl"

SuiteProgress = Callable[[int, int, Result], None]
"""Called with the number of cases done, of all cases, and the latest result."""


@dataclass(frozen=True)
class Suite:
    """Cases and what became of them.

    Attributes:
        cases: in the order of the world files.
        results: of the cases that were done, in the same order, whatever the number of workers.
        folder: where everything was written; None if nothing was.
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
        return 2 if counts["error"] or counts["invalid"] else 1 if counts["fail"] else 0

    def ranked(self) -> list[tuple[Case, Result]]:
        """The worst first; see :attr:`mirdrake.suites.cases.Result.place`."""
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

    A case that hangs, crashes its process or raises becomes an error; the others go on. Every result is appended to
    results.jsonl at once. Ctrl-C ends the workers and gives what is done.

    Args:
        cases: from :func:`mirdrake.suites.collect_cases`.
        workers: number of processes.
        folder: made; must be empty unless `resume`. None writes nothing.
        timeout: wall time a case may take [s]; a minute and ten times its simulated time if left out.
        progress: see :data:`SuiteProgress`.
        resume: keep the results that `folder` has of these very cases.
        keep_all: keep the run folders of cases that passed, too.

    Raises:
        RunError: the folder cannot be written, or worker processes cannot start.
    """
    place = Path(folder) if folder is not None else None
    done: dict[int, Result] = {}
    if place is not None:
        if resume:
            done = _known(cases, _read_results(place))
        elif place.exists() and any(place.iterdir()):
            raise RunError(f"{place}: is not empty; choose another folder with --out, or go on with --resume")
        _prepare(place, cases, done)
    missing = [index for index in range(len(cases)) if index not in done]
    try:
        with Pool(min(workers, max(1, len(missing))), folder=place, timeout=timeout, keep_all=keep_all) as pool:
            for at, result in pool.run([cases[index] for index in missing]):
                done[missing[at]] = result
                if place is not None:
                    _append(place, result)
                if progress is not None:
                    progress(len(done), len(cases), result)
    except KeyboardInterrupt:
        pass  # what is done is kept
    results = tuple(done[index] for index in sorted(done))
    if place is not None:
        write_file(place / RESULTS_FILE, "".join(_json(result.data()) + "\n" for result in results))
    return Suite(tuple(cases), results, place)


def load_suite(folder: Path | str) -> Suite:
    """A suite from its folder, as far as it was done.

    Raises:
        ConfigError: it is no folder of a suite.
    """
    folder = Path(folder)
    file = folder / CASES_FILE
    if not file.is_file():
        raise ConfigError(f"{folder}: not the folder of a suite (it has no {CASES_FILE})")
    try:
        cases = [_case(data) for data in parse_json(file.read_text(encoding="utf-8"))["cases"]]
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None
    done = _known(cases, _read_results(folder))
    return Suite(tuple(cases), tuple(done[index] for index in sorted(done)), folder)


def _case(data: dict[str, Any]) -> Case:
    return Case(**(data | {"expect": tuple((text, place) for text, place in data["expect"])}))


def _known(cases: Sequence[Case], results: Sequence[Result]) -> dict[int, Result]:
    """The results of these very cases, by their index."""
    found = {result.digest: result for result in results}
    digests = [case.digest() for case in cases]
    return {index: found[digest] for index, digest in enumerate(digests) if digest in found}


def _prepare(folder: Path, cases: Sequence[Case], done: dict[int, Result]) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: cannot be made: {error.strerror}; choose another folder with --out") from None
    write_file(folder / CASES_FILE, json.dumps({"cases": [case.data() for case in cases]}, indent=1) + "\n")
    write_file(folder / RESULTS_FILE, "".join(_json(done[index].data()) + "\n" for index in sorted(done)))


def _append(folder: Path, result: Result) -> None:
    path = folder / RESULTS_FILE
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(_json(result.data()) + "\n")
    except OSError as error:
        raise RunError(f"{path}: cannot be written: {error.strerror}; choose another folder with --out") from None


def _read_results(folder: Path) -> list[Result]:
    """The results of a folder; a last line that was cut off by a kill does not count."""
    path = folder / RESULTS_FILE
    if not path.is_file():
        return []
    results = []
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        if line.endswith("\n"):
            try:
                results.append(Result(**parse_json(line)))
            except (ValueError, TypeError) as error:
                raise ConfigError(f"{path}: cannot be read: {error}") from None
    return results


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, allow_nan=False)
