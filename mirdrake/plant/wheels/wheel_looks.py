"""Drawn wheels of a vehicle whose arms steer and incline them, or whose rear wheels are steered.

These angles act in the tyre forces; the bodies of the plant do not have them (:mod:`mirdrake.plant.wheels.arms`). The
illustration geometry of such wheels therefore belongs to frames of its own: in the vehicle frame B, at the steering
angle δ, with toe ε, inclination λ and spin angle q::

    R_BW = Rz(δ + ε) Rx(λ) R0 Ry(q),    p_BW = p + (x, y, z) + o Rz(δ + ε) Rx(λ) e_y

with R0 the rotation of the body at zero angles, the displacement (x, y, z) of the arms, and the kingpin p and offset o
of :class:`mirdrake.plant.wheels.motion.WheelPlace`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, FramePoseVector, GeometryFrame, GeometryInstance, Role, SceneGraph, SourceId
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_input
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.plant.rear_steering import REAR_STEERING
from mirdrake.plant.wheels.arms import arm_motion
from mirdrake.plant.wheels.motion import NO_JOINT, WheelPlace, wheel_places


@dataclass(frozen=True)
class WheelLooks:
    """Drawn wheels of a vehicle in a scene graph.

    Attributes:
        source: source of their geometry.
        frames: frame of each wheel, in the order of :data:`mirdrake.vehicles.WHEELS`.
        places: position of each wheel.
        spins: index of each wheel's angle in the positions of the plant.
        bodies: rotation of each wheel's body in B at zero angles.
    """

    source: SourceId
    frames: tuple[FrameId, ...]
    places: tuple[WheelPlace, ...]
    spins: tuple[int, ...]
    bodies: tuple[RotationMatrix, ...]

    def poses(self, q: npt.NDArray[np.float64], rear: Sequence[float]) -> FramePoseVector:
        """Return the poses of the frames.

        Args:
            q: positions of the plant.
            rear: steering angles of the rear wheels [rad].
        """
        base, vector = self.places[0].base[0], FramePoseVector()
        turned = q[base : base + 4] / np.linalg.norm(q[base : base + 4])  # integration changes the norm a little
        X_WB = RigidTransform(Quaternion(wxyz=turned), q[base + 4 : base + 7])
        for index, (frame, place, spin, R0) in enumerate(
            zip(self.frames, self.places, self.spins, self.bodies, strict=True)
        ):
            # Angles of rear wheels are not in the state of the plant.
            angle = float(q[place.steering[0]] if index < 2 else rear[index - 2])
            travel = float(q[place.suspension[0]]) if place.suspension != NO_JOINT else 0.0
            arm = arm_motion(place.arms, travel)
            R_BC = RotationMatrix.MakeZRotation(angle + arm.toe) @ RotationMatrix.MakeXRotation(arm.lean)
            p_BC = np.add(place.pivot, (arm.x, arm.y, travel)) + place.offset * R_BC.col(1)
            R_BW = R_BC @ R0 @ RotationMatrix.MakeYRotation(float(q[spin]))
            vector.set_value(frame, X_WB @ RigidTransform(R_BW, p_BC))
        return vector


def add_wheel_looks(plant: MultibodyPlant, scene_graph: SceneGraph, part: VehicleInPlant) -> WheelLooks | None:
    """Move the illustration geometry of a vehicle's wheels to frames with all their angles.

    Args:
        plant: finalised plant.
        scene_graph: its scene graph; the poses are an input of it then.
        part: the vehicle.

    Returns:
        the drawn wheels, or None if the bodies have all angles already.
    """
    places = wheel_places(part)
    if part.vehicle.spec.steering.rear is None and all(place.arms.nodes == 0 for place in places):
        return None
    inspector, plant_source = scene_graph.model_inspector(), plant.get_source_id()
    source, frames = scene_graph.RegisterSource(f"wheels/{part.name}"), []
    for joint in part.wheels:
        body = joint.child_body()
        frame = scene_graph.RegisterFrame(source, GeometryFrame(f"{part.name}::{body.name()}"))
        frames.append(frame)
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kIllustration):
            shape, X_FG = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
            drawn = GeometryInstance(X_FG, shape, inspector.GetName(geometry))
            drawn.set_illustration_properties(inspector.GetIllustrationProperties(geometry))
            scene_graph.RegisterGeometry(source, frame, drawn)
            scene_graph.RemoveRole(plant_source, geometry, Role.kIllustration)

    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    for joint in (*part.steering, *part.wheels):
        joint.set_angle(context, 0.0)
    rotations = tuple(plant.EvalBodyPoseInWorld(context, joint.child_body()).rotation() for joint in part.wheels)
    spins = tuple(joint.position_start() for joint in part.wheels)
    return WheelLooks(source, tuple(frames), tuple(places), spins, rotations)


class WheelPoses(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Poses of the drawn wheels of a vehicle.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        rear_steering (4): :data:`mirdrake.plant.rear_steering.REAR_STEERING`; zeros if it is not connected.
    Output ports:
        poses: FramePoseVector of the wheels.

    Args:
        looks: the drawn wheels.
        plant: the plant.
    """

    optional_inputs: tuple[str, ...] = ("rear_steering",)

    def __init__(self, looks: WheelLooks, plant: MultibodyPlant) -> None:
        super().__init__()
        self.looks, self._positions = looks, plant.num_positions()
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.rear_steering = declare_vector_input(self, "rear_steering", REAR_STEERING)
        self.poses = self.DeclareAbstractOutputPort(
            "poses", lambda: AbstractValue.Make(FramePoseVector()), self._calc_poses
        )

    def _calc_poses(self, context: Context, value: AbstractValue) -> None:
        rear = self.rear_steering.Eval(context)[:2] if self.rear_steering.HasValue(context) else (0.0, 0.0)
        value.set_value(self.looks.poses(self.plant_state.Eval(context)[: self._positions], rear))
