"""Poses of bodies between two samples: the beams of a rotating laser are measured one after the other.

Positions are cubic in time, given by places and velocities at both samples (Hermite); so are the rotation vectors. A
car that brakes or turns is then placed within a millimetre over a tenth of a second, where the velocity alone would be
off by a centimetre. What turns by more than a radian, as a wheel does, is turned back at its present rate instead.
"""

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from mirdrake.sensors.ranging.faces import Array

NUMBERS = 18
"""Layout of a body's state: rotation (9), position (3), angular velocity (3), velocity (3)."""

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
    t = times[:, None]
    if before is None:
        return _turned(now, times), now.p + t * now.v
    # Cubic Hermite polynomials in s from 0 (sample before) to 1 (now), with the velocities at both ends.
    s = 1.0 + t / period
    bend, rise = s * s * (3.0 - 2.0 * s), s * s * (s - 1.0)
    start = s * (s - 1.0) ** 2
    p = before.p + bend * (now.p - before.p) + period * (start * before.v + rise * now.v)
    # The rotation vector is only unique for less than half a turn; a wheel turns farther between two samples.
    if max(now.spin, before.spin) * period > _FAST:
        return _turned(now, times), p
    # Rotation since the sample before, in the frame at that sample; its rate at the start is the angular velocity.
    whole = rotation_vector(before.R.T @ now.R)
    w0, w1 = before.R.T @ before.w, now.R.T @ now.w
    cross = _cross(whole)
    end = w1 + 0.5 * cross @ w1 + cross @ (cross @ w1) / 12.0  # rate of the rotation vector
    angles = bend * whole + period * (start * w0 + rise * end)
    return before.R @ rotations(angles), p


def _turned(now: BodyState, times: Array) -> Array:
    """Return R_WB (n, 3, 3) at times [s] from now, at the present angular velocity."""
    turned: Array = rotations(times[:, None] * now.w) @ now.R
    return turned


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


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3) [rad] of a rotation by less than half a turn."""
    twice = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = 0.5 * hypot(*twice.tolist()), 0.5 * (float(np.trace(R)) - 1.0)
    # atan2 is accurate for small angles and near a quarter turn, where acos and asin lose digits.
    return 0.5 * twice * (atan2(sine, cosine) / sine if sine > 1e-9 else 1.0)


def _cross(v: Array) -> Array:
    """Return the matrix of the cross product with `v`."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
