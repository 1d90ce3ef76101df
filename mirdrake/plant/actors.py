"""Actors of a world in the scene graph of a plant: frames that cameras and range sensors see, without contact.

Their geometry belongs to a source of its own. Drake's plant rejects contact with the geometry of other sources, so
actors have no proximity role.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import (
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    IllustrationProperties,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    RenderLabel,
    SceneGraph,
    SourceId,
)
from pydrake.math import RigidTransform, RotationMatrix

from mirdrake.plant.obstacles import looks
from mirdrake.worlds import Actor, World
from mirdrake.worlds.pieces import Array

_GREY = (0.72, 0.71, 0.68, 1.0)  # colour of an actor without mesh and colour


@dataclass(frozen=True)
class ActorsInScene:
    """The actors of a world in a scene graph.

    Attributes:
        source: source of their geometry; None without actors.
        frames: frame A of each actor by name, in the order of the names.
        geometries: visual geometries of each actor by name.
    """

    source: SourceId | None = None
    frames: Mapping[str, FrameId] = field(default_factory=dict)
    geometries: Mapping[str, tuple[GeometryId, ...]] = field(default_factory=dict)

    def poses(self, planar: Array) -> FramePoseVector:
        """Return the poses of the frames.

        Args:
            planar: x, y [m] and yaw [rad] of the actors (n, 3).
        """
        vector, planar = FramePoseVector(), planar[: len(self.frames)]
        # A rotation and an array: the constructor of Drake that takes least time in Python.
        places = np.column_stack((planar[:, :2], np.zeros(len(planar))))
        for frame, place, yaw in zip(self.frames.values(), places, planar[:, 2].tolist(), strict=True):
            vector.set_value(frame, RigidTransform(RotationMatrix.MakeZRotation(yaw), place))
        return vector


def add_actors(scene_graph: SceneGraph, world: World) -> ActorsInScene:
    """Add the actors of a world to a scene graph; their poses are then an input of it."""
    if not world.actors:
        return ActorsInScene()
    source = scene_graph.RegisterSource("actors")
    frames, geometries = {}, {}
    for actor in world.actors:
        frames[actor.name] = scene_graph.RegisterFrame(source, GeometryFrame(f"actor/{actor.name}"))
        geometries[actor.name] = tuple(_add_looks(scene_graph, source, frames[actor.name], actor))
    return ActorsInScene(source, frames, geometries)


def _add_looks(scene_graph: SceneGraph, source: SourceId, frame: FrameId, actor: Actor) -> list[GeometryId]:
    """Add the visual shapes of an actor, with the properties that a plant gives to its visual geometry."""
    added = []
    rgba = np.array([*actor.color, 1.0] if actor.color else _GREY)
    for index, (shape, X_PG) in enumerate(looks(actor.placed(0.0, 0.0, 0.0))):
        instance = GeometryInstance(actor.prop_pose @ X_PG, shape, f"actor/{actor.name}/look{index}")
        illustration = MakePhongIllustrationProperties(rgba)
        perception = PerceptionProperties(illustration)
        perception.AddProperty("label", "id", RenderLabel.kDontCare)
        instance.set_illustration_properties(IllustrationProperties(illustration))
        instance.set_perception_properties(perception)
        added.append(scene_graph.RegisterGeometry(source, frame, instance))
    return added
