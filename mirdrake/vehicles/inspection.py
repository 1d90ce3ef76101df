"""What a vehicle is, in figures: mass, loads, dimensions, turning circle, inertia, joints, and what looks wrong.

Everything is measured on the expanded model at its design position, with Drake's own kinematics and masses; nothing is
read twice from a file. The plant here is rigid and uncompressed: tyres sit as drawn.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody

from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.spec import WHEELS
from mirdrake.vehicles.vehicle import Vehicle

GRAVITY = 9.80665

SPIN_FACTORS = (0.4, 1.0)
"""Plausible spin inertia of a wheel over m R²: a solid disc has 0.5, a hoop 1."""

SIZE_RATIOS = (1.0 / 4.0, 1.5)
"""Plausible size of a body's inertia over the size of its shapes; the mass of a car is not in its outermost corners."""


_NONE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LinkFigures:
    """One link.

    Attributes:
        name: of the link.
        mass: [kg].
        com: centre of mass in the link's frame [m].
        moments: principal moments of inertia about the centre of mass, rising [kg m²].
        edges: of the homogeneous box with these moments, longest first [m]; zeros for a frame without mass.
        extent: edges of the box around its shapes [m], longest first; zeros without shapes.
    """

    name: str
    mass: float
    com: tuple[float, float, float]
    moments: tuple[float, float, float]
    edges: tuple[float, float, float]
    extent: tuple[float, float, float]


@dataclass(frozen=True)
class JointFigures:
    """One joint.

    Attributes:
        name: of the joint.
        kind: its type in the URDF.
        parent: link.
        child: link.
        role: what vehicle.yaml makes of it, "" for none.
        place: of its child's frame in base_link [m].
        axis: in base_link; empty for fixed joints.
        lower: limit [rad]; -inf without one.
        upper: limit [rad]; inf without one.
        velocity: limit [rad/s].
        effort: of its actuator [N m]; 0 without one.
    """

    name: str
    kind: str
    parent: str
    child: str
    role: str
    place: tuple[float, float, float]
    axis: tuple[float, ...]
    lower: float
    upper: float
    velocity: float
    effort: float


@dataclass(frozen=True)
class SensorFigures:
    """One mounted sensor: name, kind, frame, place in base_link [m], samples per second [Hz]."""

    name: str
    kind: str
    frame: str
    place: tuple[float, float, float]
    rate: float


@dataclass(frozen=True)
class Inspection:
    """Figures of a vehicle; lengths [m], masses [kg], inertia [kg m²], angles [rad], in base_link.

    Attributes:
        vehicle: its name.
        title: make and model.
        grade: of its data.
        drive: driven axle.
        mass: all of it.
        com: centre of mass.
        loads: of front and rear axle at rest [N].
        front_share: part of the load on the front axle.
        side_share: part of the load on the left wheels.
        wheelbase: between the axles.
        tracks: front and rear.
        kingpin_track: between the steering axes.
        wheel_radii: front and rear, unloaded.
        wheel_widths: front and rear.
        size: length, width, height of all shapes over the road.
        ground_clearance: lowest point of what is no wheel.
        steering_limits: of inner and outer wheel at full lock.
        turning_radius: of the rear axle's centre at full lock.
        turning_circle: diameter of the circle of the outer front wheel's middle, kerb to kerb.
        inertia: roll, pitch, yaw about the centre of mass.
        dynamic_index: k² / (a b) of the yaw inertia; 1: an axle does not feel what hits the other one.
        static_stability: track over twice the height of the centre of mass; lateral g at which it tips.
        links: all links.
        joints: all joints.
        sensors: all mounted sensors.
        warnings: what looks wrong, in words.
    """

    vehicle: str
    title: str
    grade: str
    drive: str
    mass: float
    com: tuple[float, float, float]
    loads: tuple[float, float]
    front_share: float
    side_share: float
    wheelbase: float
    tracks: tuple[float, float]
    kingpin_track: float
    wheel_radii: tuple[float, float]
    wheel_widths: tuple[float, float]
    size: tuple[float, float, float]
    ground_clearance: float
    steering_limits: tuple[float, float]
    turning_radius: float
    turning_circle: float
    inertia: tuple[float, float, float]
    dynamic_index: float
    static_stability: float
    links: tuple[LinkFigures, ...]
    joints: tuple[JointFigures, ...]
    sensors: tuple[SensorFigures, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON; what is not finite becomes None."""
        data: dict[str, Any] = _finite(asdict(self))
        return data


def inspect_vehicle(vehicle: Vehicle) -> Inspection:
    """Measure a vehicle."""
    plant, scene_graph, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context = plant.CreateDefaultContext()
    base = plant.GetBodyByName(vehicle.spec.base_link)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    geometry = vehicle.geometry

    # Mass, and how the axles share it: moments about the axles.
    mass = float(plant.CalcTotalMass(context))
    x, y, z = (float(value) for value in plant.CalcCenterOfMassPositionInWorld(context))
    front_share = x / geometry.wheelbase
    spatial = plant.CalcSpatialInertia(context, plant.world_frame(), [body.index() for body in _bodies(plant)])
    about_com = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    ahead, behind = geometry.wheelbase - x, x

    # Full lock: the inner wheel at its limit, the turning centre on the line of the rear axle.
    inner = geometry.steering_limit
    outer = math.atan2(1.0, 1.0 / math.tan(inner) + geometry.kingpin_track / geometry.wheelbase)
    radius = geometry.wheelbase / math.tan(inner) + 0.5 * geometry.kingpin_track
    scrub = 0.5 * (geometry.front_track - geometry.kingpin_track)
    outermost = math.hypot(geometry.wheelbase, radius + 0.5 * geometry.kingpin_track) + scrub

    boxes = {body.name(): _extent(plant, scene_graph, context, body) for body in _bodies(plant)}
    wheels = {plant.GetJointByName(name).child_body().name() for name in vehicle.spec.joints.wheels.names()}
    everything = [box for box in boxes.values() if box is not None]
    low, high = np.min([box[0] for box in everything], axis=0), np.max([box[1] for box in everything], axis=0)
    rest = [box[0][2] for name, box in boxes.items() if box is not None and name not in wheels]
    links = tuple(_link(plant, context, scene_graph, body) for body in _bodies(plant))
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
        side_share=0.5 + y / (front_share * geometry.front_track + (1.0 - front_share) * geometry.rear_track),
        wheelbase=geometry.wheelbase,
        tracks=(geometry.front_track, geometry.rear_track),
        kingpin_track=geometry.kingpin_track,
        wheel_radii=(geometry.front_wheel_radius, geometry.rear_wheel_radius),
        wheel_widths=(geometry.front_wheel_width, geometry.rear_wheel_width),
        size=(float(high[0] - low[0]), float(high[1] - low[1]), float(high[2])),
        ground_clearance=float(min(rest)) if rest else math.inf,
        steering_limits=(inner, outer),
        turning_radius=radius,
        turning_circle=2.0 * outermost,
        inertia=(float(about_com[0, 0]), float(about_com[1, 1]), float(about_com[2, 2])),
        dynamic_index=float(about_com[2, 2] / mass / (ahead * behind)) if ahead * behind > 0.0 else math.inf,
        static_stability=0.5 * min(geometry.front_track, geometry.rear_track) / z if z > 0.0 else math.inf,
        links=links,
        joints=joints,
        sensors=_sensors(plant, context, vehicle),
        warnings=(),
    )
    object.__setattr__(figures, "warnings", (*_warnings(figures, vehicle, wheels), *vehicle.warnings))
    return figures


# --- parts -------------------------------------------------------------------------------------------------------


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """All bodies of the vehicle, without the world."""
    instances = [ModelInstanceIndex(number) for number in range(2, plant.num_model_instances())]
    return [plant.get_body(index) for instance in instances for index in plant.GetBodyIndices(instance)]


def _extent(
    plant: MultibodyPlant, scene_graph: SceneGraph, context: Any, body: RigidBody
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Corners of the box around a body's collision shapes, along the axes of base_link; None without shapes."""
    inspector = scene_graph.model_inspector()
    X_WB = plant.EvalBodyPoseInWorld(context, body)
    corners = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        if inspector.GetProperties(geometry, Role.kProximity) is None:
            continue
        box = inspector.GetObbInGeometryFrame(geometry)
        if box is None:
            continue
        X_WO = X_WB @ inspector.GetPoseInFrame(geometry) @ box.pose()
        half = np.asarray(box.half_width())
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
        corners.append((X_WO.rotation().matrix() @ (signs * half).T).T + X_WO.translation())
    if not corners:
        return None
    points = np.vstack(corners)
    return points.min(axis=0), points.max(axis=0)


def _link(plant: MultibodyPlant, context: Any, scene_graph: SceneGraph, body: RigidBody) -> LinkFigures:
    mass = float(body.default_mass())
    box = _extent(plant, scene_graph, context, body)
    extent = sorted((box[1] - box[0]).tolist(), reverse=True) if box is not None else [0.0] * 3
    if mass <= 0.0:
        return LinkFigures(body.name(), 0.0, _NONE, _NONE, _NONE, _three(extent))
    spatial = body.CalcSpatialInertiaInBodyFrame(context)
    com = spatial.get_com()
    moments = np.linalg.eigvalsh(spatial.Shift(com).CalcRotationalInertia().CopyToFullMatrix3())
    # A box with edges a, b, c has I_a = m (b² + c²) / 12 and so on.
    squares = [6.0 * (moments.sum() - 2.0 * moment) / mass for moment in moments]
    edges = sorted((math.sqrt(max(square, 0.0)) for square in squares), reverse=True)
    return LinkFigures(body.name(), mass, _three(com), _three(moments), _three(edges), _three(extent))


def _joints(plant: MultibodyPlant, context: Any, vehicle: Vehicle) -> tuple[JointFigures, ...]:
    joints = vehicle.spec.joints
    roles = {getattr(joints.wheels, wheel): f"{wheel} wheel" for wheel in WHEELS}
    driven = {getattr(joints.wheels, wheel) for wheel in vehicle.spec.driven_wheels()}
    roles = {name: f"{role}, driven" if name in driven else role for name, role in roles.items()}
    roles |= {joints.steering.left: "left steering", joints.steering.right: "right steering"}
    efforts = {
        (actuator := plant.get_joint_actuator(index)).joint().name(): float(actuator.effort_limit())
        for index in plant.GetJointActuatorIndices()
    }
    found = []
    for element in ElementTree.fromstring(vehicle.urdf).findall("joint"):
        name, kind = element.get("name", ""), element.get("type", "")
        joint = plant.GetJointByName(name)
        X_BJ = plant.CalcRelativeTransform(context, plant.world_frame(), joint.frame_on_child())
        turns = kind in {"revolute", "continuous", "prismatic"}
        axis = joint.revolute_axis() if kind in {"revolute", "continuous"} else None
        if kind == "prismatic":
            axis = joint.translation_axis()
        limits = (joint.position_lower_limits(), joint.position_upper_limits(), joint.velocity_upper_limits())
        lower, upper, velocity = (float(limit[0]) if turns else 0.0 for limit in limits)
        found.append(
            JointFigures(
                name=name,
                kind=kind,
                parent=joint.parent_body().name(),
                child=joint.child_body().name(),
                role=roles.get(name, ""),
                place=_three(X_BJ.translation()),
                axis=_three(X_BJ.rotation().multiply(axis)) if axis is not None else (),
                lower=lower,
                upper=upper,
                velocity=velocity,
                effort=efforts.get(name, 0.0),
            )
        )
    return tuple(found)


def _sensors(plant: MultibodyPlant, context: Any, vehicle: Vehicle) -> tuple[SensorFigures, ...]:
    found = []
    for name, mount in vehicle.sensors.mounts.items():
        X_BS = plant.CalcRelativeTransform(context, plant.world_frame(), plant.GetFrameByName(mount.frame))
        found.append(SensorFigures(name, mount.kind, mount.frame, _three(X_BS.translation()), mount.rate))
    return tuple(found)


def _warnings(figures: Inspection, vehicle: Vehicle, wheels: set[str]) -> list[str]:
    """What a person who knows cars would look at twice."""
    found = []
    x, y, z = figures.com
    if not 0.0 < x < figures.wheelbase:
        found.append(f"centre of mass {x:.3f} m ahead of the rear axle: not between the axles, the vehicle tips over")
    elif not 0.25 < figures.front_share < 0.75:
        found.append(f"{100.0 * figures.front_share:.0f} % of the weight is on the front axle; cars have 40 to 65 %")
    if z <= 0.0:
        found.append(f"centre of mass {-z:.3f} m below the road: load transfer has the wrong sign")
    elif figures.static_stability < 1.0:
        found.append(
            f"centre of mass {z:.3f} m above the road: tips at {figures.static_stability:.2f} g sideways, "
            "before it slides"
        )
    if abs(y) > 0.02 * figures.tracks[1]:
        found.append(f"centre of mass {abs(y):.3f} m to the {'left' if y > 0.0 else 'right'}")
    if not 0.5 < figures.dynamic_index < 1.5:
        index = figures.dynamic_index
        found.append(f"yaw inertia {figures.inertia[2]:.4g} kg m²: {index:.2f} m a b; cars have 0.8 to 1.1")
    for link in figures.links:
        found += _implausible(link, wheels, figures)
    for joint in figures.joints:
        if joint.role.endswith("steering") and math.isinf(vehicle.geometry.steering_rate):
            found.append(f"joint '{joint.name}': no limit of its rate; the steering jumps")
        if joint.effort > 0.0 and math.isinf(joint.effort):
            found.append(f"joint '{joint.name}': no effort limit; it can give any torque")
    clearance = 0.02 * figures.wheelbase
    if figures.ground_clearance < clearance:
        found.append(f"ground clearance {figures.ground_clearance:.3f} m; the body may scrape")
    found += [f"vehicle.yaml: no source for {path}" for path in vehicle.spec.numbers_without_source()]
    return found


def _implausible(link: LinkFigures, wheels: set[str], figures: Inspection) -> list[str]:
    """Inertia that does not fit the mass and the shapes of a link."""
    if link.mass == 0.0:
        return []
    found = []
    if link.name in wheels:
        radius = max(link.extent[0], link.extent[1]) / 2.0
        factor = link.moments[2] / (link.mass * radius**2)
        if not SPIN_FACTORS[0] <= factor <= SPIN_FACTORS[1]:
            found.append(
                f"wheel '{link.name}': largest moment of inertia {link.moments[2]:.4g} kg m² is {factor:.2f} m R²; "
                "a disc has 0.5, a hoop 1"
            )
        return found
    if link.extent[0] > 0.0:
        ratio = link.edges[0] / link.extent[0]
        if not SIZE_RATIOS[0] <= ratio <= SIZE_RATIOS[1]:
            found.append(
                f"link '{link.name}': inertia of a box {link.edges[0]:.3g} m long, but its shapes measure "
                f"{link.extent[0]:.3g} m"
            )
    small, middle, large = link.moments
    if small + middle < 1.001 * large and link.mass > 0.05 * figures.mass:
        found.append(f"link '{link.name}': inertia of a flat plate ({small:.4g} + {middle:.4g} = {large:.4g} kg m²)")
    return found


def _three(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float, float]:
    a, b, c = (float(value) + 0.0 for value in values)
    return a, b, c


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value
