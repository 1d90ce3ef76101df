"""Whether a vehicle reaches what a manoeuvre asks for; if not, why, in one line."""

import math

from mirdrake.manoeuvres.base import NotFeasible, Outcome
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.metrics.straight import KMH

_POWER_MARGIN = 1.02


def check_speed(facts: Facts, speed: float) -> None:
    """Refuse a speed that the motor cannot hold on the flat."""
    if speed > facts.top_speed / _POWER_MARGIN:
        raise NotFeasible(
            f"{speed / KMH:.0f} km/h is asked for, but its motor holds {facts.top_speed / KMH:.0f} km/h at most; "
            "set a lower speed"
        )


def check_steering(facts: Facts, angle: float, *, what: str) -> None:
    """Refuse an angle [rad] of the road wheels beyond the steering's limit."""
    if abs(angle) > facts.steering_limit:
        raise NotFeasible(
            f"{what} needs {math.degrees(abs(angle)):.1f} deg at the road wheels, but its steering ends at "
            f"{math.degrees(facts.steering_limit):.1f} deg"
        )


def check_rate(facts: Facts, rate: float, *, what: str) -> None:
    """Refuse a rate [rad/s] at the road wheels beyond the steering's limit."""
    if abs(rate) > facts.steering_rate * 1.001:
        raise NotFeasible(
            f"{what} needs {math.degrees(abs(rate)):.0f} deg/s at the road wheels, but its steering turns at "
            f"{math.degrees(facts.steering_rate):.0f} deg/s at most"
        )


def check_entry(speed: float, wanted: float, tolerance: float, *, where: str) -> None:
    """Refuse a run whose speed [m/s] was not what is asked for."""
    if not abs(speed - wanted) <= tolerance:
        raise NotFeasible(
            f"{wanted / KMH:.1f} ± {tolerance / KMH:.1f} km/h are asked for {where}, but it had {speed / KMH:.1f} km/h"
        )


def note_held_speed(outcome: Outcome, *, pedals: bool) -> None:
    """Say that a vehicle without pedals cannot coast."""
    if not pedals:
        outcome.notes.append(
            "it has no pedals (control.yaml: no wheel_speed of kind pedals): the speed is held in place of coasting"
        )
