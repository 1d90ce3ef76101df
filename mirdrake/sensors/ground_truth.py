"""Ground truth: the exact state of a vehicle."""

from collections.abc import Sequence
from math import asin, atan2, pi, remainder, sqrt
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import PATH_ERROR, STATE, STEERING_ANGLES, WHEEL_SPEEDS
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.sampling import Array, SampledSensor, mount_pose

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant
    from mirdrake.worlds import Track


class GroundTruth(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Pose, twist and joint rates of one vehicle.

    Input ports:
        plant_state: the plant's state, positions and velocities.
    Output ports:
        state (12) [m, rad, m/s, rad/s]: x, y, z, roll, pitch, yaw of the vehicle frame B in the world; velocity of its
            origin and angular velocity, both expressed in B.
        wheel_speeds (4) [rad/s]: front_left, front_right, rear_left, rear_right; positive when rolling forward.
        steering_angles (2) [rad]: left, right; positive to the left.
        path (3) [m, rad, m]: lateral and heading error against the track's centre line, and progress along it; only
            with a track.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.
        track: the track it is measured against.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant", *, track: "Track | None" = None) -> None:
        super().__init__()
        self._track = track
        self._period = part.period
        positions = plant.num_positions()
        # Indices are found once; the outputs read the state vector directly.
        self._pose = part.base.floating_positions_start()
        self._twist = positions + part.base.floating_velocities_start_in_v()
        self._wheels = [positions + joint.velocity_start() for joint in part.wheels]
        self._steering = [joint.position_start() for joint in part.steering]
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.state = declare_vector_output(self, "state", STATE, self._calc_state)
        self.wheel_speeds = declare_vector_output(self, "wheel_speeds", WHEEL_SPEEDS, self._calc_wheels)
        self.steering_angles = declare_vector_output(self, "steering_angles", STEERING_ANGLES, self._calc_steering)

        if track is not None:
            self.path = declare_vector_output(self, "path", PATH_ERROR[:3], self._calc_path)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        x = self.plant_state.Eval(context)
        pose, twist = x[self._pose : self._pose + 7].tolist(), x[self._twist : self._twist + 6].tolist()
        output.SetFromVector(vehicle_state(pose, twist, self._period))

    def _calc_path(self, context: Context, output: BasicVector) -> None:
        assert self._track is not None
        x, y, _, _, _, yaw, *_ = self.state.Eval(context).tolist()
        s, lateral = self._track.project(x, y)
        _, _, direction = self._track.pose_at(s)
        output.SetFromVector([lateral, remainder(yaw - direction, 2.0 * pi), s])

    def _calc_wheels(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._wheels])

    def _calc_steering(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._steering])


class TruthSensor(SampledSensor):
    """Pose and twist of a frame, sampled like a sensor's output.

    Input ports:
        body_poses, body_spatial_velocities: the plant's outputs of all bodies.
    Output ports:
        sample (12) [m, rad, m/s, rad/s]: :data:`mirdrake.core.vectors.STATE`, of the frame S in place of B. The
            first sample is there from the start, unless there is a latency.
        stamp (1) [s]: when it was taken; -inf before the first.

    Args:
        frame: fixed to a body.
        mount: rate, latency and dropout.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
        period: time step of the plant [s], see :func:`vehicle_state`.
    """

    def __init__(self, frame: Frame, mount: "GroundTruthMount", *, stream: int = 0, period: float = 0.0) -> None:
        super().__init__(STATE, mount, stream=stream, initial=[0.0] * len(STATE))
        body, self._X_BS = mount_pose(frame)
        self._body, self._period = int(body.index()), period
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        velocities = AbstractValue.Make([SpatialVelocity()])
        self.body_velocities = self.DeclareAbstractInputPort("body_spatial_velocities", velocities)
        self.declare_first_sample()

    def measure(self, context: Context) -> Array:
        """Return the state of the frame (12)."""
        X_WB, V_WB = self.body_poses.Eval(context)[self._body], self.body_velocities.Eval(context)[self._body]
        X_WS, turn = X_WB.multiply(self._X_BS), V_WB.rotational()
        velocity = V_WB.translational() + np.cross(turn, X_WS.translation() - X_WB.translation())
        pose = (*X_WS.rotation().ToQuaternion().wxyz(), *X_WS.translation())
        twist = [*turn.tolist(), *velocity.tolist()]
        return np.array(vehicle_state([float(value) for value in pose], twist, self._period))


def vehicle_state(pose: Sequence[Any] | Array, twist: Sequence[Any] | Array, period: float = 0.0) -> list[Any]:
    """Return the state vector of a floating body, or those of many poses as 12 arrays.

    In each step of a plant the velocities at its end move the bodies, so that positions lead velocities by half a step.
    The pose of the state is that of its velocities: it is moved back by half a step.

    Args:
        pose: quaternion w, x, y, z of R_WB and position p_WB [m] (7), or an array (7 x n).
        twist: angular velocity w_WB_W [rad/s] and velocity v_WB_W [m/s] (6), or an array (6 x n).
        period: time step of the plant [s]; zero: the pose is not moved.

    Returns:
        the 12 numbers of :data:`mirdrake.core.vectors.STATE`; roll, pitch, yaw as in Drake's RollPitchYaw.
    """
    w, i, j, k, x, y, z = pose
    # For floats the standard library is much faster than NumPy.
    arrays = isinstance(pose, np.ndarray)
    functions: Any = (np.sqrt, np.arctan2, np.arcsin) if arrays else (sqrt, atan2, asin)
    root, angle, tilt = functions
    # Drake's order: angular velocity before linear velocity, both in the world frame.
    ax, ay, az, vx, vy, vz = twist
    back = 0.5 * period
    if back > 0.0:
        x, y, z, turn = x - back * vx, y - back * vy, z - back * vz, 0.5 * back
        w, i, j, k = (
            w + turn * (ax * i + ay * j + az * k),
            i - turn * (ax * w + ay * k - az * j),
            j - turn * (ay * w + az * i - ax * k),
            k - turn * (az * w + ax * j - ay * i),
        )
    norm = root(w * w + i * i + j * j + k * k)  # Drake lets it drift from 1
    w, i, j, k = w / norm, i / norm, j / norm, k / norm
    xx, xy, xz = 1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - w * k), 2.0 * (i * k + w * j)  # rows of R_WB
    yx, yy, yz = 2.0 * (i * j + w * k), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - w * i)
    zx, zy, zz = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)
    # Roll, pitch and yaw of R = Rz Ry Rx; the clip absorbs rounding near ±90 degrees.
    return [
        x,
        y,
        z,
        angle(zy, zz),
        tilt(np.clip(-zx, -1.0, 1.0) if arrays else min(max(-zx, -1.0), 1.0)),
        angle(yx, xx),
        xx * vx + yx * vy + zx * vz,  # columns of R_WB: expressed in B
        xy * vx + yy * vy + zy * vz,
        xz * vx + yz * vy + zz * vz,
        xx * ax + yx * ay + zx * az,
        xy * ax + yy * ay + zy * az,
        xz * ax + yz * ay + zz * az,
    ]


class GroundTruthMount(SensorMount):
    """Exact pose and twist of a frame, without any error."""

    kind: Literal["ground_truth"]

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> TruthSensor:
        """Return the ground-truth sensor."""
        frame = parts.plant.GetFrameByName(self.frame, part.instance)
        return TruthSensor(frame, self, stream=stream, period=part.period)
