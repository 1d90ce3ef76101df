"""Which axle of a car is driven, from what the files say about its joints."""

from collections.abc import Iterable, Mapping

from mirdrake.vehicles.importing.kinematics import source_name
from mirdrake.vehicles.importing.model import Change, Plugin, SourceModel
from mirdrake.vehicles.spec import Drive

_MOVES = ("drive", "ackermann", "steer", "control", "motor", "wheel")
_READS = ("state", "odom", "encoder", "slip")


def find_drive(
    model: SourceModel, wheels: Mapping[str, str], *, asked: Drive | None
) -> tuple[Drive, str, list[Change]]:
    """The driven axle of a car.

    Args:
        model: as read.
        wheels: wheel joints by the names of :data:`mirdrake.vehicles.spec.WHEELS`.
        asked: what the caller says; it counts before everything else.

    Returns:
        driven axle, where that is said, and a change if nothing says it.
    """
    if asked is not None:
        return asked, "given", []
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
    commanded = {
        joint: item.where
        for item in model.controllers
        if "state" not in item.kind.lower()
        for joint in item.joints
        if joint in places and (not moved or joint in moved)
    }
    plugged = {joint: item.where for item in model.plugins for joint in _moved_by(item, places)}
    for found, kind in ((commanded, "controller"), (moved, "transmission"), (plugged, "plugin")):
        if found:
            drive = _axle(places[joint] for joint in found)
            return drive, f"imported: {kind}, {next(iter(found.values()))}", []
    where = source_name(model)
    why = "no transmission, controller or plugin says what drives"
    return "rear", "", [Change(where, "driven axle", "not said", "rear", why)]


def _axle(wheels: Iterable[str]) -> Drive:
    ends = {name.split("_")[0] for name in wheels}
    return "all" if len(ends) == 2 else "front" if "front" in ends else "rear"


def _moved_by(plugin: Plugin, joints: Iterable[str]) -> list[str]:
    """Wheel joints that a plugin moves; none if it names all of them, as it has to for other reasons as well."""
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
    # gz-sim's Ackermann plugin lists what it drives, several times the same element: all four are driven then.
    return list(named) if all(leaf in ("left_joint", "right_joint") for leaf in named.values()) else []
