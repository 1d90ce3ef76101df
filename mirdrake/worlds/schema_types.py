"""Types that the parts of the world language share."""

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, PlainValidator

from mirdrake.core.yaml_io import Schema, shown_value

LARGEST_COUNT = 20_000
"""Largest number of props in a world."""


def _value(value: Any) -> float | int | str:
    if isinstance(value, bool) or not isinstance(value, float | int | str):
        raise ValueError(f"{shown_value(value)} is not a number or a text such as '0 .. 3'")
    if isinstance(value, str) and not value.strip():
        raise ValueError("is empty")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    return value


Value = Annotated[float | int | str, PlainValidator(_value, json_schema_input_type=float | str)]
"""A number, or an expression of :mod:`mirdrake.worlds.values`."""

Pair = Annotated[list[Value], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Value], Field(min_length=3, max_length=3)]
Label = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
SurfaceName = Literal["asphalt", "concrete", "grass", "gravel", "ice"]


def origin() -> list[float | int | str]:
    """Return the default position (0, 0)."""
    return [0.0, 0.0]


def kinds_of(schema: type[Schema], base: type) -> tuple[str, ...]:
    """Return the names of the fields of a schema whose type is derived from `base`.

    The fields are the registry of the kinds: a new kind is one class and one field.
    """
    return tuple(
        name
        for name, field in schema.model_fields.items()
        if any(isinstance(part, type) and issubclass(part, base) for part in get_args(field.annotation))
    )


def exactly_one(spec: Schema, names: tuple[str, ...]) -> None:
    """Raise an error unless exactly one of the fields is given.

    Raises:
        ValueError: none or several of them are given.
    """
    given = [name for name in names if getattr(spec, name) is not None]
    if len(given) != 1:
        allowed = ", ".join(name.rstrip("_") for name in names[:-1])
        hint = f"; given are {' and '.join(given)}" if given else ""
        raise ValueError(f"give exactly one of {allowed} and {names[-1]}{hint}")


def given_one(spec: Schema, names: tuple[str, ...]) -> Any:
    """Return the value of the one field that is given."""
    return next(value for name in names if (value := getattr(spec, name)) is not None)
