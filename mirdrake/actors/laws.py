"""Accelerations of actors by the laws of their behaviours."""

import math

from mirdrake.actors.behaviours import follow, idm, idm_mobil
from mirdrake.actors.motion import approach
from mirdrake.worlds.pieces import Array


def acceleration(law: int, numbers: Array, speed: float, desired: float, gap: float, ahead: float, dt: float) -> float:
    """Return the acceleration of an actor [m/s²], before its limit.

    Args:
        law: number of the law.
        numbers: parameters of the behaviour.
        speed: present speed [m/s].
        desired: desired speed [m/s].
        gap: distance to the object ahead [m]; infinite without one.
        ahead: its speed [m/s].
        dt: time step [s].
    """
    if law == follow.LAW:
        rate = numbers[follow.ACCELERATION] if desired > speed else numbers[follow.DECELERATION]
        after, _ = approach(speed, desired, rate, dt)
        return (after - speed) / dt
    return idm.idm(numbers, speed, desired, gap, ahead)


def sees(law: int) -> bool:
    """Return whether a law depends on other objects."""
    return law == idm.LAW or law == idm_mobil.LAW


def stopping_distance(law: int, numbers: Array, speed: float) -> float:
    """Return the distance of a comfortable stop [m]."""
    deceleration = numbers[follow.DECELERATION] if law == follow.LAW else numbers[idm.DECELERATION]
    distance: float = 0.5 * speed * speed / deceleration
    return distance


def at_end(law: int, numbers: Array, speed: float, desired: float, rest: float) -> float:
    """Return the largest acceleration before the end of a lane that has no successor [m/s²].

    Args:
        law: number of the law.
        numbers: parameters of the behaviour.
        speed: present speed [m/s].
        desired: desired speed [m/s].
        rest: distance to the end [m].
    """
    if law == follow.LAW:
        # Constant speed until the needed deceleration has reached the comfortable one; then it stops at the end.
        needed = 0.5 * speed * speed / max(rest, 1e-9)
        return -needed if needed >= numbers[follow.DECELERATION] or rest <= 0.0 else math.inf
    # The end as a standing obstacle; the standstill gap is added because the end itself may be reached.
    return idm.idm(numbers, speed, desired, rest + numbers[idm.STANDSTILL], 0.0)


PARTS = (acceleration, sees, stopping_distance, at_end, *idm.PARTS, *idm_mobil.PARTS)
"""Compiled functions of this module."""
