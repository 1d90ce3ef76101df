"""Results of a set of manoeuvres as text, results.json and metrics.csv."""

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mirdrake.core.files import write_file
from mirdrake.core.wording import plural
from mirdrake.manoeuvres.base import STATUS, Outcome, SettingRecord
from mirdrake.manoeuvres.facts import Facts

RESULTS, METRICS = "results.json", "metrics.csv"


@dataclass(frozen=True)
class HandlingResults:
    """Outcomes of one vehicle.

    Attributes:
        facts: facts of the vehicle.
        model: "full" or "single_track".
        plant: settings of the plant.
        friction: friction of the road [1].
        outcomes: one per manoeuvre, in the order of driving.
        folder: folder of all files; None writes nothing.
    """

    facts: Facts
    model: str
    plant: Mapping[str, Any]
    friction: float
    outcomes: Sequence[Outcome]
    folder: Path | None = None

    @property
    def exit_code(self) -> int:
        """1 if a manoeuvre failed or diverged, else 0."""
        return int(any(outcome.verdict in {"fail", "diverged"} for outcome in self.outcomes))

    def data(self) -> dict[str, object]:
        """Return plain data for JSON."""
        facts = self.facts
        # Units are in the keys, and digits as far as they mean anything.
        return {
            "vehicle": {
                "name": facts.name,
                "title": facts.title,
                "mass_kg": round(facts.mass, 3),
                "wheelbase_m": round(facts.wheelbase, 4),
                "width_m": round(facts.width, 4),
                "steering_ratio": facts.ratio,
                "tyres": facts.tyres,
                "pedals": facts.pedals,
                "scale": round(facts.scale, 4),
            },
            "model": self.model,
            "plant": dict(self.plant),
            "friction": self.friction,
            "manoeuvres": [outcome.data() for outcome in self.outcomes],
        }


def write_results(results: HandlingResults) -> None:
    """Write results.json and metrics.csv into the folder.

    Raises:
        RunError: a file cannot be written.
    """
    assert results.folder is not None
    write_file(results.folder / RESULTS, json.dumps(results.data(), indent=2, ensure_ascii=False) + "\n")
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["vehicle", "model", "manoeuvre", "verdict", "metric", "value", "unit", "text", "note"])
    for outcome in results.outcomes:
        start = [results.facts.name, results.model, outcome.name, outcome.verdict]
        # A manoeuvre without figures keeps one row with its reason, so that no manoeuvre is missing in the table.
        if not outcome.metrics:
            table.writerow([*start, "", "", "", outcome.reason, ""])
        for m in outcome.metrics:
            # repr keeps all digits, so that the table can be read back without loss.
            value = "" if m.value is None else repr(m.value)
            table.writerow([*start, m.key, value, m.unit, m.text, m.remark])
    write_file(results.folder / METRICS, text.getvalue())


def format_number(value: float | None) -> str:
    """Return a number with four significant digits, without an exponent where possible."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0.0 or abs(value) < 1e-9:
        return "0"
    if abs(value) < 1e-4:
        return f"{value:.2e}"
    decimals = min(max(0, 3 - math.floor(math.log10(abs(value)))), 6)
    text = f"{value:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def format_figure(value: float | None) -> str:
    """Return a number with four significant digits for a page; ``–`` for None."""
    return "–" if value is None else format_number(value).replace("-", "−")


def format_setting(used: SettingRecord) -> str:
    """Return the value of a setting with its unit."""
    value = used.value
    if isinstance(value, tuple | list):
        text = ", ".join(format_number(float(element)) for element in value)
    # Before the numbers: bool is a subclass of int.
    elif isinstance(value, bool) or value is None:
        text = {None: "-", True: "yes", False: "no"}[value]
    else:
        text = format_number(float(value)) if isinstance(value, int | float) else str(value)
    extra = ""
    # Files are in SI units; people read km/h and degrees.
    if used.unit == "m/s" and isinstance(value, float):
        extra = f" ({format_number(value * 3.6)} km/h)"
    elif used.unit.startswith("rad") and isinstance(value, float):
        extra = f" ({format_number(math.degrees(value))} {used.unit.replace('rad', 'deg')})"
    return f"{text} {used.unit}".rstrip() + extra


def format_status(used: SettingRecord) -> str:
    """Return a phrase about the reliability of a setting, with its source."""
    word = "given" if used.given else STATUS.get(used.status, used.status)
    return f"{word}: {used.source}" if used.source and not used.given else word


def recalled(outcome: Outcome) -> list[str]:
    """Return the names of the settings whose numbers are recalled, not verified in a source."""
    return [used.name for used in outcome.used if used.status == "R" and not used.given]


def describe(outcome: Outcome) -> Iterator[str]:
    """Yield the lines of text that describe an outcome."""
    runs = f"{plural(len(outcome.runs), 'run')}, {outcome.wall:.1f} s"
    reason = f": {outcome.reason}" if outcome.reason else ""
    yield f"{outcome.title} ({outcome.standard}) - {outcome.verdict}{reason} [{runs}]"
    width = max((len(m.text) for m in outcome.metrics), default=0)
    # Columns are aligned within a manoeuvre.
    number_width = max((len(format_number(m.value)) for m in outcome.metrics), default=0)
    for m in outcome.metrics:
        note = f"   ({m.remark})" if m.remark else ""
        yield f"  {m.text:{width}}  {format_number(m.value):>{number_width}} {m.unit}{note}".rstrip()
    for note in outcome.notes:
        yield f"  note: {note}"
    if recalled(outcome) and outcome.verdict != "not possible":
        yield f"  settings not verified in a source: {', '.join(recalled(outcome))}"
