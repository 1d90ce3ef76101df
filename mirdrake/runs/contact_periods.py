"""Begin and end of the contacts of two objects in the samples of a run."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


class ContactPeriods:
    """Contact periods of a pair, block by block.

    A shorter gap than ``APART`` belongs to the period, so objects that rattle against each other are one contact. After
    ``MOST`` periods nothing more is reported.
    """

    APART: ClassVar[float] = 0.5  # [s]
    MOST: ClassVar[int] = 20
    FIRST: ClassVar[str] = "begins"

    def __init__(self) -> None:
        self._count = 0
        self._began = self._last = 0.0
        self._open = False

    def look(self, times: NDArray[np.float64], touches: NDArray[np.bool_]) -> Iterator[tuple[float, str]]:
        """Return the times at which contacts begin or end, with the text of each.

        Args:
            times: times of the samples (n) [s].
            touches: whether the objects touch at these times (n).
        """
        if not len(times):
            return
        for time in times[touches].tolist():
            # A gap since the last sample has ended the contact before.
            yield from self._end(time)
            if not self._open:
                self._count += 1
                self._began, self._open = time, True
                if self._count <= self.MOST:
                    yield time, self.FIRST if self._count == 1 else f"begins again ({self._count})"
                elif self._count == self.MOST + 1:
                    yield time, "begins again; later contacts of the pair are not listed"
            self._last = time
        yield from self._end(float(times[-1]))

    def _end(self, time: float) -> Iterator[tuple[float, str]]:
        """Close the period if its last contact is long ago."""
        if self._open and time - self._last > self.APART:
            self._open = False
            if self._count <= self.MOST:
                yield self._last, f"ends after {max(self._last - self._began, 0.0):.2f} s"
