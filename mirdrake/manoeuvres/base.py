"""What a manoeuvre is: settings with units and sources, a run, and an outcome that says what was used."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema, where

Array = NDArray[np.float64]
Verdict = Literal["done", "pass", "fail", "not possible", "diverged"]
Status = Literal["V", "E", "R", "own"]

STATUS: dict[str, str] = {
    "V": "verified in the source",
    "E": "seen in an excerpt of the source",
    "R": "recalled, not verified in any source",
    "own": "a choice of this program",
}
"""How sure the numbers of a manoeuvre are."""

_SCALING = {"m": 1.0, "s": 0.5, "m/s": 0.5, "Hz": -0.5, "rad/s": -0.5, "1/m": -1.0}
_UNIT = re.compile(r"\[([^\]]*)\]")


class NotPossible(Exception):  # noqa: N818 - no error: an answer
    """The vehicle does not reach what the manoeuvre asks for; the text says why, in one line."""


class Diverged(Exception):  # noqa: N818
    """A run of the manoeuvre diverged; the text says where."""


def setting(default: Any, text: str, status: Status, source: str = "", *, scales: bool = True, **checks: Any) -> Any:
    """A field of a manoeuvre.

    Args:
        default: for a car.
        text: its meaning, with the unit in brackets.
        status: how sure the default is, a key of :data:`STATUS`.
        source: where it is from.
        scales: whether it shrinks with a small vehicle, see :func:`scaled`.
        checks: as for a pydantic field.
    """
    extra: dict[str, Any] = {"status": status, "source": source, "scales": scales}
    return Field(default, description=text, json_schema_extra=extra, **checks)


@dataclass(frozen=True)
class Used:
    """A setting as it was used: name, value and unit, meaning, status, source, and whether the user gave it."""

    name: str
    value: Any
    unit: str
    meaning: str
    status: str
    source: str
    given: bool


@dataclass(frozen=True)
class Metric:
    """A figure.

    Attributes:
        key: of it.
        text: what it is in words.
        value: None: there is none.
        unit: of the value.
        note: a short one.
        scale: what a change is to be measured by, in the same unit, where that is not the value itself: for what may
            be zero, or is a small difference of large numbers.
    """

    key: str
    text: str
    value: float | None
    unit: str
    note: str = ""
    scale: float | None = None

    def change(self, other: "Metric") -> float:
        """How much another figure of the same kind differs, over the larger of scale and value [1].

        0 if neither has a value, infinite if one has none.
        """
        if self.value is None or other.value is None:
            return 0.0 if self.value is other.value else math.inf
        if self.value == other.value:
            return 0.0
        size = max(abs(self.scale or 0.0), abs(self.value), abs(other.value))
        return abs(self.value - other.value) / size


@dataclass(frozen=True)
class Line:
    """One curve of a figure: its name, its points, and whether it is drawn as dots, dashed or as a line."""

    name: str
    x: Array
    y: Array
    style: Literal["line", "dashed", "dots"] = "line"
    colour: int = 0


@dataclass(frozen=True)
class Chart:
    """One pair of axes, with units; `equal` for maps, `log` for a logarithmic x axis."""

    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    lines: tuple[Line, ...]
    equal: bool = False
    log: bool = False


@dataclass
class Outcome:
    """What became of a manoeuvre.

    Attributes:
        name: of the manoeuvre.
        title: for people.
        standard: whose definition it is.
        verdict: "done" without a pass criterion.
        reason: why it failed, was not possible or diverged; one line.
        metrics: the figures.
        charts: for the report.
        used: the settings.
        notes: what a reader should know.
        runs: labels of the simulations, names of their folders.
        wall: time it took [s].
    """

    name: str
    title: str
    standard: str
    verdict: Verdict = "done"
    reason: str = ""
    metrics: list[Metric] = field(default_factory=list)
    charts: list[Chart] = field(default_factory=list)
    used: list[Used] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    runs: list[str] = field(default_factory=list)
    wall: float = 0.0

    def add(
        self, key: str, text: str, value: float | None, unit: str, note: str = "", *, scale: float | None = None
    ) -> None:
        """Add a figure, see :class:`Metric`; NaN counts as none."""
        number = None if value is None or not np.isfinite(value) else float(value)
        self.metrics.append(Metric(key, text, number, unit, note, scale))

    def value(self, key: str) -> float | None:
        """A figure by its key.

        Raises:
            ConfigError: there is none of that key.
        """
        for metric in self.metrics:
            if metric.key == key:
                return metric.value
        raise ConfigError(f"{self.name}: no figure '{key}'")

    def data(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {
            "name": self.name,
            "title": self.title,
            "standard": self.standard,
            "verdict": self.verdict,
            "reason": self.reason,
            "metrics": {
                m.key: {"value": m.value, "unit": m.unit, "text": m.text}
                | ({"note": m.note} if m.note else {})
                | ({"scale": m.scale} if m.scale is not None else {})
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
    """Settings of a manoeuvre; a subclass has its numbers and :meth:`drive`."""

    title: ClassVar[str] = ""
    standard: ClassVar[str] = ""

    def drive(self, rig: Any, outcome: Outcome) -> None:
        """Run what is to be run on a :class:`mirdrake.manoeuvres.rig.Rig` and fill the outcome.

        Raises:
            NotPossible: the vehicle does not reach what is asked for.
            Diverged: a run diverged.
        """
        raise NotImplementedError

    def fault(self, name: str, text: str) -> ConfigError:
        """An error about one of the settings, with the place where it was written."""
        return ConfigError(f"{where(self, name)}: {text}")

    def used(self) -> Iterator[Used]:
        """All settings."""
        for name, info in type(self).model_fields.items():
            extra: Any = info.json_schema_extra or {}
            text = info.description or ""
            unit = unit_of(text)
            meaning = _UNIT.sub("", text).strip().rstrip(";").strip()
            given = name in self.model_fields_set
            status = "given" if given else str(extra.get("status", "own"))
            value = getattr(self, name)
            yield Used(name, value, "" if unit == "-" else unit, meaning, status, str(extra.get("source", "")), given)


def unit_of(text: str) -> str:
    """The unit in the brackets of a description."""
    match = _UNIT.search(text)
    return match.group(1) if match else "-"


def scaled(spec: ManoeuvreSpec, scale: float) -> ManoeuvreSpec:
    """The same manoeuvre for a smaller vehicle: equal Froude numbers, so that accelerations and angles stay.

    Lengths shrink with `scale`, times and speeds with its square root, frequencies grow with it. What the user has set
    stays as it is.

    Args:
        spec: of a manoeuvre.
        scale: length of the vehicle over that of a car [1].
    """
    changes: dict[str, Any] = {}
    for name, info in type(spec).model_fields.items():
        extra: Any = info.json_schema_extra or {}
        power = _SCALING.get(unit_of(info.description or ""))
        value = getattr(spec, name)
        if name in spec.model_fields_set or power is None or not extra.get("scales", True) or scale == 1.0:
            continue
        factor = scale**power
        if isinstance(value, tuple | list):
            changes[name] = type(value)(one * factor for one in value)
        elif isinstance(value, float):
            changes[name] = value * factor
    given = set(spec.model_fields_set)
    copy = spec.model_copy(update=changes)
    copy.__pydantic_fields_set__.clear()
    copy.__pydantic_fields_set__.update(given)
    return copy
