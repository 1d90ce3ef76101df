"""What the trial of a speed loop asks of the tyres, over what they can give: above 1 no gains can do it.

A driven axle pushes with friction times its load, and load moves to the rear axle with the push. With s = a + g sin θ,
the push needed per mass, the centre of mass h above the road, l_r ahead of the rear axle, l_f behind the front::

    front axle   |s| ≤ μ g cos θ l_r / (L + μ h)      uphill; L - μ h when the push is backward
    rear axle    |s| ≤ μ g cos θ l_f / (L - μ h)      uphill; L + μ h when the push is backward
    both         |s| ≤ μ g cos θ

Source: T. D. Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 2, traction-limited acceleration. Rolling
resistance and air are left out: mass does not matter then.
"""

import math
from dataclasses import dataclass

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.bench import PlantBench


@dataclass(frozen=True)
class Axles:
    """Where the load of a car stands.

    Attributes:
        to_front: from the centre of mass forward to the front axle [m].
        to_rear: back to the rear axle [m].
        height: of the centre of mass above the road [m].
        front: whether the front axle is driven.
        rear: whether the rear axle is.
    """

    to_front: float
    to_rear: float
    height: float
    front: bool
    rear: bool

    def most(self, friction: float, grade: float, *, backward: bool = False) -> float:
        """Largest |a + g sin θ| that the driven axles can give [m/s²].

        Args:
            friction: coefficient μ [1].
            grade: θ, positive uphill [rad].
            backward: whether they push backward.
        """
        weight, moved = friction * GRAVITY * math.cos(grade), friction * self.height * (-1.0 if backward else 1.0)
        if self.front and self.rear:
            return weight
        base = self.to_front + self.to_rear
        return weight * (self.to_rear / (base + moved) if self.front else self.to_front / (base - moved))

    def use(self, friction: float, grade: float, acceleration: float) -> float:
        """What is asked over what can be given, the larger of holding the speed and of accelerating [1].

        Args:
            friction: see :meth:`most`.
            grade: see :meth:`most`.
            acceleration: of the set-point, with sign [m/s²].
        """
        asked = [GRAVITY * math.sin(grade) + part for part in (0.0, acceleration)]
        return max(abs(one) / self.most(friction, grade, backward=one < 0.0) for one in asked)


def axles_of(bench: PlantBench) -> Axles:
    """Axles of the vehicle on a bench, as it stands."""
    plant, part = bench.assembly.parts.plant, bench.part
    context = plant.CreateDefaultContext()
    centre = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])
    hubs = [plant.EvalBodyPoseInWorld(context, joint.child_body()).translation() for joint in part.wheels]
    front, rear = np.mean(hubs[:2], axis=0), np.mean(hubs[2:], axis=0)
    road = front[2] - part.rolling_radii(plant)[0]
    driven = part.vehicle.spec.drive
    return Axles(
        to_front=float(front[0] - centre[0]),
        to_rear=float(centre[0] - rear[0]),
        height=float(centre[2] - road),
        front=driven != "rear",
        rear=driven != "front",
    )


def grip_use(axles: Axles, loop: LoopSpec, conditions: Conditions) -> float:
    """What the trial of a speed loop asks of the tyres under conditions, over what they can give [1]."""
    limits = loop.diagram["vehicles"][loop.vehicle]["control"]["speed"]
    slope = limits["max_acceleration"] if loop.course["step"] > 0.0 else -limits["max_deceleration"]
    friction = loop.nominal["friction"] if conditions.friction is None else conditions.friction
    return axles.use(friction, conditions.grade, slope)
