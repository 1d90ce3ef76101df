"""Intelligent driver model with lane changes by MOBIL (A. Kesting, M. Treiber, D. Helbing, TRR 1999, 2007)."""

import math
from typing import ClassVar, Final, Literal

from pydantic import Field

from mirdrake.actors.behaviours.idm import Idm
from mirdrake.core.yaml_io import Acceleration, Duration
from mirdrake.worlds.pieces import Array

LAW: Final = 2

POLITENESS: Final = 6
THRESHOLD: Final = 7
SAFE: Final = 8
TIME: Final = 9
"""Numbers: p [-], da_th, b_safe [m/s²], duration of a lane change [s]."""


class IdmMobil(Idm):
    """Intelligent driver model with lane changes by MOBIL."""

    law: ClassVar[int] = LAW

    kind: Literal["idm_mobil"] = Field(description="intelligent driver model with lane changes [-]")  # type: ignore[assignment]
    politeness: float = Field(default=0.2, ge=0.0, le=1.0, description="weight of others' accelerations [-]")
    threshold: Acceleration = Field(default=0.15, ge=0.0, le=5.0, description="smallest advantage [m/s²]")
    safe: Acceleration = Field(default=3.0, gt=0.0, le=20.0, description="deceleration that others may need [m/s²]")
    change_time: Duration = Field(default=4.0, gt=0.0, le=60.0, description="duration of a lane change [s]")

    def numbers(self) -> tuple[float, ...]:
        """Return its parameters."""
        return *super().numbers(), self.politeness, self.threshold, self.safe, self.change_time


def mobil(
    numbers: Array, own: float, own_then: float, new: float, new_then: float, old: float, old_then: float
) -> float:
    """Return the advantage of a lane change beyond the threshold [m/s²]; -inf if it is not safe.

    The advantage is ã_c - a_c + p (ã_n - a_n + ã_o - a_o), the change is safe if ã_n >= -b_safe.

    Args:
        numbers: parameters.
        own: acceleration of the actor now [m/s²].
        own_then: after the change.
        new: acceleration of the follower on the new lane now; 0 without one.
        new_then: after the change.
        old: acceleration of the follower on the old lane now; 0 without one.
        old_then: after the change.
    """
    # MOBIL checks the new follower only; here the actor must not brake hard on the new lane, either.
    if new_then < -numbers[SAFE] or own_then < -numbers[SAFE]:
        return -math.inf
    others = new_then - new + old_then - old
    advantage: float = own_then - own + numbers[POLITENESS] * others - numbers[THRESHOLD]
    return advantage


PARTS = (mobil,)
"""Compiled functions of this module."""
