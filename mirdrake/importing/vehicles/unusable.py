"""Reasons why joints that are probably meant as steering or wheels cannot be used, for rejection messages."""

import re
from collections.abc import Sequence
from math import acos, degrees, hypot

from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.kinematics import UP, Tree, frame_about
from mirdrake.importing.vehicles.model import Joint
from mirdrake.importing.vehicles.round_shapes import find_rounds

_STEERING = re.compile("steer|king_?pin|knuckle", re.IGNORECASE)
_WHEEL = re.compile("(?<!fifth)(?<!fifth_)wheel|tire|tyre", re.IGNORECASE)  # a fifth wheel is a coupling
_TURNING = ("revolute", "continuous", "universal", "revolute2")
MOST_NAMES = 6


def unusable_steering(tree: Tree, wheels: Sequence[str], used: Sequence[str], *, upright: float, level: float) -> str:
    """Return a clause with the joints meant to steer and their faults; "" if there are none.

    Args:
        tree: tree of the model.
        wheels: names of the wheel joints that were found.
        used: names of joints that steer a wheel.
        upright: smallest cosine between a steering axis and the vertical.
        level: largest sine of a wheel axis over the horizontal.
    """
    # Upright joints without a steering name count only if a wheel is below: others may turn a lidar.
    carrying = {joint.name for name in wheels for joint in tree.path(tree.model.joints[name].child)} - set(wheels)
    named = _named_by_plugins(tree, "steer")
    words = []
    for joint in tree.model.joints.values():
        meant = _STEERING.search(f"{joint.name} {joint.child}") or joint.name in named
        if joint.name in (*wheels, *used) or not (meant or _turns_upright(tree, joint, upright)):
            continue
        stiff = _stiff_wheel(tree, joint, wheels) if joint.name not in carrying else ""
        if not meant and joint.name not in carrying and not stiff:
            continue  # a turning lidar, an arm
        if _turns_round(tree, joint, level):
            continue  # a wheel with another name, see below
        words.append(f"'{joint.name}' {_steering_fault(tree, joint, stiff, carrying, upright)}")
    return _clause("cannot be used as steering", words)


def unusable_wheels(tree: Tree, wheels: Sequence[str], *, level: float) -> str:
    """Return a clause with the joints meant as wheels and their faults; "" if there are none.

    Args:
        tree: tree of the model.
        wheels: names of the wheel joints that were found.
        level: largest sine of a wheel axis over the horizontal.
    """
    named = _named_by_plugins(tree, "wheel") - _named_by_plugins(tree, "steer")
    # Names are a hint at the intention only, hence the clause is part of an explanation.
    words = []
    for joint in tree.model.joints.values():
        meant = joint.name in named or (_WHEEL.search(joint.name) and not _STEERING.search(joint.name))
        meant = meant or _turns_round(tree, joint, level)
        if not meant or joint.name in wheels:
            continue
        axis = tree.axis(joint) if joint.parent in tree.poses else None
        if joint.child not in tree.poses:
            fault = "is not connected to the vehicle"
        elif joint.kind not in _TURNING:
            fault = f"is {joint.kind}"
        elif axis is not None and abs(axis[2]) > level:
            fault = f"has an axis {90.0 - degrees(acos(min(1.0, abs(axis[2])))):.0f} degrees off the horizontal"
        elif joint.limits.lower is not None and joint.limits.upper is not None and joint.kind == "revolute":
            fault = f"turns from {joint.limits.lower:.4g} to {joint.limits.upper:.4g} rad only"
        else:
            continue
        words.append(f"'{joint.name}' {fault}")
    return _clause("cannot be used as wheels", words)


def _steering_fault(tree: Tree, joint: Joint, stiff: str, carrying: set[str], upright: float) -> str:
    # The first fault on the way from the vehicle to a steered wheel.
    axis = tree.axis(joint) if joint.parent in tree.poses else None
    # The first fault that applies is reported: later checks assume that the earlier ones passed.
    if joint.child not in tree.poses:
        return "is not connected to the vehicle"
    if joint.kind not in _TURNING:
        return f"is {joint.kind}"
    if axis is None:
        return "has an axis of length zero"
    if abs(axis[2]) < upright:
        inclination, largest = degrees(acos(min(1.0, abs(float(axis[2]))))), degrees(acos(upright))
        return f"has an axis {inclination:.0f} degrees off the vertical (at most {largest:.0f})"
    if joint.name not in carrying:
        return f"carries '{stiff}', which is round but has no joint to turn on" if stiff else "carries no wheel"
    # Limits that are equal are how files fix a joint without changing its type.
    if joint.limits.lower == joint.limits.upper and joint.limits.lower is not None:
        return f"has no range ({joint.limits.lower:.4g} to {joint.limits.upper:.4g} rad)"
    return "does not steer one wheel by itself"


def _turns_upright(tree: Tree, joint: Joint, upright: float) -> bool:
    axis = tree.axis(joint) if joint.kind in _TURNING and joint.parent in tree.poses else None
    return axis is not None and abs(axis[2]) >= upright


def _stiff_wheel(tree: Tree, joint: Joint, wheels: Sequence[str]) -> str:
    """Return the link on a joint with limits that is round about the axis of the wheels, without turning on it."""
    if not wheels or joint.child not in tree.poses or joint.kind == "continuous" or joint.limits.upper is None:
        return ""
    lateral = tree.axis(tree.model.joints[wheels[0]])
    return next((name for name in tree.rigid_with(joint.child, ()) if _is_round(tree, name, lateral)), "")


def _turns_round(tree: Tree, joint: Joint, level: float) -> bool:
    """Return whether a joint turns a round link about a level axis, within whatever limits."""
    axis = tree.axis(joint) if joint.kind in _TURNING and joint.parent in tree.poses else None
    return axis is not None and abs(axis[2]) <= level and _is_round(tree, joint.child, axis)


def _is_round(tree: Tree, link: str, axis: Vector | None) -> bool:
    """Return whether a link has a shape that is round about a level axis through its origin."""
    if axis is None or link not in tree.poses or abs(axis @ UP) > 0.99:
        return False
    rounds = find_rounds(tree, [link], frame_about(tree.poses[link].translation(), y=axis, up=UP))
    return any(float(hypot(item.centre[0], item.centre[2])) < 0.2 * item.radius for item in rounds)


def _named_by_plugins(tree: Tree, word: str) -> set[str]:
    """Return the joints in plugin elements whose name contains a word."""
    return {
        value
        for plugin in tree.model.plugins
        for key, value in plugin.values.items()
        if word in key.rpartition(".")[2].lower() and value in tree.model.joints
    }


def _clause(part: str, words: Sequence[str]) -> str:
    if not words:
        return ""
    return f"; {part}: {', '.join(words[:MOST_NAMES])}" + (", …" if len(words) > MOST_NAMES else "")
