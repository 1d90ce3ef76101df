"""Traction limits of vehicles whose driven axles also brake.

The force of a driven axle is at most friction times its load, and acceleration moves load to the rear axle. With
s = a + g sin θ, the required force per mass, the centre of mass h above the road, l_r ahead of the rear axle and l_f
behind the front axle::

    front axle   |s| ≤ μ g cos θ l_r / (L + μ h)      driving; L - μ h for a backward force
    rear axle    |s| ≤ μ g cos θ l_f / (L - μ h)      driving; L + μ h for a backward force
    both         |s| ≤ μ g cos θ

Source: T. D. Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 2, traction-limited acceleration. Rolling
resistance and drag are neglected, so that the mass has no effect.

A controller needs more than the force of the slope itself. With the dead time τ and feed-forward, the speed lags the
ramp a t by a τ until the control acts, and the proportional part kp (in rad/s) adds kp a τ to the acceleration.
With the rule SIMC and τc = 1.25 τ, Ms is 1.59 and the peak 1.48 times the slope; a loop of a smaller Ms has a smaller
one. A set-point of that slope over the peak, and a reserve of friction, is followed without wheels that slip.
"""

import math
from dataclasses import dataclass

from mirdrake.core.constants import GRAVITY

FORCE_PEAK = 1.5
"""Largest acceleration of a speed loop with dead time at the start of a slope, over the slope, for Ms up to 1.6 [1]."""

FRICTION_RESERVE = 0.1
"""Share of the friction that the slope of a set-point leaves unused [1]."""


def followed_slope(largest: float) -> float:
    """Return the largest slope of the speed's set-point that tuned loops follow without wheels that slip [m/s²].

    Args:
        largest: acceleration that grip or torque of the driven wheels allow [m/s²].
    """
    return (1.0 - FRICTION_RESERVE) / FORCE_PEAK * largest


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
