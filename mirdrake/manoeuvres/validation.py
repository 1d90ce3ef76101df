"""A vehicle simulated against what is published of the real one, side by side."""

import csv
import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
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
    """What a user may set."""

    tolerance: float = Field(3.0, gt=0.0, lt=100.0, description="largest error that passes [%]")
    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact [-]")
    friction: float = Field(0.85, gt=0.0, le=2.0, description="of the road; 0.85 is dry asphalt [-]")
    seed: int = Field(0, ge=0, description="of everything random [-]")


@dataclass(frozen=True)
class Comparison:
    """A published figure beside its simulation.

    Attributes:
        figure: what is published.
        simulated: in the same unit; None: there is none.
        note: of the simulation; without a value why there is none.
        payload: with which it was driven [kg].
        tolerance: largest error that passes [1].
    """

    figure: Figure
    simulated: float | None
    note: str
    payload: float
    tolerance: float

    @property
    def error(self) -> float | None:
        """Simulated less published, over published [1]; None without a simulation."""
        return None if self.simulated is None else self.simulated / self.figure.number - 1.0

    @property
    def word(self) -> str:
        """``within``, ``outside``, ``not simulated`` or ``not compared``."""
        if self.figure.not_compared:
            return "not compared"
        if self.error is None:
            return "not simulated"
        above, below = self.error > self.tolerance, self.error < -self.tolerance
        missed = {"about": above or below, "at_most": above, "at_least": below}[self.figure.bound]
        return "outside" if missed else "within"

    @property
    def passed(self) -> bool:
        """Whether nothing speaks against the model."""
        return self.word in {"within", "not compared"}

    def data(self) -> dict[str, Any]:
        """Plain data, for JSON and the table."""
        return {
            "quantity": self.figure.quantity,
            "text": self.figure.text,
            "role": self.figure.role,
            "unit": self.figure.shown_unit,
            "published": self.figure.number,
            "bound": self.figure.bound,
            "simulated": self.simulated,
            "error_percent": None if self.error is None else 100.0 * self.error,
            "verdict": self.word,
            "payload_kg": self.payload,
            "source": self.figure.source,
            "status": self.figure.status,
            "note": "; ".join(part for part in (self.figure.note, self.figure.not_compared, self.note) if part),
        }


@dataclass(frozen=True)
class ValidationResults:
    """All figures of a vehicle.

    Attributes:
        facts: of the vehicle without payload.
        published: the file.
        comparisons: in its order.
        outcomes: what was driven.
        tolerance: largest error that passes [1].
        plant: settings of the plant.
        friction: of the road [1].
        folder: where all is written; None: nowhere.
        wall: time it took [s].
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
        return int(not all(one.passed for one in self.comparisons))

    @property
    def compared(self) -> list[Comparison]:
        """Figures that count."""
        return [one for one in self.comparisons if one.word != "not compared"]

    @property
    def headline(self) -> str:
        """The outcome in one line."""
        if not self.comparisons:
            return "nothing is published to compare with"
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
        return [one for one in self.comparisons if one.figure.role == role]

    def count(self, role: Role) -> tuple[int, int]:
        """Return how many figures of a role are within the tolerance, and how many are compared."""
        words = [one.word for one in self.having(role) if one.word != "not compared"]
        return words.count("within"), len(words)

    def data(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {
            "vehicle": self.facts.name,
            "title": self.facts.title,
            "tolerance_percent": 100.0 * self.tolerance,
            "headline": self.headline,
            "none_because": self.published.none_because,
            "plant": dict(self.plant),
            "friction": self.friction,
            "notes": list(self.published.notes),
            "figures": [one.data() for one in self.comparisons],
            "runs": [outcome.data() for outcome in self.outcomes],
            "wall_s": round(self.wall, 1),
        }


@dataclass
class _Cars:
    """The vehicle with one payload and other arguments after another."""

    model: str
    settings: ValidationSettings
    tell: Callable[[str], None]
    folder: Path | None
    rigs: dict[tuple[float, tuple[tuple[str, str], ...]], Rig] = field(default_factory=dict)

    def rig(self, payload: float, arguments: Mapping[str, str]) -> Rig:
        """Where it is driven."""
        key = payload, tuple(sorted(arguments.items()))
        if key not in self.rigs:
            given = dict(arguments) | ({"payload": f"{payload:.10g}"} if payload else {})
            vehicle = load_vehicle(self.model, arguments=given)
            self.rigs[key] = Rig(
                self.model,
                vehicle,
                find_facts(vehicle),
                plant=self.settings.plant.model_dump(exclude_unset=True),
                friction=self.settings.friction,
                seed=self.settings.seed,
                tell=self.tell,
                arguments=given,
            )
        return self.rigs[key]


def driven_name(name: str, published: PublishedFigures) -> str:
    """The vehicle to be driven: the variant that the file names, unless the user has named one."""
    return f"{name}{VARIANT_MARK}{published.variant}" if published.variant and VARIANT_MARK not in name else name


def validate_vehicle(
    name: str,
    vehicle: Vehicle,
    published: PublishedFigures,
    settings: ValidationSettings | None = None,
    *,
    folder: Path | None = None,
    only: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> ValidationResults:
    """Drive what the published figures need, and compare.

    Args:
        name: of the vehicle to be driven, see :func:`driven_name`.
        vehicle: the same, loaded.
        published: its figures.
        settings: tolerance, plant, friction.
        folder: gets the runs, a folder each; None: nothing is written.
        only: quantities that are compared; all if left out.
        tell: told what is being driven.

    Raises:
        ConfigError: the vehicle has no argument that a figure asks for, or a setting makes no sense.
    """
    settings = settings or ValidationSettings()
    began = time.perf_counter()
    figures = [one for one in published.figures if not only or one.quantity in only]
    cars = _Cars(name, settings, tell, folder)
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, figure in enumerate(figures):
        if not figure.not_compared:
            key = (*figure.run, _payload(figure, published), *sorted(figure.arguments.items()))
            groups.setdefault(key, []).append(index)
    readings: dict[int, Reading] = {}
    outcomes = []
    for number, indices in enumerate(groups.values(), start=1):
        members = [figures[index] for index in indices]
        rig = cars.rig(_payload(members[0], published), members[0].arguments)
        rig.folder = folder / f"run_{number}" if folder is not None else None
        drive, found = run_figures(members, rig)
        outcomes.append(drive.outcome)
        readings.update(zip(indices, found, strict=True))
    comparisons = []
    for index, figure in enumerate(figures):
        reading = readings.get(index, Reading(None))
        value = None if reading.value is None else reading.value / figure.factor
        tolerance = settings.tolerance / 100.0
        comparisons.append(Comparison(figure, value, reading.note, _payload(figure, published), tolerance))
    used = next(iter(cars.rigs.values()), None)
    plant = settings.plant.model_dump() | ({"contact": used.contact} if used is not None else {})
    return ValidationResults(
        find_facts(vehicle),
        published,
        comparisons,
        outcomes,
        settings.tolerance / 100.0,
        plant,
        settings.friction,
        folder,
        time.perf_counter() - began,
    )


def _payload(figure: Figure, published: PublishedFigures) -> float:
    return published.payload if figure.payload is None else figure.payload


def write_validation_results(results: ValidationResults) -> None:
    """results.json and figures.csv in the folder.

    Raises:
        RunError: it cannot be written.
    """
    assert results.folder is not None
    write_file(results.folder / RESULTS, json.dumps(results.data(), indent=2, ensure_ascii=False) + "\n")
    text = io.StringIO()
    rows = [{"vehicle": results.facts.name, **one.data()} for one in results.comparisons]
    names = list(rows[0]) if rows else ["vehicle", "quantity"]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_file(results.folder / TABLE, text.getvalue())


_BOUND = {"about": "", "at_most": "at most ", "at_least": "at least "}


def format_published(figure: Figure) -> str:
    """A published value with its bound and unit, as it was written."""
    text = figure.value if figure.value.endswith(figure.shown_unit) else f"{figure.value} {figure.shown_unit}"
    return _BOUND[figure.bound] + text.replace("^2", "²")


def error_told(one: Comparison) -> str:
    """An error with its sign, ``-`` for none."""
    return "-" if one.error is None else f"{100.0 * one.error:+.1f} %"


def describe_validation(results: ValidationResults) -> list[str]:
    """The comparison as lines of text."""
    lines = [f"{results.facts.title} ({results.facts.name}): {results.headline}"]
    if results.published.none_because:
        lines.append(f"  {results.published.none_because}")
    heads = ("figure", "published", "simulated", "error", "", "source")
    tables = {role: [_cells(one) for one in results.having(role)] for role in ROLES}
    rows = [heads, *(row for table in tables.values() for row in table)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    for role, table in tables.items():
        if table:
            lines.append(f"{role}: {ROLES[role]}")
        for row in [heads, *table] if table else []:
            cells = [row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in (1, 2, 3))]
            lines.append("  " + "  ".join([*cells, row[4].ljust(widths[4]), row[5]]).rstrip())
    reasons = {one.note: None for one in results.comparisons if one.word == "not simulated" and one.note}
    return [*lines, *(f"  not simulated: {reason}" for reason in reasons)]


def _cells(one: Comparison) -> tuple[str, ...]:
    """A row of the table in the terminal."""
    simulated = "-" if one.simulated is None else format_number(one.simulated)
    return one.figure.text, format_published(one.figure), simulated, error_told(one), one.word, one.figure.status
