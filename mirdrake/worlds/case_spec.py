"""Part of the world language: tests of a world."""

from typing import Annotated, Any

from pydantic import ConfigDict, Field, field_validator

from mirdrake.core.contacts import STUDY_CONTACT, ContactModel
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Duration, Schema, shown_value
from mirdrake.worlds.schema_types import Label


class SearchSpec(Schema):
    """Ranges of parameters in which a search looks for a variation that fails."""

    over: dict[str, tuple[float, float]] = Field(min_length=1, description="lower and upper limit of parameters [-]")
    budget: int = Field(default=50, ge=1, le=100_000, description="number of runs [-]")

    @field_validator("over")
    @classmethod
    def _rising(cls, over: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for name, (low, high) in over.items():
            if not low < high:
                raise ValueError(f"{name}: the lower limit comes first")
        return over


def is_seed(value: Any) -> bool:
    """Return whether a value can be a seed: a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


class OtherSpec(Schema):
    """Another full vehicle of a test, with its driver and its own requirements."""

    vehicle: str = Field(default="bolt", description="name of a vehicle [-]")
    start: str = Field(description="a start of the world [-]")
    goal: str | None = Field(default=None, description="a goal of the world, to which 'at goal' refers [-]")
    behaviour: str | Json = Field(description="a driver as in a diagram file, its kind, or module:Class [-]")
    expect: list[str] = Field(default_factory=list, description="requirements on this vehicle [-]")


class CaseSpec(Schema):
    """A test: a vehicle with a behaviour, and requirements on it."""

    model_config = ConfigDict(populate_by_name=True)

    name: Label = Field(description="its name [-]")
    vehicle: str = Field(default="bolt", description="name of a vehicle [-]")
    start: str | None = Field(default=None, description="a start of the world; default: the first [-]")
    goal: str | None = Field(default=None, description="a goal of the world, to which 'at goal' refers [-]")
    behaviour: str | Json = Field(description="a driver as in a diagram file, its kind, or module:Class [-]")
    duration: Duration = Field(default=30.0, gt=0.0, le=86400.0, description="simulated time [s]")
    contact: ContactModel = Field(default=STUDY_CONTACT, description="contact of the tyres [-]")
    variations: dict[str, int | list[Any]] = Field(
        default_factory=dict, description="values of parameters and of seed; all combinations are run [-]"
    )
    expect: Annotated[list[str], Field(min_length=1)] = Field(description="requirements [-]")
    others: dict[Label, OtherSpec] = Field(default_factory=dict, description="other full vehicles by name [-]")
    search: SearchSpec | None = Field(default=None, description="ranges in which failures are searched [-]")

    @field_validator("variations")
    @classmethod
    def _lists(cls, variations: dict[str, int | list[Any]]) -> dict[str, int | list[Any]]:
        for name, values in variations.items():
            if isinstance(values, list) and not values:
                raise ValueError(f"{name}: the list is empty")
            if isinstance(values, int) and (name != "seed" or not 1 <= values <= 10_000):
                raise ValueError(f"{name}: give a list of values; only seed may be a number of seeds, 1 to 10000")
            if name == "seed" and isinstance(values, list) and not all(map(is_seed, values)):
                raise ValueError("seed: give whole numbers")
            for value in values if isinstance(values, list) else ():
                if isinstance(value, dict | list):
                    raise ValueError(f"{name}: {shown_value(value)} is not a number or a text")
        return variations
