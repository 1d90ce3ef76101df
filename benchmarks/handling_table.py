"""Figures of manoeuvres over contacts and steps: ``python -m benchmarks.handling_table --out runs/handling_table``.

Each outcome is a line of ``outcomes.jsonl`` in the folder; a second call continues with those that are missing.
``table.md`` has, for each manoeuvre and vehicle, the figure that changes most.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

from mirdrake.manoeuvres import MANOEUVRES, Rig, find_facts, read_settings, run_manoeuvre
from mirdrake.manoeuvres.base import Metric
from mirdrake.vehicles import load_vehicle

VEHICLES = ("bolt", "mkz", "catvehicle", "unior")
CONTACTS = ("point", "tyre", "hydroelastic")
STEPS = (0.005, 0.0025, 0.00125, 0.01)

LIMIT = 0.01
"""Relative change up to which figures count as equal [1]."""

# One side is enough for a car whose sides are alike.
_LEFT = {
    "steady_state_circle": ("steady_state_circle.turns=left",),
    "sine_with_dwell": ("sine_with_dwell.turns=left",),
}


class Key(NamedTuple):
    """An outcome: manoeuvre, vehicle, contact, and step of the plant [s]."""

    manoeuvre: str
    vehicle: str
    contact: str
    step: float


def main() -> int:
    """Drive the manoeuvres that are missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/handling_table"), metavar="DIR", help="folder")
    parser.add_argument("--manoeuvres", nargs="+", choices=MANOEUVRES, default=list(MANOEUVRES), metavar="NAME")
    parser.add_argument("--vehicles", nargs="+", choices=VEHICLES, default=VEHICLES)
    parser.add_argument("--contacts", nargs="+", choices=CONTACTS, default=CONTACTS)
    parser.add_argument("--steps", nargs="+", type=float, default=STEPS, metavar="S", help="steps of the plant [s]")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no outcome is begun after this time")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file, end = options.out / "outcomes.jsonl", time.monotonic() + options.seconds
    outcomes = read_outcomes(file)
    for manoeuvre in options.manoeuvres:
        for vehicle in options.vehicles:
            for step in options.steps:
                for contact in options.contacts:
                    key = Key(manoeuvre, vehicle, contact, step)
                    if key in outcomes or time.monotonic() > end:
                        continue
                    outcomes[key] = row = drive(key)
                    with file.open("a", encoding="utf-8") as lines:
                        lines.write(json.dumps({**key._asdict(), **row}) + "\n")
                    print(*key, row["verdict"], f"{row['wall']:.0f} s", file=sys.stderr)
    (options.out / "table.md").write_text("\n".join(table(outcomes)) + "\n", encoding="utf-8")
    return 0


def drive(key: Key) -> dict[str, Any]:
    """Return verdict, reason, wall time [s] and figures (value and scale by key) of a manoeuvre."""
    begin, name = time.monotonic(), f"{key.vehicle}@handling"
    vehicle = load_vehicle(name)
    rig = Rig(name, vehicle, find_facts(vehicle), plant={"time_step": key.step, "contact": key.contact})
    spec = getattr(read_settings(_LEFT.get(key.manoeuvre, ())), key.manoeuvre)
    outcome = run_manoeuvre(key.manoeuvre, rig, spec)
    figures = {metric.key: [metric.value, metric.scale] for metric in outcome.metrics}
    wall = round(time.monotonic() - begin, 1)
    return {"verdict": outcome.verdict, "reason": outcome.reason, "wall": wall, "figures": figures}


def read_outcomes(file: Path) -> dict[Key, dict[str, Any]]:
    """Return the outcomes in a file; none if there is no file."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    rows = [json.loads(line) for line in lines]
    return {Key(*(row[name] for name in Key._fields)): row for row in rows}


def changes(first: dict[str, Any], second: dict[str, Any]) -> dict[str, float]:
    """Return the relative change of each figure; infinite if only one outcome has it, or under another verdict."""
    if first["verdict"] != second["verdict"]:
        return {f"verdict {first['verdict']}, {second['verdict']}": float("inf")}
    keys = first["figures"].keys() | second["figures"].keys()
    return {key: _metric(first, key).change(_metric(second, key)) for key in keys}


def _metric(outcome: dict[str, Any], key: str) -> Metric:
    """Return a figure of an outcome; without a value if it does not have it."""
    value, scale = outcome["figures"].get(key, (None, None))
    return Metric(key, "", value, "", scale=scale)


def table(outcomes: dict[Key, dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of a table: pairs of contacts at 5 ms, and steps against half of them."""
    pairs = [(contact, STEPS[0], other, STEPS[0]) for other, contact in combinations(CONTACTS, 2)]
    halved = sorted(step for step in STEPS if 0.5 * step in STEPS)
    pairs += [(contact, step, contact, 0.5 * step) for contact in CONTACTS for step in halved]
    yield "| manoeuvre | change | " + " | ".join(VEHICLES) + " |"
    yield "|---|---|" + "---|" * len(VEHICLES)
    for manoeuvre in MANOEUVRES:
        for contact, step, other, half in pairs:
            cells = []
            for vehicle in VEHICLES:
                keys = Key(manoeuvre, vehicle, contact, step), Key(manoeuvre, vehicle, other, half)
                if not all(key in outcomes for key in keys):
                    cells.append("")
                    continue
                cells.append(_cell(changes(*(outcomes[key] for key in keys))))
            if any(cells):
                what = (
                    f"{other} to {contact}" if other != contact else f"{contact}, {1e3 * step:g} to {1e3 * half:g} ms"
                )
                yield f"| `{manoeuvre}` | {what} | " + " | ".join(cells) + " |"


def _cell(found: dict[str, float]) -> str:
    """Return the largest change [%], and the figures that change by more than the limit."""
    if not found:
        return "not possible"
    over = sorted((key for key, change in found.items() if change >= LIMIT), key=lambda key: -found[key])
    largest = f"{100.0 * max(found.values()):.2f}"
    named = ", ".join(f"{key} {100.0 * found[key]:.1f}" for key in over)
    return f"{largest} ({named})" if over else largest


if __name__ == "__main__":
    sys.exit(main())
