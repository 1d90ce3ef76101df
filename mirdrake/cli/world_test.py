"""``mirdrake world test``: run the tests of worlds with all their variations, and say what does not hold."""

import argparse
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirdrake.core.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.suites import Case, Result, Suite

HELP = "run the tests of worlds with all their variations"
MORE = """\
Each variation runs in a worker process; one that raises, hangs or crashes is an error, and the others go on. The folder
holds report.html, junit.xml, results.jsonl, and below cases/ the run of every case that did not pass, the worst of them
with a recording that opens offline. A margin is how far a requirement is from changing: positive where it holds.
Ctrl-C stops early and keeps what is done. Exit codes: 0 all passed, 1 a test failed, 2 invalid worlds or errors, 130
interrupted.

examples:
  mirdrake world test parking_lot barrels -j 4
  mirdrake world test parking_lot --case stops_for_pedestrian#2        one variation, with a recording
  mirdrake world test parking_lot -p mu=0.25 -p seed=7                 other values than those of the file
  mirdrake world test parking_lot --out runs/lot --resume              go on after a kill"""

_MOST_ROWS = 40  # of the table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="names or paths of world files")
    parser.add_argument("--case", action="append", default=[], metavar="NAME[#K]", help="only this test, or this one")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<name>-<UTC time>)")
    parser.add_argument("--resume", action="store_true", help="keep the results that --out has of the same cases")
    add_common(parser)


def add_common(parser: argparse.ArgumentParser) -> None:
    """What testing and searching have in common."""
    parser.add_argument("-j", "--jobs", type=count, default=_cores(), metavar="N", help="processes (%(default)s)")
    parser.add_argument(
        "-p",
        "--param",
        action="append",
        default=[],
        type=_parameter,
        metavar="NAME=VALUE",
        help="value of a parameter, or of seed, in place of its variations; may be given again",
    )
    parser.add_argument("--timeout", type=_seconds, metavar="S", help="wall time a case may take [s]")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Run all cases and write what became of them."""
    from mirdrake.core.errors import ConfigError
    from mirdrake.report.junit import write_junit
    from mirdrake.report.suite import write_suite_report
    from mirdrake.report.suite_recordings import write_recordings
    from mirdrake.runs.simulation import default_folder
    from mirdrake.suites import collect_cases, run_suite

    if options.resume and options.out is None:
        raise ConfigError("--resume: say with --out which folder goes on")
    cases = collect_cases(options.files, only=options.case, values=dict(options.param))
    if not check_layouts(cases):
        return 2
    single = cases[0].slug if len(cases) == 1 else Path(cases[0].world).stem
    folder = options.out or default_folder(single if len({case.world for case in cases}) == 1 else "suite")
    began = time.monotonic()
    with terminated_like_interrupted():
        with progress_bar(len(cases), "cases", quiet=options.quiet) as bar:

            def progress(done: int, total: int, result: "Result") -> None:  # noqa: ARG001
                bar.update(done - bar.n)
                bar.counts[result.verdict] = bar.counts.get(result.verdict, 0) + 1
                bar.set_postfix_str(", ".join(f"{n} {key}" for key, n in bar.counts.items() if key != "pass"))

            bar.counts = {}
            suite = run_suite(
                cases,
                workers=options.jobs,
                folder=folder,
                timeout=options.timeout,
                progress=progress,
                resume=options.resume,
                keep_all=bool(options.case),
            )
        faults: list[tuple[str, str]] = []
        if suite.complete:
            with suppress(KeyboardInterrupt):  # the verdicts stand without the pictures
                faults = write_recordings(suite)
                if options.case:
                    _write_run_reports(suite)
    write_suite_report(suite)
    write_junit(suite, folder / "junit.xml")
    for name, why in faults:
        print(f"{name}: not recorded: {why}", file=sys.stderr)
    if not options.quiet:
        print("\n".join(_told(suite, time.monotonic() - began)))
    if not suite.complete:
        left = len(suite.cases) - len(suite.results)
        print(
            f"interrupted: {left} of {len(suite.cases)} cases were not run; "
            f"--out {shown(folder)} --resume goes on with them",
            file=sys.stderr,
        )
        return 130
    return suite.exit_code


def check_layouts(cases: "Sequence[Case]") -> bool:
    """Whether the worlds of some cases are sound as their files have them; tells all faults.

    What chance or parameters change is judged case by case: what finds no place, and rules on areas.
    """
    from mirdrake.world_checks import check_world

    faults = [fault for path in dict.fromkeys(case.world for case in cases) for fault in check_world(path)]
    for fault in faults:
        print(f"error: {fault}", file=sys.stderr)
    return not faults


def _write_run_reports(suite: "Suite") -> None:
    """report.html in the run folder of each case."""
    from mirdrake.report import write_report
    from mirdrake.runs.logs import SUMMARY, load_run, reads_run

    for result in suite.results:
        place = suite.folder / result.folder if suite.folder is not None and result.folder is not None else None
        if place is not None and (place / SUMMARY).is_file():
            reads_run(write_report)(load_run(place))


def _told(suite: "Suite", wall: float) -> Iterator[str]:
    """What became of the cases, line by line."""
    from mirdrake.report.suite_recordings import RECORDING

    assert suite.folder is not None
    rows = [
        (result.verdict, result.name, values_told(case.values), margin_told(result), asked_told(result))
        for case, result in suite.ranked()
    ]
    bad = sum(row[0] != "pass" for row in rows)
    most = max(_MOST_ROWS, bad)
    yield from table(("verdict", "case", "values", "margin", "of the requirement, or why not"), rows[:most])
    if len(rows) > most:
        yield f"and {len(rows) - most} more that passed"
    counts = ", ".join(f"{number} {verdict}" for verdict, number in suite.counts.items() if number)
    yield f"{len(rows)} case{'s' * (len(rows) != 1)}: {counts or 'none done'} ({wall:.1f} s)"
    yield f"  {shown(suite.folder)}/"
    yield "    report.html      report"
    yield "    junit.xml        for continuous integration"
    recorded = [
        f"{result.folder}/{RECORDING}"
        for _, result in suite.ranked()
        if result.folder is not None and (suite.folder / result.folder / RECORDING).is_file()
    ]
    if recorded:
        more = f" (and {len(recorded) - 1} more)" if len(recorded) > 1 else ""
        yield f"    {recorded[0]}      replay, opens offline{more}"
    worst = next(((case, result) for case, result in suite.ranked() if result.verdict != "pass"), None)
    if worst is not None and len(suite.cases) > 1:
        yield f"  the worst again: {worst[0].command}"


# --- what searching uses, too --------------------------------------------------------------------------------------


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines of a table whose columns are as wide as they must be; the last one hangs over."""
    if not rows:
        return
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head) - 1)]
    for row in (head, *rows):
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        yield "  ".join([*cells, row[-1]]).rstrip()


def values_told(values: dict[str, Any]) -> str:
    """``seed=3 mu=0.3``."""
    return " ".join(f"{key}={value}" for key, value in values.items())


def margin_told(result: "Result") -> str:
    """The smallest margin, with its sign and unit."""
    worst = result.worst
    if worst is None:
        return "-"
    return "unbounded" if worst["margin"] is None else f"{worst['margin']:+.3g} {worst['unit']}".rstrip()


def asked_told(result: "Result") -> str:
    """The requirement that decides, or why there is none."""
    worst = result.worst
    if worst is None or result.verdict in {"error", "invalid"}:
        return result.reason
    at = f" (at {worst['worst_time']:.2f} s)" if worst["margin"] is not None else ""
    more = sum(not finding["passed"] for finding in result.findings) - 1
    return f"{worst['text']}{at}" + (f", and {more} more failed" if more > 0 else "")


@contextmanager
def progress_bar(total: int, unit: str, *, quiet: bool) -> Iterator[Any]:
    """A progress bar; none without a terminal."""
    from tqdm import tqdm

    bar = tqdm(
        total=total,
        unit=unit,
        disable=not (sys.stderr.isatty() and not quiet),
        bar_format="{percentage:3.0f}% |{bar}| {n_fmt}/{total_fmt} {unit}, {remaining} left{postfix}",
    )
    with bar:
        yield bar


@contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """While inside, SIGTERM ends what is running as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def count(text: str) -> int:
    """A whole number from 1 on."""
    if not text.isdecimal() or not 1 <= int(text) <= 100_000:
        raise argparse.ArgumentTypeError(f"'{text}' is not allowed; it must be a whole number from 1 to 100000")
    return int(text)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not allowed; it must be a positive time in s")
    return value


def _parameter(text: str) -> tuple[str, float | int | str]:
    from mirdrake.core.errors import ConfigError
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
