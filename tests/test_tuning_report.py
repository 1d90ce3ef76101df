"""Report of a tuning study, from a small but real study of a textbook loop: the page has the figures of the result."""

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mirdrake.core.errors import ConfigError
from mirdrake.report.tuning import FIGURES, render_tuning, write_tuning_report
from mirdrake.report.tuning_axes import Shown
from mirdrake.report.tuning_charts import draw_distribution, draw_map
from mirdrake.report.words import format_quantity
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.result import TABLES, Schedule, ScheduleRow, ScheduleTest, TuningResult, read_result
from mirdrake.tuning.robustness import CornerTest
from tests.tuning_sample import short_result, write_sample


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> TuningResult:
    return write_sample(tmp_path_factory.mktemp("study") / "result", runs=20, trials=30, cells=(9, 8))


@pytest.fixture(scope="module")
def page(sample: TuningResult) -> str:
    return write_tuning_report(sample).read_text()


class _Tables(HTMLParser):
    """The texts of all cells: table, row, cell."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in {"td", "th"}:
            self.tables[-1][-1].append("")
        if tag not in {"meta", "link", "rect", "path", "br"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if any(tag in {"td", "th"} for tag in self.open):
            self.tables[-1][-1][-1] += data


def _tables(page: str) -> list[list[list[str]]]:
    reader = _Tables()
    reader.feed(page)
    return reader.tables


def test_the_title_is_the_verdict(sample: TuningResult, page: str) -> None:
    best, baseline = sample.candidate(), sample.candidate(sample.baseline)
    assert best.cost is not None
    assert baseline.cost is not None
    change = 100.0 * (1.0 - best.cost / baseline.cost)
    heading = html.unescape(re.search(r"<h1>(.*?)</h1>", page).group(1))  # type: ignore[union-attr]
    assert heading.startswith(f"Textbook wheel: {change:.0f} % less IAE than the given gains (")
    assert heading.endswith("; all criteria are met")
    assert page.index("<h1>") < page.index("Acceptance") < page.index("Response") < page.index("All candidates")
    assert page.count('<span class="verdict good">met</span>') == len(sample.acceptance) == 4


def test_every_candidate_is_in_the_table_with_all_its_figures(sample: TuningResult, page: str) -> None:
    first, *others = [rows for rows in _tables(page) if rows[0][0] == "Candidate" and rows[0][1] != "Failed"][:4]
    assert first[0][:3] == ["Candidate", "Origin", "Verdict"]
    assert [len(rows) for rows in (first, *others)] == [len(sample.candidates) + 1] * 4
    # The tables side by side: each has the candidates in its first column.
    table = [sum((row[1:] for row in rows), first) for first, *rows in zip(first, *others, strict=True)]
    # Figures that no candidate has are left out.
    shown = [name for name in FIGURES if any(name in candidate.figures for candidate in sample.candidates)]
    assert set(FIGURES) - set(shown) == {"over_present"}
    assert [len(row) for row in table] == [3 + 3 + 1 + len(shown)] * len(table)
    for row, candidate in zip(table[1:], sample.candidates, strict=True):
        assert row[0].startswith(candidate.name)
        if candidate.status == "ok":
            expected = [candidate.gains[name] for name in ("kp", "ki", "kd")] + [candidate.cost]
            expected += [candidate.figures.get(name) for name in shown]
            assert row[3:] == ["–" if value is None else format_quantity(value) for value in expected]
        else:
            assert row[2] == "unstable"
            assert set(row[6:]) == {"–"}


def test_the_robustness_table_has_the_figures_of_the_study(sample: TuningResult, page: str) -> None:
    assert sample.robustness is not None
    table = next(rows for rows in _tables(page) if rows[0][:2] == ["Candidate", "Failed"])
    figures = next(rows for rows in _tables(page) if rows[0][0] == "Figure of the runs")
    by_name = {row[-4]: row[-3:] for row in figures[1 : len(table)]}  # those of the first figure
    for row in table[1:]:
        candidate = sample.robustness.candidates[row[0]]
        assert row[1] == f"{candidate.failures.failures} of 20"
        assert row[2] == f"{100.0 * candidate.failures.low:.1f} to {100.0 * candidate.failures.high:.1f} %"
        iae = candidate.figures["iae"]
        assert by_name[row[0]] == [format_quantity(value) for value in (iae.median, iae.p95, iae.worst)]
    assert [row[0] for row in table[1:]] == list(sample.robustness.candidates)
    assert table[2][1:3] == ["20 of 20", "83.2 to 100.0 %"]  # published gains: (0.025)^(1/20) = 0.8316


def test_the_page_needs_no_network_and_all_ids_are_unique(page: str) -> None:
    outside = re.findall(
        r"""(?:src|href|xlink:href)=["'](?!#|data:)[^"']*|@import|url\(\s*["']?(?!#|data:)[^)]*""", page
    )
    assert outside == []
    assert "http" not in re.sub(r"<pre>.*?</pre>", "", page, flags=re.DOTALL)
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for used in re.findall(r"url\(#([^)]+)\)", page):
        assert used in ids
    assert page.count("<svg") == 7
    assert "#0101" not in page  # every reserved colour has become a variable of the page
    assert "#0102" not in page
    for name in set(re.findall(r"var\(--([a-z0-9]+)\)", page)):
        assert f"--{name}:" in page, name


def test_the_same_result_gives_the_same_bytes(sample: TuningResult, page: str) -> None:
    assert render_tuning(read_result(sample.folder)) == page


def test_units_are_those_of_the_loop(page: str) -> None:
    head = [cell for rows in _tables(page) if rows[0][0] == "Candidate" for cell in rows[0]]
    start = head.index("Verdict") + 1
    assert head[start : start + 4] == ["kpN m s/rad", "kiN m/rad", "kdN m s²/rad", "Cost\u00a0"]
    assert {"IAErad", "ITAErad s", "ISE(rad/s)² s", "RMS jerkrad/s³", "Peak effortN m", "Phase margin°"} <= set(head)


def test_a_name_with_markup_is_text(tmp_path: Path) -> None:
    result = short_result("car", tmp_path)
    name = "<script>alert(1)</script>"
    candidates = (*result.candidates[:2], replace(result.candidates[2], name=name))
    text = render_tuning(replace(result, candidates=candidates, best=name))
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)" in text


@pytest.mark.parametrize("lost", [("responses", "frequency"), ("trials", "map", "monte_carlo"), TABLES])
def test_without_some_of_the_tables_the_rest_is_shown(
    sample: TuningResult, tmp_path: Path, page: str, lost: tuple[str, ...]
) -> None:
    for path in sample.folder.glob("*.*"):
        if path.stem not in lost and path.suffix != ".html":
            (tmp_path / path.name).write_bytes(path.read_bytes())
    text = write_tuning_report(read_result(tmp_path)).read_text()
    pictures = {"responses": 1, "trials": 2, "frequency": 2, "map": 1, "monte_carlo": 1}
    assert text.count("<svg") == page.count("<svg") - sum(pictures[name] for name in lost)
    assert "All candidates" in text


def test_an_unstable_baseline_is_reported(sample: TuningResult) -> None:
    text = render_tuning(replace(sample, baseline="published"))
    assert "the given gains are unstable; all criteria are met" in text
    assert "is unstable: a pole of the closed loop is in the right half plane." in text


def test_a_study_without_a_feasible_candidate_is_reported(sample: TuningResult) -> None:
    text = render_tuning(replace(sample, best=None, best_rule=None, acceptance=()))
    assert "no candidate meets the constraints, searched is the nearest" in text


@pytest.mark.parametrize(("constant", "missing"), [(["kp", "ms"], ["ki"]), (["ki"], ["iae", "settling_time"])])
def test_constant_or_missing_columns_do_not_break_charts(
    sample: TuningResult, tmp_path: Path, constant: list[str], missing: list[str]
) -> None:
    trials = pd.read_parquet(sample.folder / "trials.parquet")
    trials[constant] = 1.0
    trials[missing] = float("nan")
    trials.to_parquet(tmp_path / "trials.parquet", index=False)
    (tmp_path / "tuning.json").write_bytes((sample.folder / "tuning.json").read_bytes())
    assert "All candidates" in write_tuning_report(read_result(tmp_path)).read_text()


def test_a_schedule_is_shown(sample: TuningResult) -> None:
    rows = tuple(ScheduleRow(v, {"kp": v, "ki": 2.0 * v, "kd": 0.0}) for v in (5.0, 15.0, 25.0))
    tables = _tables(render_tuning(replace(sample, schedule=Schedule(rows))))
    table = next(rows for rows in tables if rows[0][0] == "Speed")
    assert table[2] == ["15.0\u00a0m/s", "15.0", "30.0", "0"]


def test_tests_of_a_schedule_are_shown_with_their_verdicts(sample: TuningResult) -> None:
    rows = tuple(ScheduleRow(v, {"kp": v, "ki": 2.0 * v, "kd": 0.0}) for v in (5.0, 15.0))
    tests = tuple(
        ScheduleTest(v, name, "between" if v == 10.0 else "tuned", {}, "ok", cost, good)
        for v in (5.0, 10.0, 15.0)
        for name, cost, good in (("scheduled", 0.1 * v, True), ("searched", 0.2 * v, v < 12.0))
    )
    tables = _tables(render_tuning(replace(sample, schedule=Schedule(rows, tests))))
    table = next(rows for rows in tables if "Cost, scheduled" in rows[0])
    assert table[2] == ["10.0\u00a0m/s", "between", "1.00", "feasible", "2.00", "feasible"]
    assert table[3][-1] == "breaks a limit"


@pytest.mark.parametrize(
    ("use", "words"), [(0.8, "at most 80\u00a0%"), (1.2, "1 of 20 runs require more longitudinal force")]
)
def test_the_required_grip_and_the_corners_are_reported(
    sample: TuningResult, tmp_path: Path, use: float, words: str
) -> None:
    assert sample.robustness is not None
    assert sample.best is not None
    tried = (CornerTest(Conditions(mass=0.8), "unstable", "oscillates"), CornerTest(Conditions(), "ok"))
    result = replace(sample, robustness=replace(sample.robustness, corners={sample.best: tried}), folder=tmp_path)
    runs = pd.read_parquet(sample.folder / "monte_carlo.parquet")
    runs["grip_use"] = [use if run == 7 else 0.5 for run in runs["run"]]
    runs.to_parquet(tmp_path / "monte_carlo.parquet", index=False)
    text = render_tuning(result)
    assert words in text
    table = next(rows for rows in _tables(text) if rows[0][:2] == ["Candidate", "Failed"])
    assert table[0][3] == "Corners failed (information)"
    assert {row[0]: row[3] for row in table[1:]}[sample.best] == "1 of 2"
    assert 'title="mass × 0.80: oscillates"' in text
    assert (
        "mass 80 to 120\u00a0% of the nominal one; friction 0.3 to 1; whole delay of the actuator 0 to 100\u00a0ms"
        in text
    )


def test_a_damaged_table_gives_one_line(sample: TuningResult, tmp_path: Path) -> None:
    (tmp_path / "tuning.json").write_bytes((sample.folder / "tuning.json").read_bytes())
    (tmp_path / "map.parquet").write_bytes(b"PAR1 nonsense")
    with pytest.raises(ConfigError, match=r"map.parquet: cannot be read: "):
        write_tuning_report(read_result(tmp_path))


def test_the_documentation_defines_every_figure_of_the_report() -> None:
    text = (Path(__file__).resolve().parent.parent / "docs" / "tuning_reference.md").read_text("utf-8")
    for label, _ in FIGURES.values():
        assert f"**{label}**" in text, label


@pytest.mark.parametrize(("tops", "cut"), [((1.0, 9.0), True), ((-2.0, 9.0), False), ((0.0, 9.0), False)])
def test_a_distribution_is_cut_only_where_six_times_the_best_has_a_meaning(tops, cut, monkeypatch):
    limits = []
    monkeypatch.setattr("matplotlib.axes.Axes.set_xlim", lambda _, *values, **__: limits.append(values))
    table = pd.DataFrame({"candidate": ["a", "b"], "status": "ok", "margin": tops})
    shown = [Shown(name, "best", "main") for name in ("a", "b")]
    draw_distribution(table, "margin", "Margin", shown)
    assert ((0.0, 6.0) in limits) is cut


def test_labels_of_the_map_of_gains_do_not_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three candidates in neighbouring cells, in the middle and in a corner of the map."""
    figures: list[Figure] = []
    monkeypatch.setattr("mirdrake.report.tuning_charts.embed", lambda figure, *_: figures.append(figure))
    rows = [(kp, ki, kp + ki, 1.2, True) for kp in range(1, 20) for ki in range(1, 15)]
    table = pd.DataFrame(rows, columns=["kp", "ki", "cost", "ms", "stable"])
    for kp, ki in ((9.0, 8.0), (18.0, 1.0), (1.0, 14.0)):
        roles = (("baseline", "edge"), ("best rule", "own1"), ("nearest", "main"))
        marks = [
            (Shown(role, role, colour), {"kp": kp + 0.3 * place, "ki": ki - 0.1 * place})
            for place, (role, colour) in enumerate(roles)
        ]
        draw_map(table, marks, None)
        figure = figures.pop()
        renderer = FigureCanvasAgg(figure).get_renderer()
        boxes = [text.get_window_extent(renderer) for text in figure.axes[0].texts]
        assert len(boxes) == 3
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
        frame = figure.axes[0].bbox
        assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 for box in boxes)
        assert all(frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in boxes)
