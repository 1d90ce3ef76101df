"""Inspection of a vehicle: mass, loads, dimensions, turning circle, inertia, joints, and implausible values.

Everything is measured on the expanded model at its design position, with Drake's own kinematics and masses; nothing is
read twice from a file. The plant here is rigid and uncompressed: tyres sit as drawn.

With wheelbase L, kingpin track Tk, track T, scrub radius c = (T - Tk)/2 and the inner wheel at its limit (R. Rajamani,
Vehicle Dynamics and Control, 2nd ed., section 2.2), the turning centre lies on the line of the rear axle at

    R = L / tan(inner) + Tk/2     cot(outer) = cot(inner) + Tk/L

from its middle. The outer front wheel runs on a circle of radius sqrt(L² + (R + Tk/2)²) + c, kerb to kerb; the corner
(x, y) of the body on one of radius sqrt(x² + (R - y)²), and the farthest one counts between walls.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId, SceneGraphInspector
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody

from mirdrake.core.constants import GRAVITY
from mirdrake.core.hulls import bounding_points, solids_of
from mirdrake.vehicles.figures import (
    ActuatorFigures,
    Inspection,
    JointFigures,
    JointRole,
    LinkFigures,
    Overlap,
    SensorFigures,
)
from mirdrake.vehicles.overlaps import find_overlaps
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.plausibility import find_oddities
from mirdrake.vehicles.spec import WHEELS
from mirdrake.vehicles.vehicle import Vehicle

__all__ = ["Inspection", "JointFigures", "LinkFigures", "Overlap", "SensorFigures", "find_sensors", "inspect_vehicle"]

Points = NDArray[np.float64]

_NONE = (0.0, 0.0, 0.0)


def inspect_vehicle(vehicle: Vehicle) -> Inspection:
    """Return the figures of a vehicle: mass, axle loads, dimensions, inertia, links, joints, sensors, warnings."""
    plant, scene_graph, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context = plant.CreateDefaultContext()
    base = plant.GetBodyByName(vehicle.spec.base_link)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    geometry = vehicle.geometry

    # Mass and axle loads, from moments about the axles.
    mass = float(plant.CalcTotalMass(context))
    x, y, z = (float(value) for value in plant.CalcCenterOfMassPositionInWorld(context))
    front_share = x / geometry.wheelbase
    # Inertia of the whole vehicle about its centre of mass.
    spatial = plant.CalcSpatialInertia(context, plant.world_frame(), [body.index() for body in _bodies(plant)])
    about_com = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    ahead, behind = geometry.wheelbase - x, x

    # Full lock: the inner wheel is at its limit, the centre of the turn is on the line of the rear axle.
    inner = geometry.steering_limit
    outer = math.atan2(1.0, 1.0 / math.tan(inner) + geometry.kingpin_track / geometry.wheelbase)
    radius = geometry.wheelbase / math.tan(inner) + 0.5 * geometry.kingpin_track
    scrub = 0.5 * (geometry.front_track - geometry.kingpin_track)
    outermost = math.hypot(geometry.wheelbase, radius + 0.5 * geometry.kingpin_track) + scrub

    inspector = scene_graph.model_inspector()

    # Extent of the vehicle: clearance and wall circle are those of the body without its wheels.
    wheels = {plant.GetJointByName(name).child_body().name() for name in vehicle.spec.joints.wheels.names()}
    solid = {
        body.name(): _corners(inspector, plant.EvalBodyPoseInWorld(context, body), solids_of(plant, inspector, body))
        for body in _bodies(plant)
    }
    seen = [
        _corners(inspector, plant.EvalBodyPoseInWorld(context, body), plant.GetVisualGeometriesForBody(body))
        for body in _bodies(plant)
    ]
    corners, rest = np.vstack(list(solid.values())), np.vstack([solid[name] for name in solid if name not in wheels])
    # Wall circle: the farthest point from the turning centre, which is `radius` to one side on the rear axle.
    wall = max(float(np.hypot(rest[:, 0], radius + np.abs(rest[:, 1])).max(initial=0.0)), outermost)
    inertia = _three(np.diag(about_com))
    links = tuple(_link(plant, context, inspector, body, solid[body.name()], vehicle) for body in _bodies(plant))
    joints = _joints(plant, context, vehicle)
    figures = Inspection(
        vehicle=vehicle.name,
        title=vehicle.spec.name,
        grade=vehicle.spec.grade,
        drive=vehicle.spec.drive,
        mass=mass,
        com=(x, y, z),
        loads=(mass * GRAVITY * front_share, mass * GRAVITY * (1.0 - front_share)),
        front_share=front_share,
        # Share of the left wheels in the weight: lateral moments with the load-weighted mean of the tracks.
        side_share=0.5 + y / (front_share * geometry.front_track + (1.0 - front_share) * geometry.rear_track),
        wheelbase=geometry.wheelbase,
        tracks=(geometry.front_track, geometry.rear_track),
        kingpin_track=geometry.kingpin_track,
        wheel_radii=(geometry.front_wheel_radius, geometry.rear_wheel_radius),
        wheel_widths=(geometry.front_wheel_width, geometry.rear_wheel_width),
        size=_size(corners),
        visual_size=_size(points) if len(points := np.vstack(seen)) else None,
        ground_clearance=float(rest[:, 2].min(initial=math.inf)),
        steering_limits=(inner, outer),
        turning_radius=radius,
        turning_circle=2.0 * outermost,
        wall_circle=2.0 * wall,
        inertia=inertia,
        gyration=_three([math.sqrt(moment / mass) for moment in inertia]),
        # Yaw dynamic index Izz / (m a b); at 1 each axle is the centre of percussion of the other.
        dynamic_index=float(about_com[2, 2] / mass / (ahead * behind)) if ahead * behind > 0.0 else math.inf,
        static_stability=0.5 * min(geometry.front_track, geometry.rear_track) / z if z > 0.0 else math.inf,
        overlaps=find_overlaps(plant, scene_graph, vehicle, angles=(inner, outer)),
        links=links,
        joints=joints,
        actuators=_actuators(plant, joints),
        sensors=_sensors(plant, context, vehicle),
        warnings=(),
    )
    # Warnings are found from the figures, hence after the record of these exists.
    return replace(figures, warnings=(*find_oddities(figures, vehicle), *vehicle.warnings))


# --- parts -------------------------------------------------------------------------------------------------------


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Return all bodies of the vehicle, without the world."""
    # Drake's first two model instances are the world and the default one.
    instances = [ModelInstanceIndex(number) for number in range(2, plant.num_model_instances())]
    return [plant.get_body(index) for instance in instances for index in plant.GetBodyIndices(instance)]


def _corners(inspector: SceneGraphInspector, X_WB: RigidTransform, geometries: Sequence[GeometryId]) -> Points:
    """Return points (n, 3) in base_link with the bounding box of the shapes: hulls of meshes, corners of boxes."""
    clouds = [bounding_points(inspector, X_WB, geometry) for geometry in geometries]
    return np.vstack([np.empty((0, 3)), *(points for points in clouds if points is not None)])


def _size(points: Points) -> tuple[float, float, float]:
    """Return length, width, and height above the road [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return _three([high[0] - low[0], high[1] - low[1], high[2]])


def _link(
    plant: MultibodyPlant,
    context: Any,
    inspector: SceneGraphInspector,
    body: RigidBody,
    corners: Points,
    vehicle: Vehicle,
) -> LinkFigures:
    mass = float(body.default_mass())
    # The extent of shapes is compared with the size that the inertia implies.
    extent = sorted(np.ptp(corners, axis=0).tolist(), reverse=True) if len(corners) else [0.0] * 3
    frictions = [
        float(inspector.GetProximityProperties(shape).GetProperty("material", "coulomb_friction").static_friction())
        for shape in solids_of(plant, inspector, body)
        if inspector.GetProximityProperties(shape).HasProperty("material", "coulomb_friction")
    ]
    friction = max(frictions, default=None)
    # A link without mass is a frame on a fixed joint.
    if mass <= 0.0:
        return LinkFigures(body.name(), 0.0, _NONE, _NONE, _NONE, _three(extent), friction=friction)
    spatial = body.CalcSpatialInertiaInBodyFrame(context)
    com = spatial.get_com()
    tensor = spatial.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()
    moments = np.linalg.eigvalsh(tensor)
    # A box with edges a, b, c has I_a = m (b² + c²) / 12 and so on.
    squares = [6.0 * (moments.sum() - 2.0 * moment) / mass for moment in moments]
    edges = sorted((math.sqrt(max(square, 0.0)) for square in squares), reverse=True)
    # A wheel: inertia about the axis of its joint, in the axes of the body.
    spin = None
    for name, radius in zip(vehicle.spec.joints.wheels.names(), vehicle.geometry.wheel_radii, strict=True):
        joint = plant.GetJointByName(name)
        if joint.child_body().index() == body.index():
            axis = joint.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(joint.revolute_axis())
            spin = float(axis @ tensor @ axis)
            spin_factor = spin / (mass * radius**2)
    return LinkFigures(
        name=body.name(),
        mass=mass,
        com=_three(com),
        moments=_three(moments),
        edges=_three(edges),
        extent=_three(extent),
        size_ratio=edges[0] / extent[0] if extent[0] > 0.0 else None,
        triangle=float((moments[0] + moments[1]) / moments[2]),
        spin=None if spin is None else spin_factor,
        spin_is_smaller=spin is not None and spin < 0.99 * float(moments[2]),
        friction=friction,
    )


def _joints(plant: MultibodyPlant, context: Any, vehicle: Vehicle) -> tuple[JointFigures, ...]:
    joints = vehicle.spec.joints
    # The role of a joint is that in vehicle.yaml, since names say nothing reliable.
    driven = set(vehicle.spec.driven_wheels())
    roles = {
        getattr(joints.wheels, wheel): (JointRole.DRIVEN_WHEEL if wheel in driven else JointRole.WHEEL, wheel)
        for wheel in WHEELS
    }
    roles |= {getattr(joints.steering, side): (JointRole.STEERING, side) for side in ("left", "right")}
    # Dampers of a suspension are force elements of mirdrake, not joint damping of the URDF.
    dampers: dict[str, float] = {}
    if joints.suspension is not None and vehicle.spec.suspension is not None:
        names = zip(WHEELS, joints.suspension.names(), strict=True)
        roles |= {name: (JointRole.SUSPENSION, wheel) for wheel, name in names}
        corners = vehicle.spec.suspension.corners()
        dampers = {name: corner.damping for name, corner in zip(joints.suspension.names(), corners, strict=True)}
    # Effort limits belong to actuators in Drake; a joint without one has none.
    efforts = {
        (actuator := plant.get_joint_actuator(index)).joint().name(): float(actuator.effort_limit())
        for index in plant.GetJointActuatorIndices()
    }
    rows = []
    # Joints are listed in the order of the file, with fixed ones.
    for element in ElementTree.fromstring(vehicle.urdf).findall("joint"):
        name, kind = element.get("name", ""), element.get("type", "")
        joint = plant.GetJointByName(name)
        X_BJ = plant.CalcRelativeTransform(context, plant.world_frame(), joint.frame_on_child())
        turns = kind in {"revolute", "continuous", "prismatic"}
        axis = joint.revolute_axis() if kind in {"revolute", "continuous"} else None
        # Fixed joints have no axis, and limits of 0.
        if kind == "prismatic":
            axis = joint.translation_axis()
        limits = (joint.position_lower_limits(), joint.position_upper_limits(), joint.velocity_upper_limits())
        role, corner = roles.get(name, (JointRole.NONE, ""))
        lower, upper, velocity = (float(limit[0]) if turns else 0.0 for limit in limits)
        rows.append(
            JointFigures(
                name=name,
                kind=kind,
                parent=joint.parent_body().name(),
                child=joint.child_body().name(),
                role=role,
                corner=corner,
                place=_three(X_BJ.translation()),
                axis=_three(X_BJ.rotation().multiply(axis)) if axis is not None else (),
                lower=lower,
                upper=upper,
                velocity=velocity,
                effort=efforts.get(name, 0.0),
                damping=dampers.get(name, float(joint.default_damping_vector()[0]) if turns else 0.0),
            )
        )
    return tuple(rows)


def _actuators(plant: MultibodyPlant, joints: Sequence[JointFigures]) -> tuple[ActuatorFigures, ...]:
    known = {joint.name: joint for joint in joints}
    rows = []
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        joint = known[actuator.joint().name()]
        corner = joint.corner.replace("_", " ")
        # Drive and brake torque share the actuator of a wheel.
        moves = {
            JointRole.DRIVEN_WHEEL: f"drives and brakes the {corner} wheel",
            JointRole.WHEEL: f"brakes the {corner} wheel",
            JointRole.STEERING: f"steers the {corner} front wheel",
        }.get(joint.role, f"moves '{joint.child}'")
        rows.append(
            ActuatorFigures(
                name=actuator.name(),
                joint=joint.name,
                moves=moves,
                effort=float(actuator.effort_limit()),
            )
        )
    return tuple(rows)


def find_sensors(vehicle: Vehicle) -> tuple[SensorFigures, ...]:
    """Return the mounted sensors of a vehicle with their places.

    Raises:
        ModelError: Drake cannot read the URDF, for example because a mesh is missing.
    """
    # The scene graph must live as long as the plant.
    plant, _scene_graph, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context = plant.CreateDefaultContext()
    base = plant.GetBodyByName(vehicle.spec.base_link)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    return _sensors(plant, context, vehicle)


def _sensors(plant: MultibodyPlant, context: Any, vehicle: Vehicle) -> tuple[SensorFigures, ...]:
    rows = []
    for name, mount in vehicle.sensors.mounts.items():
        X_BS = plant.CalcRelativeTransform(context, plant.world_frame(), plant.GetFrameByName(mount.frame))
        # Direction of view: x axis of the mounted frame; + 0.0 turns -0.0 into 0.0 in tables.
        ahead = X_BS.rotation().matrix()[:, 0]
        view = mount.field_of_view()
        rows.append(
            SensorFigures(
                name=name,
                kind=mount.kind,
                frame=mount.frame,
                place=_three(X_BS.translation()),
                rate=mount.rate,
                yaw=math.atan2(ahead[1], ahead[0]) + 0.0,
                pitch=math.asin(min(max(float(ahead[2]), -1.0), 1.0)) + 0.0,
                roll=float(RollPitchYaw(X_BS.rotation()).roll_angle()) + 0.0,
                across=view.across if view else (),
                upward=view.upward if view else (),
                reach=view.reach if view else (),
            )
        )
    return tuple(rows)


def _three(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float, float]:
    a, b, c = (float(value) + 0.0 for value in values)
    return a, b, c
