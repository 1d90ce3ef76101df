"""``mirdrake world search``: look for the values with which a test of a world goes worst."""

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mirdrake.cli.world_test import (
    add_common,
    asked_told,
    check_layouts,
    count,
    margin_told,
    progress_bar,
    table,
    terminated_like_interrupted,
    values_told,
)

if TYPE_CHECKING:
    from mirdrake.suites import SearchResult, Trial

HELP = "look for values with which a test fails"
MORE = """\
A test says what to search: ``search: {over: {mu: [0.2, 0.9]}, budget: 50}``. Half of the budget covers the ranges
evenly, the rest goes downhill from the worst values found. Exit codes: 0 no failure was found, 1 one was found, 2 some
runs could not be judged, and none failed; 130 interrupted before a failure was found.

examples:
  mirdrake world search parking_lot --case stops_for_pedestrian -j 4
  mirdrake world search parking_lot --budget 200 -p seed=3"""

_MOST_ROWS = 8  # of the worst values


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("file", metavar="FILE", help="name or path of a world file")
    parser.add_argument("--case", action="append", default=[], metavar="TEST", help="only this test")
    parser.add_argument("--budget", type=count, metavar="N", help="number of runs, instead of the file's")
    parser.add_argument("--seed", type=int, default=0, help="of the points tried (%(default)s)")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Search test by test."""
    from mirdrake.suites import collect_searches, search

    codes = [0]
    searches = collect_searches(options.file, only=options.case, values=dict(options.param))
    if not check_layouts([case for case, _ in searches]):
        return 2
    for case, wanted in searches:
        budget = options.budget or wanted.budget
        with terminated_like_interrupted(), progress_bar(budget, "runs", quiet=options.quiet) as bar:

            def progress(done: int, total: int, trial: "Trial", bar: object = bar) -> None:  # noqa: ARG001
                bar.update(1)  # type: ignore[attr-defined]

            found = search(
                case,
                wanted.over,
                budget,
                seed=options.seed,
                workers=options.jobs,
                timeout=options.timeout,
                progress=progress,
            )
        if not options.quiet:
            print("\n".join(_told(found, wanted.over)))
        codes.append(_code(found))
    return 130 if 130 in codes else 1 if 1 in codes else max(codes)


def _code(found: "SearchResult") -> int:
    if found.failures:
        return 1
    judged = sum(trial.result.verdict == "pass" for trial in found.tried)
    return 130 if found.interrupted else 2 if judged < len(found.tried) else 0


def _told(found: "SearchResult", over: dict[str, tuple[float, float]]) -> Iterator[str]:
    """What was found, line by line."""
    verdicts = [trial.result.verdict for trial in found.tried]
    counts = [f"{verdicts.count(key)} {key}" for key in ("fail", "error", "invalid", "pass") if key in verdicts]
    ranges = ", ".join(f"{name} {low:g} .. {high:g}" for name, (low, high) in over.items())
    yield f"{found.case.test} over {ranges}: {len(found.tried)} runs ({', '.join(counts) or 'none done'})"
    ranked = found.ranked()
    rows = [
        (trial.result.verdict, values_told(trial.values), margin_told(trial.result), asked_told(trial.result))
        for trial in ranked[:_MOST_ROWS]
    ]
    yield from (f"  {line}" for line in table(("verdict", "values", "margin", "of the requirement, or why not"), rows))
    if ranked:
        yield f"  the worst again: {found.replay(ranked[0]).command}"
