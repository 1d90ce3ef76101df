"""Parts that are placed on a skin: mirrors, handles, plates, the insides of the wheel openings, a roof spoiler."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import shapely

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.regions import triangulate
from tools.meshes.outlines.shell import Skin
from tools.meshes.outlines.solids import pillow


class PointMap(Protocol):
    """Takes points from the frame of a drawing to that of the car and back."""

    def forth(self, p: Array) -> Array:
        """Return true points of drawn ones."""

    def back(self, p: Array) -> Array:
        """Return drawn points of true ones."""


@dataclass(frozen=True)
class Part:
    """A solid and its place.

    Attributes:
        mesh: the solid, about its own origin.
        at: its place; with ``on`` the start of a ray inside the body.
        turn: rotation (3, 3), or None.
        on: direction of a ray from ``at``: the place is where it leaves the body, moved by ``shift``.
        shift: see ``on``.
        pair: the part belongs to the left side and has a mirror image on the right.
    """

    mesh: Mesh
    at: tuple[float, float, float]
    turn: Array | None = None
    on: tuple[float, float, float] | None = None
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pair: bool = False


@dataclass(frozen=True)
class Spoiler:
    """A roof spoiler: a wing that continues the roof to the rear, with black winglets beside the window [m].

    Attributes:
        span: half width.
        front: x where it starts on the roof; root: x where it leaves the roof in the middle plane; back: x of its end.
        fall: slope behind the root.
        fin: depth of the winglets.
        floor: height from which rays find the roof.
    """

    span: float = 0.54
    front: float = -0.30
    root: float = -0.40
    back: float = -0.650
    fall: float = 0.19
    fin: float = 0.13
    floor: float = 1.2


def place(skin: Skin, part: Part) -> Mesh:
    """Return a part's mesh at its place."""
    position: Sequence[float] = part.at
    if part.on is not None:
        position = (skin.hit(part.at, part.on) + np.array(part.shift)).tolist()
    mesh = Mesh()
    mesh.add_mesh(part.mesh, part.turn, position)
    return mesh


def wheelhouse(
    skin: Skin, axle: float, wheel_radius: float, arch_radius: float, inner_y: float, *, warp: PointMap | None = None
) -> Mesh:
    """Return the dark inside of the left wheel opening at an axle, in the car's frame."""
    mesh = Mesh()
    a = np.concatenate([np.zeros(4), np.linspace(0.0, np.pi, 37), np.full(4, np.pi)])
    drop = np.concatenate([[0.15, 0.10, 0.05, 0.0], np.zeros(37), [0.0, 0.05, 0.10, 0.15]])
    x, z = axle + arch_radius * np.cos(a), wheel_radius + arch_radius * np.sin(a) - drop
    if warp is None:
        z = np.maximum(z, skin.form.bottom(x) + 0.03)
        start = np.stack([x, np.full_like(x, 0.3), z], axis=1)
    else:
        start = warp.back(np.stack([x, np.full_like(x, inner_y), z], axis=1))
        start[:, 2] = np.maximum(start[:, 2], skin.form.bottom(start[:, 0]) + 0.03)
        z = warp.forth(start)[:, 2]
    outer = skin.cast(start, np.broadcast_to(np.array([0.0, 1.0, 0.0]), start.shape), reach=0.9)
    outer = outer if warp is None else warp.forth(outer)
    inner = outer.copy()
    inner[:, 1] = inner_y
    normal = np.stack([-np.cos(a), np.zeros_like(a), -np.sin(a)], axis=1)
    lip = outer.copy()
    lip[:, 1] -= 0.016
    outer = outer - 0.007 * normal  # starts behind the skin, so that no gap shows along the edge
    outer[:, 1] -= 0.003
    mesh.add_grid("cladding", np.stack([outer, lip]), np.stack([normal, normal]))
    mesh.add_grid("dark", np.stack([lip, inner]), np.stack([normal, normal]))
    wall = shapely.Polygon(np.stack([inner[:, 0], inner[:, 2]], axis=1))
    wall = wall if wall.is_valid else wall.buffer(0)  # the underside may lie above the wheel's centre
    flat = triangulate(wall)
    side = np.stack([flat[..., 0], np.full(flat.shape[:2], inner_y), flat[..., 1]], axis=-1)
    mesh.add_flat("dark", side, (0, 1, 0))
    return mesh


def spoiler(skin: Skin, wing: Spoiler) -> Mesh:
    """Return a roof spoiler, a wing profile swept across the car."""
    mesh = Mesh()
    y = np.linspace(-wing.span, wing.span, 23)
    share = np.linspace(0.0, 1.0, 9)
    rows_top, rows_low = [], []
    for yy in y:
        front, root = wing.front, wing.root + 0.05 * (yy / 0.6) ** 2
        back = wing.back + 0.10 * abs(yy / 0.6) ** 3
        x = front + share * (back - front)
        probe = np.stack([np.maximum(x, root), np.full_like(x, yy), np.full_like(x, wing.floor)], axis=1)
        z = skin.cast(probe, np.broadcast_to(np.array([0.0, 0.0, 1.0]), probe.shape), reach=0.6)[:, 2] + 0.003
        z = z - wing.fall * np.maximum(root - x, 0.0)
        rows_top.append(np.stack([x, np.full_like(x, yy), z], axis=1))
        thick = np.interp(x, [back, back + 0.02, front], [0.014, 0.030, 0.06])
        rows_low.append(np.stack([x + 0.012, np.full_like(x, yy), z - thick], axis=1))

    def normals(grid: Array, up: float) -> Array:
        n = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        result: Array = n * np.sign(n[..., 2:]) * up
        return result

    top, low = np.stack(rows_top), np.stack(rows_low)
    mesh.add_grid("paint", top, normals(top, 1.0))
    mesh.add_grid("gloss_black", low, normals(low, -1.0))
    rear = np.stack([top[:, -1], low[:, -1]])
    mesh.add_grid("paint", rear, np.broadcast_to(np.array([-1.0, 0, 0.1]), rear.shape).copy())
    for k, sign in ((0, -1.0), (-1, 1.0)):
        end = np.stack([top[k], low[k]])
        mesh.add_grid("paint", end, np.broadcast_to(np.array([0, sign, 0.0]), end.shape).copy())
        if not wing.fin:
            continue
        # A black winglet beside the rear window closes the gap between the spoiler and the pillar.
        fin = np.stack([top[k] - [0, 0, 0.004], top[k] - np.linspace([0, 0, wing.fin], [0, 0, 0.02], top.shape[1])])
        fin[1, :, 0] += np.linspace(0.0, 0.025, top.shape[1])
        for shift, facing in ((-0.004, sign), (-0.026, -sign)):
            side = fin + np.array([0.0, sign * shift, 0.0])
            mesh.add_grid("gloss_black", side, np.broadcast_to(np.array([0, facing, 0.0]), fin.shape).copy())
        width = np.array([0.0, 0.022 * sign, 0.0])
        edge = np.stack([fin[1] - 0.004 * np.array([0, sign, 0]), fin[1] - 0.004 * np.array([0, sign, 0]) - width])
        mesh.add_grid("gloss_black", edge, np.broadcast_to(np.array([-0.5, 0, -0.8]), edge.shape).copy())
    stop = pillow("lamp_red", (0.012, 0.30, 0.014), 0.4, (12, 7))
    mesh.add_mesh(stop, None, (float(rear[0, 11, 0]) + 0.002, 0.0, float(rear[:, 11, 2].mean())))
    return mesh
