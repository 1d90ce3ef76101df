"""Drawing of a simulation in Meshcat while it runs."""

from typing import Any

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.framework import Context, DiagramBuilder

from mirdrake.assembly.diagram import DRAWING_PERIOD, Assembly


class LiveView:
    """Monitor that draws a diagram in Meshcat until Meshcat ends.

    A copy of the scene graph with a MeshcatVisualizer is a diagram of its own, which gets the poses of each drawing: an
    exception of Meshcat does not reach the simulator, neither at the start nor within a step.

    Args:
        assembly: simulated diagram.
        meshcat: Meshcat in which it is drawn.

    Attributes:
        failed: whether Meshcat has ended.
        failed_at: simulated time at which that was noticed [s].
    """

    def __init__(self, assembly: Assembly, meshcat: Meshcat) -> None:
        self._plant = assembly.parts.plant
        # A diagram of its own with a copy of the scene graph, so that the simulated diagram has no visualizer.
        builder = DiagramBuilder()
        scene_graph: Any = builder.AddSystem(assembly.parts.scene_graph.Clone())
        params = MeshcatVisualizerParams(delete_on_initialization_event=False)
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._poses = scene_graph.get_source_pose_port(self._plant.get_source_id())
        self._poses_context = scene_graph.GetMyMutableContextFromRoot(self._context)
        self._actors = assembly.parts.actors
        self._traffic = assembly.diagram.GetSubsystemByName("traffic") if self._actors.source is not None else None
        if self._actors.source is not None:
            self._actor_poses = scene_graph.get_source_pose_port(self._actors.source)
        # Wheels that are drawn apart from the bodies of the plant.
        diagram, names = assembly.diagram, [f"{name}.wheel_poses" for name in assembly.parts.vehicles]
        wheels: list[Any] = [diagram.GetSubsystemByName(name) for name in names if diagram.HasSubsystemNamed(name)]
        self._wheels = [(system, scene_graph.get_source_pose_port(system.looks.source)) for system in wheels]
        self._next = 0.0
        self.failed, self.failed_at = False, 0.0

    def __call__(self, context: Context) -> None:
        """Draw, if a picture is due."""
        time = context.get_time()
        # A drawing every step would slow the run down without being visible.
        if time >= self._next:
            self._next = time + DRAWING_PERIOD
            self.update(context)

    def update(self, context: Context) -> None:
        """Draw the state of a Context of the whole diagram, unless Meshcat has ended."""
        if self.failed:
            return
        try:
            self.draw(context)
        except RuntimeError:
            self.failed, self.failed_at = True, context.get_time()

    def draw(self, context: Context) -> None:
        """Draw the state of a Context of the whole diagram.

        Raises:
            RuntimeError: Meshcat has ended.
        """
        # Poses are copied as fixed values into the copy, because the two diagrams have separate Contexts.
        poses = self._plant.get_geometry_pose_output_port()
        self._poses.FixValue(self._poses_context, poses.EvalAbstract(self._plant.GetMyContextFromRoot(context)))
        if self._traffic is not None:
            states = self._traffic.states.Eval(self._traffic.GetMyContextFromRoot(context))
            # States of actors are (x, y, yaw, ...) in rows of six; the pose needs the first three.
            self._actor_poses.FixValue(self._poses_context, self._actors.poses(states.reshape(-1, 6)[:, :3]))
        for system, port in self._wheels:
            port.FixValue(self._poses_context, system.poses.EvalAbstract(system.GetMyContextFromRoot(context)))
        self._context.SetTime(context.get_time())
        self._diagram.ForcedPublish(self._context)
