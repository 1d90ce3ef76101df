"""The scene of a plant as cameras see it: every body where it is at the time of the velocities.

In each step of a plant the velocities at its end move the bodies: positions lead velocities by half a step. Ground
truth and sensors are those of the time of the velocities. The geometry engine of the diagram has the positions of the
plant, which contact needs. Pictures are therefore rendered in a Context of the scene graph of its own, with the
positions q - h N(q) v, where h is half a step and N maps velocities to derivatives of positions. Actors that only
cameras see are functions of time, and have no lead.
"""

import numpy as np
import numpy.typing as npt
from pydrake.common.value import Value
from pydrake.geometry import FramePoseVector, QueryObject, SceneGraph, SourceId
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context


class SeenScene:
    """Scene of a plant at the time of its velocities, for all cameras of a diagram.

    Args:
        plant: the finalised plant.
        scene_graph: its scene graph.
        lead: time by which positions of the plant lead its velocities [s].
        actors: source of the geometry of the actors; None without actors.
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, *, lead: float, actors: SourceId | None = None
    ) -> None:
        self._plant, self._scene_graph, self._lead, self._actors = plant, scene_graph, lead, actors
        self._contexts: tuple[Context, Context] | None = None

    @property
    def has_actors(self) -> bool:
        """Whether it has actors."""
        return self._actors is not None

    def query(self, state: npt.NDArray[np.float64], actors: FramePoseVector | None = None) -> QueryObject:
        """Return the scene for a state of the plant; the next call changes it.

        Args:
            state: positions and velocities of the plant.
            actors: poses of the actors; needed if there are any.
        """
        plant, scene_graph = self._plant, self._scene_graph
        if self._contexts is None:
            self._contexts = self._make_contexts()
        own, scene = self._contexts
        plant.SetPositionsAndVelocities(own, state)
        positions = plant.GetPositions(own) - self._lead * plant.MapVelocityToQDot(own, plant.GetVelocities(own))
        plant.SetPositions(own, positions)
        self._pose(scene, plant.get_source_id(), plant.get_geometry_pose_output_port().Eval(own))
        if self._actors is not None and actors is not None:
            self._pose(scene, self._actors, actors)
        return scene_graph.get_query_output_port().Eval(scene)

    def _make_contexts(self) -> tuple[Context, Context]:
        """Return Contexts of plant and scene graph; made at the first picture, when all geometry is registered."""
        scene = self._scene_graph.CreateDefaultContext()
        inspector = self._scene_graph.model_inspector()
        for source in inspector.GetAllSourceIds():
            # Cameras see the geometry of plant and actors only; what is drawn elsewhere needs some pose. The world
            # frame belongs to the scene graph itself.
            still, frames = FramePoseVector(), inspector.FramesForSource(source) - {inspector.world_frame_id()}
            for frame in frames:
                still.set_value(frame, RigidTransform())
            if frames:
                self._pose(scene, source, still)
        return self._plant.CreateDefaultContext(), scene

    def _pose(self, scene: Context, source: SourceId, poses: FramePoseVector) -> None:
        self._scene_graph.get_source_pose_port(source).FixValue(scene, Value[FramePoseVector](poses))
