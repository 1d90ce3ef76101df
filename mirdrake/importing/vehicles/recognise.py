"""Recognition of wheel and steering joints by their motion, not by their names.

A road wheel is round about the level axis on which it turns freely, and is one of the lowest parts of the model. It is
steered if another joint between it and the body turns about an upright axis. A car has four wheels on two axles, two of
them steered; any other model is rejected with what was found.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from mirdrake.core.errors import ModelError
from mirdrake.core.wording import plural
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.driven import find_drive
from mirdrake.importing.vehicles.kinematics import UP, Tree, frame_about, make_tree, source_name
from mirdrake.importing.vehicles.model import Joint, Limits, SourceModel
from mirdrake.importing.vehicles.round_shapes import Round, bounds_in, find_rounds
from mirdrake.importing.vehicles.unusable import unusable_steering, unusable_wheels
from mirdrake.vehicles.spec import WHEELS, Drive

LEVEL = 0.35
"""Largest sine of a wheel axis over the horizontal: camber, and swing arms that are not at their rest position."""

UPRIGHT = 0.8
"""Smallest cosine between a steering axis and the vertical: kingpins are inclined by up to 15 degrees, some by more."""

LOW = 0.3
"""Height difference of wheels on one road over the radius."""

WORLD_LIMIT = 1e15  # SDF writes "no limit" as ±1e16
BOTH_STEERED = "both axles are steered; the front is that towards +x, for the other see steering.rear in vehicle.yaml"


@dataclass(frozen=True)
class Wheel:
    """A road wheel in the model's frame M.

    Attributes:
        joint: joint on which it turns.
        second: whether it turns on the joint's second axis (universal, revolute2).
        axis: unit vector, as the source has it: to the left or to the right.
        point: point on the axis, in the wheel's middle plane [m].
        off_axis: how far the shape's centre is from the axis [m].
        shape: round shape.
        steering: upright joints on the way from the root, the nearest to the wheel last.
        seen: the largest round visual; None if there is none.
    """

    joint: Joint
    second: bool
    axis: Vector
    point: Vector
    off_axis: float
    shape: Round
    steering: tuple[Joint, ...]
    seen: Round | None

    @property
    def bottom(self) -> float:
        """Height of the lowest point [m]."""
        return float(self.point[2] - self.shape.radius)


@dataclass(frozen=True)
class Roles:
    """Wheel and steering joints of a model.

    Attributes:
        tree: tree of the model.
        wheels: wheels by name, in the order of :data:`mirdrake.vehicles.spec.WHEELS`.
        steering: joints of the left and of the right front wheel.
        drive: driven axle.
        drive_source: its place in the source; "" if it is not stated.
        changes: changes of the recognition.
    """

    tree: Tree
    wheels: dict[str, Wheel]
    steering: tuple[Joint, Joint]
    drive: Drive
    drive_source: str
    changes: Changes


def recognise(model: SourceModel, drive: Drive | None = None) -> Roles:
    """Find wheels, steering and driven axle of a model.

    Args:
        model: model as read.
        drive: driven axle, if the caller knows it.

    Raises:
        ModelError: the model is not a car with four wheels, two of them steered; the message states what it is.
    """
    tree, changes = make_tree(model)
    wheels_found, blank = find_wheels(tree)
    axles = _axles(tree, wheels_found, blank)
    front, rear = _front_and_rear(tree, axles, changes)
    ahead = _level(_middle(front) - _middle(rear))
    # Left follows from up and the direction of travel, whatever axes the source has.
    left = np.cross(UP, ahead)
    wheels = {}
    for name, pair in (("front", front), ("rear", rear)):
        for side, wheel in zip(("left", "right"), sorted(pair, key=lambda wheel: -(wheel.point @ left)), strict=True):
            wheels[f"{name}_{side}"] = wheel
    wheels = {name: wheels[name] for name in WHEELS}
    steering = (_own(wheels["front_left"], front)[-1], _own(wheels["front_right"], front)[-1])
    joints = {name: wheel.joint.name for name, wheel in wheels.items()}
    drive, drive_source, driven_changes = find_drive(model, joints, asked=drive)
    return Roles(tree, wheels, steering, drive, drive_source, Changes(changes + driven_changes))


def turns_freely(joint: Joint, limits: Limits) -> bool:
    """Return whether a joint turns without end: continuous, without limits, or limits more than a turn apart."""
    if joint.kind == "continuous":
        return True
    if joint.kind not in ("revolute", "revolute2", "universal"):
        return False
    low, high = limits.lower, limits.upper
    if low is None or high is None or not (np.isfinite(low) and np.isfinite(high)):
        return True
    return min(abs(low), abs(high)) > WORLD_LIMIT or high - low > 2.0 * pi


def find_wheels(tree: Tree) -> tuple[list[Wheel], list[Joint]]:
    """Return the round links that turn freely about a level axis and touch the lowest plane.

    Returns:
        wheels, and joints that turn like wheels but carry nothing round.

    Raises:
        ModelError: a joint turns the wheels of both sides.
    """
    # The shape decides, not the name: a wheel is round about its own axis.
    turning, blank = [], []
    spinning = {joint.name: spin for joint in tree.above.values() if (spin := _spin(tree, joint)) is not None}
    for name, (joint, axis, second) in spinning.items():
        X_MW = frame_about(tree.pose(joint).translation(), y=axis, up=UP)
        rounds = find_rounds(tree, tree.rigid_with(joint.child, ()), X_MW)
        if not rounds:
            blank.append(joint)
            continue
        shape = rounds[0]
        # Equal round shapes more than a diameter apart on one joint are the wheels of a rigid axle.
        alike = [item.centre[1] for item in rounds if item.role == shape.role and item.radius > 0.9 * shape.radius]
        if max(alike) - min(alike) > 2.0 * shape.radius:
            inner = [
                other for other in spinning if any(above.name == name for above in tree.path(spinning[other][0].parent))
            ]
            if len(inner) > 1:  # the cage of a differential
                continue
            raise ModelError(
                f"joint '{name}' turns the wheels of both sides; mirdrake needs a joint for each of the four wheels",
                where=source_name(tree.model),
            )
        upright = [other for other in tree.path(joint.child) if other is not joint and _is_upright(tree, other)]
        if second and _is_upright(tree, joint):
            upright.append(joint)
        # Distance of the shape's centre from the joint's axis, which is y of W.
        off_axis = float(np.hypot(shape.centre[0], shape.centre[2]))
        point = X_MW.multiply(np.array([0.0, shape.centre[1], 0.0]))
        seen = next((item for item in rounds if item.role == "visual"), None)
        turning.append(Wheel(joint, second, axis, point, off_axis, shape, tuple(upright), seen))
    if not turning:
        return [], blank
    # Steering wheels, fans and lidars are round and turn as well, but do not touch the road.
    lowest = min(turning, key=lambda wheel: wheel.bottom)
    return [wheel for wheel in turning if wheel.bottom - lowest.bottom <= LOW * lowest.shape.radius], blank


def _spin(tree: Tree, joint: Joint) -> tuple[Joint, Vector, bool] | None:
    """Return a joint that turns freely about a level axis, with that axis in M and whether it is its second one."""
    # The second axis of a universal joint spins the wheel if it is level; the first one steers then.
    second = joint.kind in ("universal", "revolute2") and _is_level(tree.axis(joint, second=True))
    axis = tree.axis(joint, second=second)
    limits = joint.limits2 if second else joint.limits
    return (joint, axis, second) if axis is not None and _is_level(axis) and turns_freely(joint, limits) else None


def _is_level(axis: Vector | None) -> bool:
    return axis is not None and abs(axis[2]) <= LEVEL


def _is_upright(tree: Tree, joint: Joint) -> bool:
    if joint.kind not in ("revolute", "continuous", "universal", "revolute2"):
        return False
    axis = tree.axis(joint)
    return axis is not None and abs(axis[2]) >= UPRIGHT


# --- axles -------------------------------------------------------------------------------------------------------


def _axles(tree: Tree, wheels: list[Wheel], blank: list[Joint]) -> list[list[Wheel]]:
    """Return the wheels of two axles."""
    if not wheels:
        part = f"no road wheels: {_inventory(tree)}, none of which turns a round link about a level axis"
        raise _rejection(tree, part + _blank_clause(tree, blank), wheels)
    # Axes point to either side; all are turned to the side of the first before their mean is taken.
    axes = np.array([wheel.axis * (1.0 if wheel.axis @ wheels[0].axis >= 0.0 else -1.0) for wheel in wheels])
    lateral = _level(axes.sum(axis=0))
    if (np.abs(axes @ lateral) < 1.0 - LEVEL**2).any():
        raise _rejection(tree, f"{_named(wheels)}, whose axes are not parallel", wheels)
    along = np.cross(lateral, UP)
    places = sorted(wheels, key=lambda wheel: wheel.point @ along)
    # Wheels that are less than half a radius apart along the car share an axle.
    reach = 0.5 * min(wheel.shape.radius for wheel in wheels)
    axles: list[list[Wheel]] = []
    for wheel in places:
        if axles and (wheel.point - axles[-1][-1].point) @ along < reach:
            axles[-1].append(wheel)
        else:
            axles.append([wheel])
    if len(wheels) == 4 and [len(axle) for axle in axles] == [2, 2]:
        for left, right in axles:
            if abs((left.point - right.point) @ lateral) < 0.5 * (left.shape.width + right.shape.width):
                raise _rejection(tree, f"{_named(wheels)}, two of which are at the same place", wheels)
        return axles
    raise _rejection(tree, _other_vehicle(tree, wheels, axles) + _blank_clause(tree, blank), wheels)


def _other_vehicle(tree: Tree, wheels: list[Wheel], axles: list[list[Wheel]]) -> str:
    """Return the kind of vehicle with these wheels, for a message."""
    swivels = [wheel for wheel in wheels if _is_caster(tree, wheel)]
    driven = [wheel for wheel in wheels if wheel not in swivels]
    # A link that touches the road and is steered within limits is a front wheel without a joint to turn on.
    feet = _feet(tree, wheels)
    stiff = [
        link for link in feet if any(_is_upright(tree, j) and not turns_freely(j, j.limits) for j in tree.path(link))
    ]
    casters = len(swivels) + len(feet) - len(stiff)
    steered = [wheel for wheel in wheels if wheel.steering]
    number = len(wheels)
    # Order matters: a differential drive may have as many wheels as a tricycle.
    if len(driven) == 2 and not stiff and (casters or (number == 2 and len(axles) == 1)):
        count = f" and {plural(casters, 'caster')}" if casters else " on one axle"
        return f"2 driven wheels{count} (differential drive): {_names(driven)}"
    if number == 2 and len(axles) == 2:
        return f"a bicycle: {_named(wheels)}"
    if number == 3:
        return f"a tricycle: {_named(wheels)} on {plural(len(axles), 'axle')}"
    if number > 4 and not steered:
        return f"{_named(wheels)} on {plural(len(axles), 'axle')} without steering (tracked or skid-steered)"
    return f"{_named(wheels)} on {plural(len(axles), 'axle')}"


def _front_and_rear(tree: Tree, axles: list[list[Wheel]], changes: Changes) -> tuple[list[Wheel], list[Wheel]]:
    """Return the steered axle and the other one."""
    wheels = [wheel for axle in axles for wheel in axle]
    # Each rejection names the kind of robot that was recognised, since skid-steer and differential drives are common.
    casters = [wheel for wheel in wheels if _is_caster(tree, wheel)]
    if len(casters) == 2:
        driven = [wheel for wheel in wheels if wheel not in casters]
        raise _rejection(tree, f"2 driven wheels and 2 casters (differential drive): {_names(driven)}", wheels)
    steered = [axle for axle in axles if all(_own(wheel, axle) for wheel in axle)]
    for axle in axles:
        steers = [bool(_own(wheel, axle)) for wheel in axle]
        if any(steers) and not all(steers):
            steered_one = axle[steers.index(True)].joint.name
            part = f"{_named(axle)} on one axle, only one of which is steered ('{steered_one}')"
            raise _rejection(tree, part, wheels)
        # A single joint for both wheels is a solid axle, as of a trailer or a tricycle.
        shared = [joint for joint in axle[0].steering if joint in axle[1].steering]
        if shared and not any(steers):
            part = f"joint '{shared[-1].name}' steers an axle as a whole; a car steers each front wheel by itself"
            raise _rejection(tree, part, wheels)
    if not steered:
        raise _rejection(tree, f"skid-steer: {_named(wheels)}, no steering joint", wheels)
    # One steered axle is the front. Most sources have it towards +x; others drive backwards.
    if len(steered) == 1:
        front = steered[0]
        rear = next(axle for axle in axles if axle is not front)
        if (_middle(front) - _middle(rear))[0] < 0.0:
            why = "the steered axle is assumed to be the front"
            places = f"{_names(front)} towards -x"
            changes.add(
                Code.DIRECTION, front[0].joint.where, "direction of travel", places, "towards the steered axle", why
            )
        return front, rear
    # Both axles are steered, so that only the direction of x is left to decide.
    rear, front = sorted(axles, key=lambda axle: _middle(axle)[0])
    for wheel in rear:
        joint = _own(wheel, rear)[-1]
        changes.add(Code.JOINT_FIXED, joint.where, f"joint '{joint.name}'", joint.kind, "fixed at zero", BOTH_STEERED)
    return front, rear


def _own(wheel: Wheel, axle: Sequence[Wheel]) -> list[Joint]:
    """Return the steering joints of a wheel that do not move the other wheel of its axle."""
    others = [joint for other in axle if other is not wheel for joint in other.steering]
    return [joint for joint in wheel.steering if joint not in others]


def _is_caster(tree: Tree, wheel: Wheel) -> bool:
    """Return whether a wheel trails an upright joint that swivels freely."""
    for joint in wheel.steering:
        # A caster trails: its wheel is behind the swivel axis, while a steering axis passes near the wheel.
        arm = (wheel.point - tree.pose(joint).translation())[:2]
        across = np.cross(UP, wheel.axis)[:2]
        if turns_freely(joint, joint.limits) and abs(arm @ across) > 0.2 * wheel.shape.radius:
            return True
    return False


def _feet(tree: Tree, wheels: Sequence[Wheel]) -> list[str]:
    """Return links without a wheel that touch the road: balls and skids in place of casters."""
    turning = {name for wheel in wheels for name in tree.rigid_with(wheel.joint.child, ())}
    low = min(wheel.bottom for wheel in wheels)
    near = LOW * min(wheel.shape.radius for wheel in wheels)
    feet = []
    for name, X_ML in tree.poses.items():
        link = tree.model.links[name]
        if name not in turning:
            boxes = [bounds_in(shape, X_ML) for shape in link.collisions if shape.kind != "box"]
            if any(box is not None and box[0][2] - low < near for box in boxes):
                feet.append(name)
    return feet


# --- words -------------------------------------------------------------------------------------------------------


def _rejection(tree: Tree, summary: str, wheels: Sequence[Wheel]) -> ModelError:
    """Return the error for a model that is not a car: what was found, unusable joints, mistakes in the files."""
    names, used = [wheel.joint.name for wheel in wheels], [joint.name for wheel in wheels for joint in wheel.steering]
    faults = unusable_wheels(tree, names, level=LEVEL) if len(wheels) != 4 else ""
    steering = unusable_steering(tree, names, used, upright=UPRIGHT, level=LEVEL)
    faults += steering
    if steering:
        summary = summary.replace("no steering joint", "no usable steering joint")
    hints = "".join(f"; {hint}" for hint in tree.model.hints)
    location = source_name(tree.model)
    part = "not a car with four wheels on two axles, two of them steered"
    return ModelError(f"{part}; found {summary}{faults}{hints}", where=location)


def _inventory(tree: Tree) -> str:
    kinds = Counter(joint.kind for joint in tree.above.values() if joint.kind != "fixed")
    joints = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "no movable"
    return f"{plural(len(tree.poses), 'link')} with {joints} joint{'' if sum(kinds.values()) == 1 else 's'}"


def _blank_clause(tree: Tree, blank: Sequence[Joint]) -> str:
    """Return a clause about joints whose links have no known shape but might be wheels."""
    if not blank:
        return ""
    names = ", ".join(f"'{joint.name}'" for joint in blank[:6]) + (", …" if len(blank) > 6 else "")
    links = [tree.model.links[name] for joint in blank for name in tree.rigid_with(joint.child, ())]
    lost = [shape.address for link in links for shape in (*link.visuals, *link.collisions) if shape.kind == "mesh"]
    lost = [address for address in dict.fromkeys(lost) if address]
    reasons = {change.old: f": {change.reason}" for change in tree.model.changes if change.left_out}
    why = (
        f" (is a mesh missing? {', '.join(address + reasons.get(address, '') for address in lost[:3])})" if lost else ""
    )
    return f"; {names} turn{'s' if len(blank) == 1 else ''} like a wheel but nothing round{why}"


def _named(wheels: Sequence[Wheel]) -> str:
    words = {1: "one wheel", 2: "2 wheels", 3: "3 wheels", 4: "four wheels"}
    return f"{words.get(len(wheels), f'{len(wheels)} wheels')} ({_names(wheels)})"


def _names(wheels: Sequence[Wheel]) -> str:
    names = [f"'{wheel.joint.name}'" for wheel in wheels]
    return ", ".join(names[:6]) + (", …" if len(names) > 6 else "")


def _middle(axle: Sequence[Wheel]) -> Vector:
    middle: Vector = np.mean([wheel.point for wheel in axle], axis=0)
    return middle


def _level(vector: Vector) -> Vector:
    level: Vector = np.array([vector[0], vector[1], 0.0])
    level /= np.linalg.norm(level)
    return level
