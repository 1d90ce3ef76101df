"""Traction limits of vehicles whose driven axles also brake.

The force of a driven axle is at most friction times its load, and acceleration moves load to the rear axle. With
s = a + g sin θ, the required force per mass, the centre of mass h above the road, l_r ahead of the rear axle and l_f
behind the front axle::

    front axle   |s| ≤ μ g cos θ l_r / (L + μ h)      driving; L - μ h for a backward force
    rear axle    |s| ≤ μ g cos θ l_f / (L - μ h)      driving; L + μ h for a backward force
    both         |s| ≤ μ g cos θ

Source: T. D. Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 2, traction-limited acceleration. Rolling
resistance and drag are neglected, so that the mass has no effect.
"""

import math
from dataclasses import dataclass

from mirdrake.core.constants import GRAVITY


@dataclass(frozen=True)
class Axles:
    """Position of the centre of mass between the axles, and the driven axles.

    Attributes:
        to_front: distance from the centre of mass forward to the front axle [m].
        to_rear: distance back to the rear axle [m].
        height: of the centre of mass above the road [m].
        front: whether the front axle is driven.
        rear: whether the rear axle is driven.
    """

    to_front: float
    to_rear: float
    height: float
    front: bool
    rear: bool

    def largest(self, friction: float, grade: float, *, backward: bool = False) -> float:
        """Return the largest |a + g sin θ| that the driven axles can provide [m/s²].

        Args:
            friction: coefficient μ [1].
            grade: θ, positive uphill [rad].
            backward: whether the force is backward.
        """
        weight, moved = friction * GRAVITY * math.cos(grade), friction * self.height * (-1.0 if backward else 1.0)
        if self.front and self.rear:
            return weight
        base = self.to_front + self.to_rear
        return weight * (self.to_rear / (base + moved) if self.front else self.to_front / (base - moved))

    def use(self, friction: float, grade: float, acceleration: float) -> float:
        """Return the grip use, the larger one of constant speed and of acceleration [1].

        Args:
            friction: coefficient μ [1].
            grade: θ, positive uphill [rad].
            acceleration: of the set-point, with sign [m/s²].
        """
        required = [GRAVITY * math.sin(grade) + part for part in (0.0, acceleration)]
        return max(abs(force) / self.largest(friction, grade, backward=force < 0.0) for force in required)
