"""The picture of a drive: a second plant with the pose of the simulated one.

The picture follows the wall clock and is omitted without a viewer or when time is short. The simulated diagram draws
nothing and equals that of `mirdrake run`.
"""

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.framework import Context, DiagramBuilder

from mirdrake.assembly.diagram import Assembly
from mirdrake.plant.plant import make_plant
from mirdrake.viewer.meshcat import ChaseCamera
from mirdrake.viewer.views import View, make_views, set_view


class Picture:
    """The picture of a drive in Meshcat.

    Args:
        meshcat: where to draw.
        assembly: what drives.
        name: of the vehicle that is followed.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly, name: str) -> None:
        self._camera, self._plant = ChaseCamera(meshcat), assembly.parts.plant
        builder = DiagramBuilder()
        vehicles = {key: part.vehicle for key, part in assembly.parts.vehicles.items()}
        self._parts = make_plant(builder, assembly.parts.world, vehicles, spec=assembly.spec.plant)
        params = MeshcatVisualizerParams(publish_period=1.0 / 30.0, delete_on_initialization_event=False)
        MeshcatVisualizer.AddToBuilder(builder, self._parts.scene_graph, meshcat, params)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._own = self._parts.plant.GetMyMutableContextFromRoot(self._context)
        self._base = self._parts.vehicles[name].base
        self.views = {view.name: view for view in make_views(vehicles[name])}
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
            context: of the simulated diagram.
            passed: time since the last picture [s].
        """
        self._context.SetTime(context.get_time())
        self._parts.plant.SetPositions(self._own, self._plant.GetPositions(self._plant.GetMyContextFromRoot(context)))
        X_WB = self._parts.plant.EvalBodyPoseInWorld(self._own, self._base)
        self._diagram.ForcedPublish(self._context)
        self._camera.follow(X_WB, elapsed=passed, lag=self.view.lag)
