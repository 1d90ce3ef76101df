"""Overlaps of wheels with other parts of their vehicle. Contact within a vehicle is disabled and does not show them."""

from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet, QueryObject, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from mirdrake.core.hulls import solids_of
from mirdrake.vehicles.figures import Overlap
from mirdrake.vehicles.spec import WHEELS
from mirdrake.vehicles.vehicle import Vehicle

LEAST_DEPTH = 5e-4
"""Smallest depth of an overlap [m]; shapes that only touch do not overlap."""


def find_overlaps(
    plant: MultibodyPlant, scene_graph: SceneGraph, vehicle: Vehicle, *, angles: tuple[float, float]
) -> tuple[Overlap, ...]:
    """Return the deepest overlap of each wheel with each link, straight ahead, else at full lock to either side.

    Links between body and wheels, the knuckles, are left out: they reach into their wheels.

    Args:
        plant: finalised plant with this vehicle only.
        scene_graph: SceneGraph of the plant.
        vehicle: provides the roles of the joints (wheels, steering).
        angles: steering angles of the inner and the outer wheel at full lock [rad].
    """
    wheels = [plant.GetJointByName(name) for name in vehicle.spec.joints.wheels.names()]
    steering = [plant.GetJointByName(name) for name in vehicle.spec.joints.steering.names()]
    moved = {joint.child_body().index() for joint in (*wheels, *steering)}
    inspector = scene_graph.model_inspector()
    # Body 0 is the world.
    bodies = [plant.get_body(BodyIndex(number)) for number in range(1, plant.num_bodies())]
    solids = {body.index(): solids_of(plant, inspector, body) for body in bodies}
    # Parsers exclude adjacent links from collision; here every pair is of interest.
    plant_context, context = plant.CreateDefaultContext(), scene_graph.CreateDefaultContext()
    everything = GeometrySet([shape for shapes in solids.values() for shape in shapes])
    scene_graph.collision_filter_manager(context).Apply(CollisionFilterDeclaration().AllowWithin(everything))

    # Straight ahead first: an overlap found there is not reported again at full lock.
    deepest: dict[tuple[str, str], Overlap] = {}
    inner, outer = angles
    for left, right in ((0.0, 0.0), (inner, outer), (-outer, -inner)):
        for joint, angle in zip(steering, (left, right), strict=True):
            joint.set_angle(plant_context, angle)
        # SceneGraph has a Context of its own here, so the poses are copied into its input.
        poses = plant.get_geometry_pose_output_port().Eval(plant_context)
        scene_graph.get_source_pose_port(plant.get_source_id()).FixValue(context, poses)
        query = scene_graph.get_query_output_port().Eval(context)
        pose = "straight ahead" if left == 0.0 else "at full lock"
        # Only front wheels move with the steering.
        for joint in wheels[: len(WHEELS) if left == 0.0 else 2]:
            wheel = joint.child_body()
            for index, shapes in solids.items():
                if index in moved:
                    continue
                pairs = [(mine, other) for mine in solids[wheel.index()] for other in shapes]
                depth = max((_depth(query, *pair) for pair in pairs), default=0.0)
                key = (wheel.name(), plant.get_body(index).name())
                known = deepest.get(key)
                if depth > LEAST_DEPTH and (known is None or (known.pose == pose and depth > known.depth)):
                    deepest[key] = Overlap(*key, depth, pose)
    return tuple(deepest.values())


def _depth(query: QueryObject, first: GeometryId, second: GeometryId) -> float:
    """Return the depth of the overlap of two shapes [m]; negative when apart, 0 if Drake cannot compute it."""
    try:
        return -float(query.ComputeSignedDistancePairClosestPoints(first, second).distance)
    except RuntimeError:  # no algorithm for this pair of shapes, or it did not converge
        return 0.0
