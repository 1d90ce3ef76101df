"""Poses of bodies between two samples: the beams of a rotating laser are measured one after the other.

Positions are cubic in time, given by places and velocities at both samples (Hermite); so are the rotation vectors. A
car that brakes or turns is then placed within a millimetre over a tenth of a second, where the velocity alone would be
off by a centimetre. What turns by more than a radian, as a wheel does, is turned back at its present rate instead.
"""

import math
from dataclasses import dataclass
from math import cos, hypot, sin

import numpy as np

from mirdrake.core.compiled import compiled
from mirdrake.sensors.ranging.faces import Array

NUMBERS = 18
"""Layout of a body's state: rotation (9), position (3), angular velocity (3), velocity (3)."""

POSE = 12
"""Number of its first numbers that are its pose."""

_FAST = 1.0  # [rad] in the time between two samples


@dataclass(frozen=True)
class BodyState:
    """Pose and twist of a body frame B in the world."""

    R: Array
    """R_WB (3, 3)"""
    p: Array
    """p_WB (3) [m]"""
    w: Array
    """w_WB_W (3) [rad/s]"""
    v: Array
    """v_WB_W (3) [m/s]"""

    @property
    def speed(self) -> float:
        """Of the origin of B [m/s]."""
        return hypot(*self.v.tolist())

    @property
    def spin(self) -> float:
        """Rate of turn [rad/s]."""
        return hypot(*self.w.tolist())

    def back(self, time: float) -> "BodyState":
        """Return the state with the pose of a short time before [s], at the present velocities."""
        if time == 0.0 or not (self.v.any() or self.w.any()):
            return self
        return BodyState(rotations(-time * self.w[None])[0] @ self.R, self.p - time * self.v, self.w, self.v)

    def numbers(self) -> Array:
        """Return the state as :data:`NUMBERS` numbers."""
        return np.concatenate((self.R.ravel(), self.p, self.w, self.v))


def body_state(numbers: Array) -> BodyState:
    """Return the state of :meth:`BodyState.numbers`."""
    return BodyState(numbers[:9].reshape(3, 3), numbers[9:12], numbers[12:15], numbers[15:18])


def planar_state(row: Array) -> BodyState:
    """Return the state of a body on the ground: x, y [m], yaw [rad], vx, vy [m/s] in W, yaw rate [rad/s] (6)."""
    x, y, yaw, vx, vy, rate = row.tolist()
    c, s = cos(yaw), sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return BodyState(R, np.array([x, y, 0.0]), np.array([0.0, 0.0, rate]), np.array([vx, vy, 0.0]))


def poses_at(times: Array, before: BodyState | None, now: BodyState, period: float) -> tuple[Array, Array]:
    """Return the poses of a body at times since the last sample.

    Args:
        times: before now, 0 or negative, not further back than the period (n) [s].
        before: state one period ago; None if it is not known: then it moved as it does now.
        now: present state.
        period: time between the two [s].

    Returns:
        R_WB (n, 3, 3) and p_WB (n, 3) [m].
    """
    poses = np.empty((len(times), POSE))
    last, earlier = now.numbers(), (before or now).numbers()
    compiled(write_poses, parts=PARTS)(times, last, earlier, before is not None, period, poses)
    return poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]


def write_poses(times: Array, now: Array, before: Array, is_known: bool, period: float, poses: Array) -> None:
    """Write the poses of :func:`poses_at` (n, 12): R_WB by rows, p_WB [m]; other arguments as of `write_pose`."""
    for k in range(len(times)):
        write_pose(times[k], now, before, is_known, period, poses[k])


def write_pose(t: float, now: Array, before: Array, is_known: bool, period: float, pose: Array) -> None:
    """Write the pose of a body at a time since the last sample.

    Args:
        t: time, 0 or negative [s].
        now: present state, as the numbers of a :class:`BodyState`.
        before: state one period ago.
        is_known: whether that is known; otherwise the body moved as it does now.
        period: time between the two [s].
        pose: R_WB by rows, p_WB [m] (12); written.
    """
    # Cubic Hermite polynomials in s from 0 (sample before) to 1 (now), with the velocities at both ends.
    s = 1.0 + t / period
    bend, rise, start = s * s * (3.0 - 2.0 * s), s * s * (s - 1.0), s * (s - 1.0) * (s - 1.0)
    for k in range(3):
        if is_known:
            change, rates = now[9 + k] - before[9 + k], start * before[15 + k] + rise * now[15 + k]
            pose[9 + k] = before[9 + k] + bend * change + period * rates
        else:
            pose[9 + k] = now[9 + k] + t * now[15 + k]

    # The rotation vector is only unique for less than half a turn; a wheel turns farther between two samples.
    spin = math.sqrt(max(_square(now, 12), _square(before, 12)))
    if not is_known or spin * period > _FAST:
        _turn(t * now[12], t * now[13], t * now[14], now, False, pose)
        return

    # Rotation since the sample before, in the frame at that sample; its rate at the start is the angular velocity.
    x, y, z = _rotation_between(before, now)
    w0, w1 = _turned_back(before, before), _turned_back(now, now)
    # Rate of the rotation vector at the end: w + v x w / 2 + v x (v x w) / 12.
    cross = _cross(x, y, z, w1[0], w1[1], w1[2])
    twice = _cross(x, y, z, cross[0], cross[1], cross[2])
    _turn(
        bend * x + period * (start * w0[0] + rise * (w1[0] + 0.5 * cross[0] + twice[0] / 12.0)),
        bend * y + period * (start * w0[1] + rise * (w1[1] + 0.5 * cross[1] + twice[1] / 12.0)),
        bend * z + period * (start * w0[2] + rise * (w1[2] + 0.5 * cross[2] + twice[2] / 12.0)),
        before, True, pose,
    )  # fmt: skip


def _square(numbers: Array, first: int) -> float:
    """Return the square of the length of a vector within the numbers of a state."""
    return float(numbers[first] ** 2 + numbers[first + 1] ** 2 + numbers[first + 2] ** 2)


def _turned_back(state: Array, vector: Array) -> tuple[float, float, float]:
    """Return the angular velocity of a state in the frame of another one, R^T w."""
    w = vector[12:15]
    return (
        state[0] * w[0] + state[3] * w[1] + state[6] * w[2],
        state[1] * w[0] + state[4] * w[1] + state[7] * w[2],
        state[2] * w[0] + state[5] * w[1] + state[8] * w[2],
    )


def _cross(x: float, y: float, z: float, a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return the cross product of (x, y, z) and (a, b, c)."""
    return y * c - z * b, z * a - x * c, x * b - y * a


def _rotation_between(before: Array, now: Array) -> tuple[float, float, float]:
    """Return the rotation vector [rad] of R_before^T R_now, a rotation by less than half a turn."""
    # Elements of the product: column i of the first times column j of the second.
    xy, yx = _columns(before, 0, now, 1), _columns(before, 1, now, 0)
    xz, zx = _columns(before, 0, now, 2), _columns(before, 2, now, 0)
    yz, zy = _columns(before, 1, now, 2), _columns(before, 2, now, 1)
    x, y, z = zy - yz, xz - zx, yx - xy
    trace = _columns(before, 0, now, 0) + _columns(before, 1, now, 1) + _columns(before, 2, now, 2)
    sine, cosine = 0.5 * math.sqrt(x * x + y * y + z * z), 0.5 * (trace - 1.0)
    # atan2 is accurate for small angles and near a quarter turn, where acos and asin lose digits.
    factor = 0.5 * (math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0)
    return factor * x, factor * y, factor * z


def _columns(first: Array, i: int, second: Array, j: int) -> float:
    """Return the scalar product of a column of one rotation matrix and one of another."""
    return float(first[i] * second[j] + first[3 + i] * second[3 + j] + first[6 + i] * second[6 + j])


def _turn(x: float, y: float, z: float, state: Array, after: bool, pose: Array) -> None:
    """Write the rotation of a state turned by a rotation vector [rad]: R exp(v) if `after`, else exp(v) R."""
    # Rodrigues' formula; series for small angles, as sin(a)/a and (1 - cos(a))/a² are 0/0 at zero.
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    sine = math.sin(angle) / angle if angle >= 1e-6 else 1.0
    versine = (1.0 - math.cos(angle)) / square if angle >= 1e-6 else 0.5
    turn = (
        1.0 + versine * (x * x - square), versine * x * y - sine * z, versine * x * z + sine * y,
        versine * x * y + sine * z, 1.0 + versine * (y * y - square), versine * y * z - sine * x,
        versine * x * z - sine * y, versine * y * z + sine * x, 1.0 + versine * (z * z - square),
    )  # fmt: skip
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += state[3 * i + k] * turn[3 * k + j] if after else turn[3 * i + k] * state[3 * k + j]
            pose[3 * i + j] = total


PARTS = (write_pose, _square, _turned_back, _cross, _rotation_between, _columns, _turn)
"""Compiled functions of this module."""


def rotations(vectors: Array) -> Array:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3) [rad], by Rodrigues' formula."""
    square = np.einsum("ij,ij->i", vectors, vectors)
    angle = np.sqrt(square)
    # Series for small angles: sin(a)/a and (1 - cos(a))/a² are 0/0 at zero.
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0, np.sin(safe) / safe)
    versine = np.where(small, 0.5, (1.0 - np.cos(safe)) / (safe * safe))
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    outer = vectors[:, :, None] * vectors[:, None, :] - square[:, None, None] * np.eye(3)
    turned: Array = np.eye(3) + sine[:, None, None] * cross + versine[:, None, None] * outer
    return turned
