"""The skin of a car body: the zero set of one smooth function of space, sampled by rays from inside.

A body is two volumes joined by a rounded union: the lower body (plan view, side profile, nose, tail, deck, bottom) and
the cabin (its plan view, taper, roof and rear). Each is the rounded intersection of surfaces drawn as curves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.meshes.outlines.curves import Array, Curve, curve, smooth_max, smooth_min

_SPINE = curve((-0.5, 0.78), (1.5, 0.72), (3.0, 0.58))


@dataclass(frozen=True)
class Form:
    """The curves and numbers that make the skin of a car, all in metres in the frame of the body.

    Attributes:
        plan: half width of the lower body over x.
        side_inset: how far the flank lies inside the plan over z.
        nose: x of the front end over z; tail: x of the rear end over z.
        deck: height of bonnet and boot over x.
        bottom: height of the underside over x.
        roof: height of windscreen and roof over x, in the middle plane.
        cabin_plan: half width of the cabin over x; cabin_taper: how far it lies inside that over z.
        cabin_tail: x of the rear window over z.
        half_width: the flank is cut at this distance from the middle plane.
        corner: distance from the middle plane where nose, tail and deck reach the sweeps given below.
        nose_sweep: how far the nose lies back there, power of that over y, slope for scaling.
        tail_sweep: the same of the tail.
        deck_crown: drop of the deck there.
        ridge: height, y and width of a crease along the bonnet; x where it starts and over which length it grows.
        roof_sweep: how far [m/m²] the roof's profile is moved back over y²; roof_crown: its fall at y = 0.65.
        roof_slope: scaling of the windscreen: square of its slope, x where it starts and its length.
        back_sweep: how far the rear window lies ahead at y = 0.7, power of that, scaling.
        flare: height, radius about the wheel's centre and width of the swelling around the wheel openings.
        blends: radii of the creases: nose and tail, deck, flank, bottom, cabin's sides, cabin's rear, cabin on body.
        cabin_floor: the cabin volume ends at this height.
        spine: the ends in x of the line the rays start from; spine_height: its height over x.
        middle: views from ahead see what lies ahead of this x, views from behind what lies behind it.
        mesh: points along the spine, in each end fan, and around.
    """

    plan: Curve
    side_inset: Curve
    nose: Curve
    tail: Curve
    deck: Curve
    bottom: Curve
    roof: Curve
    cabin_plan: Curve
    cabin_taper: Curve
    cabin_tail: Curve
    half_width: float
    corner: float = 0.85
    nose_sweep: tuple[float, float, float] = (0.30, 2.4, 0.5)
    tail_sweep: tuple[float, float, float] = (0.13, 2.6, 0.3)
    deck_crown: float = 0.050
    ridge: tuple[float, float, float, float, float] = (0.018, 0.60, 0.10, 2.0, 0.6)
    roof_sweep: float = 0.26
    roof_crown: float = 0.055
    roof_slope: tuple[float, float, float] = (0.3, 1.5, 0.4)
    back_sweep: tuple[float, float, float] = (0.13, 2.4, 1.08)
    flare: tuple[float, float, float] = (0.012, 0.40, 0.07)
    blends: tuple[float, float, float, float, float, float, float] = (0.02, 0.10, 0.11, 0.05, 0.10, 0.08, 0.055)
    cabin_floor: float = 0.7
    spine: tuple[float, float] = (-0.15, 2.85)
    spine_height: Curve = _SPINE
    middle: float = 1.0
    mesh: tuple[int, int, int] = (40, 16, 35)


@dataclass(frozen=True)
class Skin:
    """The surface of a form, with wheels whose centres are at ``axles`` (x) and ``wheel_height`` (z)."""

    form: Form
    axles: tuple[float, ...]
    wheel_height: float

    def function(self, p: Array) -> Array:
        """Return a function of space at points (…, 3): negative inside, about the distance near the surface."""
        f = self.form
        x, y, z = p[..., 0], np.abs(p[..., 1]), p[..., 2]
        r_y = y / f.corner
        flare = np.zeros_like(x)
        for axle in self.axles:
            r = np.hypot(x - axle, z - self.wheel_height)
            flare = flare + f.flare[0] * np.exp(-(((r - f.flare[1]) / f.flare[2]) ** 2))
        side = y - np.minimum(f.plan(x) - f.side_inset(z) + flare, f.half_width)
        back, power, slope = f.nose_sweep
        nose = (x - f.nose(z) + back * r_y**power) / np.sqrt(1 + (slope * r_y) ** 2)
        back, power, slope = f.tail_sweep
        tail = (f.tail(z) + back * r_y**power - x) / np.sqrt(1 + (slope * r_y) ** 2)
        high, position, wide, start, over = f.ridge
        ridge = high * np.exp(-(((y - position) / wide) ** 2)) * np.clip((x - start) / over, 0, 1)
        deck = (z - f.deck(x) + f.deck_crown * r_y**2 - ridge) / np.sqrt(1 + 0.2**2)
        ends, decks, flanks, low, tops, backs, cabins = f.blends
        lower = smooth_max(smooth_max(nose, tail, ends), deck, decks)
        lower = smooth_max(lower, side, flanks)
        lower = smooth_max(lower, f.bottom(x) - z, low)
        cabin_side = (y - f.cabin_plan(x) + f.cabin_taper(z)) / 1.06
        steep, start, over = f.roof_slope
        roof = z - f.roof(x + f.roof_sweep * y**2) + f.roof_crown * (y / 0.65) ** 2
        roof = roof / np.sqrt(1 + steep * np.clip((x - start) / over, 0, 1))
        ahead, power, scale = f.back_sweep
        rear = (f.cabin_tail(z) + ahead * (y / 0.7) ** power - x) / scale
        cabin = smooth_max(smooth_max(cabin_side, roof, tops), rear, backs)
        cabin = smooth_max(cabin, f.cabin_floor - z, 0.02)
        return smooth_min(lower, cabin, cabins)

    def gradient(self, p: Array, step: float = 2e-4) -> Array:
        """Return the gradient of the function at points (…, 3)."""
        columns = []
        for axis in range(3):
            d = np.zeros(3)
            d[axis] = step
            columns.append((self.function(p + d) - self.function(p - d)) / (2 * step))
        return np.stack(columns, axis=-1)

    def normals(self, p: Array) -> Array:
        """Return the outward unit normals at points on the surface."""
        g = self.gradient(p, 2e-3)
        on_plane = np.abs(p[..., 1]) < 1e-6
        g[on_plane, 1] = 0.0
        result: Array = g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9)
        return result

    def project(self, p: Array) -> Array:
        """Move points near the surface onto it (those on the plane of symmetry stay there)."""
        for _ in range(4):
            g = self.gradient(p)
            g[np.abs(p[..., 1]) < 1e-6, 1] = 0.0
            move = self.function(p)[..., None] * g / np.maximum((g * g).sum(-1, keepdims=True), 0.25)
            p = p - np.clip(move, -0.01, 0.01)
        return p

    def cast(self, origin: Array, direction: Array, *, reach: float = 1.6) -> Array:
        """Return the points where rays from inside first leave the body."""
        steps = np.linspace(0.0, reach, 161)
        # Every fourth step, then the three before the first that is outside.
        coarse = np.stack([self.function(origin + s * direction) > 0 for s in steps[::4]])
        last = 4 * np.argmax(coarse, axis=0)
        first = last
        for back in (1, 2, 3):
            index = np.maximum(last - back, 0)
            outside = self.function(origin + steps[index][..., None] * direction) > 0
            first = np.where(outside & (last > 0), index, first)
        low, high = steps[np.maximum(first - 1, 0)], steps[first]
        for _ in range(24):
            mid = (low + high) / 2
            outside = self.function(origin + mid[..., None] * direction) > 0
            low, high = np.where(outside, low, mid), np.where(outside, mid, high)
        result: Array = origin + high[..., None] * direction
        return result

    def hit(self, origin: Sequence[float], direction: Sequence[float]) -> Array:
        """Return the point (3,) where one ray from inside leaves the body."""
        hits: Array = self.cast(np.array([origin], dtype=float), np.array([direction], dtype=float))[0]
        return hits


def half_shell(skin: Skin) -> tuple[Array, NDArray[np.int64]]:
    """Sample the left half of the skin on a structured grid; return its points (n, 3) and triangles (m, 3)."""
    grid = _sample(skin)
    m, n = grid.shape[:2]
    index = np.arange(m * n).reshape(m, n)
    p, q, r, s = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    points = grid.reshape(-1, 3)
    # The shorter diagonal divides each quadrilateral.
    first_diagonal = np.linalg.norm(points[p] - points[r], axis=-1) <= np.linalg.norm(points[q] - points[s], axis=-1)
    first = np.where(first_diagonal[..., None], np.stack([p, q, r], -1), np.stack([p, q, s], -1))
    second = np.where(first_diagonal[..., None], np.stack([p, r, s], -1), np.stack([q, r, s], -1))
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    keep = np.linalg.norm(normal, axis=1) > 1e-9
    faces, normal, corner = faces[keep], normal[keep], corner[keep]
    wrong = np.einsum("ij,ij->i", normal, skin.normals(corner.mean(axis=1))) < 0
    faces = np.where(wrong[:, None], faces[:, ::-1], faces)
    return points, faces


def _sample(skin: Skin) -> Array:
    """Return points (m, n, 3) of the left half: half rings about the spine, a fan of them at either end."""
    x_rear, x_front = skin.form.spine
    along_count, fan_count, count = skin.form.mesh
    fan = np.linspace(np.pi / 2, 0.0, fan_count)
    stations = [(x_rear, -np.sin(a), np.cos(a)) for a in fan[:-1]]
    stations += [(float(x), 0.0, 1.0) for x in np.linspace(x_rear, x_front, along_count)]
    stations += [(x_front, np.sin(a), np.cos(a)) for a in fan[::-1][1:]]
    dense = 260
    origins, directions = [], []
    theta = np.linspace(-np.pi / 2, np.pi / 2, dense)
    for x, along, across in stations:
        height = float(skin.form.spine_height(np.array(x)))
        level = np.cos(theta)
        level[[0, -1]] = 0.0
        across = 0.0 if across < 1e-9 else across
        origins.append(np.broadcast_to(np.array([x, 0.0, height]), (dense, 3)))
        directions.append(np.stack([along * level, across * level, np.sin(theta)], axis=1))
    hits = skin.cast(np.stack(origins), np.stack(directions), reach=2.2)
    rows = []
    for p, n in zip(hits, skin.normals(hits), strict=True):
        length = np.linalg.norm(np.diff(p, axis=0), axis=1)
        turn = np.linalg.norm(np.diff(n, axis=0), axis=1)
        below = (n[:-1, 2] + n[1:, 2]) / 2 < -0.8
        weight = np.where(below, 0.2, 1.0) * (length + 0.10 * turn) + 1e-7
        rows.append((p, weight))
    # Blend the sampling of neighbouring stations, so that the grid lines along the car run smoothly.
    share = np.stack([np.concatenate([[0.0], np.cumsum(w)]) / w.sum() for _, w in rows])
    for _ in range(4):
        share[1:-1] = 0.25 * share[:-2] + 0.5 * share[1:-1] + 0.25 * share[2:]
    fractions = np.linspace(0.0, 1.0, count)
    grid = np.stack(
        [
            np.stack([np.interp(fractions, s, p[:, axis]) for axis in range(3)], axis=1)
            for s, (p, _) in zip(share, rows, strict=True)
        ]
    )
    for _ in range(2):
        grid[:, [0, -1], 1] = 0.0
        grid[[0, -1], :, 1] = 0.0
        grid = skin.project(grid)
    return grid
