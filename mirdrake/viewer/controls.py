"""Buttons in Meshcat's controls that show and hide layers, and the loop that follows them."""

import time
from collections.abc import Callable, Mapping

from pydrake.geometry import Meshcat

STOP = "Stop"
"""Button that ends :func:`follow_controls`."""

PERIOD = 1.0 / 32.0
"""Time between two readings of the controls [s]."""


class LayerButtons:
    """A button for each layer; each click shows or hides it.

    Args:
        meshcat: Meshcat with the layers.
        keys: key of each button, by the name of its layer.
        shown: whether each layer is visible at first.
        paths: path of each layer in the scene tree.
    """

    def __init__(
        self, meshcat: Meshcat, keys: Mapping[str, str], shown: Mapping[str, bool], paths: Mapping[str, str]
    ) -> None:
        self._meshcat, self._paths = meshcat, paths
        self.shown = dict(shown)
        self._clicks = dict.fromkeys(keys, 0)
        for name, key in keys.items():
            meshcat.AddButton(name, key)

    def follow(self) -> bool:
        """Apply the clicks since the last call; return whether a layer has changed."""
        changed = False
        for name in self._clicks:
            clicks = self._meshcat.GetButtonClicks(name)
            if (clicks - self._clicks[name]) % 2:
                self.shown[name] = not self.shown[name]
                changed = True
            self._clicks[name] = clicks
        if changed:
            self.apply()
        return changed

    def apply(self) -> None:
        """Show and hide the layers."""
        for name, path in self._paths.items():
            self._meshcat.SetProperty(path, "visible", self.shown[name])


def follow_controls(
    meshcat: Meshcat, follow: Callable[[], bool], *, timeout: float | None = None, key: str = "Escape"
) -> None:
    """Call `follow` until the button "Stop" or its key is pressed, or for a time [s]."""
    meshcat.AddButton(STOP, key)
    end = None if timeout is None else time.monotonic() + timeout
    try:
        while meshcat.GetButtonClicks(STOP) < 1 and (end is None or time.monotonic() < end):
            follow()
            time.sleep(PERIOD)
    finally:
        meshcat.DeleteButton(STOP)
