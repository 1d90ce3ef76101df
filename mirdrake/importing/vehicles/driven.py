"""Driven axle of a car, by transmissions, controllers and plugins."""

import re
from collections.abc import Iterable, Mapping
from math import isfinite

from mirdrake.importing.changes import Change, Code
from mirdrake.importing.values import to_number
from mirdrake.importing.vehicles.kinematics import source_name
from mirdrake.importing.vehicles.model import Plugin, SourceModel
from mirdrake.vehicles.spec import Drive

_MOVES = ("drive", "ackermann", "steer", "control", "motor", "wheel")
_DRIVES_ALL = ("fourwid", "four_wheel", "4wd", "4wid")
# Plugins with these words measure wheels and do not move them.
_READS = ("state", "odom", "encoder", "slip")
# "feedback_torque" is not a torque at the back axle.
_TORQUE = re.compile("(?<!feed)(front|rear|back).*torque", re.IGNORECASE)
_OTHER_TORQUE = re.compile("brak|steer", re.IGNORECASE)


def find_drive(
    model: SourceModel, wheels: Mapping[str, str], *, asked: Drive | None
) -> tuple[Drive, str, list[Change]]:
    """Return the driven axle of a car.

    Args:
        model: model as read.
        wheels: wheel joints by the names of :data:`mirdrake.vehicles.spec.WHEELS`.
        asked: choice of the user, which takes precedence.

    Returns:
        driven axle, its place in the source, and a change if it is not stated.
    """
    if asked is not None:
        return asked, "given", []
    # A controller commands joints, a transmission only connects them, and a plugin may name joints for other reasons.
    places = {joint: name for name, joint in wheels.items()}
    interfaces = ("effort", "velocity")
    moved = {
        item.joint: item.where
        for item in model.transmissions
        if item.joint in places and any(word in interface for interface in item.interfaces for word in interfaces)
    }
    named = {item.joint: item.where for item in model.transmissions if item.joint in places}
    if not moved and len(named) < len(places):  # without interfaces, but not simply all wheels
        moved = named
    # State controllers only publish, and a joint that no transmission moves is not driven.
    commanded = {
        joint: item.where
        for item in model.controllers
        if "state" not in item.kind.lower()
        for joint in item.joints
        if joint in places and (not moved or joint in moved)
    }
    plugged = {joint: item.where for item in model.plugins for joint in _moved_by(item, places)}
    # Order of trust: controllers, transmissions, torques of a plugin, joints that a plugin names.
    for driven_joints, kind in ((commanded, "controller"), (moved, "transmission")):
        if driven_joints:
            drive = _axle(places[joint] for joint in driven_joints)
            return drive, f"imported: {kind}, {next(iter(driven_joints.values()))}", []
    for plugin in model.plugins:  # a torque is a stronger sign than the name of a joint
        by_torque = _by_torque(plugin)
        if by_torque is not None:
            # Joints that a plugin merely names may be those of encoders, so that they count least.
            return by_torque, f"imported: torques of the plugin, {plugin.where}", []
    if plugged:
        drive = _axle(places[joint] for joint in plugged)
        return drive, f"imported: plugin, {next(iter(plugged.values()))}", []
    # The rear axle is an assumption, which the report asks the user to check.
    where = source_name(model)
    why = "no transmission, controller or plugin states the driven axle"
    return "rear", "", [Change(Code.DRIVE, where, "driven axle", "not stated", "rear", why)]


def _axle(wheels: Iterable[str]) -> Drive:
    ends = {name.split("_")[0] for name in wheels}
    return "all" if len(ends) == 2 else "front" if "front" in ends else "rear"


def _by_torque(plugin: Plugin) -> Drive | None:
    """Return the axles that a plugin drives, if it states a torque for each."""
    torques: dict[str, float] = {}
    for key, text in plugin.values.items():
        leaf, torque = key.rpartition(".")[2], to_number(text)
        match = _TORQUE.search(leaf)
        if match is None or _OTHER_TORQUE.search(leaf) is not None:
            continue
        if torque is not None and isfinite(torque):
            end = "front" if match.group(1).lower() == "front" else "rear"
            torques[end] = max(torques.get(end, 0.0), abs(torque))
    # A torque of zero counts only if both axles are stated: one is driven, the other is not.
    driven = [end for end, torque in torques.items() if torque > 0.0]
    return _axle(driven) if len(torques) == 2 and driven else None


def _moved_by(plugin: Plugin, joints: Iterable[str]) -> list[str]:
    """Return the wheel joints that a plugin drives; none if it names all of them for other reasons."""
    label = f"{plugin.name} {plugin.filename}".lower()
    if not any(word in label for word in _MOVES) or any(word in label for word in _READS):
        return []
    known = list(joints)
    named = {}
    for key, value in plugin.values.items():
        leaf = key.rpartition(".")[2].partition("[")[0].lower()
        for joint in known:
            if joint in value.replace(",", " ").split() and "steer" not in leaf:
                named[joint] = leaf
    if len(named) < len(known):
        return list(named)
    if any(word in label for word in _DRIVES_ALL):
        return list(named)
    # gz-sim's Ackermann plugin lists what it drives, several times the same element: all four are driven then.
    return list(named) if all(leaf in ("left_joint", "right_joint") for leaf in named.values()) else []
