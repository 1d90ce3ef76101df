"""Validation of a vehicle: simulated against published figures."""

import csv
import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import Schema
from mirdrake.manoeuvres.base import Outcome
from mirdrake.manoeuvres.facts import Facts, find_facts
from mirdrake.manoeuvres.published import ROLES, Figure, PublishedFigures, Role
from mirdrake.manoeuvres.results import format_number
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.validation_runs import Reading, run_figures
from mirdrake.plant.plant import PlantSpec
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.vehicle import VARIANT_MARK

RESULTS, TABLE = "results.json", "figures.csv"


class ValidationSettings(Schema):
    """Settings of a validation."""

    tolerance: float = Field(3.0, gt=0.0, lt=100.0, description="largest error that passes [%]")
    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact [-]")
    friction: float = Field(0.85, gt=0.0, le=2.0, description="friction of the road; 0.85 is dry asphalt [-]")
    seed: int = Field(0, ge=0, description="seed of everything random [-]")


@dataclass(frozen=True)
class Comparison:
    """Published figure and its simulated value.

    Attributes:
        figure: the published figure.
        simulated: simulated value in the unit of the figure; None if there is none.
        note: remark on the simulation, or the reason for the missing value.
        payload: payload of the simulation [kg].
        tolerance: largest error that passes [1].
    """

    figure: Figure
    simulated: float | None
    note: str
    payload: float
    tolerance: float

    @property
    def error(self) -> float | None:
        """Simulated less published over published value [1]; None without a simulated value."""
        return None if self.simulated is None else self.simulated / self.figure.number - 1.0

    @property
    def verdict(self) -> str:
        """``within``, ``outside``, ``not simulated`` or ``not compared``."""
        if self.figure.not_compared:
            return "not compared"
        if self.error is None:
            return "not simulated"
        # A bound is missed on one side only.
        above, below = self.error > self.tolerance, self.error < -self.tolerance
        missed = {"about": above or below, "at_most": above, "at_least": below}[self.figure.bound]
        return "outside" if missed else "within"

    @property
    def remarks(self) -> str:
        """Remarks on the figure and on its simulation."""
        return "; ".join(part for part in (self.figure.note, self.figure.not_compared, self.note) if part)

    def data(self) -> dict[str, object]:
        """Return plain data for JSON and the table."""
        return {
            "quantity": self.figure.quantity,
            "text": self.figure.text,
            "role": self.figure.role,
            "unit": self.figure.shown_unit,
            "published": self.figure.number,
            "bound": self.figure.bound,
            "simulated": self.simulated,
            "error_percent": None if self.error is None else 100.0 * self.error,
            "verdict": self.verdict,
            "payload_kg": self.payload,
            "source": self.figure.source,
            "status": self.figure.status,
            "note": self.remarks,
        }


@dataclass(frozen=True)
class ValidationResults:
    """All figures of a vehicle.

    Attributes:
        facts: figures of the vehicle without payload.
        published: contents of published_figures.yaml.
        comparisons: comparisons in the order of that file.
        outcomes: outcomes of the manoeuvres that were driven.
        tolerance: largest error that passes [1].
        plant: settings of the plant.
        friction: friction of the road [1].
        folder: folder of all files; None writes nothing.
        wall: wall time [s].
    """

    facts: Facts
    published: PublishedFigures
    comparisons: Sequence[Comparison]
    outcomes: Sequence[Outcome]
    tolerance: float
    plant: Mapping[str, Any]
    friction: float
    folder: Path | None = None
    wall: float = 0.0

    @property
    def exit_code(self) -> int:
        """0 if every figure that was compared is within the tolerance, else 1."""
        return int(not all(comparison.verdict in {"within", "not compared"} for comparison in self.comparisons))

    @property
    def headline(self) -> str:
        """Result in one line."""
        if not self.comparisons:
            return "no published figures to compare"
        counts = {role: self.count(role) for role in ROLES}
        shown = {role: f"{within} of {total}" for role, (within, total) in counts.items() if total}
        predicted = shown.pop("predicted", "")
        limit = f"within {format_number(100.0 * self.tolerance)} %"
        others = ", ".join(f"{role} {text}" for role, text in shown.items())
        if not predicted:
            return f"no predicted figure to compare; {others} {limit}" if others else "no predicted figure to compare"
        return f"{predicted} predicted figures {limit}" + (f" ({others})" if others else "")

    def having(self, role: Role) -> list[Comparison]:
        """Return the comparisons whose figures have a role."""
        return [comparison for comparison in self.comparisons if comparison.figure.role == role]

    def count(self, role: Role) -> tuple[int, int]:
        """Return how many figures of a role are within the tolerance, and how many are compared."""
        verdicts = [comparison.verdict for comparison in self.having(role)]
        return verdicts.count("within"), len(verdicts) - verdicts.count("not compared")

    def data(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "vehicle": self.facts.name,
            "title": self.facts.title,
            "tolerance_percent": 100.0 * self.tolerance,
            "headline": self.headline,
            "none_because": self.published.none_because,
            "plant": dict(self.plant),
            "friction": self.friction,
            "notes": list(self.published.notes),
            "figures": [comparison.data() for comparison in self.comparisons],
            "runs": [outcome.data() for outcome in self.outcomes],
            "wall_s": round(self.wall, 1),
        }


def driven_name(name: str, published: PublishedFigures) -> str:
    """Return the name of the vehicle to drive: the variant that the file names, unless the user has named one."""
    return f"{name}{VARIANT_MARK}{published.variant}" if published.variant and VARIANT_MARK not in name else name


def validate_vehicle(
    name: str,
    vehicle: Vehicle,
    published: PublishedFigures,
    settings: ValidationSettings | None = None,
    *,
    folder: Path | None = None,
    only: Sequence[str] = (),
    report: Callable[[str], None] = lambda _: None,
) -> ValidationResults:
    """Drive the manoeuvres that the published figures need, and compare.

    Args:
        name: name of the vehicle to drive, see :func:`driven_name`.
        vehicle: the same, loaded without payload.
        published: its published figures.
        settings: tolerance, plant, friction.
        folder: folder in which each run writes its own; None writes nothing.
        only: quantities that are compared; by default all.
        report: called with the name of each run before it starts.

    Raises:
        ConfigError: the vehicle lacks a xacro argument of a figure, or a setting is out of range.
    """
    settings = settings or ValidationSettings()
    tolerance = settings.tolerance / 100.0
    start = time.perf_counter()
    figures = [figure for figure in published.figures if not only or figure.quantity in only]

    # Figures with equal run, payload and arguments share a simulation.
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, figure in enumerate(figures):
        if not figure.not_compared:
            conditions = _payload(figure, published), tuple(sorted(figure.arguments.items()))
            groups.setdefault((figure.run, *conditions), []).append(index)
    # Loading a vehicle with other arguments takes long: one rig per payload and set of arguments.
    rigs: dict[tuple[object, ...], Rig] = {}
    readings: dict[int, Reading] = {}
    outcomes = []
    for number, ((_, *rest), indices) in enumerate(groups.items(), start=1):
        members = [figures[index] for index in indices]
        key = tuple(rest)
        if key not in rigs:
            rigs[key] = _make_rig(name, _payload(members[0], published), members[0].arguments, settings, report)
        rig = rigs[key]
        rig.folder = folder / f"run_{number}" if folder is not None else None
        drive, group_readings = run_figures(members, rig)
        outcomes.append(drive.outcome)
        readings.update(zip(indices, group_readings, strict=True))

    # In the order of the file, also those that are not compared or could not be simulated.
    comparisons = []
    for index, figure in enumerate(figures):
        reading = readings.get(index, Reading(None))
        # Readings are SI, published figures in their own unit.
        value = None if reading.value is None else reading.value / figure.factor
        comparisons.append(Comparison(figure, value, reading.note, _payload(figure, published), tolerance))
    used = next(iter(rigs.values()), None)
    return ValidationResults(
        find_facts(vehicle),
        published,
        comparisons,
        outcomes,
        tolerance,
        settings.plant.model_dump() | ({"contact": used.contact} if used is not None else {}),
        settings.friction,
        folder,
        time.perf_counter() - start,
    )


def _make_rig(
    name: str,
    payload: float,
    arguments: Mapping[str, str],
    settings: ValidationSettings,
    report: Callable[[str], None],
) -> Rig:
    """Return the rig of the vehicle with a payload [kg] and other xacro arguments."""
    # Payload is a xacro argument of the vehicle; without payload the argument is left out, as not all vehicles have it.
    arguments = dict(arguments) | ({"payload": f"{payload:.10g}"} if payload else {})
    vehicle = load_vehicle(name, arguments=arguments)
    plant = settings.plant.model_dump(exclude_unset=True)
    return Rig(
        name,
        vehicle,
        find_facts(vehicle),
        plant=plant,
        friction=settings.friction,
        seed=settings.seed,
        report=report,
        arguments=arguments,
    )


def _payload(figure: Figure, published: PublishedFigures) -> float:
    return published.payload if figure.payload is None else figure.payload


def write_validation_results(results: ValidationResults) -> None:
    """Write results.json and figures.csv into the folder.

    Raises:
        RunError: a file cannot be written.
    """
    assert results.folder is not None
    write_file(results.folder / RESULTS, json.dumps(results.data(), indent=2, ensure_ascii=False) + "\n")
    text = io.StringIO()
    rows = [{"vehicle": results.facts.name, **comparison.data()} for comparison in results.comparisons]
    names = list(rows[0]) if rows else ["vehicle", "quantity"]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_file(results.folder / TABLE, text.getvalue())


_BOUND = {"about": "", "at_most": "at most ", "at_least": "at least "}


def format_published(figure: Figure) -> str:
    """Return a published value with its bound and unit, as it was written."""
    text = figure.value if figure.value.endswith(figure.shown_unit) else f"{figure.value} {figure.shown_unit}"
    return _BOUND[figure.bound] + text.replace("^2", "²")


def format_error(error: float | None) -> str:
    """Return an error [1] in percent with its sign, ``-`` for none."""
    return "-" if error is None else f"{100.0 * error:+.1f} %"


_STATUS = {
    "verified": "read in the source, or computed from it",
    "excerpt": "read in a quotation of the source",
    "recalled": "not found in a source",
}


def describe_validation(results: ValidationResults) -> list[str]:
    """Return the comparison as lines of text."""
    lines = [f"{results.facts.title} ({results.facts.name}): {results.headline}"]
    if results.published.none_because:
        lines.append(f"  {results.published.none_because}")
    heads = ("figure", "published", "simulated", "error", "", "status")
    # One table per role, with columns of equal width over all of them.
    tables = {role: [_cells(comparison) for comparison in results.having(role)] for role in ROLES}
    rows = [heads, *(row for table in tables.values() for row in table)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    for role, table in tables.items():
        if table:
            lines.append(f"{role}: {ROLES[role]}")
        for row in [heads, *table] if table else []:
            cells = [row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in (1, 2, 3))]
            lines.append("  " + "  ".join([*cells, row[4].ljust(widths[4]), row[5]]).rstrip())
    # Each reason once: many figures share a run.
    reasons = dict.fromkeys(x.note for x in results.comparisons if x.verdict == "not simulated" and x.note)
    lines += [f"  not simulated: {reason}" for reason in reasons]
    known = [f"{status}: {meaning}" for status, meaning in _STATUS.items() if any(row[5] == status for row in rows[1:])]
    return [*lines, f"status of the source: {'; '.join(known)}"] if known else lines


def _cells(comparison: Comparison) -> tuple[str, ...]:
    """Return a row of the table in the terminal."""
    figure, simulated = comparison.figure, format_number(comparison.simulated)
    return (
        figure.text,
        format_published(figure),
        simulated,
        format_error(comparison.error),
        comparison.verdict,
        figure.status,
    )
