"""Actors of a world: frames in the scene graph that cameras and range sensors see, and bodies of solid actors.

The frames belong to a source of their own. Drake's plant rejects contact with the geometry of other sources, so they
have no proximity role. A solid actor also is a body of the plant, with its mass and collision shapes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    GeometrySet,
    IllustrationProperties,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    RenderLabel,
    SceneGraph,
    SourceId,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Joint,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
)
from pydrake.systems.framework import Context

from mirdrake.ground import FLAT, Terrain
from mirdrake.plant.obstacles import contact_material, looks
from mirdrake.worlds import Actor, World
from mirdrake.worlds.actors import WHEELBASE
from mirdrake.worlds.pieces import Array

_STIFF = 30.0  # [rad/s] natural frequency of the controllers of solid actors: 1 cm behind at 9 m/s²

GREY = (0.72, 0.71, 0.68)
"""Colour of an actor without mesh and colour."""


@dataclass(frozen=True)
class ActorsInScene:
    """The actors of a world in a scene graph.

    Attributes:
        source: source of their geometry; None without actors.
        frames: frame A of each actor by name, in the order of the names.
        geometries: visual geometries of each actor by name.
        solid: names of the solid actors, in the order of the world.
        instance: model instance of their bodies; None without solid actors.
        terrain: the ground, on which they move.
        upright: names of actors that stay upright on a slope: people.
    """

    source: SourceId | None = None
    frames: Mapping[str, FrameId] = field(default_factory=dict)
    geometries: Mapping[str, tuple[GeometryId, ...]] = field(default_factory=dict)
    solid: tuple[str, ...] = ()
    instance: ModelInstanceIndex | None = None
    terrain: Terrain = FLAT
    upright: frozenset[str] = frozenset()

    def poses(self, planar: Array) -> FramePoseVector:
        """Return the poses of the frames, on the ground and along its slope.

        Args:
            planar: x, y [m] and yaw [rad] of the actors (n, 3).
        """
        vector, planar = FramePoseVector(), planar[: len(self.frames)]
        ground = self.terrain.slopes(planar[:, 0], planar[:, 1])
        places = np.column_stack((planar[:, :2], ground[:, 0]))
        for (name, frame), place, yaw, (_, along_x, along_y) in zip(
            self.frames.items(), places, planar[:, 2].tolist(), ground, strict=True
        ):
            R_WA = RotationMatrix.MakeZRotation(yaw)
            if not self.terrain.flat and name not in self.upright:
                # z is the normal of the ground; x is along the slope and, seen from above, in the direction of yaw.
                c, s = math.cos(yaw), math.sin(yaw)
                ahead = np.array([c, s, along_x * c + along_y * s])
                across = np.cross([-along_x, -along_y, 1.0], ahead)
                axes = [axis / np.linalg.norm(axis) for axis in (ahead, across, np.cross(ahead, across))]
                R_WA = RotationMatrix(np.column_stack(axes))
            # Of the constructors of RigidTransform this one takes the least time in Python.
            vector.set_value(frame, RigidTransform(R_WA, place))
        return vector


def add_solid_actors(plant: MultibodyPlant, world: World) -> ActorsInScene:
    """Add the bodies of the solid actors of a world to a plant that is not finalised yet, before the world.

    Each moves in the plane, on joints along x, y and about z of W at its frame A; on a relief also along z, upright at
    the height of the ground. PD controllers, which Drake solves implicitly with the contact, hold them at their desired
    state: the motion of the actor. They are critically damped, and their force in the plane is limited to that of the
    actor's hardest braking: a vehicle that hits it pushes it off its way.
    """
    solid = [actor for actor in world.actors if actor.spec.body == "solid"]
    if not solid:
        return ActorsInScene()
    instance = plant.AddModelInstance("actors")
    terrain = world.ground.terrain
    for actor in solid:
        _add_body(plant, instance, actor, rises=not terrain.flat)
    # The ground bears them.
    plant.set_gravity_enabled(instance, False)
    return ActorsInScene(solid=tuple(actor.name for actor in solid), instance=instance, terrain=terrain)


def exclude_world(plant: MultibodyPlant, scene_graph: SceneGraph, actors: ActorsInScene) -> None:
    """Exclude contact of solid actors with ground and static props: their motion is in the plane, and given."""
    if actors.instance is None:
        return
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(actors.instance)]
    mine = [geometry for body in bodies for geometry in plant.GetCollisionGeometriesForBody(body)]
    still = [plant.world_body(), *plant.GetBodiesWeldedTo(plant.world_body())]
    theirs = [geometry for body in still for geometry in plant.GetCollisionGeometriesForBody(body)]
    declaration = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(mine), GeometrySet(theirs))
    scene_graph.collision_filter_manager().Apply(declaration)


def _add_body(plant: MultibodyPlant, instance: ModelInstanceIndex, actor: Actor, *, rises: bool) -> None:
    """Add the body of a solid actor with its joints and controllers; `rises` adds the joint along z."""
    prop, behaviour = actor.prop, actor.spec.behaviour
    body = plant.AddRigidBody(actor.name, instance, prop.inertia)
    frame = plant.AddFrame(FixedOffsetFrame(f"{actor.name}/A", body.body_frame(), actor.prop_pose.inverse(), instance))
    # Bodies without mass between the joints.
    axes = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0]} | ({"z": [0.0, 0.0, 1.0]} if rises else {})
    joints: list[Joint] = []
    parent = plant.world_frame()
    for name, axis in axes.items():
        slide = plant.AddRigidBody(f"{actor.name}/{name}", instance, SpatialInertia.Zero()).body_frame()
        joints.append(PrismaticJoint(f"{actor.name}/{name}", parent, slide, axis))
        parent = slide
    joints.append(RevoluteJoint(f"{actor.name}/yaw", parent, frame, [0.0, 0.0, 1.0]))
    force = prop.mass * behaviour.braking_limit  # type: ignore[attr-defined]
    # About A; the lever of the tyre forces is half of a wheelbase, that of feet half of the length.
    lever = 0.5 * prop.size[0] * (1.0 if actor.walks else WHEELBASE)
    turning = float(prop.inertia.CalcRotationalInertia().get_moments()[2]) + prop.mass * actor.rear_axle**2
    inertias = [prop.mass] * len(axes) + [turning]
    limits = [force, force, *([math.inf] if rises else []), force * lever]
    for joint, inertia, limit in zip(joints, inertias, limits, strict=True):
        actuator = plant.AddJointActuator(joint.name(), plant.AddJoint(joint), limit)
        actuator.set_controller_gains(PdControllerGains(p=inertia * _STIFF**2, d=2.0 * inertia * _STIFF))
    material = contact_material(prop)
    for number, solid in enumerate(prop.solids):
        plant.RegisterCollisionGeometry(body, solid.X_PS, solid.shape, f"actor/{actor.name}/{number}", material)


def add_actors(scene_graph: SceneGraph, world: World, bodies: ActorsInScene | None = None) -> ActorsInScene:
    """Add the actors of a world to a scene graph; their poses are then an input of it.

    Args:
        scene_graph: the scene graph.
        world: the world.
        bodies: its solid actors, as they were added to the plant.
    """
    bodies = bodies or ActorsInScene()
    if not world.actors:
        return bodies
    source = scene_graph.RegisterSource("actors")
    frames, geometries = {}, {}
    for actor in world.actors:
        frames[actor.name] = scene_graph.RegisterFrame(source, GeometryFrame(f"actor/{actor.name}"))
        geometries[actor.name] = tuple(_add_looks(scene_graph, source, frames[actor.name], actor))
    upright = frozenset(actor.name for actor in world.actors if actor.walks)
    terrain = world.ground.terrain
    return replace(bodies, source=source, frames=frames, geometries=geometries, terrain=terrain, upright=upright)


def fix_at_start(scene_graph: SceneGraph, actors: ActorsInScene, world: World, context: Context) -> None:
    """Fix the poses of the actors in a context of the whole diagram at their starts, for pictures of a world."""
    if actors.source is None:
        return
    starts = {actor.name: world.actor_start(actor) for actor in world.actors}
    port = scene_graph.get_source_pose_port(actors.source)
    planar = np.array([starts[name] for name in actors.frames])
    port.FixValue(scene_graph.GetMyMutableContextFromRoot(context), actors.poses(planar))


def _add_looks(scene_graph: SceneGraph, source: SourceId, frame: FrameId, actor: Actor) -> list[GeometryId]:
    """Add the visual shapes of an actor, with the properties that a plant gives to its visual geometry."""
    added = []
    rgba = np.array([*(actor.color or GREY), 1.0])
    for index, (shape, X_PG) in enumerate(looks(actor.placed(0.0, 0.0, 0.0))):
        instance = GeometryInstance(actor.prop_pose @ X_PG, shape, f"actor/{actor.name}/look{index}")
        illustration = MakePhongIllustrationProperties(rgba)
        perception = PerceptionProperties(illustration)
        perception.AddProperty("label", "id", RenderLabel.kDontCare)
        instance.set_illustration_properties(IllustrationProperties(illustration))
        instance.set_perception_properties(perception)
        added.append(scene_graph.RegisterGeometry(source, frame, instance))
    return added
