"""Follow a path at the desired speed, without regard to others."""

from typing import ClassVar, Final, Literal

from pydantic import Field

from mirdrake.actors.behaviours.base import LaneBehaviour
from mirdrake.core.yaml_io import Acceleration

LAW: Final = 0

ACCELERATION: Final = 1
DECELERATION: Final = 2
"""Numbers: rates of changes of speed [m/s²]."""


class Follow(LaneBehaviour):
    """Follow the path at the desired speed, without regard to others; stop at its end."""

    law: ClassVar[int] = LAW

    kind: Literal["follow"] = Field(description="without regard to others [-]")
    acceleration: Acceleration = Field(default=2.0, gt=0.0, le=50.0, description="at the start [m/s²]")
    deceleration: Acceleration = Field(default=3.0, gt=0.0, le=50.0, description="at the end of the path [m/s²]")

    def numbers(self) -> tuple[float, ...]:
        """Return its parameters."""
        return self.acceleration, self.deceleration
