"""A person on a bicycle: tubes, wheels with spokes, and a soft rider."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.wheels import revolve
from tools.meshes.prop_shapes import Field, ball, box, joined, limb, soft

WHEEL, AXLES = 0.345, (-0.525, 0.525)
"""Radius of a wheel, and x of the axles [m]."""

_TYRE = 0.02  # radius of its section [m]
_CRANK = np.array([-0.09, 0.0, 0.285])
_SADDLE = np.array([-0.25, 0.0, 0.95])
_STEM = np.array([0.37, 0.0, 1.03])


def rod(
    material: str, start: Sequence[float] | Array, end: Sequence[float] | Array, radius: float, count: int = 8
) -> Mesh:
    """Return a tube between two points."""
    a, along = np.array(start, dtype=float), np.subtract(end, start).astype(float)
    length = float(np.linalg.norm(along))
    y = along / length
    # Any direction across: that of the axis to which the tube is least parallel.
    x = np.cross(y, np.eye(3)[int(np.argmin(np.abs(y)))])
    x /= np.linalg.norm(x)
    mesh = Mesh()
    tube = revolve(material, [(0.0, 1e-4), (0.0, radius), (length, radius), (length, 1e-4)], count)
    mesh.add_mesh(tube, np.column_stack((x, y, np.cross(x, y))), a.tolist())
    return mesh


def _wheel() -> Mesh:
    """Return a wheel about y: tyre, rim, hub, spokes."""
    mesh = Mesh()
    middle, angles = WHEEL - _TYRE, np.linspace(np.pi, -np.pi, 9)
    mesh.add_mesh(revolve("rubber", [(_TYRE * np.cos(a), middle + _TYRE * np.sin(a)) for a in angles], 36))
    rim = middle - _TYRE
    section = [
        (-0.011, rim - 0.012),
        (-0.011, rim + 0.008),
        (0.011, rim + 0.008),
        (0.011, rim - 0.012),
        (-0.011, rim - 0.012),
    ]
    mesh.add_mesh(revolve("rim_machined", section, 36))
    mesh.add_mesh(rod("steel", (0.0, -0.045, 0.0), (0.0, 0.045, 0.0), 0.02))
    for k, angle in enumerate(np.arange(0.0, 2.0 * np.pi, np.pi / 9.0)):
        side = 0.03 if k % 2 else -0.03
        outer = (rim * np.cos(angle), 0.0, rim * np.sin(angle))
        mesh.add_mesh(rod("steel", (0.02 * np.cos(angle), side, 0.02 * np.sin(angle)), outer, 0.0016, 3))
    return mesh


def _bicycle() -> Mesh:
    mesh = Mesh()
    for x in AXLES:
        mesh.add_mesh(_wheel(), None, (x, 0.0, WHEEL))
    rear, front = (np.array([x, 0.0, WHEEL]) for x in AXLES)
    head, neck, seat = np.array([0.405, 0.0, 0.72]), np.array([0.375, 0.0, 0.87]), np.array([-0.205, 0.0, 0.78])
    tubes = [
        (_CRANK, _SADDLE, 0.016),
        (_CRANK, head, 0.021),
        (seat, np.subtract(neck, (0, 0, 0.03)), 0.017),
        (head, _STEM, 0.018),
    ]
    for start, end, radius in tubes:
        mesh.add_mesh(rod("frame", start, end, radius))
    for side in (-0.05, 0.05):
        aside = np.array([0.0, side, 0.0])
        for start, end in ((_CRANK, rear), (seat, rear), (head, front)):
            mesh.add_mesh(rod("frame", start + 0.4 * aside, end + aside, 0.010))
        grip = _STEM + 5.6 * aside
        mesh.add_mesh(rod("frame", _STEM, grip, 0.012))
        mesh.add_mesh(rod("rubber", grip, np.subtract(grip, (0.10, 0.0, 0.0)), 0.016))
    mesh.add_mesh(box("rubber", (0.26, 0.13, 0.05), np.add(_SADDLE, (0.0, 0.0, 0.02)).tolist(), 0.015))
    mesh.add_mesh(rod("steel", np.add(_CRANK, (0, -0.06, 0)), np.add(_CRANK, (0, -0.052, 0)), 0.09, 20))
    for side, pedal in ((1.0, _PEDALS[0]), (-1.0, _PEDALS[1])):
        mesh.add_mesh(rod("steel", np.add(_CRANK, (0, 0.07 * side, 0)), (pedal[0], 0.07 * side, pedal[2]), 0.010))
        mesh.add_mesh(box("rubber", (0.09, 0.10, 0.025), pedal, 0.004))
    return mesh


# --- the rider -------------------------------------------------------------------------------------------------------

_PEDALS = ((0.03, 0.12, 0.405), (-0.21, -0.12, 0.165))
_LEGS = (
    ((-0.20, 0.085, 1.02), (0.205, 0.115, 0.925), (-0.005, 0.12, 0.515)),
    ((-0.20, -0.085, 1.02), (0.075, -0.115, 0.70), (-0.245, -0.12, 0.275)),
)
"""Hip, knee and ankle of the left and the right leg."""


def _rider() -> Mesh:
    mesh = Mesh()
    jacket = joined([
        joined([
            limb([(-0.195, -0.065, 1.06), (-0.195, 0.065, 1.06)], (0.098, 0.098)),
            limb([(-0.105, -0.075, 1.27), (-0.105, 0.075, 1.27)], (0.098, 0.098)),
            limb([(-0.005, -0.140, 1.46), (-0.005, 0.140, 1.46)], (0.060, 0.060)),
        ], 0.14),
        *[limb([(0.005, 0.175 * side, 1.445), (0.130, 0.250 * side, 1.215), (0.275, 0.270 * side, 1.085)],
               (0.054, 0.045, 0.036)) for side in (-1.0, 1.0)],
    ], 0.04)  # fmt: skip
    mesh.add_mesh(soft("paint", jacket, (-0.36, -0.36, 0.92), (0.36, 0.36, 1.56), 0.028))
    for leg, pedal in zip(_LEGS, _PEDALS, strict=True):
        low, high = np.min(leg, axis=0) - 0.13, np.max(leg, axis=0) + 0.13
        mesh.add_mesh(soft("trousers", limb(leg, (0.088, 0.062, 0.045)), low.tolist(), high.tolist(), 0.028))
        x, y, z = pedal
        shoe = limb(
            [(x - 0.09, y, z + 0.06), (x + 0.02, y, z + 0.052), (x + 0.12, y, z + 0.042)], (0.046, 0.044, 0.030)
        )
        mesh.add_mesh(soft("shoe", shoe, (x - 0.18, y - 0.09, z - 0.04), (x + 0.2, y + 0.09, z + 0.15), 0.026))
    for side in (-1.0, 1.0):
        hand = ball((0.310, 0.276 * side, 1.050), (0.048, 0.034, 0.038))
        y = 0.276 * side
        mesh.add_mesh(soft("skin", hand, (0.24, y - 0.06, 0.99), (0.38, y + 0.06, 1.11), 0.022))
    head = joined([
        ball((0.085, 0.0, 1.655), (0.097, 0.079, 0.112)),
        ball((0.125, 0.0, 1.590), (0.058, 0.054, 0.060)),
        limb([(0.010, 0.0, 1.47), (0.060, 0.0, 1.59)], (0.052, 0.050)),
        limb([(0.178, 0.0, 1.650), (0.190, 0.0, 1.622)], (0.007, 0.012)),
    ], 0.028)  # fmt: skip
    mesh.add_mesh(soft("skin", head, (-0.06, -0.12, 1.42), (0.24, 0.12, 1.80), 0.022))
    shell = ball((0.078, 0.0, 1.690), (0.128, 0.100, 0.098))

    def helmet(p: Array) -> Array:
        return np.maximum(shell(p), 1.682 + 0.12 * (p[..., 0] - 0.078) - p[..., 2])

    covered: Field = helmet
    mesh.add_mesh(soft("helmet", covered, (-0.09, -0.14, 1.62), (0.25, 0.14, 1.83), 0.022))
    return mesh


def make_cyclist() -> Mesh:
    """Return a person on a bicycle who rides along x: helmet, jacket, trousers; 1.74 m long and 1.79 m high."""
    mesh = _bicycle()
    mesh.add_mesh(_rider())
    return mesh
