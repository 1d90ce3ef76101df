"""``mirdrake world test``: run the tests of worlds with all their variations and report which fail."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import (
    add_param,
    add_quiet,
    core_count,
    positive_time,
    table_lines,
    terminated_like_interrupted,
    whole_number,
)
from mirdrake.core.errors import ConfigError
from mirdrake.core.progress import Progress
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path

if TYPE_CHECKING:
    from mirdrake.suites import Case, Result, Suite

MORE = """\
Each variation runs in a worker process. A variation that raises an exception, hangs or crashes counts as an error; the
others continue. The folder holds report.html, junit.xml, results.jsonl, and below cases/ the run of every case that did
not pass, the worst of them with a report and a recording that open offline. The margin of a requirement is its distance
from the limit; it is positive if the requirement is met. Ctrl-C stops early and keeps the results so far.
Exit codes: 0 all passed, 1 a test failed, 2 invalid worlds or errors, 130 interrupted.

examples:
  mirdrake world test parking_lot barrels -j 4
  mirdrake world test parking_lot --case stops_for_pedestrian#2        one variation, with a recording
  mirdrake world test parking_lot -p mu=0.25 -p seed=7                 other values than those of the file
  mirdrake world test parking_lot --out runs/lot --resume              continue after a kill"""

RESULT_HEAD = ("verdict", "values", "margin", "requirement that decides, or reason")
"""Columns of the tables of results, from the second on in a table of cases."""

_MOST_ROWS = 40  # of the table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="names or paths of world files")
    parser.add_argument("--case", action="append", default=[], metavar="NAME[#K]", help="run only this test or case")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<name>-<UTC time>)")
    parser.add_argument("--resume", action="store_true", help="keep the results of the same cases in --out")
    add_test_options(parser)


def add_test_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that ``world test`` and ``world search`` share."""
    parser.add_argument(
        "-j", "--jobs", type=whole_number(1), default=core_count(), metavar="N", help="processes (%(default)s)"
    )
    add_param(parser, type=_parameter)
    parser.add_argument(
        "--timeout", type=positive_time, metavar="S", help="largest wall time of a case [s], or with a unit"
    )
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Run all cases, write their results and print them."""
    from mirdrake.report.junit import write_junit
    from mirdrake.report.suite import write_suite_report
    from mirdrake.report.suite_runs import write_run_pages
    from mirdrake.runs.simulation import default_folder
    from mirdrake.suites import collect_cases, run_suite

    if options.resume and options.out is None:
        raise ConfigError("--resume: give the folder to continue with --out")

    # Worlds with faults are reported before any case runs, as each of their cases would fail for the same reason.
    cases = collect_cases(options.files, only=options.case, values=dict(options.param))
    if not print_world_faults(cases):
        return 2
    # A single case names its folder, several the world.
    name = cases[0].slug if len(cases) == 1 else Path(cases[0].world).stem
    folder = options.out or default_folder(name if len({case.world for case in cases}) == 1 else "suite")
    began = time.monotonic()
    with terminated_like_interrupted():
        with Progress(name, len(cases), "cases", quiet=options.quiet) as progress:
            counts: Counter[str] = Counter()

            def show(done: int, _: int, result: "Result") -> None:
                counts[result.verdict] += result.verdict != "pass"
                progress.update(done, text=", ".join(f"{count} {verdict}" for verdict, count in (+counts).items()))

            suite = run_suite(
                cases,
                workers=options.jobs,
                folder=folder,
                timeout=options.timeout,
                progress=show,
                resume=options.resume,
                keep_all=bool(options.case),
            )

        # An interrupted suite is to be continued, so that pages of its runs are not made yet.
        faults: list[tuple[str, str]] = []
        if suite.complete:
            with suppress(KeyboardInterrupt):  # the verdicts are valid without the pages of runs
                faults = write_run_pages(suite)
    write_suite_report(suite)
    write_junit(suite, folder / "junit.xml")
    for name, reason in faults:
        print(f"{name}: not written: {reason}", file=sys.stderr)
    if not options.quiet:
        print("\n".join(_result_lines(suite, time.monotonic() - began)))
    if not suite.complete:
        left = len(suite.cases) - len(suite.results)
        print(
            f"interrupted: {left} of {len(suite.cases)} cases were not run; "
            f"continue with --out {display_path(folder)} --resume",
            file=sys.stderr,
        )
        # As shells report an interrupt: 128 + SIGINT.
        return 130
    return suite.exit_code


def print_world_faults(cases: "Sequence[Case]") -> bool:
    """Print all faults of the worlds of some cases as their files have them; return whether there are none.

    What random draws or parameters change is judged case by case: unplaced props, and rules on areas.
    """
    from mirdrake.world_checks import check_world

    faults = [fault for path in dict.fromkeys(case.world for case in cases) for fault in check_world(path)]
    for fault in faults:
        print(f"error: {fault}", file=sys.stderr)
    return not faults


def result_cells(values: Mapping[str, object], result: "Result") -> tuple[str, str, str, str]:
    """Return the cells of :data:`RESULT_HEAD` for a result with its values of parameters."""
    settings = " ".join(f"{key}={value}" for key, value in values.items())
    return result.verdict, settings, _format_margin(result), _format_requirement(result)


def _format_margin(result: "Result") -> str:
    """Return the smallest margin with its sign and unit."""
    worst = result.worst
    if worst is None:
        return "-"
    return "unbounded" if worst.margin is None else f"{worst.margin:+.3g} {worst.unit}".rstrip()


def _format_requirement(result: "Result") -> str:
    """Return the requirement with the smallest margin, or the reason why there is none."""
    worst = result.worst
    if worst is None or result.verdict in {"error", "invalid"}:
        return result.reason
    when = f" (at {worst.worst_time:.2f} s of the run)" if worst.margin is not None else ""
    more = sum(not finding.passed for finding in result.findings) - 1
    return f"{worst.text}{when}" + (f", and {more} more failed" if more > 0 else "")


def _result_lines(suite: "Suite", wall: float) -> Iterator[str]:
    """Yield the results line by line: failures first, then the files and the command that repeats the worst case."""
    from mirdrake.report.suite_runs import RECORDING, REPORT

    assert suite.folder is not None
    ranked = suite.ranked()
    rows = []
    for case, result in ranked:
        verdict, *others = result_cells(case.values, result)
        rows.append((verdict, result.name, *others))
    # Failures are listed in full; passed cases only up to a screen.
    row_limit = max(_MOST_ROWS, sum(row[0] != "pass" for row in rows))
    yield from table_lines((RESULT_HEAD[0], "case", *RESULT_HEAD[1:]), rows[:row_limit])
    if len(rows) > row_limit:
        yield f"and {len(rows) - row_limit} more that passed"
    counts = ", ".join(f"{number} {verdict}" for verdict, number in suite.counts.items() if number)
    yield f"{plural(len(rows), 'case')}: {counts or 'none done'} ({wall:.1f} s)"
    if any(len(result.findings) > 1 for result in suite.results):
        yield "  decides: the smallest margin relative to the limit (to 1 m: collision, on road; to 0.05 m/s: stopped)"
    yield f"  {display_path(suite.folder)}/"
    yield "    report.html      report"
    yield "    junit.xml        for continuous integration"
    for name, text in ((REPORT, "report of a case"), (RECORDING, "recording, opens offline")):
        kept = [
            f"{result.folder}/{name}"
            for _, result in ranked
            if result.folder is not None and (suite.folder / result.folder / name).is_file()
        ]
        if kept:
            yield f"    {kept[0]}      {text}{_more(kept)}"
    worst = next((case for case, result in ranked if result.verdict != "pass"), None)
    if worst is not None and len(suite.cases) > 1:
        yield f"  repeat the worst case: {worst.command}"


def _more(pages: Sequence[str]) -> str:
    """Return how many pages there are besides the first one."""
    return f" (and {len(pages) - 1} more)" if len(pages) > 1 else ""


def _parameter(text: str) -> tuple[str, float | int | str]:
    """Return the name and value of ``NAME=VALUE``; the type of an option."""
    from mirdrake.core.yaml_io import parse_tree

    name, sign, given = (part.strip() for part in text.partition("="))
    try:
        value = parse_tree(given, name)[0] if sign and name and given else None
    except ConfigError:
        value = None
    if isinstance(value, bool) or not isinstance(value, float | int | str):
        raise argparse.ArgumentTypeError(f"'{text}' is not allowed; write NAME=VALUE, for example mu=0.3")
    if name == "seed" and not isinstance(value, int):
        raise argparse.ArgumentTypeError(f"'{text}' is not allowed; a seed is a whole number")
    return name, value
