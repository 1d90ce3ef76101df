"""The pace of a drive: simulated time follows the wall clock, and pictures are drawn in the remaining time.

Time slices are due at fixed times. After a slice that ends late, the next ones do not wait until the drive has caught
up. Pictures are less frequent while the drive lags real time, and take at most a share of the time.
"""

import time
from collections.abc import Callable

BEHIND = 0.5
"""Largest delay against the wall clock that the drive catches up [s]; beyond it, simulated time runs slower."""

FRAME = 1.0 / 36.0
"""Least wall-clock time between two pictures [s], a little less than that of two slices."""

LATE = 0.02
"""Delay against the wall clock above which pictures are less frequent [s]."""

SHARE = 0.25
"""Largest share of pictures in the wall-clock time [1]; a fifth of it while the drive lags real time."""


class Pace:
    """Schedule of time slices and pictures.

    Args:
        period: simulated time of a slice [s].
        clock: returns the wall-clock time [s].
        sleep: waits for a time [s].

    Attributes:
        late: delay against the wall clock after the last slice [s]; negative while the drive waits.
        passed: time between the last two pictures [s].
    """

    def __init__(
        self,
        period: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period, self._clock, self._sleep = period, clock, sleep
        self._began, self._cost = clock() - FRAME, 0.0
        self.late = self.passed = 0.0
        self.rest()

    def rest(self) -> None:
        """Restart the schedule now, after a pause."""
        self._due, self.late = self._clock(), 0.0

    def keep(self) -> None:
        """Wait after a slice until the next one is due, if that is in the future."""
        # The schedule advances by the period, not from now: small delays are caught up instead of accumulated.
        self._due += self._period
        self.late = self._clock() - self._due
        if self.late < 0.0:
            self._sleep(-self.late)
        elif self.late > BEHIND:
            # Beyond the limit, the schedule itself is moved; a long pause is not replayed in a rush.
            self._due += self.late - BEHIND

    def draws(self) -> bool:
        """Return whether a picture is due; call :meth:`drew` after it."""
        # The cost of the last picture limits how often the next ones are drawn.
        now, gap = self._clock(), max(FRAME, self._cost / SHARE)
        passed = now - self._began
        if passed < (gap if self.late < LATE else 5.0 * gap):
            return False
        self._began, self.passed = now, passed
        return True

    def drew(self) -> None:
        """Record the time that the picture took."""
        self._cost = self._clock() - self._began
