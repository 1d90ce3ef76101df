"""The suite report: the worst cases first, with a map of each and every margin.

The page needs no network and no other file; only its links to recordings and run folders do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.errors import MirdrakeError
from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import shortest_name
from mirdrake.report.page import Tile, render_page
from mirdrake.report.suite_pictures import draw_bar, draw_case, draw_curve, draw_speed
from mirdrake.report.suite_runs import RECORDING, REPORT
from mirdrake.report.words import format_duration, format_quantity
from mirdrake.runs.logs import load_run
from mirdrake.suites import Case, Result, Suite
from mirdrake.suites.cases import Judgement
from mirdrake.suites.trace import Trace, read_trace
from mirdrake.suites.worker import TRACES
from mirdrake.worlds import World

_TEMPLATE = "suite.html.jinja"
_MOST_ROWS = 1000  # of the table
_MOST_DETAILS = 60  # cases with pictures
_MOST_COLUMNS = 60  # of a matrix


@dataclass(frozen=True)
class Line:
    """A requirement of a case: a line with a bar and a curve."""

    text: str
    passed: bool
    margin: str
    at: str
    bar: Markup
    curve: Markup


@dataclass(frozen=True)
class Row:
    """A case as a row of the table."""

    name: str
    anchor: str
    verdict: str
    reason: str
    values: list[tuple[str, str]]
    margin: str
    bar: Markup | None
    asked: str
    detailed: bool


@dataclass(frozen=True)
class Detail:
    """A case with its map and its requirements."""

    row: Row
    picture: Markup | None
    lines: list[Line]
    command: str
    folder: str
    recording: str
    report: str
    speed: Markup


@dataclass(frozen=True)
class Matrix:
    """All variations of a test as squares; one parameter varies along the rows, the others from row to row."""

    test: str
    across: str
    columns: list[str]
    rows: list[tuple[str, list[tuple[str, str, str]]]]
    """label, and for each column verdict, anchor and tooltip"""


def write_suite_report(suite: Suite) -> Path:
    """Write report.html into the folder of a suite.

    Args:
        suite: suite with a folder, complete or not.

    Returns:
        the path of the file. The same suite gives the same bytes.

    Raises:
        RunError: the file cannot be written.
    """
    assert suite.folder is not None
    path = suite.folder / "report.html"
    write_file(path, render_suite(suite))
    return path


def render_suite(suite: Suite) -> str:
    """Return the page; see :func:`write_suite_report`."""
    # Failures come first; only the first cases get a picture, so that the page stays small.
    ranked = suite.ranked()
    largest = _largest(suite.results)
    rows = [_row(case, result, largest, detailed=index < _MOST_DETAILS) for index, (case, result) in enumerate(ranked)]
    detailed = zip(rows, ranked[:_MOST_DETAILS], strict=False)
    details = [_detail(suite, case, result, row, largest) for row, (case, result) in detailed]
    worlds = list(dict.fromkeys(shortest_name("worlds", Path(case.world)) for case in suite.cases))
    return render_page(
        _TEMPLATE,
        title=f"{', '.join(Path(world).stem for world in worlds) or 'suite'} · test report",
        over=", ".join(worlds),
        headline=_headline(suite),
        tiles=_tiles(suite),
        total=len(suite.cases),
        missing=len(suite.cases) - len(suite.results),
        matrices=_matrices(suite),
        rows=rows[:_MOST_ROWS],
        more_rows=max(0, len(rows) - _MOST_ROWS),
        details=details,
        more_details=max(0, len(rows) - len(details)),
    )


def _tiles(suite: Suite) -> list[Tile]:
    simulated = sum(result.simulated for result in suite.results)
    labels = {"pass": "Passed", "fail": "Failed", "error": "Errors", "invalid": "Invalid worlds"}
    tiles = [Tile(label, str(suite.counts[verdict])) for verdict, label in labels.items()]
    return [*tiles, Tile("Simulated", format_duration(simulated))]


def _headline(suite: Suite) -> str:
    counts, total = suite.counts, len(suite.results)
    if not total:
        return "No case was run"
    if counts["pass"] == total:
        return "The case passed" if total == 1 else f"All {total} cases passed"
    words = {"fail": "failed", "error": "could not be evaluated", "invalid": "invalid"}
    parts = [f"{counts[key]} {text}" for key, text in words.items() if counts[key]]
    return f"{counts['pass']} of {total} cases passed; " + ", ".join(parts)


def _largest(results: Sequence[Result]) -> dict[str, float]:
    """Return the largest finite margin of each requirement, the scale of its bars."""
    largest: dict[str, float] = {}
    for finding in (finding for result in results for finding in result.findings):
        if finding.margin is not None:
            largest[finding.text] = max(largest.get(finding.text, 0.0), abs(finding.margin))
    return largest


def _row(case: Case, result: Result, largest: dict[str, float], *, detailed: bool) -> Row:
    # The bar is relative to the largest margin of the same requirement: margins of different units do not compare.
    worst = result.worst
    bar = None
    if worst is not None:
        bar = draw_bar(worst.margin, largest.get(worst.text, 0.0), passed=worst.passed)
    return Row(
        name=result.name,
        anchor=f"case-{case.slug}",
        verdict=result.verdict,
        reason=result.reason,
        values=[(key, _value(value)) for key, value in case.values.items()],
        margin=_margin(worst) if worst is not None else "",
        bar=bar,
        asked=_asked(result),
        detailed=detailed,
    )


def _asked(result: Result) -> str:
    """Return the decisive requirement and the number of other failures; or the reason why there is none."""
    worst = result.worst
    if worst is None:
        return result.reason
    more = sum(not finding.passed for finding in result.findings) - 1
    return f"{worst.text} (and {more} more failed)" if more > 0 else worst.text


def _detail(suite: Suite, case: Case, result: Result, row: Row, largest: dict[str, float]) -> Detail:
    # The trace has the margins over time; a case that was not driven has none.
    trace = _trace(suite.folder, case)
    lines = []
    for index, finding in enumerate(result.findings):
        curve = Markup("")
        if trace is not None and index < len(trace.curves):
            curve = draw_curve(trace.curves[index], unit=finding.unit, margin=finding.margin, passed=finding.passed)
        bar = draw_bar(finding.margin, largest.get(finding.text, 0.0), passed=finding.passed)
        time_text = f"at {finding.worst_time:.2f} s" if finding.margin is not None else ""
        lines.append(Line(finding.text, finding.passed, _margin(finding), time_text, bar, curve))
    worst = result.findings.index(result.worst) if result.worst is not None and trace is not None else None
    # A trace of an interrupted case has fewer curves than findings.
    if trace is not None and worst is not None and worst >= len(trace.curves):
        worst = None
    folder = suite.folder / result.folder if suite.folder is not None and result.folder else None
    world = _world(case, folder)
    # Links of the pages that were written.
    recording, report = (
        f"{result.folder}/{page}" if folder is not None and (folder / page).is_file() else ""
        for page in (RECORDING, REPORT)
    )
    return Detail(
        row=row,
        picture=None if world is None else draw_case(world, trace, worst, failed=result.verdict == "fail"),
        lines=lines,
        command=case.command,
        folder=result.folder or "",
        recording=recording,
        report=report,
        speed=Markup("") if trace is None else draw_speed(trace),
    )


def _trace(folder: Path | None, case: Case) -> Trace | None:
    """Return the trace of a case; None if it was not driven."""
    return read_trace(folder / TRACES / f"{case.slug}.json") if folder is not None else None


def _world(case: Case, folder: Path | None) -> World | None:
    """Return the world of a case: from its run folder, or laid out again if the case passed and has none."""
    try:
        if folder is not None:
            return load_run(folder).scene().world
    except MirdrakeError:
        pass  # of a run that ended before it had a scene
    try:
        return make_spec(case.diagram).world.load()
    except MirdrakeError:
        return None


def _matrices(suite: Suite) -> list[Matrix]:
    """Return a matrix for each test with variations."""
    results = {result.name: result for result in suite.results}
    tests: dict[tuple[str, str], list[Case]] = {}
    for case in suite.cases:
        tests.setdefault((case.world, case.test), []).append(case)
    matrices = []
    for (_, test), cases in tests.items():
        # The parameter with most values runs along the columns, all others are rows.
        axes = {key: list(dict.fromkeys(_value(case.values[key]) for case in cases)) for key in cases[0].values}
        if len(cases) < 2 or not axes:
            continue
        across = max(axes, key=lambda key: len(axes[key]))
        columns = axes[across]
        if len(columns) > _MOST_COLUMNS:
            continue
        rows: dict[str, dict[str, tuple[str, str, str]]] = {}
        for case in cases:
            label = ", ".join(f"{key} {_value(value)}" for key, value in case.values.items() if key != across)
            result = results.get(case.name)
            verdict = result.verdict if result is not None else "none"
            tooltip = f"{case.name}: {verdict}" + (f", {_margin(result.worst)}" if result and result.worst else "")
            rows.setdefault(label, {})[_value(case.values[across])] = (verdict, f"case-{case.slug}", tooltip)
        blank = ("none", "", "")
        cells = [(label, [row.get(column, blank) for column in columns]) for label, row in rows.items()]
        matrices.append(Matrix(test, across, columns, cells))
    return matrices


def _margin(finding: Judgement | None) -> str:
    if finding is None:
        return ""
    if finding.margin is None:
        return "unbounded"
    return ("+" if finding.margin > 0.0 else "") + format_quantity(finding.margin, finding.unit)


def _value(value: Any) -> str:
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:g}"
    return str(value)
