"""Intelligent driver model: follow the object ahead (M. Treiber, A. Hennecke, D. Helbing, Phys. Rev. E 62, 2000)."""

import math
from typing import ClassVar, Final, Literal

from pydantic import Field

from mirdrake.actors.behaviours.base import LaneBehaviour
from mirdrake.core.yaml_io import Acceleration, Duration, Length
from mirdrake.worlds.pieces import Array

LAW: Final = 1

ACCELERATION: Final = 1
DECELERATION: Final = 2
HEADWAY: Final = 3
STANDSTILL: Final = 4
EXPONENT: Final = 5
"""Numbers: a, b [m/s²], T [s], s0 [m], delta [-]."""

_TIGHT = 0.01  # [m] smallest gap in the formula


class Idm(LaneBehaviour):
    """Intelligent driver model; the defaults are the values of its author for cars."""

    law: ClassVar[int] = LAW

    kind: Literal["idm"] = Field(description="intelligent driver model [-]")
    acceleration: Acceleration = Field(default=1.0, gt=0.0, le=20.0, description="largest acceleration a [m/s²]")
    deceleration: Acceleration = Field(default=3.0, gt=0.0, le=20.0, description="comfortable deceleration b [m/s²]")
    headway: Duration = Field(default=1.8, ge=0.0, le=10.0, description="time headway T [s]")
    standstill: Length = Field(default=2.0, gt=0.0, le=50.0, description="gap at standstill s0 [m]")
    exponent: float = Field(default=4.0, gt=0.0, le=20.0, description="exponent of the speed [-]")

    def numbers(self) -> tuple[float, ...]:
        """Return its parameters."""
        return self.acceleration, self.deceleration, self.headway, self.standstill, self.exponent


def idm(numbers: Array, speed: float, desired: float, gap: float, ahead: float) -> float:
    """Return the acceleration [m/s²].

    a (1 - (v/v0)^delta - (s*/s)²) with s* = s0 + max(0, v T + v dv / (2 sqrt(a b))).

    Args:
        numbers: parameters.
        speed: v [m/s].
        desired: v0 [m/s].
        gap: s to the object ahead [m], infinite without one.
        ahead: speed of that object [m/s].
    """
    a, b = numbers[ACCELERATION], numbers[DECELERATION]
    dynamic = speed * numbers[HEADWAY] + speed * (speed - ahead) / (2.0 * math.sqrt(a * b))
    wish = numbers[STANDSTILL] + max(0.0, dynamic)
    # A set-point of zero would divide by zero; this term makes it brake, harder at higher speed.
    free = (speed / desired) ** numbers[EXPONENT] if desired > 0.0 else 1.0 + speed
    # A lower bound: a negative gap would brake less, the more two objects overlap.
    near = wish / max(gap, _TIGHT)
    acceleration: float = a * (1.0 - free - near * near)
    return acceleration


PARTS = (idm,)
"""Compiled functions of this module."""
