"""Base of all manoeuvres: settings with units and sources, figures, charts, and the outcome of a manoeuvre."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.config import JsonDict

from mirdrake.core.contacts import STUDY_CONTACT
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema, where

Array = NDArray[np.float64]
Verdict = Literal["done", "pass", "fail", "not possible", "diverged"]
Status = Literal["V", "E", "R", "own"]

STATUS: dict[str, str] = {
    "V": "verified in the source",
    "E": "seen in an excerpt of the source",
    "R": "recalled, not verified in any source",
    "own": "chosen by mirdrake",
}
"""Reliability of the numbers of a manoeuvre."""

_LENGTH_POWERS = {"m": 1.0, "s": 0.5, "m/s": 0.5, "Hz": -0.5, "rad/s": -0.5, "1/m": -1.0}
"""Power of the length scale with which a quantity of each unit is scaled at equal Froude number v²/(g l)."""


class NotFeasible(Exception):  # noqa: N818 - a result, not an error
    """The manoeuvre is beyond the vehicle; the text is the reason in one line."""


class Diverged(Exception):  # noqa: N818 - a result, not an error
    """A run of the manoeuvre diverged; the text names the run and the time."""


def setting(
    default: Any, meaning: str, unit: str, status: Status, source: str = "", *, scales: bool = True, **checks: Any
) -> Any:
    """Return a field of a manoeuvre.

    Args:
        default: value for a car.
        meaning: meaning as a noun phrase.
        unit: unit of the value; empty for a number without a unit and for a choice.
        status: reliability of the default, a key of :data:`STATUS`.
        source: origin of the default.
        scales: whether it is scaled to a small vehicle, see :func:`scaled`.
        checks: constraints, as of a pydantic field.
    """
    extra: JsonDict = {"meaning": meaning, "unit": unit, "status": status, "source": source, "scales": scales}
    return Field(default, description=f"{meaning} [{unit or '-'}]", json_schema_extra=extra, **checks)


def time_step_setting(default: float, reason: str) -> Any:
    """Return the field of a time step of the plant [s]; a `plant.time_step` of the user takes precedence."""
    meaning = f"of the plant, unless plant.time_step is given; {reason}"
    return setting(default, meaning, "s", "own", scales=False, gt=0.0)


@dataclass(frozen=True)
class SettingRecord:
    """Setting as it was used: name, value and unit, meaning, status, source, and whether the user gave it."""

    name: str
    value: Any
    unit: str
    meaning: str
    status: str
    source: str
    given: bool


class Margin(NamedTuple):
    """Difference of a figure of the single-track model from that of the full plant, over the latter [1].

    Both are of `bolt@handling` under :data:`MARGIN_CONDITIONS`; tests/test_manoeuvres.py measures and checks them.

    Attributes:
        measured: measured difference.
        limit: limit of its size that the test allows.
    """

    measured: float
    limit: float


MARGIN_CONDITIONS = f"bolt@handling, {STUDY_CONTACT} contact, default settings"
"""Conditions of the margins."""


@dataclass(frozen=True)
class Metric:
    """Figure of a manoeuvre.

    Attributes:
        key: name of the figure in results.json and metrics.csv.
        text: name of the figure in words.
        value: None if the run has no such figure.
        unit: unit of the value.
        note: short remark.
        scale: size to which changes are relative, in the same unit; by default the value itself. Figures that may be
            zero, or are a small difference of large numbers, need it.
        margin: margin against the full plant, for a figure of the single-track model; see :class:`Margin`.
    """

    key: str
    text: str
    value: float | None
    unit: str
    note: str = ""
    scale: float | None = None
    margin: "Margin | None" = None

    @property
    def remark(self) -> str:
        """The note, with the margin against the full plant."""
        if self.margin is None:
            return self.note
        size, side = 100.0 * abs(self.margin.measured), "above" if self.margin.measured >= 0.0 else "below"
        text = f"{size:.2g} % {side} the full plant, tested within {100.0 * self.margin.limit:.3g} %"
        return f"{self.note}; {text}" if self.note else text

    def change(self, other: "Metric") -> float:
        """Return the relative difference of another figure of the same key: over the larger of scale and values [1].

        It is 0 if neither has a value and infinite if one has none.
        """
        if self.value is None or other.value is None:
            return 0.0 if self.value is other.value else math.inf
        if self.value == other.value:
            return 0.0
        size = max(abs(self.scale or 0.0), abs(self.value), abs(other.value))
        return abs(self.value - other.value) / size


@dataclass(frozen=True)
class Curve:
    """Curve of a chart: name, points, and whether it is drawn as a line, dashed or as dots."""

    name: str
    x: Array
    y: Array
    style: Literal["line", "dashed", "dots"] = "line"
    colour: int = 0


@dataclass(frozen=True)
class Chart:
    """Chart with labels and units of both axes, and curves; `equal` for maps, `log` for a logarithmic x axis."""

    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    lines: tuple[Curve, ...]
    equal: bool = False
    log: bool = False


@dataclass
class Outcome:
    """Result of a manoeuvre.

    Attributes:
        name: name of the manoeuvre.
        title: its title in reports.
        standard: standard that defines it.
        verdict: "done" for a manoeuvre without a pass criterion.
        reason: why it failed, was not possible or diverged; one line.
        metrics: figures.
        charts: charts of the report.
        used: settings as they were used.
        notes: remarks for the reader of the report.
        runs: labels of the simulations, which are the names of their folders.
        simulated: simulated time of all runs [s].
        wall: wall time [s].
    """

    name: str
    title: str
    standard: str
    verdict: Verdict = "done"
    reason: str = ""
    metrics: list[Metric] = field(default_factory=list)
    charts: list[Chart] = field(default_factory=list)
    used: list[SettingRecord] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    runs: list[str] = field(default_factory=list)
    simulated: float = 0.0
    wall: float = 0.0

    def add(
        self, key: str, text: str, value: float | None, unit: str, note: str = "", *, scale: float | None = None
    ) -> None:
        """Add a figure, see :class:`Metric`; NaN means that the value is undefined."""
        number = None if value is None or not np.isfinite(value) else float(value)
        self.metrics.append(Metric(key, text, number, unit, note, scale))

    def value(self, key: str) -> float | None:
        """Return the value of a figure.

        Raises:
            ConfigError: the key is unknown.
        """
        for metric in self.metrics:
            if metric.key == key:
                return metric.value
        raise ConfigError(f"no figure '{key}'", where=self.name)

    def data(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "name": self.name,
            "title": self.title,
            "standard": self.standard,
            "verdict": self.verdict,
            "reason": self.reason,
            # Optional keys are left out, so that files of manoeuvres without notes and scales stay small.
            "metrics": {
                m.key: {"value": m.value, "unit": m.unit, "text": m.text}
                | ({"note": m.note} if m.note else {})
                | ({"scale": m.scale} if m.scale is not None else {})
                | ({"margin": m.margin._asdict()} if m.margin is not None else {})
                for m in self.metrics
            },
            "settings": {
                u.name: {"value": u.value, "unit": u.unit, "status": u.status, "given": u.given} for u in self.used
            },
            "notes": self.notes,
            "runs": self.runs,
            "wall_s": round(self.wall, 2),
        }


class ManoeuvreSpec(Schema):
    """Settings of a manoeuvre; a subclass is a kind of manoeuvre.

    Attributes:
        title: title in reports.
        standard: standard that defines it.
        headline: keys of the figures that summarise it in the report.
        uneven: whether its ground has a relief, on which a vertical tyre bears the wheels.
        margins: margins of figures of the single-track model against the full plant, by key.
    """

    title: ClassVar[str] = ""
    standard: ClassVar[str] = ""
    headline: ClassVar[tuple[str, ...]] = ()
    uneven: ClassVar[bool] = False
    margins: ClassVar[dict[str, Margin]] = {}

    def drive(self, rig: Any, outcome: Outcome) -> None:
        """Simulate the runs on a :class:`mirdrake.manoeuvres.rig.Rig` and fill the outcome; each kind defines it.

        Raises:
            NotFeasible: the manoeuvre is beyond the vehicle.
            Diverged: a run diverged.
        """
        raise NotImplementedError

    def fault(self, name: str, text: str) -> ConfigError:
        """Return an error about a setting, with the file and line where it was written."""
        return ConfigError(f"{text}", where=where(self, name))

    def used(self) -> Iterator[SettingRecord]:
        """Yield all settings."""
        for name, info in type(self).model_fields.items():
            extra: Any = info.json_schema_extra
            given = name in self.model_fields_set
            status = "given" if given else extra["status"]
            value = getattr(self, name)
            yield SettingRecord(name, value, extra["unit"], extra["meaning"], status, extra["source"], given)


def scaled(spec: ManoeuvreSpec, scale: float) -> ManoeuvreSpec:
    """Return the settings of a manoeuvre for a smaller vehicle at equal Froude number.

    Lengths are multiplied by `scale`, times and speeds by its square root, frequencies by the inverse of that;
    accelerations and angles stay. Settings that the user has given stay as well.

    Args:
        spec: settings for a car.
        scale: length of the vehicle over that of a car [1].
    """
    changes: dict[str, object] = {}
    for name, info in type(spec).model_fields.items():
        extra: Any = info.json_schema_extra
        power = _LENGTH_POWERS.get(extra["unit"])
        value = getattr(spec, name)
        # Settings of the user, without a length or time in their unit, or marked as not scaling stay as they are.
        if name in spec.model_fields_set or power is None or not extra["scales"] or scale == 1.0:
            continue
        factor = scale**power
        if isinstance(value, tuple | list):
            changes[name] = type(value)(element * factor for element in value)
        elif isinstance(value, float):
            changes[name] = value * factor

    # model_copy marks the changed fields as given by the user; reports need to know which ones really were.
    given = set(spec.model_fields_set)
    copy = spec.model_copy(update=changes)
    copy.__pydantic_fields_set__.clear()
    copy.__pydantic_fields_set__.update(given)
    return copy
