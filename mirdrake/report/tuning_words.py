"""What the report of a tuning study says in words: the verdict, tiles, notices, and figures with their units."""

import math
from collections.abc import Mapping
from typing import Any

from mirdrake.report.tuning_axes import Shown
from mirdrake.report.words import format_quantity, format_time, title_case
from mirdrake.tuning.result_folder import TuningResult

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


class Words:
    """What the page says of one result, in sentences and single figures."""

    def __init__(self, result: TuningResult) -> None:
        self.result, self.data = result, result.data
        self.y = str(result.loop.get("output_unit") or "1")
        self.u = str(result.loop.get("effort_unit") or "1")
        self.candidates = [merged(one) for one in result.candidates]
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

    def spreads(self) -> dict[str, dict[str, Any]]:
        """Results of the Monte Carlo by candidate."""
        found: dict[str, dict[str, Any]] = (self.data.get("robustness") or {}).get("candidates") or {}
        return found

    def figure(self, name: str) -> tuple[str, str]:
        """Label and unit of a figure."""
        label, unit = FIGURES.get(name, (title_case(name), ""))
        per_second = self.y.removesuffix("/s") if self.y.endswith("/s") else ""
        integrals = (per_second, f"{per_second} s") if per_second else (f"{self.y} s", f"{self.y} s²")
        second = f"{per_second}/s³" if per_second else f"{self.y}/s²"
        return label, unit.format(y=self.y, u=self.u, ys=integrals[0], yss=integrals[1], y_ss=second)

    def told(self, name: str, value: Any) -> str:
        """A figure with its unit; a margin that is not finite is none at all."""
        if value is None or not isinstance(value, int | float) or not math.isfinite(value):
            return "none" if name in {"gain_margin", "delay_margin_s", "phase_margin_deg"} and value is None else "–"
        return format_quantity(float(value), self.figure(name)[1])

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
            (name, format_quantity(value), str(gains.get(name, {}).get("unit") or ""))
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
                f"took {format_time(float(data['wall_s']))}" if data.get("wall_s") is not None else "",
                versions,
            )
            if text
        ]


def merged(one: Mapping[str, Any]) -> dict[str, Any]:
    """A candidate with its margins among its figures."""
    margins = {name: value for name, value in (one.get("margins") or {}).items() if value is not None}
    return {**one, "figures": {**(one.get("figures") or {}), **margins}}
