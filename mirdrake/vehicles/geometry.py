"""Dimensions of a vehicle, measured on its kinematics."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule, Cylinder, Ellipsoid, SceneGraph, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint

from mirdrake.core.errors import ModelError
from mirdrake.core.hulls import solids_of
from mirdrake.vehicles.spec import VehicleSpec

TOLERANCE = 1e-3  # [m] and [rad]: what counts as symmetric, lateral, vertical


@dataclass(frozen=True)
class VehicleGeometry:
    """Lengths [m] and steering limits of a vehicle at its design position.

    The wheels of one axle are alike; front and rear axle may differ.

    Attributes:
        wheelbase: distance between the axles.
        front_track: distance between the contact centres of the front wheels.
        rear_track: distance between the contact centres of the rear wheels.
        kingpin_track: distance between the steering axes, on the road.
        front_wheel_radius: unloaded radius of the front wheels.
        rear_wheel_radius: unloaded radius of the rear wheels.
        front_wheel_width: width of the collision shape of a front wheel.
        rear_wheel_width: width of the collision shape of a rear wheel.
        steering_limit: [rad] of the inner wheel.
        steering_rate: [rad/s] at the road wheel; inf without a limit.
    """

    wheelbase: float
    front_track: float
    rear_track: float
    kingpin_track: float
    front_wheel_radius: float
    rear_wheel_radius: float
    front_wheel_width: float
    rear_wheel_width: float
    steering_limit: float
    steering_rate: float

    @property
    def wheel_radii(self) -> tuple[float, float, float, float]:
        """Radius [m] of each wheel, in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front_wheel_radius,) * 2 + (self.rear_wheel_radius,) * 2

    @property
    def wheel_widths(self) -> tuple[float, float, float, float]:
        """Width [m] of each wheel, in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front_wheel_width,) * 2 + (self.rear_wheel_width,) * 2


def measure_geometry(
    plant: MultibodyPlant, scene_graph: SceneGraph, *, spec: VehicleSpec, where: Callable[[str], str]
) -> VehicleGeometry:
    """Return the dimensions of the only vehicle in a finalised plant.

    Args:
        plant: holds the vehicle and nothing else, finalised, all joints at zero.
        scene_graph: scene graph of the plant.
        spec: joint roles and optional steering limits.
        where: ``file:line`` of a joint in its source.

    Raises:
        ModelError: an axis is not lateral or vertical, the vehicle is not symmetric, or a wheel is not on the road.
    """
    # All measures are taken with the joints at zero, relative to the frame of base_link.
    context = plant.CreateDefaultContext()
    base = plant.GetFrameByName(spec.base_link)
    wheels = [plant.GetJointByName(name) for name in spec.joints.wheels.names()]
    kingpins = [plant.GetJointByName(name) for name in spec.joints.steering.names()]

    def axis_and_centre(joint: RevoluteJoint) -> tuple[np.ndarray, np.ndarray]:
        X_BJ = plant.CalcRelativeTransform(context, base, joint.frame_on_child())
        return X_BJ.rotation().multiply(joint.revolute_axis()), X_BJ.translation()

    # The signs of speeds and angles follow from the axes, so both are checked before anything is measured.
    for joint in wheels:
        axis, _ = axis_and_centre(joint)
        if abs(axis[1] - 1.0) > TOLERANCE:
            raise ModelError(
                f"wheel joint '{joint.name()}' turns about {_shown(axis)} of "
                f"'{spec.base_link}'; it must be 0 1 0, so that a positive speed rolls forward",
                where=where(joint.name()),
            )
    for joint in kingpins:
        axis, _ = axis_and_centre(joint)
        if abs(axis[2] - 1.0) > TOLERANCE:
            raise ModelError(
                f"steering joint '{joint.name()}' turns about {_shown(axis)} of "
                f"'{spec.base_link}'; it must be 0 0 1, so that a positive angle turns left",
                where=where(joint.name()),
            )
    # One number describes both sides of an axle, so the sides must be mirror images.
    p_BW = np.array([axis_and_centre(joint)[1] for joint in wheels])
    p_BK = np.array([axis_and_centre(joint)[1] for joint in kingpins])
    for pair, points in ((wheels[:2], p_BW[:2]), (wheels[2:], p_BW[2:]), (kingpins, p_BK)):
        _check_pair(pair, points, where)
    # Both wheels of an axle at once, so that a difference between them is an error that names both.
    sizes = [_measure_axle(plant, scene_graph, axle, where) for axle in (wheels[:2], wheels[2:])]
    # The rest pose and the tyre model assume that base_link is on the road below the rear axle.
    for i, (joint, (x, _, z)) in enumerate(zip(wheels, p_BW, strict=True)):
        radius = sizes[i // 2][0]
        if abs(z - radius) > TOLERANCE:
            raise ModelError(
                f"wheel of '{joint.name()}' has its centre {z:.4f} m above '{spec.base_link}' "
                f"but a radius of {radius:.4f} m; '{spec.base_link}' should lie on the road",
                where=where(joint.name()),
            )
        if i >= 2 and abs(x) > TOLERANCE:
            raise ModelError(
                f"rear wheel '{joint.name()}' is at x = {x:.4f} m; '{spec.base_link}' should lie below the rear axle",
                where=where(joint.name()),
            )
    limit, rate = _steering_limits(kingpins, where)
    return VehicleGeometry(
        wheelbase=float(p_BW[0, 0] - p_BW[2, 0]),
        front_track=float(p_BW[0, 1] - p_BW[1, 1]),
        rear_track=float(p_BW[2, 1] - p_BW[3, 1]),
        kingpin_track=float(p_BK[0, 1] - p_BK[1, 1]),
        front_wheel_radius=sizes[0][0],
        rear_wheel_radius=sizes[1][0],
        front_wheel_width=sizes[0][1],
        rear_wheel_width=sizes[1][1],
        # The specification may limit steering further than the joints do.
        steering_limit=min(limit, spec.steering.limit or math.inf),
        steering_rate=min(rate, spec.steering.rate or math.inf),
    )


def _check_pair(joints: list[RevoluteJoint], points: np.ndarray, where: Callable[[str], str]) -> None:
    """Check that the left and the right joint are mirror images and not exchanged."""
    left, right = points
    if left[1] <= right[1]:
        raise ModelError(
            f"'{joints[0].name()}' lies to the right of '{joints[1].name()}'; exchange them",
            where=where(joints[0].name()),
        )
    # The mirror plane is y = 0 of base_link.
    mirrored = right * np.array([1.0, -1.0, 1.0])
    if np.abs(left - mirrored).max() > TOLERANCE:
        raise ModelError(
            f"'{joints[0].name()}' at {_shown(left)} m and '{joints[1].name()}' at "
            f"{_shown(right)} m are not mirror images within 1 mm",
            where=where(joints[0].name()),
        )


def _measure_axle(
    plant: MultibodyPlant, scene_graph: SceneGraph, wheels: list[RevoluteJoint], where: Callable[[str], str]
) -> tuple[float, float]:
    """Return radius and width [m] of the wheels of an axle, from collision shapes that are coaxial with the joints."""
    inspector = scene_graph.model_inspector()
    sizes = []
    for joint in wheels:
        body = joint.child_body()
        sizes_of_shapes = [
            _wheel_size(inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry))
            for geometry in solids_of(plant, inspector, body)
        ]
        sized = [size for size in sizes_of_shapes if size is not None]
        if not sized:
            raise ModelError(
                f"wheel '{body.name()}' has no collision shape that is round about its axis; "
                "give it a cylinder about y",
                where=where(joint.name()),
            )
        # The largest shape touches the road; smaller ones, such as a hub, are inside it.
        sizes.append(max(sized))
    low, high = np.min(sizes, axis=0), np.max(sizes, axis=0)
    if high[0] - low[0] > TOLERANCE:
        raise ModelError(
            f"'{wheels[0].name()}' and '{wheels[1].name()}' turn wheels of different "
            f"radius, {low[0]:.4f} and {high[0]:.4f} m; make the wheels of an axle alike",
            where=where(wheels[0].name()),
        )
    return float(high[0]), float(high[1])


def _wheel_size(shape: Shape, X_WS: RigidTransform) -> tuple[float, float] | None:
    """Return radius and width of a shape that is centred on the wheel and round about its y axis, else None."""
    # An offset along the axle is allowed, as of a tyre beside its joint; one in the disc would be eccentric.
    if np.abs(X_WS.translation()[[0, 2]]).max() > TOLERANCE:
        return None
    if isinstance(shape, Sphere):
        return shape.radius(), 2.0 * shape.radius()
    # Drake's cylinders, capsules and ellipsoids have their axis along z of the shape.
    along_y = abs(abs(X_WS.rotation().matrix()[1, 2]) - 1.0) < TOLERANCE
    if isinstance(shape, Cylinder) and along_y:
        return shape.radius(), shape.length()
    if isinstance(shape, Capsule) and along_y:
        return shape.radius(), shape.length() + 2.0 * shape.radius()
    if isinstance(shape, Ellipsoid) and along_y:
        return max(shape.a(), shape.b()), 2.0 * shape.c()
    return None


def _steering_limits(kingpins: list[RevoluteJoint], where: Callable[[str], str]) -> tuple[float, float]:
    """Return the angle [rad] and rate [rad/s] that both steering joints reach to both sides."""
    for joint in kingpins:
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        if not -math.pi / 2 < low < 0.0 < high < math.pi / 2:
            raise ModelError(
                f"steering joint '{joint.name()}' is limited to {low:g} … {high:g} rad; "
                "it needs a limit on each side of zero, below pi/2",
                where=where(joint.name()),
            )
    # The smaller side counts, since a limit is one number for left and right.
    limit = min(min(joint.position_upper_limit(), -joint.position_lower_limit()) for joint in kingpins)
    rate = min(min(joint.velocity_upper_limit(), -joint.velocity_lower_limit()) for joint in kingpins)
    return float(limit), float(rate)


def _shown(vector: np.ndarray) -> str:
    return " ".join(f"{value:.4g}" for value in np.where(np.abs(vector) < 1e-9, 0.0, vector))
