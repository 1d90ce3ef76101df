"""Gain schedules: gains interpolated linearly over speed, constant beyond the first and last speed.

W. J. Rugh and J. S. Shamma, Research on gain scheduling, Automatica 36 (2000) 1401.
"""

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Schema, Speed


@dataclass(frozen=True)
class GainTable:
    """Table of gains over speed.

    Attributes:
        speeds: speeds [m/s], strictly increasing.
        gains: values of each gain, one per speed, by name.

    Raises:
        ConfigError: the speeds are missing or do not increase, or a gain has another number of values.
    """

    speeds: tuple[float, ...]
    gains: dict[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        if not self.speeds or any(b <= a for a, b in zip(self.speeds, self.speeds[1:], strict=False)):
            raise ConfigError(
                f"schedule.speeds: must increase, got {', '.join(f'{v:g}' for v in self.speeds) or 'none'}"
            )
        for name, values in self.gains.items():
            if len(values) != len(self.speeds):
                raise ConfigError(f"schedule.{name}: {len(self.speeds)} values are needed, got {len(values)}")
            for value in (*values, *self.speeds):
                check_number("schedule", name, value)

    def at(self, speed: float) -> dict[str, float]:
        """Return the gains at a speed [m/s]."""
        after = bisect_right(self.speeds, speed)
        # Beyond the table the gains of its end hold.
        if after in (0, len(self.speeds)):
            return {name: values[max(after - 1, 0)] for name, values in self.gains.items()}
        low, high = self.speeds[after - 1], self.speeds[after]
        part = (speed - low) / (high - low)
        return {
            name: values[after - 1] + part * (values[after] - values[after - 1]) for name, values in self.gains.items()
        }

    def between(self, count: int = 1) -> list[float]:
        """Return `count` evenly spaced speeds [m/s] within each interval of the table."""
        return [
            low + (high - low) * k / (count + 1)
            for low, high in zip(self.speeds, self.speeds[1:], strict=False)
            for k in range(1, count + 1)
        ]

    def data(self) -> list[Json]:
        """Return one row per speed with the keys speed and gains, as plain data."""
        return [{"speed": speed, "gains": self.at(speed)} for speed in self.speeds]


class GainSchedule(Schema):
    """Gains over the measured speed of the car, forward or backward: straight lines between the speeds, held beyond."""

    speeds: list[Annotated[Speed, Field(ge=0)]] = Field(min_length=2, description="[m/s] rising")
    kp: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as kp of the loop")
    ki: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as ki of the loop")
    kd: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as kd of the loop")

    @model_validator(mode="after")
    def _fits(self) -> "GainSchedule":
        if any(not low < high for low, high in pairwise(self.speeds)):
            raise ValueError(f"speeds: must increase, got {', '.join(f'{speed:g}' for speed in self.speeds)}")
        rows = self.rows()
        if not rows:
            raise ValueError("no gain is given; write for example kp: [300, 400], one for each speed")
        for name, values in rows.items():
            if len(values) != len(self.speeds):
                raise ValueError(f"{name}: {len(self.speeds)} values are needed, one for each speed, not {len(values)}")
        return self

    def rows(self) -> dict[str, tuple[float, ...]]:
        """Return the values of each scheduled gain, by name."""
        given = {"kp": self.kp, "ki": self.ki, "kd": self.kd}
        return {name: tuple(values) for name, values in given.items() if values is not None}

    def table(self) -> GainTable:
        """Return the schedule as a table to interpolate in."""
        return GainTable(tuple(self.speeds), self.rows())
