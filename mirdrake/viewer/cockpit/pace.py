"""The pace of a drive: simulated time keeps up with the wall clock, and pictures are drawn where time is left.

Slices of time are due at fixed moments, not some time after each other. So a slice that ends late is made good by the
next ones, which do not wait. Pictures get rare while the drive is late, and never take more than a part of the time.
"""

import time
from collections.abc import Callable

BEHIND = 0.5
"""So far behind the wall clock, the drive gives up catching up: time goes slower, nothing jumps further [s]."""

FRAME = 1.0 / 36.0
"""Wall-clock time between two pictures, where there is time [s]; a little less than that of two slices."""

LATE = 0.02
"""So far behind the wall clock, pictures are left out [s]."""

SHARE = 0.25
"""The most of the wall-clock time that pictures take; a fifth of it while the drive is late."""


class Pace:
    """When the next slice of simulated time is due, and when a picture may be drawn.

    Args:
        period: simulated time of a slice [s].
        clock: wall clock, rising [s].
        sleep: waits for so long [s].

    Attributes:
        late: how far the drive was behind the wall clock after the last slice [s]; negative while it waits.
        passed: from the beginning of the last picture but one to that of the last one [s].
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
        """Time stood still until now; nothing is due for it."""
        self._due, self.late = self._clock(), 0.0

    def keep(self) -> None:
        """A slice was simulated: wait until the next one is due, or do not where that has passed."""
        self._due += self._period
        self.late = self._clock() - self._due
        if self.late < 0.0:
            self._sleep(-self.late)
        elif self.late > BEHIND:
            self._due += self.late - BEHIND

    def draws(self) -> bool:
        """Whether there is time for a picture now; :meth:`drew` is to be called after it."""
        now, gap = self._clock(), max(FRAME, self._cost / SHARE)
        passed = now - self._began
        if passed < (gap if self.late < LATE else 5.0 * gap):
            return False
        self._began, self.passed = now, passed
        return True

    def drew(self) -> None:
        """The picture was drawn."""
        self._cost = self._clock() - self._began
