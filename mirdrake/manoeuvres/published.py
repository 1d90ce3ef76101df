"""published_figures.yaml of a vehicle: published figures of the real one, with their conditions and sources.

An entry of ``figures`` has a ``quantity``, its conditions, a ``value`` with its unit, a ``role``, a ``source`` and a
``status``::

    - quantity: time_to_speed
      speed: 60 mph
      value: 6.9 s
      role: calibrated
      source: Edmunds' track test of 24 January 2017
      status: excerpt

A new quantity is a class here and a run in :mod:`mirdrake.manoeuvres.validation_runs`.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Length, Mass, Schema, Speed, load_yaml, to_si, where
from mirdrake.manoeuvres.metrics.straight import FOOT, KMH, MILE, MPH
from mirdrake.vehicles import Vehicle

FILE = "published_figures.yaml"

_QUARTER_MILE = 0.25 * MILE

KNOWN: dict[str, str] = {
    "verified": "the source was opened, or the number computed from one that was",
    "excerpt": "seen in an excerpt of the source",
    "recalled": "recalled, not verified in any source",
}
"""Reliability of a figure."""

Role = Literal["predicted", "calibrated", "input"]

ROLES: dict[Role, str] = {
    "predicted": "set no parameter of the model",
    "calibrated": "parameters of the model were fitted to it",
    "input": "follows from a value or a limit in the vehicle's files, such as the governor's",
}
"""Role of a figure for the model, in the order in which figures are shown; only predicted ones test the model."""


class _Figure(Schema):
    """Base class of the figures; a subclass is a quantity."""

    unit: ClassVar[str] = ""
    manoeuvre: ClassVar[str] = ""

    value: str = Field(description="number with its unit, as published [-]")
    bound: Literal["about", "at_most", "at_least"] = Field(
        default="about", description="whether the source gives the value, an upper or a lower bound [-]"
    )
    role: Role = Field(
        description="input: follows from a value or limit in the vehicle's files; calibrated: a parameter was fitted "
        "to it; predicted: neither [-]"
    )
    source: str = Field(min_length=1, description="source of the figure [-]")
    status: Literal["verified", "excerpt", "recalled"] = Field(description="reliability [-]")
    payload: Mass | None = Field(
        default=None, ge=0.0, description="driver and equipment; by default that of the file [kg]"
    )
    arguments: dict[str, str] = Field(default_factory=dict, description="xacro arguments besides payload [-]")
    note: str = Field(default="", description="remark for the reader [-]")
    not_compared: str = Field(
        default="", description="reason why it is listed but not simulated; empty if it is simulated [-]"
    )

    @field_validator("value", mode="before")
    @classmethod
    def _has_its_unit(cls, value: Any) -> str:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"must be a number in {cls.unit}")
        text = str(value).strip()
        number = to_si(text, cls.unit) if isinstance(value, str) else float(value)
        if isinstance(number, str):
            raise ValueError(f"must be a number in {cls.unit}, not '{text[:60]}'")
        if not 0.0 < number < 1e9:
            raise ValueError("must be above zero")
        return text

    @property
    def si(self) -> float:
        """Value in its SI unit."""
        return float(to_si(self.value, self.unit))

    @property
    def shown_unit(self) -> str:
        """Unit in which the figure was published."""
        match = re.fullmatch(r"[-+0-9.eE]+\s*(.*)", self.value)
        return (match.group(1) if match else "") or self.unit

    @property
    def number(self) -> float:
        """Value in the unit in which it was published."""
        return self.si / self.factor

    @property
    def factor(self) -> float:
        """Published unit over the SI unit."""
        return float(to_si(f"1 {self.shown_unit}", self.unit))

    @property
    def text(self) -> str:
        """Name of the quantity with its conditions; each class defines it."""
        raise NotImplementedError

    @property
    def run(self) -> tuple[object, ...]:
        """Key of the simulation: figures with equal keys, payloads and arguments are read from one."""
        return (self.manoeuvre,)


def _format_speed(speed: float) -> str:
    """Return a speed in mph if that is a round number, else in km/h."""
    mph = speed / MPH
    return f"{mph:.0f} mph" if abs(mph - round(mph)) < 1e-6 else f"{speed / KMH:.4g} km/h"


def _format_distance(distance: float) -> str:
    return "Quarter mile" if abs(distance - _QUARTER_MILE) < 0.01 else f"First {distance:.4g} m"


class TimeToSpeed(_Figure):
    """Full throttle from standstill to a speed."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["time_to_speed"]
    speed: Speed = Field(gt=0, description="speed that is reached [m/s]")
    rollout: bool = Field(default=False, description="whether the time of the first foot is subtracted [-]")

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"0 to {_format_speed(self.speed)}{', less the first foot' if self.rollout else ''}"


class TimeToDistance(_Figure):
    """Full throttle from standstill over a distance."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["time_to_distance"]
    distance: Length = Field(default=_QUARTER_MILE, gt=0, description="distance; by default a quarter mile [m]")
    rollout: bool = Field(default=False, description="whether the first foot and its time are subtracted [-]")

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"{_format_distance(self.distance)}{', from the first foot on' if self.rollout else ''}"


class SpeedAtDistance(_Figure):
    """Speed after a distance with full throttle from standstill."""

    unit: ClassVar[str] = "m/s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["speed_at_distance"]
    distance: Length = Field(default=_QUARTER_MILE, gt=0, description="distance; by default a quarter mile [m]")

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"Speed after the {_format_distance(self.distance).lower()}"


class TopSpeed(_Figure):
    """Highest speed that full throttle holds."""

    unit: ClassVar[str] = "m/s"
    manoeuvre: ClassVar[str] = "top_speed"
    quantity: Literal["top_speed"]

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return "Top speed"


class BrakingDistance(_Figure):
    """Full braking to standstill."""

    unit: ClassVar[str] = "m"
    manoeuvre: ClassVar[str] = "braking"
    quantity: Literal["braking_distance"]
    speed: Speed = Field(gt=0, description="speed at the start [m/s]")

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"{_format_speed(self.speed)} to standstill"

    @property
    def run(self) -> tuple[object, ...]:
        """Key of the simulation: one for each speed."""
        return self.manoeuvre, self.speed


class LateralLimit(_Figure):
    """Highest steady lateral acceleration on a circle, of both turns."""

    unit: ClassVar[str] = "m/s^2"
    manoeuvre: ClassVar[str] = "skidpad"
    quantity: Literal["lateral_limit"]
    diameter: Length = Field(gt=0, description="diameter of the circle [m]")

    @property
    def text(self) -> str:
        """Name of the quantity; the diameter is in feet if that is a round number."""
        feet = self.diameter / FOOT
        size = f"{feet:.0f} ft" if abs(feet - round(feet)) < 1e-6 else f"{self.diameter:.5g} m"
        return f"Lateral acceleration on a circle of {size}"

    @property
    def run(self) -> tuple[object, ...]:
        """Key of the simulation: one for each circle."""
        return self.manoeuvre, self.diameter


class CoastTime(_Figure):
    """Coasting in neutral from one speed down to another."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "coast_down"
    quantity: Literal["coast_time"]
    first: Speed = Field(gt=0, description="speed at the start [m/s]")
    last: Speed = Field(gt=0, description="speed at the end [m/s]")
    rotating_mass: bool = Field(
        default=True, description="whether the figure includes the inertia of wheels and rotors [-]"
    )

    @model_validator(mode="after")
    def _speed_decreases(self) -> "CoastTime":
        if self.last >= self.first:
            raise ValueError("last must be below first")
        return self

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"Coasting from {_format_speed(self.first)} to {_format_speed(self.last)}"


class RoadLoad(_Figure):
    """Force of rolling resistance and air at a speed."""

    unit: ClassVar[str] = "N"
    manoeuvre: ClassVar[str] = "coast_down"
    quantity: Literal["road_load"]
    speed: Speed = Field(gt=0, description="speed [m/s]")

    @property
    def text(self) -> str:
        """Name of the quantity."""
        return f"Road load at {_format_speed(self.speed)}"


Figure = (
    TimeToSpeed | TimeToDistance | SpeedAtDistance | TopSpeed | BrakingDistance | LateralLimit | CoastTime | RoadLoad
)


class PublishedFigures(Schema):
    """Contents of published_figures.yaml."""

    variant: str = Field(default="", description="variant that is driven when the vehicle is named without one [-]")
    payload: Mass = Field(default=0.0, ge=0.0, description="driver and equipment in the tests [kg]")
    payload_source: str = Field(default="", description="source of the payload [-]")
    none_because: str = Field(default="", description="reason why the file has no figures [-]")
    notes: list[str] = Field(default_factory=list, description="remarks on all figures [-]")
    figures: list[Annotated[Figure, Field(discriminator="quantity")]] = Field(
        default_factory=list, description="published figures [-]"
    )


def load_published(vehicle: Vehicle) -> PublishedFigures:
    """Return the published figures of a loaded vehicle.

    Raises:
        ConfigError: the file does not exist, it is invalid, or it has neither figures nor a reason for that.
    """
    path = vehicle.folder / FILE
    if not path.is_file():
        raise ConfigError(f"has no {FILE}; write one as in docs/validation.md", where=vehicle.name)
    return read_published(path)


def read_published(path: Path, *, overrides: Iterable[str] = ()) -> PublishedFigures:
    """Read a file of published figures.

    Raises:
        ConfigError: the file is invalid, or it has neither figures nor a reason for that.
    """
    published = load_yaml(path, PublishedFigures, overrides=overrides)
    if not published.figures and not published.none_because:
        raise ConfigError(
            "has no figures; add figures, or the reason as none_because", where=where(published, "figures")
        )
    return published
