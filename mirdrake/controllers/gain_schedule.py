"""Gains over speed: straight lines between the speeds of a table, held beyond them.

W. J. Rugh and J. S. Shamma, Research on gain scheduling, Automatica 36 (2000) 1401.
"""

from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.vehicles.spec import GainSchedule


@dataclass(frozen=True)
class GainTable:
    """Gains over speed.

    Attributes:
        speeds: [m/s], rising.
        gains: values of each gain, one per speed, by name.

    Raises:
        ConfigError: no speed, speeds that do not rise, or rows of other lengths.
    """

    speeds: tuple[float, ...]
    gains: dict[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        if not self.speeds or any(b <= a for a, b in zip(self.speeds, self.speeds[1:], strict=False)):
            raise ConfigError(f"schedule.speeds: must rise, got {', '.join(f'{v:g}' for v in self.speeds) or 'none'}")
        for name, values in self.gains.items():
            if len(values) != len(self.speeds):
                raise ConfigError(f"schedule.{name}: {len(self.speeds)} values are needed, got {len(values)}")
            for value in (*values, *self.speeds):
                check_number("schedule", name, value)

    def at(self, speed: float) -> dict[str, float]:
        """Gains at a speed [m/s]: on straight lines between the speeds, held beyond them."""
        after = bisect_right(self.speeds, speed)
        if after in (0, len(self.speeds)):
            return {name: values[max(after - 1, 0)] for name, values in self.gains.items()}
        low, high = self.speeds[after - 1], self.speeds[after]
        part = (speed - low) / (high - low)
        return {
            name: values[after - 1] + part * (values[after] - values[after - 1]) for name, values in self.gains.items()
        }

    def between(self, count: int = 1) -> list[float]:
        """Speeds between those of the table, so many in each gap, evenly [m/s]."""
        return [
            low + (high - low) * k / (count + 1)
            for low, high in zip(self.speeds, self.speeds[1:], strict=False)
            for k in range(1, count + 1)
        ]

    def data(self) -> list[dict[str, Any]]:
        """A row a speed, as plain data: speed and gains."""
        return [{"speed": speed, "gains": self.at(speed)} for speed in self.speeds]


def read_schedule(given: GainSchedule | None) -> GainTable | None:
    """The table of a loop in control.yaml; None if it has none."""
    return None if given is None else GainTable(tuple(given.speeds), given.rows())
