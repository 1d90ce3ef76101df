"""Search of the highest speed at which a test is passed."""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")

_FACTOR = 1.12
"""Ratio of a speed to the one before while the limit is not bracketed [1]."""


class SpeedLimit(NamedTuple, Generic[T]):
    """Result of a search.

    Attributes:
        best: result at the highest speed that passed; None if none did.
        passed: that speed [m/s]; nan if there is none.
        failed: lowest speed that failed [m/s]; inf if none did.
        reason: reason of that failure; if no speed passed, of the failure at the lowest speed.
    """

    best: T | None
    passed: float
    failed: float
    reason: str


def find_highest(
    attempt: Callable[[float], tuple[T | None, str]],
    *,
    lowest: float,
    highest: float,
    guess: float,
    resolution: float,
) -> SpeedLimit[T]:
    """Return the highest speed that passes: steps from a guess until the limit is bracketed, then a bisection.

    Args:
        attempt: returns the result at a speed [m/s], and the reason of a failure; it passed if the text is empty.
        lowest: lowest speed that is tried [m/s].
        highest: highest speed that is tried [m/s].
        guess: first speed that is tried [m/s].
        resolution: width of the bracket at which the search ends [m/s].
    """
    best: T | None = None
    passed, failed, reason = float("nan"), float("inf"), ""
    speed = min(max(guess, lowest), highest)
    while True:
        result, fault = attempt(speed)
        if fault:
            failed, reason = speed, fault
        else:
            best, passed = result, speed

        # No speed has passed yet: go down until one does, or the lowest fails.
        if best is None:
            if speed <= lowest:
                return SpeedLimit(None, passed, failed, reason)
            speed = max(lowest, failed / _FACTOR)
        # No speed has failed yet: go up until one does, or the highest passes.
        elif failed == float("inf"):
            if passed >= highest:
                return SpeedLimit(best, passed, failed, reason)
            speed = min(highest, passed * _FACTOR)
        # The limit is bracketed.
        elif failed - passed <= resolution:
            return SpeedLimit(best, passed, failed, reason)
        else:
            speed = 0.5 * (passed + failed)
