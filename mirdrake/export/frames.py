"""Frames of a run: vehicles, their links and loose props in the world, sensors on their vehicles.

They are computed from the scene of the run (:mod:`mirdrake.assembly.scene`) and from its signals.
"""

from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, RigidBody
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.recording.parts import read_groups
from mirdrake.core.vectors import SIDES
from mirdrake.plant.plant import PlantParts, PlantSpec, VehicleInPlant, make_plant
from mirdrake.runs.logs import SIGNALS, Run
from mirdrake.vehicles import WHEELS

Pose = tuple[float, ...]
"""x, y, z [m] and the quaternion w, x, y, z."""

Entry = tuple[str, str, Pose]
"""Parent frame, child frame, and the pose of the child in the parent."""

WORLD = "world"
X_SC = RigidTransform(RotationMatrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])))
"""Pose of a camera's optical frame (z forward, x right, y down) in that of its mount (x forward, y left, z up)."""

_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def optical_name(name: str) -> str:
    """Return the name of a camera's optical frame: z forward, x right, y down."""
    return f"{name}.optical"


def eyes_of(name: str, mount: Any) -> dict[str, float]:
    """Return the y position [m] of each lens of a camera in its mount, by the name of its pictures."""
    if not hasattr(mount, "width"):
        return {}
    half = 0.5 * getattr(mount, "baseline", 0.0)
    return {f"{name}.left": half, f"{name}.right": -half} if half else {name: 0.0}


def link_name(vehicle: str, body: RigidBody) -> str:
    """Return the frame name of a vehicle's link; the frame of the base link has the vehicle's name."""
    return f"{vehicle}/{body.name()}"


def sensor_mounts(run: Run) -> Mapping[str, Any]:
    """Return the mounts of the sensors of a run by ``<vehicle>.<sensor>``."""
    vehicles = run.scene().vehicles
    return {
        f"{name}.{sensor}": vehicles[name].sensors.mounts[sensor]
        for name, sensors in run.spec.get("sensors", {}).items()
        for sensor in sensors
    }


def joint_columns(run: Run, part: VehicleInPlant) -> list[tuple[Joint, str, str | None]]:
    """Return the recorded joints of a vehicle, with the columns of their positions and, if recorded, velocities."""
    joints = [
        (joint, f"wheel_angle.{wheel}", f"wheel_speed.{wheel}")
        for wheel, joint in zip(WHEELS, part.wheels, strict=True)
    ]
    joints += [(joint, f"steering_angle.{side}", "") for side, joint in zip(SIDES, part.steering, strict=True)]
    # A vehicle without suspension has no spring joints.
    joints += [(joint, f"travel.{wheel}", "") for wheel, joint in zip(WHEELS, part.suspension, strict=False)]
    named = [(joint, f"{part.name}.{key}", f"{part.name}.{rate}") for joint, key, rate in joints]
    return [(joint, key, rate if rate in run.units else None) for joint, key, rate in named if key in run.units]


def actor_frame(name: str) -> str:
    """Return the name of the frame of an actor: on the ground below its rear axle, or below the middle of a walker."""
    return f"actors.{name}"


class Frames:
    """The frames of a run.

    Args:
        run: run with a folder and a scene.

    Attributes:
        parts: a plant of the scene; :meth:`moving` moves its vehicles.
    """

    def __init__(self, run: Run) -> None:
        self._run, scene = run, run.scene()
        # The plant is posed but never simulated, so that it needs no hydroelastic meshes.
        self.parts: PlantParts = make_plant(
            DiagramBuilder(), scene.world, scene.vehicles, spec=PlantSpec(contact="point")
        )
        self._plant: MultibodyPlant = self.parts.plant
        self._context = self._plant.CreateDefaultContext()

    def moving(self) -> Iterator[tuple[float, list[Entry]]]:
        """Yield the time [s] and the poses of all moving frames at each sample of the signals."""
        assert self._run.folder is not None
        units, vehicles = self._run.units, self.parts.vehicles
        # Only loose props move and have recorded poses.
        props = [name.removesuffix(".yaw") for name in units if name.startswith("props.") and name.endswith(".yaw")]
        names = [name for name in (*vehicles, *props) if f"{name}.yaw" in units]
        columns = [f"{name}.{key}" for name in names for key in _KEYS]
        joints = [joint for name in names if name in vehicles for joint in joint_columns(self._run, vehicles[name])]
        columns += [column for _, column, _ in joints]
        positions = self._plant.GetPositions(self._context).copy()
        links = {name: self._links(part) for name, part in vehicles.items()}

        for group in read_groups(self._run.folder / SIGNALS, ["time", *columns]):
            for time, *values in zip(*(group[name].to_pylist() for name in ("time", *columns)), strict=True):
                entries = []
                for index, name in enumerate(names):
                    position = values[6 * index : 6 * index + 6]
                    if all(map(isfinite, position)):  # a run that diverged
                        entries.append((WORLD, name, pose_of(RigidTransform(RollPitchYaw(position[3:]), position[:3]))))
                angles = values[6 * len(names) :]
                for (joint, _, _), value in zip(joints, angles, strict=True):
                    # A value that is not finite leaves the joint where it was.
                    if isfinite(value):
                        positions[joint.position_start()] = value
                # Only joints are set: poses of links are relative to their base, which has an entry of its own.
                self._plant.SetPositions(self._context, positions)
                for name, bodies in links.items():
                    entries += [(name, link_name(name, body), self._pose_of(name, body)) for body in bodies]
                yield time, entries

    def sensors(self) -> list[Entry]:
        """Return the poses of the sensors in use on their vehicles, with the optical frames of cameras."""
        entries = []
        for name, mount in sensor_mounts(self._run).items():
            vehicle = name.split(".")[0]
            part = self.parts.vehicles[vehicle]
            frame = self._plant.GetFrameByName(mount.frame, part.instance)
            X_BS = self._plant.CalcRelativeTransform(self._context, part.base.body_frame(), frame)
            entries.append((vehicle, name, pose_of(X_BS)))
            # Optical frames have z along the view, as ROS and Foxglove expect of images.
            for eye, y in eyes_of(name, mount).items():
                entries.append((name, optical_name(eye), pose_of(RigidTransform([0.0, y, 0.0]) @ X_SC)))
        return entries

    def _links(self, part: VehicleInPlant) -> list[RigidBody]:
        """Return the visible links of a vehicle without its base link."""
        bodies = [self._plant.get_body(index) for index in self._plant.GetBodyIndices(part.instance)]
        return [b for b in bodies if b.index() != part.base.index() and self._plant.GetVisualGeometriesForBody(b)]

    def _pose_of(self, vehicle: str, body: RigidBody) -> Pose:
        base = self.parts.vehicles[vehicle].base.body_frame()
        return pose_of(self._plant.CalcRelativeTransform(self._context, base, body.body_frame()))


def pose_of(transform: RigidTransform) -> Pose:
    """Return a transform as position and quaternion."""
    return (*transform.translation().tolist(), *transform.rotation().ToQuaternion().wxyz().tolist())
