"""The picture of a drive: a second plant with the pose of the simulated one.

The picture follows the wall clock and is omitted without a viewer or when time is short. The simulated diagram draws
nothing and equals that of `mirdrake run`.
"""

from math import exp, pi

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import Context, DiagramBuilder

from mirdrake.assembly.diagram import Assembly
from mirdrake.plant.plant import make_plant
from mirdrake.viewer.meshcat import LIGHTS_PATH, WORLD_PATH, chase
from mirdrake.viewer.views import View, make_views, set_view


class Picture:
    """The picture of a drive in Meshcat.

    Args:
        meshcat: where to draw.
        assembly: what drives.
        name: of the vehicle that is followed.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly, name: str) -> None:
        self._meshcat, self._plant = meshcat, assembly.parts.plant
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
        self._heading: float | None = None
        set_view(meshcat, self.view)

    def look(self, name: str) -> None:
        """Select a view; the page moves the camera, here only its turning rate changes."""
        self.view = self.views.get(name, self.view)

    def forget(self) -> None:
        """Place the camera anew after a jump of the vehicle."""
        self._heading = None

    def draw(self, context: Context, *, passed: float) -> None:
        """Draw the present state.

        Args:
            context: of the simulated diagram.
            passed: time since the last picture [s].
        """
        self._context.SetTime(context.get_time())
        self._parts.plant.SetPositions(self._own, self._plant.GetPositions(self._plant.GetMyContextFromRoot(context)))
        X_WB = self._parts.plant.EvalBodyPoseInWorld(self._own, self._base)
        x, y, _ = X_WB.translation()
        yaw = RollPitchYaw(X_WB.rotation()).yaw_angle()
        if self._heading is None or self.view.lag <= 0.0:
            self._heading = yaw
        turn = (yaw - self._heading + pi) % (2.0 * pi) - pi
        self._heading += turn * (1.0 - exp(-passed / self.view.lag)) if self.view.lag > 0.0 else 0.0
        X_CW, X_CL = chase(x=x, y=y, yaw=self._heading)
        self._diagram.ForcedPublish(self._context)
        self._meshcat.SetTransform(WORLD_PATH, X_CW)
        self._meshcat.SetTransform(LIGHTS_PATH, X_CL)
