"""The report of a tuning study: one page which needs no network and no other file."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.logs import write_file
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
from mirdrake.report.tuning_trials import draw_front, draw_parallel
from mirdrake.report.words import clock, spoken, tell
from mirdrake.tuning.result_folder import TuningResult, read_result

_TEMPLATE = "tuning.html.jinja"

FIGURES: dict[str, tuple[str, str]] = {
    "iae": ("IAE", "{ys}"),
    "itae": ("ITAE", "{yss}"),
    "ise": ("ISE", "({y})² s"),
    "overshoot_percent": ("Overshoot", "%"),
    "rise_time": ("Rise time", "s"),
    "settling_time": ("Settling time", "s"),
    "steady_error": ("Steady error", "{y}"),
    "peak_effort": ("Peak effort", "{u}"),
    "rms_effort": ("RMS effort", "{u}"),
    "total_variation": ("Total variation", "{u}"),
    "saturation_time": ("Saturation", "s"),
    "rms_jerk": ("RMS jerk", "{y_ss}"),
    "peak_jerk": ("Peak jerk", "{y_ss}"),
    "ms": ("Ms", ""),
    "mt": ("Mt", ""),
    "gain_margin": ("Gain margin", "×"),
    "phase_margin_deg": ("Phase margin", "°"),
    "delay_margin_s": ("Delay margin", "s"),
    "disk_margin": ("Disk margin", ""),
}
"""Label and unit of each figure; y and u are the units of output and effort."""

_ENOUGH = 20
"""Trials on the plant from which on they are shown instead of those on the reduced model."""

_KINDS = {
    "baseline": "baseline",
    "rule": "rule",
    "shaped": "loop shaping",
    "searched": "search",
    "scheduled": "over speed",
}


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
    page = _Page(result)
    with drawing_style():
        charts = page.charts()
    data = result.data
    return render_page(
        _TEMPLATE,
        name=spoken(result.name),
        over=" · ".join(
            str(part) for part in (data.get("vehicle"), f"loop {result.loop.get('name', '')}", "tuning report") if part
        ),
        headline=page.headline(),
        tiles=page.tiles(),
        acceptance=page.acceptance(),
        notices=page.notices(),
        charts=charts,
        legend=[(one.role, one.name, f"var(--{one.colour})", one.dashed) for one in page.shown],
        robustness=page.robustness(),
        head=page.head(),
        rows=page.rows(),
        hows=page.hows(),
        models=page.models(),
        schedule=page.schedule(),
        spec=json.dumps(data.get("spec", {}), indent=2, ensure_ascii=False),
        facts=page.facts(),
        weights=page.weights(),
        max_ms=page.max_ms,
        units=(page.y, page.u),
    )


class _Page:
    """What the page says of one result."""

    def __init__(self, result: TuningResult) -> None:
        self.result, self.data = result, result.data
        self.y = str(result.loop.get("output_unit") or "1")
        self.u = str(result.loop.get("effort_unit") or "1")
        self.candidates = [_merged(one) for one in result.candidates]
        self.by_name = {one["name"]: one for one in self.candidates}
        self.baseline = self.by_name.get(self.data.get("baseline"), {})
        self.best = self.by_name.get(self.data.get("best"), {})
        self.best_rule = self.by_name.get(self.data.get("best_rule"), {})
        self.spec: Mapping[str, Any] = self.data.get("spec") or {}
        self.cost: Mapping[str, float] = self.spec.get("cost") or {}
        limits = self.spec.get("constraints") or {}
        self.max_ms = limits.get("ms") if isinstance(limits, Mapping) else None
        self.winner = self.best or self._nearest()
        roles = [
            (self.baseline, "baseline", "edge", True),
            (self.best_rule, "best rule", "own1", False),
            (self.winner, "best" if self.best else "nearest", "main", False),
        ]
        shown = {one["name"]: Shown(one["name"], role, colour, dashed) for one, role, colour, dashed in roles if one}
        self.shown = list(shown.values())

    def _nearest(self) -> dict[str, Any]:
        """What to show where no candidate meets the constraints: what was shaken last, else what costs least."""
        known = {self.data.get("baseline"), self.data.get("best_rule")}
        shaken = [self.by_name[name] for name in self.spreads() if name in self.by_name and name not in known]
        tried = [one for one in self.candidates if one["name"] not in known and one.get("cost") is not None]
        tried = [one for one in tried if one.get("kind") != "baseline" and one.get("status", "ok") == "ok"]
        return shaken[-1] if shaken else min(tried, key=lambda one: float(one["cost"]), default={})

    # --- words ---

    def figure(self, name: str) -> tuple[str, str]:
        """Label and unit of a figure."""
        label, unit = FIGURES.get(name, (spoken(name), ""))
        per_second = self.y.removesuffix("/s") if self.y.endswith("/s") else ""
        integrals = (per_second, f"{per_second} s") if per_second else (f"{self.y} s", f"{self.y} s²")
        second = f"{per_second}/s³" if per_second else f"{self.y}/s²"
        return label, unit.format(y=self.y, u=self.u, ys=integrals[0], yss=integrals[1], y_ss=second)

    def told(self, name: str, value: Any) -> str:
        """A figure with its unit; a margin that is not finite is none at all."""
        if value is None or not isinstance(value, int | float) or not math.isfinite(value):
            return "none" if name in {"gain_margin", "delay_margin_s", "phase_margin_deg"} and value is None else "–"
        return tell(float(value), self.figure(name)[1])

    def headline(self) -> str:
        """The verdict in a sentence."""
        if not self.best:
            nearest = f"; {self.winner['name']} comes nearest" if self.winner else ""
            return f"no candidate meets the constraints{nearest}"
        met = [bool(one.get("met")) for one in self.data.get("acceptance") or []]
        verdict = f"{sum(met)} of {len(met)} criteria are met" if met else "no criteria were set"
        if met and all(met):
            verdict = "every criterion is met"
        name = next(iter(self.cost), "iae")
        label, _ = self.figure(name)
        after = self.best["figures"].get(name)
        before = (self.baseline.get("figures") or {}).get(name)
        if self.baseline.get("status", "ok") != "ok":
            state = self.baseline.get("status")
            return f"{verdict}; the baseline is {state}, the best has {label} {self.told(name, after)}"
        if before and after is not None and self.baseline is not self.best:
            change = 100.0 * (after / before - 1.0)
            direction = "less" if change < 0.0 else "more"
            return f"{verdict}; {abs(change):.0f} % {direction} {label} than the baseline"
        return verdict

    def tiles(self) -> list[tuple[str, str, str]]:
        """Label, value and note of each."""
        if not self.winner:
            return []
        best, figures = self.winner, self.winner["figures"]
        base, rule = self.baseline.get("figures") or {}, self.best_rule.get("figures") or {}
        gains = self.result.loop["gains"]
        tiles = [
            (name, tell(value), str(gains.get(name, {}).get("unit") or ""))
            for name, value in best["gains"].items()
            if value
        ][:4]
        for name in ("iae", "overshoot_percent", "settling_time", "ms", "phase_margin_deg", "delay_margin_s"):
            if name in figures:
                notes = [f"baseline {self.told(name, base[name])}"] if name in base else []
                notes += [f"best rule {self.told(name, rule[name])}"] if name in rule and rule is not figures else []
                tiles.append((self.figure(name)[0], self.told(name, figures[name]), ", ".join(notes)))
        spread = self.spreads().get(best["name"])
        if spread:
            runs = self.data["robustness"]["runs"]
            note = f"95 % interval {100.0 * spread['low']:.1f} to {100.0 * spread['high']:.1f} %"
            tiles.append(("Failures", f"{spread['failures']} of {runs}", note))
        return tiles[: len(tiles) // 4 * 4 or len(tiles)]

    def notices(self) -> list[str]:
        """What the reader must know before the figures."""
        found = [str(note) for note in self.data.get("notes") or []]
        if self.baseline.get("status", "ok") != "ok":
            reason = self.baseline.get("reason") or "no reason given"
            found.append(f"The baseline '{self.baseline['name']}' is {self.baseline['status']}: {reason}.")
        if self.best and self.best.get("kind") == "baseline":
            found.append("No candidate is better than the baseline.")
        spread = self.spreads().get(self.winner.get("name", ""))
        if spread and spread["failures"]:
            found.append(f"'{self.winner['name']}' fails in {spread['failures']} runs of the Monte Carlo.")
        return found

    def weights(self) -> str:
        """The cost and the constraints in words."""
        cost = " + ".join(
            f"{'' if weight == 1 else f'{weight:g} × '}{self.figure(name)[0]}" for name, weight in self.cost.items()
        )
        limits = self.spec.get("constraints") or {}
        least = {"gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin"}
        bounds = [
            f"{self.figure(name)[0]} {'≥' if name in least else '≤'} {self.told(name, limit)}"
            for name, limit in limits.items()
        ]
        return f"Cost: {cost or 'not given'}." + (f" Constraints: {', '.join(bounds)}." if bounds else "")

    def facts(self) -> list[str]:
        """The last lines."""
        data = self.data
        versions = ", ".join(f"{name} {number}" for name, number in (data.get("versions") or {}).items())
        return [
            text
            for text in (
                f"seed {data['seed']}" if data.get("seed") is not None else "",
                f"SHA-256 of the study {str(data.get('spec_sha256'))[:16]}" if data.get("spec_sha256") else "",
                f"took {clock(float(data['wall_s']))}" if data.get("wall_s") is not None else "",
                versions,
            )
            if text
        ]

    # --- tables ---

    def acceptance(self) -> list[tuple[str, str, str, bool]]:
        """What, value, limit, met."""
        return [
            (
                self._criterion(str(one["what"])),
                _number(one.get("value")),
                _number(one.get("limit")),
                bool(one.get("met")),
            )
            for one in self.data.get("acceptance") or []
        ]

    def _criterion(self, what: str) -> str:
        """A criterion that is a figure by its label."""
        return _labelled(*self.figure(what)).removesuffix(" [1]") if what in FIGURES else what

    def head(self) -> list[tuple[str, str]]:
        """Label and unit of the columns of numbers in the table of candidates."""
        gains = self.result.loop["gains"]
        columns = [(name, str(gains[name].get("unit") or "")) for name in gains]
        return [*columns, ("Cost", ""), *(self.figure(name) for name in self._names())]

    def _names(self) -> list[str]:
        """Figures that any candidate has, in the order of :data:`FIGURES`."""
        has = dict.fromkeys(name for one in self.candidates for name in one["figures"])
        return [name for name in FIGURES if name in has] + [name for name in has if name not in FIGURES]

    def rows(self) -> list[dict[str, Any]]:
        """Candidates with all figures."""
        found = []
        roles = {one.name: one.role for one in self.shown}
        for one in self.candidates:
            figures = one["figures"]
            numbers = [one["gains"].get(name) for name in self.result.loop["gains"]]
            numbers += [one.get("cost"), *(figures.get(name) for name in self._names())]
            status = str(one.get("status", "ok"))
            word = status if status != "ok" else "feasible" if one.get("feasible") else "breaks a bound"
            found.append(
                {
                    "name": one["name"],
                    "kind": _KINDS.get(str(one.get("kind")), str(one.get("kind"))),
                    "role": roles.get(one["name"], ""),
                    "word": word,
                    "tone": {"feasible": "good", "breaks a bound": "plain"}.get(word, "bad"),
                    "numbers": [(_number(value), _sortable(value)) for value in numbers],
                    "reason": str(one.get("reason") or ""),
                }
            )
        return found

    def hows(self) -> list[tuple[str, str, str]]:
        """Name, way and sentence of each candidate."""
        return [
            (one["name"], _KINDS.get(str(one.get("kind")), str(one.get("kind"))), str(one.get("how") or ""))
            for one in self.candidates
        ]

    def models(self) -> list[tuple[str, str, str, str]]:
        """Name, kind, parameters, and how well it fits."""
        found = []
        for one in self.data.get("models") or []:
            parameters = "; ".join(
                f"{spoken(name).lower()} {tell(float(value[0]), self.unit_told(str(value[1] or '')))}"
                if isinstance(value, list | tuple) and isinstance(value[0], int | float)
                else f"{spoken(name).lower()} {value}"
                for name, value in (one.get("parameters") or {}).items()
            )
            fit = one.get("fit_percent")
            notes = [f"fit {fit:.1f} %"] if isinstance(fit, int | float) else []
            notes += [str(one["note"])] if one.get("note") else []
            found.append((str(one.get("name", "")), str(one.get("kind", "")), parameters, "; ".join(notes)))
        return found

    def unit_told(self, unit: str) -> str:
        """A unit with y and u of a general loop as those of this one."""
        general = {
            "y/u": f"{self.y} per {self.u}",
            "u/y": f"{self.u} per {self.y}",
            "y/(u s)": f"{self.y} per {self.u} and s",
        }
        return "" if unit == "1" else general.get(unit, unit)

    def spreads(self) -> dict[str, dict[str, Any]]:
        """Results of the Monte Carlo by candidate."""
        found: dict[str, dict[str, Any]] = (self.data.get("robustness") or {}).get("candidates") or {}
        return found

    def robustness(self) -> dict[str, Any] | None:
        """The table of the Monte Carlo."""
        spreads = self.spreads()
        if not spreads:
            return None
        runs = self.data["robustness"]["runs"]
        names = list(dict.fromkeys(name for one in spreads.values() for name in one.get("figures") or {}))
        order = [name for name in FIGURES if name in names]
        chosen = [
            name
            for name in order
            if name
            in {"iae", "overshoot_percent", "settling_time", "ms", "phase_margin_deg", "saturation_time", *self.cost}
        ]
        rows = []
        for name, one in spreads.items():
            rate = f"{one['failures']} of {runs}"
            interval = f"{100.0 * one['low']:.1f} to {100.0 * one['high']:.1f} %"
            cells = [
                tuple(_number((one["figures"].get(figure) or {}).get(key)) for key in ("median", "p95", "worst"))
                for figure in chosen
            ]
            rows.append((name, rate, interval, bool(one["failures"]), cells))
        ranges = self.data["robustness"].get("ranges") or {}
        return {
            "runs": runs,
            "ranges": "; ".join(f"{spoken(name).lower()} {_range(value)}" for name, value in ranges.items()),
            "figures": [self.figure(name) for name in chosen],
            "rows": rows,
        }

    def schedule(self) -> list[tuple[str, list[str]]]:
        """Speed and gains."""
        gains = self.result.loop["gains"]
        return [
            (tell(float(row["speed"]), "m/s"), [_number(row["gains"].get(name)) for name in gains])
            for row in self.data.get("schedule") or []
        ]

    # --- charts ---

    def charts(self) -> dict[str, Any]:
        """Pictures by name; what the result has no data for is left out."""
        table = self.result.table
        found: dict[str, Any] = {}
        responses = table("responses")
        if responses is not None and len(responses):
            steady = [one.name for one in self.shown if self.by_name[one.name].get("status", "ok") == "ok"]
            framing = [name for name in steady if name != self.baseline.get("name")] or steady
            found["responses"] = draw_responses(responses, self.shown, (self.y, self.u), tuple(framing))
        grid = table("map")
        if grid is not None and len(grid):
            found["map"] = draw_map(grid, [(one, self.by_name[one.name]["gains"]) for one in self.shown], self.max_ms)
            found["map_gains"] = map_gains(grid)
        found |= self._trial_charts()
        curves = table("frequency")
        if curves is not None and len(curves):
            known = [one for one in self.shown if (curves["candidate"] == one.name).any()]
            ms = float(self.max_ms or 1.6)
            margins = (self.by_name[known[-1].name].get("margins") or {}) if known else {}
            found["bode"] = draw_bode(curves, known)
            found["nyquist"] = draw_nyquist(curves, known, ms, margins)
        runs = table("monte_carlo")
        name = next((name for name in (*self.cost, "iae") if runs is not None and name in runs), None)
        if runs is not None and name is not None and len(runs):
            label, unit = self.figure(name)
            found["distribution"] = draw_distribution(runs, name, f"{label} [{unit or '1'}]", self.shown)
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
        first = next((name for name in (*self.cost, "iae") if name in trials), None)
        second = next(
            (name for name in ("ms", "overshoot_percent", "total_variation") if name in trials and name != first), None
        )
        if first is None or second is None or len(trials) < 2:
            return {}
        marks = []
        for one in self.shown:
            figures = self.by_name[one.name].get("figures") or {}
            across, up = figures.get(second), figures.get(first)
            if isinstance(across, int | float) and isinstance(up, int | float):
                marks.append((one, (float(across), float(up))))
        labels = [_labelled(*self.figure(name)) for name in (second, first)]
        gains = [name for name in self.result.loop["gains"] if name in trials and trials[name].nunique() > 1]
        others = [name for name in (first, second, "overshoot_percent", "settling_time") if name in trials]
        columns = list(dict.fromkeys([*gains, *others]))
        usable = [name for name in columns if pd.api.types.is_numeric_dtype(trials[name])]
        usable = [name for name in usable if trials[name].notna().mean() > 0.5]
        pairs = [(name, name if name in gains else self.figure(name)[0]) for name in usable]
        pairs = pairs[:6]
        return {
            "front": draw_front(trials, (second, labels[0]), (first, labels[1]), marks),
            "front_of": (self.figure(first)[0], self.figure(second)[0]),
            "parallel": draw_parallel(trials, pairs, [name in gains for name in usable[:6]]),
            "trials": f"{len(trials)} {where}",
        }


def _merged(one: Mapping[str, Any]) -> dict[str, Any]:
    """A candidate with its margins among its figures."""
    margins = {name: value for name, value in (one.get("margins") or {}).items() if value is not None}
    return {**one, "figures": {**(one.get("figures") or {}), **margins}}


def _labelled(label: str, unit: str) -> str:
    return f"{label} [{unit or '1'}]"


def _number(value: Any) -> str:
    if isinstance(value, str):
        return value
    if value is None or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    return tell(float(value)) if not isinstance(value, bool) else str(value).lower()


def _sortable(value: Any) -> str:
    return repr(float(value)) if isinstance(value, int | float) and math.isfinite(value) else "inf"


def _range(value: Any) -> str:
    if isinstance(value, Mapping):
        value = [value[key] for key in ("low", "high") if key in value] or list(value.values())
    if isinstance(value, list | tuple) and len(value) == 2:
        return f"{_number(value[0])} to {_number(value[1])}"
    return _number(value)
