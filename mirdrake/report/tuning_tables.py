"""The tables of the report of a tuning study: criteria, candidates, models, Monte Carlo, gains over speed."""

import math
from collections.abc import Mapping
from typing import Any

from mirdrake.report.tuning_words import FIGURES, Words
from mirdrake.report.words import format_quantity, title_case

_KINDS = {
    "baseline": "baseline",
    "rule": "rule",
    "shaped": "loop shaping",
    "searched": "search",
    "scheduled": "over speed",
}


_SHAKEN = ("iae", "overshoot_percent", "settling_time", "ms", "phase_margin_deg", "saturation_time")
"""Figures of the Monte Carlo that are shown."""


class Tables:
    """The tables of one result.

    Args:
        words: of the same result.
    """

    def __init__(self, words: Words) -> None:
        self.words, self.data, self.result = words, words.data, words.result

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
        return labelled(*self.words.figure(what)).removesuffix(" [1]") if what in FIGURES else what

    def head(self) -> list[tuple[str, str]]:
        """Label and unit of the columns of numbers in the table of candidates."""
        gains = self.result.loop["gains"]
        columns = [(name, str(gains[name].get("unit") or "")) for name in gains]
        return [*columns, ("Cost", ""), *(self.words.figure(name) for name in self._names())]

    def _names(self) -> list[str]:
        """Figures that any candidate has, in the order of :data:`FIGURES`."""
        has = dict.fromkeys(name for one in self.words.candidates for name in one["figures"])
        return [name for name in FIGURES if name in has] + [name for name in has if name not in FIGURES]

    def rows(self) -> list[dict[str, Any]]:
        """Candidates with all figures."""
        found = []
        roles = {one.name: one.role for one in self.words.shown}
        for one in self.words.candidates:
            figures = one["figures"]
            numbers = [one["gains"].get(name) for name in self.result.loop["gains"]]
            numbers += [one.get("cost"), *(figures.get(name) for name in self._names())]
            word = _verdict(one)
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
            for one in self.words.candidates
        ]

    def models(self) -> list[tuple[str, str, str, str]]:
        """Name, kind, parameters, and how well it fits."""
        found = []
        for one in self.data.get("models") or []:
            parameters = "; ".join(
                f"{title_case(name).lower()} {format_quantity(float(value[0]), self.unit_told(str(value[1] or '')))}"
                if isinstance(value, list | tuple) and isinstance(value[0], int | float)
                else f"{title_case(name).lower()} {value}"
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
            "y/u": f"{self.words.y} per {self.words.u}",
            "u/y": f"{self.words.u} per {self.words.y}",
            "y/(u s)": f"{self.words.y} per {self.words.u} and s",
        }
        return "" if unit == "1" else general.get(unit, unit)

    def robustness(self) -> dict[str, Any] | None:
        """The table of the Monte Carlo."""
        spreads = self.words.spreads()
        if not spreads:
            return None
        runs = self.data["robustness"]["runs"]
        names = list(dict.fromkeys(name for one in spreads.values() for name in one.get("figures") or {}))
        order = [name for name in FIGURES if name in names]
        chosen = [name for name in order if name in {*_SHAKEN, *self.words.cost}]
        rows = []
        for name, one in spreads.items():
            rate = f"{one['failures']} of {runs}"
            interval = f"{100.0 * one['low']:.1f} to {100.0 * one['high']:.1f} %"
            cells = [
                tuple(_number((one["figures"].get(figure) or {}).get(key)) for key in ("median", "p95", "worst"))
                for figure in chosen
            ]
            rows.append((name, rate, interval, bool(one["failures"]), self._corners(name), cells))
        ranges = self.data["robustness"].get("ranges") or {}
        return {
            "runs": runs,
            "ranges": "; ".join(f"{title_case(name).lower()} {_range(value)}" for name, value in ranges.items()),
            "figures": [self.words.figure(name) for name in chosen],
            "rows": rows,
            "corners": any(row[4] is not None for row in rows),
            "grip": self._grip(),
        }

    def _corners(self, name: str) -> tuple[str, str] | None:
        """How many corners of the ranges a candidate does not stand, and which; None where they were not tried."""
        tried = (self.data["robustness"].get("corners") or {}).get(name)
        if not tried:
            return None
        lost = [f"{one['conditions']}: {one['reason']}" for one in tried if one["status"] != "ok"]
        return f"{len(lost)} of {len(tried)}", "; ".join(lost)

    def _grip(self) -> str:
        """What the runs ask of the tyres, over what they can give; empty where nobody knows."""
        table = self.result.table("monte_carlo")
        if table is None or "grip_use" not in table:
            return ""
        use = table.drop_duplicates("run")["grip_use"]
        beyond = int((use > 1.0).sum())
        if beyond:
            return (
                f"In {beyond} of {len(use)} runs the trial asks the driven tyres for more than they can give on that "
                "grade and friction: there the figures tell of the car, not of the gains."
            )
        return (
            f"No run asks the driven tyres for more than they can give (at most {use.max():.0%}): wheels that lose "
            "their grip and spin are the doing of the loop."
        )

    def schedule(self) -> list[tuple[str, list[str]]]:
        """Speed and gains."""
        gains = self.result.loop["gains"]
        return [
            (format_quantity(float(row["speed"]), "m/s"), [_number(row["gains"].get(name)) for name in gains])
            for row in self.data.get("schedule") or []
        ]

    def schedule_check(self) -> list[tuple[str, str, list[tuple[str, str, str]]]]:
        """Speed, whether it is one of the table's, and name, cost and verdict of what was tried there."""
        rows: dict[float, list[dict[str, Any]]] = {}
        for one in self.data.get("schedule_check") or []:
            rows.setdefault(float(one["speed"]), []).append(one)
        return [
            (
                format_quantity(speed, "m/s"),
                str(tried[0]["where"]),
                [(str(one["gains"]), _number(one["cost"]), _verdict(one)) for one in tried],
            )
            for speed, tried in rows.items()
        ]


def _verdict(one: Mapping[str, Any]) -> str:
    status = str(one.get("status", "ok"))
    return status if status != "ok" else "feasible" if one.get("feasible") else "breaks a bound"


def labelled(label: str, unit: str) -> str:
    """A figure with its unit in brackets."""
    return f"{label} [{unit or '1'}]"


def _number(value: Any) -> str:
    if isinstance(value, str):
        return value
    if value is None or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    return format_quantity(float(value)) if not isinstance(value, bool) else str(value).lower()


def _sortable(value: Any) -> str:
    return repr(float(value)) if isinstance(value, int | float) and math.isfinite(value) else "inf"


def _range(value: Any) -> str:
    if isinstance(value, Mapping):
        value = [value[key] for key in ("low", "high") if key in value] or list(value.values())
    if isinstance(value, list | tuple) and len(value) == 2:
        return f"{_number(value[0])} to {_number(value[1])}"
    return _number(value)
