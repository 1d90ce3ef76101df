"""Report of a tuning study: one page that needs no network and no other file."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.core.files import write_file
from mirdrake.report.figures import drawing_style
from mirdrake.report.page import render_page
from mirdrake.report.tuning_axes import Shown
from mirdrake.report.tuning_charts import (
    draw_bode,
    draw_distribution,
    draw_map,
    draw_nyquist,
    draw_responses,
    draw_schedule,
    map_gains,
)
from mirdrake.report.tuning_tables import Tables, labelled
from mirdrake.report.tuning_texts import FIGURES, Texts
from mirdrake.report.tuning_trials import draw_front, draw_parallel
from mirdrake.report.words import title_case
from mirdrake.tuning.result import TuningResult

_TEMPLATE = "tuning.html.jinja"

__all__ = ["FIGURES", "render_tuning", "write_tuning_report"]

_ENOUGH = 10
"""Smallest number of trials on the plant that are shown instead of those on the reduced model."""


def write_tuning_report(result: TuningResult) -> Path:
    """Write tuning.html into the folder of a tuning result.

    Raises:
        ConfigError: a table of the result is damaged.
        RunError: the page cannot be written.
    """
    path = result.folder / "tuning.html"
    write_file(path, render_tuning(result))
    return path


def render_tuning(result: TuningResult) -> str:
    """Return the text of the page; see :func:`write_tuning_report`."""
    texts = Texts(result)
    shown = _shown(texts)
    # Roles such as "winner" and "baseline" name the candidates throughout the page.
    tables = Tables(texts, {entry.name: entry.role for entry in shown})
    with drawing_style():
        charts = _Charts(texts, shown).draw()
    return render_page(
        _TEMPLATE,
        title=f"{title_case(result.name)} · tuning",
        over=" · ".join(part for part in (result.vehicle, f"loop {result.loop.kind}", "tuning report") if part),
        headline=f"{title_case(result.name)}: {texts.headline()}",
        tiles=texts.tiles(),
        acceptance=tables.acceptance(),
        notices=texts.notices(),
        charts=charts,
        legend=[(entry.role, entry.name, f"var(--{entry.colour})", entry.dashed) for entry in shown],
        robustness=tables.robustness(),
        head=tables.head(),
        groups=tables.groups(),
        rows=tables.rows(),
        rejected=tables.rejected(),
        origins=tables.origins(),
        experiments=[texts.experiment(experiment) for experiment in result.experiments],
        schedule=tables.schedule(),
        schedule_tests=tables.schedule_tests(),
        spec=json.dumps(result.spec, indent=2, ensure_ascii=False),
        facts=texts.facts(),
        weights=texts.weights(),
        max_ms=result.constraints.get("ms"),
    )


def _shown(texts: Texts) -> list[Shown]:
    """Return the candidates in the charts; the last one is drawn on top."""
    roles = [
        (texts.baseline, "baseline", "edge", True),
        (texts.best_rule, "best rule", "own1", False),
        (texts.winner, texts.winner_role, "main", False),
    ]
    # One candidate may have several roles; it is drawn once, with the last.
    shown = {
        entry.name: Shown(entry.name, role, colour, dashed)
        for entry, role, colour, dashed in roles
        if entry is not None
    }
    return list(shown.values())


class _Charts:
    """Charts of one result."""

    def __init__(self, texts: Texts, shown: list[Shown]) -> None:
        self.texts, self.shown, self.result = texts, shown, texts.result
        self.max_ms = self.result.constraints.get("ms")

    def draw(self) -> dict[str, Any]:
        """Return the charts by name; without those for which the result has no data."""
        charts: dict[str, Any] = {}
        responses, grid, curves, runs = (
            self.result.table(name) for name in ("responses", "map", "frequency", "monte_carlo")
        )
        by_name, units = self.texts.by_name, (self.texts.y, self.texts.u)
        if responses is not None and len(responses):
            # Stable candidates except for the baseline set the frame.
            stable = [entry.name for entry in self.shown if by_name[entry.name].status == "ok"]
            framing = [name for name in stable if name != self.result.baseline] or stable
            charts["responses"] = draw_responses(responses, self.shown, units, tuple(framing))
        if grid is not None and len(grid):
            # The map of gains shows where the constraint on Ms ends, so that the distance to it is seen.
            marks = [(entry, by_name[entry.name].gains) for entry in self.shown]
            charts["map"] = draw_map(grid, marks, self.max_ms)
            charts["map_gains"] = map_gains(grid)
        charts |= self._trial_charts()
        # Frequency responses exist for candidates with a linear model only.
        if curves is not None and len(curves):
            known = [entry for entry in self.shown if (curves["candidate"] == entry.name).any()]
            figures = by_name[known[-1].name].figures if known else {}
            charts["bode"] = draw_bode(curves, known)
            charts["nyquist"] = draw_nyquist(curves, known, float(self.max_ms or 1.6), figures)
        name = next((name for name in (*self.result.cost, "iae") if runs is not None and name in runs), None)
        if runs is not None and name is not None and len(runs):
            label, unit = self.texts.figure(name)
            charts["distribution"] = draw_distribution(runs, name, f"{label} [{unit or '1'}]", self.shown)
        if self.result.schedule is not None and self.result.schedule.rows:
            charts["schedule"] = draw_schedule(self.result.schedule.rows, list(self.result.loop.gains))
        return charts

    def _trial_charts(self) -> dict[str, Any]:
        """Return the charts of the trials: front and parallel coordinates."""
        trials = self.result.table("trials")
        if trials is None or "feasible" not in trials or "cost" not in trials:
            return {}

        # Trials on the plant, if there are enough of them.
        trials = trials[trials["status"] == "ok"] if "status" in trials else trials
        where = "trials"
        if "fidelity" in trials:
            on_plant = trials["fidelity"] == "plant"
            enough = int(on_plant.sum()) >= _ENOUGH
            trials = trials[on_plant if enough else ~on_plant]
            where = "trials on the plant" if enough else "trials on the reduced model; circles: confirmed on the plant"

        # The figure of the cost over another one.
        first = next((name for name in (*self.result.cost, "iae") if name in trials), None)
        second = next(
            (name for name in ("ms", "overshoot_percent", "total_variation") if name in trials and name != first), None
        )
        if first is None or second is None or len(trials) < 2:
            return {}
        # The other figures of the axes are those of robustness, overshoot or effort, which trade against the cost.
        labels = [labelled(*self.texts.figure(name)) for name in (second, first)]
        columns = self._columns(trials, first, second)
        gains = self.result.loop.gains
        pairs = [(name, name if name in gains else self.texts.figure(name)[0]) for name in columns]
        return {
            "front": draw_front(trials, (second, labels[0]), (first, labels[1]), self._marks(second, first)),
            "front_of": (self.texts.figure(first)[0], self.texts.figure(second)[0]),
            "parallel": draw_parallel(trials, pairs, [name in gains for name in columns]),
            "trials": f"{len(trials)} {where}",
        }

    def _marks(self, x: str, y: str) -> list[tuple[Shown, tuple[float, float]]]:
        """Return the shown candidates that have both figures."""
        marks = []
        for entry in self.shown:
            figures = self.texts.by_name[entry.name].figures
            if x in figures and y in figures:
                marks.append((entry, (figures[x], figures[y])))
        return marks

    def _columns(self, trials: pd.DataFrame, first: str, second: str) -> list[str]:
        """Return the columns of the parallel coordinates: gains that vary and figures that most trials have."""
        gains = [name for name in self.result.loop.gains if name in trials and trials[name].nunique() > 1]
        others = [name for name in (first, second, "overshoot_percent", "settling_time") if name in trials]
        columns = list(dict.fromkeys([*gains, *others]))
        usable = [name for name in columns if pd.api.types.is_numeric_dtype(trials[name])]
        return [name for name in usable if trials[name].notna().mean() > 0.5][:6]
