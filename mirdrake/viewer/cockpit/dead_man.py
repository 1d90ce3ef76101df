"""Who drives, and whether somebody still does: the input of pages, with a dead-man."""

import threading
from collections.abc import Callable, Mapping
from math import isfinite
from time import monotonic
from typing import Any

from mirdrake.viewer.cockpit.hands import Hands

TIMEOUT = 1.0
"""Time without a word of the page that drives, after which its input counts as lost [s]."""


class Wheel:
    """The place behind the wheel: pages report what hands do, one of them drives.

    The page that last pressed something drives. When it falls silent the vehicle is braked to a stand
    (:meth:`hands` gives None), and stays so until somebody presses something again.

    Args:
        clock: seconds, rising.
        timeout: see :data:`TIMEOUT`.
    """

    def __init__(self, *, clock: Callable[[], float] = monotonic, timeout: float = TIMEOUT) -> None:
        self._clock, self._timeout = clock, timeout
        self._lock = threading.Lock()
        self._owner: str | None = None
        self._heard = -1e9
        self._hands = Hands()
        self._lost = False
        self.view: str | None = None

    def report(self, page: str, message: Mapping[str, Any]) -> None:
        """Take in what a page says; nonsense counts as nothing pressed.

        Args:
            page: which one.
            message: throttle, brake, steer, stop, analog, speed, steering, as in :class:`Hands`; active: whether
                something is pressed or was moved; hidden: the page cannot see or hear its user; view.
        """
        with self._lock:
            now = self._clock()
            silent = now - self._heard > self._timeout
            if silent and self._owner is not None:
                self._lost = True
            active = message.get("active") is True
            if not (active or page == self._owner or silent):
                return
            self._owner = page
            if message.get("hidden") is True:
                return  # no word: the dead-man counts
            self._heard = now
            self._hands = _read(message)
            if isinstance(message.get("view"), str):
                self.view = message["view"]
            if active:
                self._lost = False

    def hands(self) -> Hands | None:
        """What hands do; None: nobody drives, brake."""
        with self._lock:
            if self._owner is not None and self._clock() - self._heard > self._timeout:
                self._lost = True
            return None if self._lost or self._owner is None else self._hands

    def let_go(self) -> None:
        """Forget what is pressed, after a reset."""
        with self._lock:
            self._hands = Hands()

    @property
    def lost(self) -> bool:
        """Whether the input was lost and nobody has taken over."""
        with self._lock:
            return self._lost

    @property
    def silence(self) -> float:
        """Time since a page was heard [s]."""
        with self._lock:
            return self._clock() - self._heard


def _read(message: Mapping[str, Any]) -> Hands:
    def number(key: str, low: float, high: float) -> float:
        value = message.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            return 0.0
        return min(max(float(value), low), high)

    def slider(key: str) -> float | None:
        return None if message.get(key) is None else number(key, -1e3, 1e3)

    return Hands(
        throttle=number("throttle", 0.0, 1.0),
        brake=number("brake", 0.0, 1.0),
        steer=number("steer", -1.0, 1.0),
        stop=message.get("stop") is True,
        speed=slider("speed"),
        steering=slider("steering"),
        analog=message.get("analog") is True,
    )
