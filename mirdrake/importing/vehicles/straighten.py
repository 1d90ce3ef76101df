"""Dimensions of a car in the form of mirdrake: mirrored pairs of wheels, lateral spin axes, vertical steering axes.

Small deviations of the source, such as camber, an inclined steering axis or a wheel that is 2 mm too far ahead, are
removed and reported. Large ones are rejected with their values.
"""

from math import acos, asin, degrees

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from mirdrake.core.errors import ModelError
from mirdrake.importing.changes import Change, Changes, Code, unusual
from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.car import Layout
from mirdrake.importing.vehicles.kinematics import Tree, frame_about, source_name
from mirdrake.importing.vehicles.model import Joint
from mirdrake.importing.vehicles.recognise import Roles, Wheel
from mirdrake.vehicles.spec import WHEELS

SIDES = ("left", "right")
ALIKE = 0.02
"""Left and right may differ by this part of the dimension, or by SLACK; beyond, the source is a mistake."""

SLACK = 0.003
"""[m] that a careless file is off by, also where 2 % of a small dimension are less."""

WORTH_SAYING = 1e-3
"""Angles [rad], and lengths over the wheelbase, that are reported."""

SEEN = 0.05
"""Relative difference of visual and collision radius that is reported."""

BESIDE = 0.15
"""Lateral offset of visual and collision shape over the radius that is reported."""

MOST_SKEW = 0.2
"""Largest slope [rad] of the road below the wheels at the zero position."""


def straighten(roles: Roles) -> tuple[Layout, list[Change]]:
    """Measure a recognised car, and straighten it.

    Raises:
        ModelError: wheels or axes are too far from those of a straight car.
    """
    tree, wheels = roles.tree, roles.wheels
    changes = Changes()
    location = source_name(tree.model)
    # Radii first: the contact points are one radius below the wheel centres.
    radii, widths = [], []
    for end in ("front", "rear"):
        pair = [wheels[f"{end}_{side}"] for side in SIDES]
        radii.append(
            _mean(location, f"radii of the {end} wheels", [wheel.shape.radius for wheel in pair], pair, changes)
        )
        sizes = [wheel.shape.width for wheel in pair]
        widths.append(_mean(location, f"widths of the {end} wheels", sizes, pair, changes, strict=False))
    # Base frame from the contact points, then each wheel and steering axis relative to it.
    contact = {
        name: wheel.point - np.array([0.0, 0.0, radii[name.startswith("rear")]]) for name, wheel in wheels.items()
    }
    X_MB = _base_frame(location, contact, changes)
    X_BM = X_MB.inverse()
    points = {name: X_BM.multiply(point) for name, point in contact.items()}
    wheelbase = float(points["front_left"][0] + points["front_right"][0]) / 2.0
    tracks = tuple(float(points[f"{end}_left"][1] - points[f"{end}_right"][1]) for end in ("front", "rear"))
    parts: dict[str, RigidTransform] = {}
    for name, wheel in wheels.items():
        front, left = name.startswith("front"), name.endswith("left")
        # Ideal contact point in B: rear axle at x = 0, front axle at the wheelbase, half a track to each side.
        ideal = np.array([wheelbase * front, (0.5 if left else -0.5) * tracks[not front], 0.0])
        _report_moved(location, wheel, points[name] - ideal, wheelbase, changes)
        parts[name] = _wheel_frame(wheel, X_MB, changes)
    # Steering axes: left and right must not be exchanged, and are made mirror images.
    kingpins = [_kingpin(tree, joint, X_BM, changes) for joint in roles.steering]
    kingpin_track = float(kingpins[0][1] - kingpins[1][1])
    if kingpin_track <= 0.0:
        names = " and ".join(f"'{joint.name}'" for joint in roles.steering)
        raise ModelError(
            f"steering axes {names} cross: the left one is {-kingpin_track:.4g} m to the right of the other",
            where=location,
        )
    skew = float(np.abs(kingpins[0] - kingpins[1] * np.array([1.0, -1.0])).max())
    if skew > max(SLACK, ALIKE * wheelbase):
        raise ModelError(
            f"steering axes at {_shown(kingpins[0])} and {_shown(kingpins[1])} m are not mirror images "
            f"within {max(SLACK, ALIKE * wheelbase):.2g} m",
            where=location,
        )
    # Mean of the left steering axis and the mirror image of the right one.
    middle = 0.5 * (kingpins[0] + kingpins[1] * np.array([1.0, -1.0]))
    if skew > WORTH_SAYING * wheelbase:
        was = f"{_shown(kingpins[0])} and {_shown(kingpins[1])} m"
        why = "left and right are mirror images"
        changes.add(Code.GEOMETRY, roles.steering[0].where, "places of the steering axes", was, _shown(middle), why)
    for side, kingpin in zip(SIDES, kingpins, strict=True):
        # The knuckle frame is on the steering axis at the height of the wheel centre.
        kingpin_point = np.array([kingpin[0], kingpin[1], radii[0]])
        parts[f"{side}_knuckle"] = X_MB.multiply(RigidTransform(kingpin_point))
    # Positive trail: the steering axis is ahead of the wheel centre.
    trail = float(middle[0]) - wheelbase
    layout = Layout(
        wheelbase=wheelbase,
        tracks=(tracks[0], tracks[1]),
        kingpin_track=2.0 * float(middle[1]),
        trail=trail if abs(trail) > 1e-6 else 0.0,
        radii=(radii[0], radii[1]),
        widths=(widths[0], widths[1]),
        X_MB=X_MB,
        parts=parts,
    )
    return layout, changes


def _mean(
    place: str, part: str, values: list[float], pair: list[Wheel], changes: Changes, *, strict: bool = True
) -> float:
    """Return the mean of left and right."""
    low, high = min(values), max(values)
    # A difference beyond the tolerance is intended by the author and cannot be averaged away.
    if strict and high - low > max(SLACK, ALIKE * high):
        names = " and ".join(f"'{wheel.joint.name}'" for wheel in pair)
        raise ModelError(
            f"{part} {names} are {values[0]:.4g} and {values[1]:.4g} m; the wheels of an axle should be equal",
            where=place,
        )
    mean = 0.5 * (low + high)
    if high - low > WORTH_SAYING * high:
        was = f"{values[0]:.4g} and {values[1]:.4g} m"
        changes.add(
            Code.GEOMETRY, pair[0].shape.shape.where, part, was, f"{mean:.4g} m", "the wheels of an axle are equal"
        )
    return mean


def _base_frame(place: str, contact: dict[str, Vector], changes: Changes) -> RigidTransform:
    """Return base_link: below the centre of the rear axle, x ahead, in the plane of the contact points."""
    front = 0.5 * (contact["front_left"] + contact["front_right"])
    rear = 0.5 * (contact["rear_left"] + contact["rear_right"])
    across = contact["front_left"] + contact["rear_left"] - contact["front_right"] - contact["rear_right"]
    # x from axle to axle, y from the wheels of both sides, made orthogonal.
    x = (front - rear) / np.linalg.norm(front - rear)
    across = across / np.linalg.norm(across)
    # Both are unit vectors, so their product is the sine of the deviation from a right angle.
    skew = asin(float(x @ across))
    if abs(skew) > MOST_SKEW:
        raise ModelError(
            f"the axles are askew by {degrees(skew):.3g} degrees; left and right should mirror", where=place
        )
    y = across - x * (across @ x)
    y = y / np.linalg.norm(y)
    z = np.cross(x, y)
    # Signs of ISO 8855: positive pitch lowers the front, positive roll raises the left side.
    for part, angle in (("pitch", asin(-float(x[2]))), ("roll", asin(float(y[2])))):
        if abs(angle) > MOST_SKEW:
            height = ", ".join(f"{name} {contact[name][2]:.4g}" for name in WHEELS)
            raise ModelError(f"the wheels are not on one level road; their lowest points [m]: {height}", where=place)
        if abs(angle) > WORTH_SAYING:
            why = "the wheels of the source are not level at the zero position"
            was = f"the contact points have {degrees(angle):.3g} degrees of {part}"
            changes.add(Code.GEOMETRY, place, "level", was, "rotated to level", why)
    return RigidTransform(RotationMatrix(np.column_stack([x, y, z])), rear)


def _report_moved(place: str, wheel: Wheel, shift: Vector, wheelbase: float, changes: Changes) -> None:
    """Report the distance [m] of a wheel from its mirrored position."""
    distance, allowed = float(np.linalg.norm(shift)), max(SLACK, ALIKE * wheelbase)
    if distance > allowed:
        raise ModelError(
            f"wheel of '{wheel.joint.name}' is {_shown(shift)} m from the mirrored position of the other "
            f"wheel of its axle; {allowed:.2g} m is allowed",
            where=place,
        )
    if distance > WORTH_SAYING * wheelbase:
        part = f"joint '{wheel.joint.name}': place"
        why = "left and right are mirror images"
        changes.add(
            Code.GEOMETRY, wheel.joint.where, part, f"{_shown(shift)} m from the mirrored position", "mirrored", why
        )


def _wheel_frame(wheel: Wheel, X_MB: RigidTransform, changes: Changes) -> RigidTransform:
    """Return the frame of a wheel in the source, y along its axis to the left."""
    R_MB = X_MB.rotation().matrix()
    joint, shape = wheel.joint, wheel.shape
    # Sense of the axis first: camber and toe refer to the corrected one.
    axis = wheel.axis
    part = f"joint '{joint.name}'"
    if axis @ R_MB[:, 1] < 0.0:
        axis = -axis
        why = "positive wheel speed drives forward"
        changes.add(Code.GEOMETRY, joint.where, f"{part}: sense of the axis", "to the right", "to the left", why)
    # Components of the spin axis in B: forward is toe, upward is camber.
    along, _, up = R_MB.T @ axis
    for name, angle in (("camber", asin(float(up))), ("toe", asin(float(along)))):
        if abs(angle) > WORTH_SAYING:
            was = f"{degrees(angle):.3g} degrees of {name}"
            why = "wheels have no camber and no toe in mirdrake"
            changes.add(Code.GEOMETRY, joint.where, f"{part}: axis", was, "lateral", why)
    if wheel.off_axis > max(1e-3, 0.01 * shape.radius):
        was = f"centre {wheel.off_axis:.3g} m from the joint's axis"
        why = "a wheel is centred on its axis"
        changes.add(Code.SHAPE, shape.shape.where, f"{part}: {shape.role} shape", was, "centred", why)
    if shape.width_from:
        was = f"sphere of radius {shape.radius:.4g} m"
        became = f"cylinder {shape.width:.4g} m wide ({shape.width_from})"
        changes.add(Code.SHAPE, shape.shape.where, f"{part}: {shape.role} shape", was, became, "a sphere has no width")
    # The collision shape decides; a visual that differs from it is a hint to check.
    if wheel.seen is not None and abs(wheel.seen.centre[1] - shape.centre[1]) > BESIDE * shape.radius:
        was = f"middle {abs(wheel.seen.centre[1] - shape.centre[1]):.3g} m from that of the visual"
        changes.append(unusual(shape.shape.where, f"{part}: track", was, "the collision shape counts"))
    if wheel.seen is not None and abs(wheel.seen.radius - shape.radius) > SEEN * shape.radius:
        was = f"radius {shape.radius:.4g} m, looks like {wheel.seen.radius:.4g} m"
        changes.append(unusual(shape.shape.where, f"{part}: radius", was, "the collision shape counts"))
    if shape.role == "visual":
        became = f"cylinder of radius {shape.radius:.4g} m, {shape.width:.4g} m wide"
        why = "the wheel has no round collision shape; that of the visual is used"
        changes.add(Code.SHAPE, shape.shape.where, f"{part}: collision shape", "none that is round", became, why)
    return frame_about(wheel.point, y=axis, up=R_MB[:, 2])


def _kingpin(tree: Tree, joint: Joint, X_BM: RigidTransform, changes: Changes) -> Vector:
    """Return the point where a steering axis meets the road, x and y [m]."""
    axis = tree.axis(joint)
    assert axis is not None, "recognised by its axis"
    up = X_BM.rotation().multiply(axis)
    if up[2] < 0.0:
        up = -up
        why = "positive steering angle turns left"
        changes.add(Code.GEOMETRY, joint.where, f"joint '{joint.name}': sense of the axis", "downwards", "upwards", why)
    # The steering axis is made vertical where it meets the road, which keeps the scrub radius.
    inclination = acos(min(1.0, float(up[2])))
    if inclination > WORTH_SAYING:
        was = f"{degrees(inclination):.3g} degrees off the vertical"
        why = "steering axes are vertical in mirdrake; their position on the road is kept"
        changes.add(Code.GEOMETRY, joint.where, f"joint '{joint.name}': axis", was, "vertical", why)
    point = X_BM.multiply(tree.pose(joint).translation())
    on_road: Vector = (point - up * (point[2] / up[2]))[:2]
    return on_road


def _shown(vector: Vector) -> str:
    return " ".join(f"{value:.4g}" for value in np.where(np.abs(vector) < 1e-6, 0.0, vector))
