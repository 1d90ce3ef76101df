"""The picture of a drive in Meshcat.

It follows the wall clock and is omitted without a viewer or when time is short. The simulated diagram draws nothing and
equals that of `mirdrake run`.
"""

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly
from mirdrake.runs.live_view import LiveView
from mirdrake.viewer.meshcat import ChaseCamera
from mirdrake.viewer.views import View, make_views, set_view


class Picture:
    """Picture of a drive in Meshcat.

    Args:
        meshcat: Meshcat in which it is drawn.
        assembly: simulated diagram.
        name: name of the vehicle that the camera follows.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly, name: str) -> None:
        self._camera, self._view = ChaseCamera(meshcat), LiveView(assembly, meshcat)
        part, self._plant = assembly.parts.vehicles[name], assembly.parts.plant
        self._base = part.base
        self.views = {view.name: view for view in make_views(part.vehicle)}
        self.view: View = next(iter(self.views.values()))
        set_view(meshcat, self.view)

    def look(self, name: str) -> None:
        """Select a view; the page moves the camera, here only its turning rate changes."""
        self.view = self.views.get(name, self.view)

    def forget(self) -> None:
        """Turn the camera to the vehicle at once, after a jump of the vehicle."""
        self._camera.forget()

    def draw(self, context: Context, *, passed: float) -> None:
        """Draw the present state.

        Args:
            context: context of the simulated diagram.
            passed: time since the last picture [s].
        """
        self._view.draw(context)
        X_WB = self._plant.EvalBodyPoseInWorld(self._plant.GetMyContextFromRoot(context), self._base)
        self._camera.follow(X_WB, elapsed=passed, lag=self.view.lag)
