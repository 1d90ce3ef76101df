"""The world in Meshcat beside the map. Meshcat is used by one thread, as Drake requires.

What draws is imported with the first drawing: it brings the plant, which the page does not need.
"""

from concurrent.futures import ThreadPoolExecutor

from pydrake.geometry import Meshcat

from mirdrake.editor.picture import view_of
from mirdrake.viewer.private_meshcat import Upstream, release
from mirdrake.worlds.world import World

_SCENE = "/drake"  # where Drake draws


class View:
    """Draws worlds into a Meshcat that the page shows in a frame.

    Attributes:
        upstream: connection to it for the server of the page; None before the first drawing.
    """

    def __init__(self) -> None:
        self.upstream: Upstream | None = None
        self._meshcat: Meshcat | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="Meshcat")

    def draw(self, world: World) -> None:
        """Draw a world instead of the one before; the camera stays where the user has put it.

        Raises:
            RunError: Meshcat cannot be started.
        """
        self._thread.submit(self._draw, world).result()

    def close(self) -> None:
        """End Meshcat."""
        self._thread.submit(self._close).result()
        self._thread.shutdown()

    def _draw(self, world: World) -> None:
        from mirdrake.viewer.meshcat import make_meshcat_behind
        from mirdrake.viewer.show import show_world

        if self._meshcat is None:
            self._meshcat, self.upstream = make_meshcat_behind(world=world)
            x0, y0, x1, y1 = view_of(world)
            x, y, size = 0.5 * (x0 + x1), 0.5 * (y0 + y1), max(x1 - x0, 1.6 * (y1 - y0))
            self._meshcat.SetCameraPose([x, y - 0.55 * size, 0.45 * size], [x, y, 0.0])
        self._meshcat.Delete(_SCENE)
        show_world(world, self._meshcat, camera=False)

    def _close(self) -> None:
        if self._meshcat is not None:
            meshcat, self._meshcat = self._meshcat, None
            release(meshcat)
