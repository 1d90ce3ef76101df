"""The input of the pages of a drive, with a watchdog: without input the vehicle brakes to standstill."""

import threading
from collections.abc import Callable, Mapping
from math import isfinite
from time import monotonic
from typing import Any

from mirdrake.viewer.cockpit.manual import ManualInput

TIMEOUT = 1.0
"""Watchdog timeout: time without a message of the driving page after which its input is lost [s]."""


class InputWatchdog:
    """Manual input of several pages, of which one drives.

    The page with the latest key press drives. When its messages stop, :meth:`read` returns None: the vehicle brakes to
    standstill until a key is pressed again.

    Args:
        clock: returns the time [s].
        timeout: see :data:`TIMEOUT`.
    """

    def __init__(self, *, clock: Callable[[], float] = monotonic, timeout: float = TIMEOUT) -> None:
        self._clock, self._timeout = clock, timeout
        self._lock = threading.Lock()
        self._owner: str | None = None
        self._heard = -1e9
        self._hands = ManualInput()
        self._lost = False
        self.view: str | None = None

    def report(self, page: str, message: Mapping[str, Any]) -> None:
        """Process a message of a page; invalid values count as no input.

        Args:
            page: its name.
            message: throttle, brake, steer, stop, analog, speed, steering, as in :class:`ManualInput`; active: whether
                something is pressed or was moved; hidden: whether the page is in the background; view.
        """
        with self._lock:
            now = self._clock()
            # Another page may take over after the timeout, or at once if its user acts.
            silent = now - self._heard > self._timeout
            if silent and self._owner is not None:
                self._lost = True
            active = message.get("active") is True
            if not (active or page == self._owner or silent):
                return
            self._owner = page
            if message.get("hidden") is True:
                return  # a hidden page gets no key events: the timeout runs
            self._heard = now
            self._hands = _read(message)
            if isinstance(message.get("view"), str):
                self.view = message["view"]
            if active:
                self._lost = False

    def read(self) -> ManualInput | None:
        """Return the input of the driver; None: no driver, brake."""
        with self._lock:
            if self._owner is not None and self._clock() - self._heard > self._timeout:
                self._lost = True
            return None if self._lost or self._owner is None else self._hands

    def release(self) -> None:
        """Release all inputs, after a reset."""
        with self._lock:
            self._hands = ManualInput()

    @property
    def lost(self) -> bool:
        """Whether the input was lost and no page has taken over."""
        with self._lock:
            return self._lost

    @property
    def silence(self) -> float:
        """Time since the last message [s]."""
        with self._lock:
            return self._clock() - self._heard


def _read(message: Mapping[str, Any]) -> ManualInput:
    # Messages come from a network: values of any type and size are possible.
    def number(key: str, low: float, high: float) -> float:
        value = message.get(key)
        # A browser may send anything: NaN or text must not reach the actuators. `True` would count as the number 1.
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            return 0.0
        return min(max(float(value), low), high)

    def slider(key: str) -> float | None:
        return None if message.get(key) is None else number(key, -1e3, 1e3)

    return ManualInput(
        throttle=number("throttle", 0.0, 1.0),
        brake=number("brake", 0.0, 1.0),
        steer=number("steer", -1.0, 1.0),
        stop=message.get("stop") is True,
        speed=slider("speed"),
        steering=slider("steering"),
        analog=message.get("analog") is True,
    )
