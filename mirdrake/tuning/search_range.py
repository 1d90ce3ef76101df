"""Range in which a gain is searched."""

from dataclasses import dataclass
from typing import Literal

from mirdrake.studies.spec import ParameterSpec


@dataclass(frozen=True)
class Range:
    """Range of a gain.

    Attributes:
        low: lower end [of the gain].
        high: upper end [of the gain].
        scale: how it is divided.
    """

    low: float
    high: float
    scale: Literal["linear", "log"] = "log"

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def parameter(self, count: int | None = None) -> ParameterSpec:
        """Return it as a parameter of a search; `count`: values on a grid."""
        return ParameterSpec(low=self.low, high=self.high, scale=self.scale, count=count)


Space = dict[str, Range]
"""Ranges by gain."""
