"""Pedestrians: social force (D. Helbing, P. Molnár, Phys. Rev. E 51, 1995), and gap acceptance at crossings."""

import math
from typing import ClassVar, Final, Literal

from pydantic import Field

from mirdrake.actors.behaviours.base import LaneBehaviour
from mirdrake.core.yaml_io import Duration, Length
from mirdrake.worlds.pieces import Array

LAW: Final = 3

RELAXATION: Final = 1
STRENGTH: Final = 2
RANGE: Final = 3
CRITICAL: Final = 4
BEGIN: Final = 5
END: Final = 6
"""Numbers: relaxation time [s], strength of the repulsion over its range [m/s²], range [m], critical gap [s]; begin and
end of the first road on the path [m], equal without one."""


class Walk(LaneBehaviour):
    """Walk along a path, keep away from others, and cross a road when the gap to each vehicle is long enough."""

    law: ClassVar[int] = LAW

    kind: Literal["walk"] = Field(description="social force with gap acceptance [-]")
    relaxation: Duration = Field(default=0.5, gt=0.0, le=10.0, description="time to reach the desired velocity [s]")
    strength: float = Field(default=2.1, ge=0.0, le=100.0, description="repulsive potential of others [m²/s²]")
    range: Length = Field(default=0.3, gt=0.0, le=10.0, description="range of the repulsion [m]")
    critical_gap: Duration = Field(
        default=4.0, ge=0.0, le=30.0, description="time until a vehicle arrives that is enough to cross [s]"
    )

    def numbers(self) -> tuple[float, ...]:
        """Return its parameters."""
        return self.relaxation, self.strength / self.range, self.range, self.critical_gap


def repulsion(numbers: Array, dx: float, dy: float, contact: float) -> tuple[float, float]:
    """Return the acceleration by one other person [m/s²]: (A/B) exp((r - d)/B) away from it.

    Args:
        numbers: parameters.
        dx: from the other to this person [m].
        dy: see `dx`.
        contact: r, sum of both radii [m].
    """
    distance = math.hypot(dx, dy)
    # No direction at the same place; beyond ten ranges the force is below 1/20000 of its strength.
    if distance < 1e-6 or distance > contact + 10.0 * numbers[RANGE]:
        return 0.0, 0.0
    # The exponent is limited: where circles overlap, the force stays finite and the time step stable.
    size = numbers[STRENGTH] * math.exp(min((contact - distance) / numbers[RANGE], 3.0))
    return size * dx / distance, size * dy / distance


def arrives_within(
    x: float, y: float, heading: float, half: float, px: float, py: float, vx: float, vy: float, time: float
) -> bool:
    """Return whether an object at (px, py) with a velocity passes a part of a path within a time.

    Args:
        x: middle of the part in the world [m].
        y: see `x`.
        heading: direction of the path [rad].
        half: half the length of the part [m].
        px: position of the object [m].
        py: see `px`.
        vx: its velocity [m/s].
        vy: see `vx`.
        time: [s].
    """
    cosine, sine = math.cos(heading), math.sin(heading)
    along, aside = (px - x) * cosine + (py - y) * sine, (py - y) * cosine - (px - x) * sine
    rate, forward = vy * cosine - vx * sine, vx * cosine + vy * sine

    # Parallel to the path, or moving away from it: it never arrives.
    if rate == 0.0 or aside * rate > 0.0:
        return False
    arrival = -aside / rate
    # Where it crosses the line of the path must be within the part, else it passes in front or behind.
    return arrival <= time and abs(along + forward * arrival) <= half


PARTS = (repulsion, arrives_within)
"""Compiled functions of this module."""
