"""Checks that a manoeuvre is within the limits of a vehicle; they raise NotFeasible with the reason in one line."""

import math

from mirdrake.manoeuvres.base import NotFeasible, Outcome
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.metrics.straight import KMH

_POWER_MARGIN = 1.02


def check_speed(facts: Facts, speed: float) -> None:
    """Reject a speed [m/s] above the top speed."""
    if speed > facts.top_speed / _POWER_MARGIN:
        raise NotFeasible(
            f"the speed of {speed / KMH:.0f} km/h is above the top speed of {facts.top_speed / KMH:.0f} km/h; "
            "set a lower speed"
        )


def check_steering(facts: Facts, angle: float, *, what: str) -> None:
    """Reject an angle of the road wheels [rad] beyond the limit of the steering."""
    if abs(angle) > facts.steering_limit:
        raise NotFeasible(
            f"{what} needs {math.degrees(abs(angle)):.1f} deg at the road wheels; the limit of the steering is "
            f"{math.degrees(facts.steering_limit):.1f} deg"
        )


def check_rate(facts: Facts, rate: float, *, what: str) -> None:
    """Reject a rate at the road wheels [rad/s] beyond the limit of the steering."""
    if abs(rate) > facts.steering_rate * 1.001:
        raise NotFeasible(
            f"{what} needs {math.degrees(abs(rate)):.0f} deg/s at the road wheels; the limit of the steering is "
            f"{math.degrees(facts.steering_rate):.0f} deg/s"
        )


def check_entry(speed: float, required: float, tolerance: float, *, where: str) -> None:
    """Reject a run whose speed [m/s] differs from the required one by more than the tolerance [m/s]."""
    if not abs(speed - required) <= tolerance:
        raise NotFeasible(
            f"the speed {where} was {speed / KMH:.1f} km/h; {required / KMH:.1f} ± {tolerance / KMH:.1f} km/h "
            "are required"
        )


def note_held_speed(outcome: Outcome, *, pedals: bool) -> None:
    """Add a note that a vehicle without pedals cannot coast."""
    if not pedals:
        outcome.notes.append(
            "the vehicle has no pedals (wheel_speed.kind in control.yaml is not pedals): it holds the speed instead of "
            "coasting"
        )
