"""Search of the highest speed at which a test is passed."""

import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from mirdrake.manoeuvres.base import Diverged
from mirdrake.manoeuvres.metrics.straight import KMH

T = TypeVar("T")

Attempt = tuple[T | None, str]
"""Result of a run at a speed [m/s], and the reason of its failure; it passed if the text is empty."""

_FACTOR = 1.12
"""Ratio of a speed to the one before while the limit is not bracketed [1]."""


class SpeedLimit(NamedTuple, Generic[T]):
    """Result of a search.

    Attributes:
        best: result at the highest speed below the first failure; None if no speed passed.
        passed: that speed [m/s]; nan if there is none. All speeds that were checked below it passed.
        failed: lowest speed that failed [m/s]; inf if none did.
        reason: reason of that failure; if no speed passed, of the failure at the lowest speed.
    """

    best: T | None
    passed: float
    failed: float
    reason: str


def speed_label(speed: float) -> str:
    """Return the name of the run at a speed [m/s], and of its folder."""
    return f"v{speed / KMH:.2f}kmh"


def once_per_label(attempt: Callable[[float], Attempt[T]]) -> Callable[[float], Attempt[T]]:
    """Return a function that attempts one of all speeds with the same label: they are one run with one folder.

    A run that diverges has failed, with the error as its reason.
    """
    tried: dict[str, Attempt[T]] = {}

    def once(speed: float) -> Attempt[T]:
        label = speed_label(speed)
        if label not in tried:
            try:
                tried[label] = attempt(speed)
            except Diverged as error:
                tried[label] = None, str(error)
        return tried[label]

    return once


def find_highest(
    attempt: Callable[[float], Attempt[T]],
    *,
    lowest: float,
    highest: float,
    guess: float,
    resolution: float,
    check: float = 0.0,
    step: float = 1.0,
) -> SpeedLimit[T]:
    """Return the highest speed below the first failure.

    The speed changes in steps from a guess until the limit is bracketed; a bisection follows. At the limit of grip a
    vehicle may pass by chance at a speed above one that fails. The speeds of a range below the result are therefore
    tried in increasing order. If one fails, the search continues below it.

    Args:
        attempt: see :data:`Attempt`; made by :func:`once_per_label`, as speeds may repeat.
        lowest: lowest speed that is tried [m/s].
        highest: highest speed that is tried [m/s].
        guess: first speed that is tried [m/s].
        resolution: width of the bracket at which the bisection ends [m/s].
        check: range below the result in which all speeds must pass [m/s].
        step: difference of the speeds in this range [m/s].
    """
    limit = _bisect(attempt, SpeedLimit(None, math.nan, math.inf, ""), (lowest, highest), guess, resolution)
    while limit.best is not None:
        below, reason = SpeedLimit[T](None, math.nan, limit.failed, limit.reason), ""
        # The speeds are multiples of the step, so that they do not depend on the bisection.
        first, last = (math.ceil(speed / step) for speed in (max(limit.passed - check, lowest), limit.passed))
        for number in range(first, last):
            speed = number * step
            result, reason = attempt(speed)
            if reason:
                below = below._replace(failed=speed, reason=reason)
                break
            below = below._replace(best=result, passed=speed)
        if not reason:
            break
        limit = _bisect(attempt, below, (lowest, highest), below.failed, resolution)
    return limit


def _bisect(
    attempt: Callable[[float], Attempt[T]],
    known: SpeedLimit[T],
    bounds: tuple[float, float],
    guess: float,
    resolution: float,
) -> SpeedLimit[T]:
    """Return a speed that passes and one that fails, closer than the resolution.

    Args:
        attempt: as in :func:`find_highest`.
        known: speeds that are known to pass and to fail.
        bounds: lowest and highest speed that are tried [m/s].
        guess: first speed that is tried if none is known [m/s].
        resolution: largest difference of the two speeds [m/s].
    """
    (best, passed, failed, reason), (lowest, highest) = known, bounds
    speed = min(max(guess, lowest), highest)
    while True:
        # No speed has passed yet: go down until one does, or the lowest fails.
        if best is None and failed < math.inf:
            if failed <= lowest:
                return SpeedLimit(None, passed, failed, reason)
            speed = max(lowest, failed / _FACTOR)
        # No speed has failed yet: go up until one does, or the highest passes.
        elif best is not None and failed == math.inf:
            if passed >= highest:
                return SpeedLimit(best, passed, failed, reason)
            speed = min(highest, passed * _FACTOR)
        # The limit is bracketed.
        elif best is not None:
            if failed - passed <= resolution:
                return SpeedLimit(best, passed, failed, reason)
            speed = 0.5 * (passed + failed)

        result, fault = attempt(speed)
        if fault:
            failed, reason = speed, fault
        else:
            best, passed = result, speed
