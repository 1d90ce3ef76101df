"""``mirdrake world search``: search for the parameter values with the smallest margin of a world's test."""

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mirdrake.cli.common import table_lines, terminated_like_interrupted, whole_number
from mirdrake.cli.world_test import RESULT_HEAD, add_test_options, print_world_faults, result_cells
from mirdrake.core.progress import Progress
from mirdrake.core.wording import plural

if TYPE_CHECKING:
    from mirdrake.suites import SearchResult, Trial

MORE = """\
The test states the ranges to search: ``search: {over: {mu: [0.2, 0.9]}, budget: 50}``. Half of the budget covers the
ranges evenly; the rest refines the values with the smallest margin.
Exit codes: 0 no failure found, 1 a failure found, 2 some runs could not be judged and none failed, 130 interrupted
before a failure was found.

examples:
  mirdrake world search parking_lot --case stops_for_pedestrian -j 4
  mirdrake world search parking_lot --budget 200 -p seed=3"""

_MOST_ROWS = 8  # of the worst values


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("file", metavar="FILE", help="name or path of a world file")
    parser.add_argument("--case", action="append", default=[], metavar="TEST", help="search only this test")
    parser.add_argument("--budget", type=whole_number(1), metavar="N", help="number of runs, instead of the file's")
    parser.add_argument(
        "--seed", type=whole_number(0, 2**32 - 1), default=0, help="seed of the values tried (%(default)s)"
    )
    add_test_options(parser)


def run(options: argparse.Namespace) -> int:
    """Search test by test."""
    from mirdrake.suites import collect_searches, search

    codes = [0]
    # A world with faults is not searched: each of its runs would fail for the same reason.
    searches = collect_searches(options.file, only=options.case, values=dict(options.param))
    if not print_world_faults([case for case, _ in searches]):
        return 2
    for case, wanted in searches:
        budget = options.budget or wanted.budget
        with (
            terminated_like_interrupted(),
            Progress(f"search {case.test}", budget, "runs", quiet=options.quiet) as progress,
        ):

            def show(done: int, _: int, __: "Trial", progress: Progress = progress) -> None:
                progress.update(done)

            result = search(
                case,
                wanted.over,
                budget,
                seed=options.seed,
                workers=options.jobs,
                timeout=options.timeout,
                progress=show,
            )
        if not options.quiet:
            print("\n".join(_result_lines(result, wanted.over)))
        codes.append(_exit_code(result))
    # The worst code of all searches; an interruption comes first.
    return 130 if 130 in codes else 1 if 1 in codes else max(codes)


def _exit_code(result: "SearchResult") -> int:
    if result.failures:
        return 1
    passed = sum(trial.result.verdict == "pass" for trial in result.tried)
    return 130 if result.interrupted else 2 if passed < len(result.tried) else 0


def _result_lines(result: "SearchResult", over: dict[str, tuple[float, float]]) -> Iterator[str]:
    """Yield the result line by line: counts, the worst values, and the command that repeats the worst."""
    verdicts = [trial.result.verdict for trial in result.tried]
    counts = [f"{verdicts.count(key)} {key}" for key in ("fail", "error", "invalid", "pass") if key in verdicts]
    ranges = ", ".join(f"{name} {low:g} .. {high:g}" for name, (low, high) in over.items())
    yield f"{result.case.test} over {ranges}: {plural(len(result.tried), 'run')} ({', '.join(counts) or 'none done'})"
    ranked = result.ranked()
    rows = [result_cells(trial.values, trial.result) for trial in ranked[:_MOST_ROWS]]
    yield from (f"  {line}" for line in table_lines(RESULT_HEAD, rows))
    if ranked:
        yield f"  repeat the worst case: {result.replay(ranked[0]).command}"
