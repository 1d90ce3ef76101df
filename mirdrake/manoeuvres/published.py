"""published_figures.yaml beside a vehicle: what is known of the real one, under which conditions, and from where.

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
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Length, Mass, Schema, Speed, load_yaml, to_si
from mirdrake.vehicles import Vehicle

FILE = "published_figures.yaml"

KNOWN: dict[str, str] = {
    "verified": "the source was opened, or the number computed from one that was",
    "excerpt": "seen in an excerpt of the source",
    "recalled": "recalled, not verified in any source",
}
"""How sure a figure is."""

Role = Literal["predicted", "calibrated", "input"]

ROLES: dict[Role, str] = {
    "predicted": "set no parameter of the model",
    "calibrated": "parameters of the model were fitted to it",
    "input": "follows from a value or a limit in the vehicle's files, such as the governor's",
}
"""What a figure is to the model, in the order in which figures are shown; only predicted ones test it."""

_KMH, _MPH = 1.0 / 3.6, 0.44704


class _Figure(Schema):
    """What all figures have."""

    unit: ClassVar[str] = ""
    manoeuvre: ClassVar[str] = ""

    value: str = Field(description="number with its unit, as published [-]")
    bound: Literal["about", "at_most", "at_least"] = Field(
        default="about", description="what the source says: this value, or no more, or no less than it [-]"
    )
    role: Role = Field(
        description="input: follows from a value or limit in the vehicle's files; calibrated: a parameter was fitted "
        "to it; predicted: neither [-]"
    )
    source: str = Field(min_length=1, description="where it is from [-]")
    status: Literal["verified", "excerpt", "recalled"] = Field(description="how sure it is [-]")
    payload: Mass | None = Field(default=None, ge=0.0, description="driver and equipment; empty: that of the file [kg]")
    arguments: dict[str, str] = Field(default_factory=dict, description="of the xacro files, besides payload [-]")
    note: str = Field(default="", description="what a reader should know [-]")
    not_compared: str = Field(
        default="", description="reason why it is listed but not simulated; empty if it is simulated [-]"
    )

    @field_validator("value", mode="before")
    @classmethod
    def _has_its_unit(cls, value: Any) -> str:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"a number in {cls.unit} is expected")
        text = str(value).strip()
        number = to_si(text, cls.unit) if isinstance(value, str) else float(value)
        if isinstance(number, str):
            raise ValueError(f"a number in {cls.unit} is expected, not '{text[:60]}'")
        if not 0.0 < number < 1e9:
            raise ValueError("must be above zero")
        return text

    @property
    def si(self) -> float:
        """The value in its SI unit."""
        return float(to_si(self.value, self.unit))

    @property
    def shown_unit(self) -> str:
        """The unit in which it was published."""
        match = re.fullmatch(r"[-+0-9.eE]+\s*(.*)", self.value)
        return (match.group(1) if match else "") or self.unit

    @property
    def number(self) -> float:
        """The value in the unit in which it was published."""
        return self.si / self.factor

    @property
    def factor(self) -> float:
        """One published unit in the SI unit."""
        return float(to_si(f"1 {self.shown_unit}", self.unit))

    @property
    def text(self) -> str:
        """The quantity in words; each kind of figure defines it."""
        raise NotImplementedError

    @property
    def run(self) -> tuple[Any, ...]:
        """Figures with equal runs, payloads and arguments are read from one simulation."""
        return (self.manoeuvre,)


def _speed_told(speed: float) -> str:
    """A round number of mph or km/h."""
    mph, kmh = speed / _MPH, speed / _KMH
    return f"{mph:.0f} mph" if abs(mph - round(mph)) < 1e-6 else f"{kmh:.4g} km/h"


def _length_told(length: float) -> str:
    feet = length / 0.3048
    return f"{feet:.0f} ft" if abs(feet - round(feet)) < 1e-6 else f"{length:.5g} m"


class TimeToSpeed(_Figure):
    """Full throttle from standstill to a speed."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["time_to_speed"]
    speed: Speed = Field(gt=0, description="that is reached [m/s]")
    rollout: bool = Field(default=False, description="without the time of the first foot [-]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"0 to {_speed_told(self.speed)}{', less the first foot' if self.rollout else ''}"


class TimeToDistance(_Figure):
    """Full throttle from standstill over a distance."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["time_to_distance"]
    distance: Length = Field(default=402.336, gt=0, description="that is covered; a quarter mile if left out [m]")
    rollout: bool = Field(default=False, description="without the first foot and its time [-]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        name = _distance_told(self.distance)
        return f"{name}{', from the first foot on' if self.rollout else ''}"


class SpeedAtDistance(_Figure):
    """Speed after a distance with full throttle from standstill."""

    unit: ClassVar[str] = "m/s"
    manoeuvre: ClassVar[str] = "acceleration"
    quantity: Literal["speed_at_distance"]
    distance: Length = Field(default=402.336, gt=0, description="that is covered; a quarter mile if left out [m]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"Speed after the {_distance_told(self.distance).lower()}"


def _distance_told(distance: float) -> str:
    return "Quarter mile" if abs(distance - 402.336) < 0.01 else f"First {distance:.4g} m"


class TopSpeed(_Figure):
    """Highest speed that full throttle holds."""

    unit: ClassVar[str] = "m/s"
    manoeuvre: ClassVar[str] = "top_speed"
    quantity: Literal["top_speed"]

    @property
    def text(self) -> str:
        """What it is, in words."""
        return "Top speed"


class BrakingDistance(_Figure):
    """Full braking to standstill."""

    unit: ClassVar[str] = "m"
    manoeuvre: ClassVar[str] = "braking"
    quantity: Literal["braking_distance"]
    speed: Speed = Field(gt=0, description="at the start [m/s]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"{_speed_told(self.speed)} to standstill"

    @property
    def run(self) -> tuple[Any, ...]:
        """One a speed."""
        return self.manoeuvre, self.speed


class LateralLimit(_Figure):
    """Highest steady lateral acceleration on a circle, of both turns."""

    unit: ClassVar[str] = "m/s^2"
    manoeuvre: ClassVar[str] = "skidpad"
    quantity: Literal["lateral_limit"]
    diameter: Length = Field(gt=0, description="of the circle [m]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"Lateral acceleration on a circle of {_length_told(self.diameter)}"

    @property
    def run(self) -> tuple[Any, ...]:
        """One a circle."""
        return self.manoeuvre, self.diameter


class CoastTime(_Figure):
    """Coasting in neutral from one speed down to another."""

    unit: ClassVar[str] = "s"
    manoeuvre: ClassVar[str] = "coast_down"
    quantity: Literal["coast_time"]
    first: Speed = Field(gt=0, description="speed at the start [m/s]")
    last: Speed = Field(gt=0, description="speed at the end [m/s]")
    rotating_mass: bool = Field(
        default=True, description="false: the figure was computed as if no wheel or rotor turned, and so is ours [-]"
    )

    @model_validator(mode="after")
    def _falls(self) -> "CoastTime":
        if self.last >= self.first:
            raise ValueError("last should be below first")
        return self

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"Coasting from {_speed_told(self.first)} to {_speed_told(self.last)}"


class RoadLoad(_Figure):
    """Force that rolling resistance and air take at a speed."""

    unit: ClassVar[str] = "N"
    manoeuvre: ClassVar[str] = "coast_down"
    quantity: Literal["road_load"]
    speed: Speed = Field(gt=0, description="at which [m/s]")

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"Road load at {_speed_told(self.speed)}"


Figure = (
    TimeToSpeed | TimeToDistance | SpeedAtDistance | TopSpeed | BrakingDistance | LateralLimit | CoastTime | RoadLoad
)


class PublishedFigures(Schema):
    """published_figures.yaml."""

    variant: str = Field(default="", description="that is driven when the vehicle is named without one [-]")
    payload: Mass = Field(default=0.0, ge=0.0, description="driver and equipment in the tests [kg]")
    payload_source: str = Field(default="", description="where that is from [-]")
    none_because: str = Field(default="", description="why there are no figures [-]")
    notes: list[str] = Field(default_factory=list, description="what a reader should know of all of them [-]")
    figures: list[Annotated[Figure, Field(discriminator="quantity")]] = Field(
        default_factory=list, description="what is known [-]"
    )


def load_published(vehicle: Vehicle) -> PublishedFigures:
    """The published figures of a loaded vehicle.

    Raises:
        ConfigError: it has no such file, or the file is wrong, or it neither has figures nor says why.
    """
    path = vehicle.folder / FILE
    if not path.is_file():
        raise ConfigError(f"{vehicle.name}: has no {FILE}; write what is known of it, see docs/validation.md")
    published = load_yaml(path, PublishedFigures)
    if not published.figures and not published.none_because:
        raise ConfigError(f"{FILE} of {vehicle.name}: no figures; say under none_because why there are none")
    return published
