"""Where things are in a run: vehicles and loose props in the world, sensors on their vehicles."""

from collections.abc import Iterator
from math import isfinite
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from mirdrake.logs import SIGNALS, Run
from mirdrake.plant import PlantSpec, make_plant
from mirdrake.recording.parts import read_groups
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world

Pose = tuple[float, ...]
"""x, y, z [m] and the quaternion w, x, y, z."""

Entry = tuple[str, str, Pose]
"""Parent frame, child frame, and the pose of the child in the parent."""

WORLD = "world"
X_SC = RigidTransform(RotationMatrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])))
"""The frame of a camera's pictures (z ahead, x to the right, y down) in that of its mount (x ahead, y left, z up)."""

_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def optical_name(name: str) -> str:
    """The frame of a camera's pictures: z ahead, x to the right, y down."""
    return f"{name}.optical"


def eyes_of(name: str, mount: Any) -> dict[str, float]:
    """The eyes of a camera by the name of their pictures, and how far each is to the left of its mount [m]."""
    if not hasattr(mount, "width"):
        return {}
    half = 0.5 * getattr(mount, "baseline", 0.0)
    return {f"{name}.left": half, f"{name}.right": -half} if half else {name: 0.0}


def frame_poses(run: Run) -> Iterator[tuple[float, list[Entry]]]:
    """At each sample of the signals the time [s], and where all that moves is."""
    assert run.folder is not None
    props = [name.removesuffix(".yaw") for name in run.units if name.startswith("props.") and name.endswith(".yaw")]
    moving = [*run.spec["vehicles"], *props]
    columns = [f"{name}.{key}" for name in moving for key in _KEYS]
    for group in read_groups(run.folder / SIGNALS, ["time", *columns]):
        for time, *values in zip(*(group[name].to_pylist() for name in ("time", *columns)), strict=True):
            entries = []
            for index, name in enumerate(moving):
                place = values[6 * index : 6 * index + 6]
                if all(map(isfinite, place)):  # a run that diverged
                    entries.append((WORLD, name, _pose(RigidTransform(RollPitchYaw(place[3:]), place[:3]))))
            yield time, entries


def sensor_mounts(run: Run) -> dict[str, Any]:
    """The mounts of the sensors in use by ``<vehicle>.<sensor>``; those of a vehicle that has gone are left out."""
    mounts: dict[str, Any] = {}
    for vehicle, sensors in run.spec.get("sensors", {}).items():
        entry = run.spec["vehicles"][vehicle]
        known = load_vehicle(entry["model"], arguments=entry.get("arguments", {})).sensors.mounts
        mounts |= {f"{vehicle}.{sensor}": known[sensor] for sensor in sensors if sensor in known}
    return mounts


def sensor_frames(run: Run) -> list[Entry]:
    """Where the sensors in use are on their vehicles; a camera also has a frame of its pictures."""
    mounts = sensor_mounts(run)
    if not mounts:
        return []
    vehicles = {
        name: load_vehicle(entry["model"], arguments=entry.get("arguments", {}))
        for name, entry in run.spec["vehicles"].items()
    }
    parts = make_plant(DiagramBuilder(), load_world("empty"), vehicles, spec=PlantSpec(contact="point"))
    context = parts.plant.CreateDefaultContext()
    entries = []
    for name, mount in mounts.items():
        vehicle = name.split(".")[0]
        part = parts.vehicles[vehicle]
        frame = parts.plant.GetFrameByName(mount.frame, part.instance)
        X_BS = parts.plant.CalcRelativeTransform(context, part.base.body_frame(), frame)
        entries.append((vehicle, name, _pose(X_BS)))
        for eye, y in eyes_of(name, mount).items():
            entries.append((name, optical_name(eye), _pose(RigidTransform([0.0, y, 0.0]) @ X_SC)))
    return entries


def _pose(transform: RigidTransform) -> Pose:
    return (*transform.translation().tolist(), *transform.rotation().ToQuaternion().wxyz().tolist())
