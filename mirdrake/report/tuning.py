"""The report of a tuning study: one page which needs no network and no other file."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.core.files import write_file
from mirdrake.report.figures import drawing_style
from mirdrake.report.page import render_page
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
from mirdrake.report.tuning_trials import draw_front, draw_parallel
from mirdrake.report.tuning_words import FIGURES, Words
from mirdrake.report.words import title_case
from mirdrake.tuning.result_folder import TuningResult, read_result

_TEMPLATE = "tuning.html.jinja"

__all__ = ["FIGURES", "render_tuning", "write_tuning_report"]

_ENOUGH = 10
"""Trials on the plant from which on they are shown instead of those on the reduced model."""


def write_tuning_report(folder: Path | str) -> Path:
    """Write tuning.html into the folder of a tuning result.

    Raises:
        ConfigError: the folder holds no result, or a damaged one.
        RunError: the page cannot be written.
    """
    result = read_result(folder)
    path = result.folder / "tuning.html"
    write_file(path, render_tuning(result))
    return path


def render_tuning(result: TuningResult) -> str:
    """The text of the page; see :func:`write_tuning_report`."""
    words = Words(result)
    tables = Tables(words)
    with drawing_style():
        charts = _Charts(words).draw()
    data = result.data
    return render_page(
        _TEMPLATE,
        title=f"{title_case(result.name)} · tuning",
        over=" · ".join(
            str(part) for part in (data.get("vehicle"), f"loop {result.loop.get('name', '')}", "tuning report") if part
        ),
        headline=f"{title_case(result.name)}: {words.headline()}",
        tiles=words.tiles(),
        acceptance=tables.acceptance(),
        notices=words.notices(),
        charts=charts,
        legend=[(one.role, one.name, f"var(--{one.colour})", one.dashed) for one in words.shown],
        robustness=tables.robustness(),
        head=tables.head(),
        rows=tables.rows(),
        hows=tables.hows(),
        models=tables.models(),
        schedule=tables.schedule(),
        schedule_check=tables.schedule_check(),
        spec=json.dumps(data.get("spec", {}), indent=2, ensure_ascii=False),
        facts=words.facts(),
        weights=words.weights(),
        max_ms=words.max_ms,
        units=(words.y, words.u),
    )


class _Charts:
    """The pictures of one result."""

    def __init__(self, words: Words) -> None:
        self.words, self.data, self.result = words, words.data, words.result

    def draw(self) -> dict[str, Any]:
        """Pictures by name; what the result has no data for is left out."""
        table, words = self.result.table, self.words
        found: dict[str, Any] = {}
        responses = table("responses")
        if responses is not None and len(responses):
            steady = [one.name for one in words.shown if words.by_name[one.name].get("status", "ok") == "ok"]
            framing = [name for name in steady if name != words.baseline.get("name")] or steady
            found["responses"] = draw_responses(responses, words.shown, (words.y, words.u), tuple(framing))
        grid = table("map")
        if grid is not None and len(grid):
            found["map"] = draw_map(
                grid, [(one, words.by_name[one.name]["gains"]) for one in words.shown], words.max_ms
            )
            found["map_gains"] = map_gains(grid)
        found |= self._trial_charts()
        curves = table("frequency")
        if curves is not None and len(curves):
            known = [one for one in self.words.shown if (curves["candidate"] == one.name).any()]
            ms = float(self.words.max_ms or 1.6)
            margins = (self.words.by_name[known[-1].name].get("margins") or {}) if known else {}
            found["bode"] = draw_bode(curves, known)
            found["nyquist"] = draw_nyquist(curves, known, ms, margins)
        runs = table("monte_carlo")
        name = next((name for name in (*self.words.cost, "iae") if runs is not None and name in runs), None)
        if runs is not None and name is not None and len(runs):
            label, unit = self.words.figure(name)
            found["distribution"] = draw_distribution(runs, name, f"{label} [{unit or '1'}]", self.words.shown)
        if self.data.get("schedule"):
            found["schedule"] = draw_schedule(self.data["schedule"], self.result.loop["gains"])
        return found

    def _trial_charts(self) -> dict[str, Any]:
        trials = self.result.table("trials")
        if trials is None or "feasible" not in trials or "cost" not in trials:
            return {}
        trials = trials[trials["status"] == "ok"] if "status" in trials else trials
        where = "trials"
        if "fidelity" in trials:
            on_plant = trials["fidelity"] == "plant"
            enough = int(on_plant.sum()) >= _ENOUGH
            trials = trials[on_plant if enough else ~on_plant]
            where = "trials on the plant" if enough else "trials on the reduced model; circles: confirmed on the plant"
        first = next((name for name in (*self.words.cost, "iae") if name in trials), None)
        second = next(
            (name for name in ("ms", "overshoot_percent", "total_variation") if name in trials and name != first), None
        )
        if first is None or second is None or len(trials) < 2:
            return {}
        marks = []
        for one in self.words.shown:
            figures = self.words.by_name[one.name].get("figures") or {}
            across, up = figures.get(second), figures.get(first)
            if isinstance(across, int | float) and isinstance(up, int | float):
                marks.append((one, (float(across), float(up))))
        labels = [labelled(*self.words.figure(name)) for name in (second, first)]
        gains = [name for name in self.result.loop["gains"] if name in trials and trials[name].nunique() > 1]
        others = [name for name in (first, second, "overshoot_percent", "settling_time") if name in trials]
        columns = list(dict.fromkeys([*gains, *others]))
        usable = [name for name in columns if pd.api.types.is_numeric_dtype(trials[name])]
        usable = [name for name in usable if trials[name].notna().mean() > 0.5]
        pairs = [(name, name if name in gains else self.words.figure(name)[0]) for name in usable]
        pairs = pairs[:6]
        return {
            "front": draw_front(trials, (second, labels[0]), (first, labels[1]), marks),
            "front_of": (self.words.figure(first)[0], self.words.figure(second)[0]),
            "parallel": draw_parallel(trials, pairs, [name in gains for name in usable[:6]]),
            "trials": f"{len(trials)} {where}",
        }
