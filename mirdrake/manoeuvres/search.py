"""The highest speed at which something is passed."""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")

_FACTOR = 1.12
"""From one speed to the next while one side of the limit is not known."""


class Found(NamedTuple, Generic[T]):
    """What a search found.

    Attributes:
        best: result at the highest speed that passed; None if none did.
        passed: that speed [m/s]; nan if there is none.
        failed: lowest speed that failed [m/s]; inf if none did.
        why: it failed there; or, if none passed, at the lowest speed.
    """

    best: T | None
    passed: float
    failed: float
    why: str


def find_highest(
    attempt: Callable[[float], tuple[T | None, str]],
    *,
    lowest: float,
    highest: float,
    guess: float,
    resolution: float,
) -> Found[T]:
    """Steps from a guess until the limit is between two speeds, then a bisection.

    Args:
        attempt: from a speed [m/s] to a result and why it failed; empty text: it passed.
        lowest: speed [m/s] below which nothing is tried.
        highest: the same above.
        guess: where to start.
        resolution: at which to end [m/s].
    """
    best: T | None = None
    passed, failed, why = float("nan"), float("inf"), ""
    speed = min(max(guess, lowest), highest)
    while True:
        result, fault = attempt(speed)
        if fault:
            failed, why = speed, fault
        else:
            best, passed = result, speed
        if best is None:
            if speed <= lowest:
                return Found(None, passed, failed, why)
            speed = max(lowest, failed / _FACTOR)
        elif failed == float("inf"):
            if passed >= highest:
                return Found(best, passed, failed, why)
            speed = min(highest, passed * _FACTOR)
        elif failed - passed <= resolution:
            return Found(best, passed, failed, why)
        else:
            speed = 0.5 * (passed + failed)
