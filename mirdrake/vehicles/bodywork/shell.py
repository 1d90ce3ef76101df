"""The skin of a car: cross-sections lofted along the vehicle, and regions of another material cut out of it.

A cross-section runs from the middle of the underside over sill, shoulder and side window to the middle of the roof. Its
size follows curves along the vehicle (:class:`Curves`). Only the left half is made; the right one is its mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy  # it imports its parts when they are first used
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.meshes import area_vectors
from mirdrake.vehicles.bodywork.mesh import Mesh
from mirdrake.vehicles.bodywork.shapes import Array, triangulate

Knots = tuple[tuple[float, float], ...]

LEFT, FRONT, REAR = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
FRONT_LEFT, REAR_LEFT, BELOW = (0.74, 0.67, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, -1.0)
_CORNER = np.linspace(0.0, 1.0, 5)[:, None]  # parameters of the points on a rounded corner of a cross-section
_STRAIGHT = np.array([[0.33], [0.67]])  # parameters of the points between two corners
_STATIONS = 60
_SAG = 0.035  # a roof lies lower at its edges by this part of the half width


@dataclass(frozen=True)
class Curves:
    """Shape of a body as curves over the station: -1 is its rear end, 0 and 1 are the axles, 2 is its front end.

    Heights are 0 at the underside and 1 at the roof; widths are parts of the half width.

    Attributes:
        deck: height of the bonnet, the belt line below the side windows, and the boot.
        roof: height of windscreen, roof and rear window; the cabin ends where the roof is lower than the deck.
        plan: width of the body.
        tumblehome: inclination of the side windows, lateral over vertical.
        shoulder: lateral distance of the side windows from the flank.
        sweep: longitudinal distance of the front and rear corners from the ends, in half widths.
        bulge: distance of the upper and lower edge of an end behind its middle, in half widths.
        edge: radius of the edges around front and rear end, in half widths.
    """

    deck: Knots
    roof: Knots
    plan: Knots
    tumblehome: float = 0.30
    shoulder: float = 0.05
    sweep: tuple[float, float] = (0.10, 0.26)
    bulge: tuple[float, float] = (0.05, 0.10)
    edge: float = 0.10


@dataclass(frozen=True)
class Frame:
    """Main dimensions of a body [m]; x of its ends, height of its underside and its roof."""

    rear: float
    front: float
    wheelbase: float
    half_width: float
    low: float
    high: float
    arch: float


@dataclass
class Shell:
    """Triangles of the left half of a body, each with its material."""

    curves: Curves
    frame: Frame
    triangles: Array = field(init=False)
    normals: Array = field(init=False)
    materials: list[str] = field(init=False)

    def __post_init__(self) -> None:
        grid = self._grid()
        rows, columns = grid.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        p, q, r, s = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces = np.concatenate([np.stack([p, r, q], axis=-1), np.stack([p, s, r], axis=-1)]).reshape(-1, 3)
        points = grid.reshape(-1, 3)
        corners = points[faces]
        area = area_vectors(corners)
        normals = np.zeros_like(points)
        for column in faces.T:
            np.add.at(normals, column, area)
        # The ends of a section lie in the plane of symmetry, and all points of the first and the last one are the same.
        normals[index[:, [0, -1]], 1] = 0.0
        for end in (index[0], index[-1]):
            normals[end] = normals[end].sum(axis=0) * [1.0, 0.0, 1.0]
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        faces = faces[np.linalg.norm(area, axis=1) > 1e-9]
        self.triangles, self.normals = points[faces], normals[faces]
        self.materials = ["paint"] * len(faces)

    @cached_property
    def _functions(self) -> dict[str, scipy.interpolate.PchipInterpolator]:
        return {
            name: scipy.interpolate.PchipInterpolator(*np.array(getattr(self.curves, name)).T)
            for name in ("deck", "roof", "plan")
        }

    def value(self, name: str, x: float) -> float:
        """Return a curve at x: the height of deck or roof [m], or the half width of the plan [m]."""
        f = self.frame
        station = np.interp(x, [f.rear, 0.0, f.wheelbase, f.front], [-1.0, 0.0, 1.0, 2.0])
        function = self._functions[name]
        value = float(function(np.clip(station, function.x[0], function.x[-1])))
        return value * f.half_width if name == "plan" else f.low + value * (f.high - f.low)

    def x(self, station: float) -> float:
        """Return x of a station [m]."""
        f = self.frame
        return float(np.interp(station, [-1.0, 0.0, 1.0, 2.0], [f.rear, 0.0, f.wheelbase, f.front]))

    def cabin(self, x: float, z: float) -> float:
        """Return the half width of the cabin [m]."""
        inner = self.value("plan", x) - self.curves.shoulder * self.frame.half_width
        return inner - self.curves.tumblehome * max(z - self.value("deck", x), 0.0)

    def side(self, x: float, z: float) -> float:
        """Return the half width of the body at a point of its side view [m]."""
        points = self._section(x)
        # `interp` needs increasing heights: only the flank of the section, from the underside to the roof.
        rising = points[np.r_[True, np.diff(points[:, 1]) > 1e-9]]
        return float(np.interp(z, rising[:, 1], rising[:, 0]))

    def _section(self, x: float) -> Array:
        """Return the points (n, 2) of a cross-section: y and z, from the middle of the underside to that of the top."""
        f = self.frame
        wide, deck = self.value("plan", x), self.value("deck", x)
        roof = max(self.value("roof", x), deck)
        # The underside rises towards both ends.
        end = max((abs(x - 0.5 * f.wheelbase) - 0.5 * f.wheelbase) / max(f.front - f.wheelbase, -f.rear), 0.0)
        low = f.low + 0.10 * (deck - f.low) * end**2
        tall, sag = deck - low, _SAG * wide
        base = self.cabin(x, deck)
        top = self.cabin(x, roof)
        # Corners of the section, from the middle of the underside around the flank to the middle of the roof.
        corners = np.array([
            (0.0, low), (0.90 * wide, low), (0.985 * wide, low + 0.16 * tall), (wide, low + 0.60 * tall),
            (0.985 * wide, deck - 0.10 * tall), (base, deck - 0.3 * sag), (top, max(roof - sag, deck - 0.3 * sag)),
            (0.6 * top, roof), (0.0, roof),
        ])  # fmt: skip
        radii = [0.08, 0.10, 0.30, 0.14, 0.03, 0.10, 0.5]
        points = [corners[:1]]
        # Each corner is rounded by a quadratic Bézier curve, at most up to the middle of its edges.
        for before, corner, after, radius in zip(corners, corners[1:], corners[2:], radii, strict=False):
            ends = []
            for other in (before, after):
                length = float(np.linalg.norm(other - corner))
                ends.append(corner + (other - corner) * min(radius * f.half_width, 0.5 * length) / max(length, 1e-9))
            t = _CORNER
            curve = (1 - t) ** 2 * ends[0] + 2 * t * (1 - t) * corner + t**2 * ends[1]
            points += [points[-1][-1] + _STRAIGHT * (curve[0] - points[-1][-1]), curve]
        return np.concatenate([*points, points[-1][-1] + _STRAIGHT * (corners[-1] - points[-1][-1]), corners[-1:]])

    def _grid(self) -> Array:
        """Return the points (stations, points of a section, 3) of the left half."""
        f, c = self.frame, self.curves
        edge = min(c.edge * f.half_width, 0.2 * (f.front - f.rear))
        # Stations are close where roof, deck or plan change.
        x = np.linspace(f.rear + edge, f.front - edge, 500)
        change = sum(np.abs(np.gradient([self.value(name, float(v)) for v in x])) for name in ("deck", "roof", "plan"))
        share = np.cumsum(np.gradient(x) + change)
        stations = np.interp(np.linspace(share[0], share[-1], _STATIONS), share, x)
        # All sections have the same number of points, so that they form the rows of a grid.
        sections = {float(v): self._section(float(v)) for v in stations}
        rows = [np.column_stack((np.full(len(s), v), s)) for v, s in sections.items()]
        caps = []
        for index, sign, sweep, bulge in ((0, -1.0, c.sweep[0], c.bulge[0]), (-1, 1.0, c.sweep[1], c.bulge[1])):
            base = rows[index]
            middle = (base[:, 2].min() + base[:, 2].max()) / 2.0
            half = np.array([base[:, 1].max(), np.ptp(base[:, 2]) / 2.0])
            # The edge is a quarter of a circle; the face within it is filled with shrinking sections.
            angles = np.linspace(0.0, np.pi / 2, 6)[1:]
            rings = [(edge * np.sin(a), 1.0 - edge * (1.0 - np.cos(a)) / half) for a in angles]
            rings += [(edge, rings[-1][1] * part) for part in (0.88, 0.72, 0.5, 0.25, 0.0)]
            cap = []
            for ahead, scale in rings:
                ring = base.copy()
                ring[:, 0] += sign * ahead
                ring[:, 1] *= scale[0]
                ring[:, 2] = middle + (ring[:, 2] - middle) * scale[1]
                cap.append(ring)
            caps.append((cap, sign, middle, half, sweep, bulge))
        grid = np.stack([*caps[0][0][::-1], *rows, *caps[1][0]])
        for _, sign, middle, half, sweep, bulge in caps:
            # Round the end in plan and side view, from the wheel arch on.
            start, end = (f.wheelbase + f.arch, f.front) if sign > 0 else (-f.arch, f.rear)
            ramp = np.clip((grid[..., 0] - start) / min(end - start, -1e-6) if sign < 0
                           else (grid[..., 0] - start) / max(end - start, 1e-6), 0.0, 1.0) ** 2  # fmt: skip
            back = sweep * (grid[..., 1] / half[0]) ** 2.4 + bulge * np.abs((grid[..., 2] - middle) / half[1]) ** 2.4
            grid[..., 0] -= sign * f.half_width * ramp * np.minimum(back, 0.6)
        # Rounding of the ends may narrow the body: the grid gets its full width again.
        grid[..., 1] *= f.half_width / grid[..., 1].max()
        return grid

    # --- regions ---------------------------------------------------------------------------------------------------

    def cut(
        self, material: str | None, view: Sequence[float], shape: BaseGeometry, *, facing: float = 0.1, only: str = ""
    ) -> None:
        """Give a region another material, or cut it out.

        Args:
            material: material of the region; None cuts a hole.
            view: direction from which the region is drawn.
            shape: outline in the picture plane of that view, see :func:`seen`.
            facing: the least cosine between the normal of a triangle and the view.
            only: the material it is drawn on; on all if empty.
        """
        axes = picture_axes(view)
        normal = area_vectors(self.triangles)
        # Triangles that face the view; the threshold leaves out those that are seen at a grazing angle.
        visible = normal @ np.array(view) > facing * np.linalg.norm(normal, axis=1)
        if view in (FRONT, REAR):  # what lies in front of the driver, or behind
            visible &= (self.triangles[:, :, 0].mean(axis=1) - 0.5 * self.frame.wheelbase) * view[0] > 0
        if only:
            visible &= np.array([name == only for name in self.materials])
        flat = self.triangles @ axes.T
        candidates = np.flatnonzero(visible)
        shapely.prepare(shape)
        polygons = np.asarray(shapely.polygons(flat[candidates]))
        inside, touched = (np.asarray(f(shape, polygons)) for f in (shapely.covers, shapely.intersects))
        keep = np.ones(len(self.triangles), dtype=bool)
        pieces: list[tuple[Array, Array, str]] = []
        for index, polygon, whole in zip(candidates[touched], polygons[touched], inside[touched], strict=True):
            # Triangles inside of the outline change their material, those across its edge are divided.
            if whole and material is not None:
                self.materials[index] = material
                continue
            keep[index] = False
            a, b, c = flat[index]
            # Barycentric coordinates of the pieces in their triangle.
            basis = np.linalg.inv(np.stack([b - a, c - a], axis=1))
            parts = [] if whole else [(polygon.difference(shape), self.materials[index])]
            if material is not None:
                parts.append((polygon.intersection(shape), material))
            for part, name in parts:
                # A piece lies in its triangle and is wound like it; corners and normals are interpolated.
                w = (triangulate(part) - a) @ basis.T
                turned = np.linalg.det(w[:, 1:] - w[:, :1]) < 0
                w[turned] = w[turned, ::-1]
                corners, normals = (
                    array[index][0] + w[..., :1] * (array[index][1] - array[index][0])
                    + w[..., 1:] * (array[index][2] - array[index][0])
                    for array in (self.triangles, self.normals)
                )  # fmt: skip
                pieces.append((corners, normals, name))
        self.materials = [name for name, is_kept in zip(self.materials, keep, strict=True) if is_kept]
        self.triangles, self.normals = self.triangles[keep], self.normals[keep]
        if pieces:
            self.triangles = np.concatenate([self.triangles, *(corners for corners, _, _ in pieces)])
            self.normals = np.concatenate([self.normals, *(normals for _, normals, _ in pieces)])
            self.materials += [name for corners, _, name in pieces for _ in corners]

    def mesh(self) -> Mesh:
        """Return the left half as a mesh."""
        mesh = Mesh()
        names = np.array(self.materials)
        for name in sorted(set(self.materials)):
            mesh.add(name, self.triangles[names == name], self.normals[names == name])
        return mesh


def picture_axes(view: Sequence[float]) -> Array:
    """Return the two axes (2, 3) of the picture plane of a view; both are positive to the left, ahead and up."""
    if abs(view[2]) > 0.9:
        return np.array([[1.0, 0, 0], [0, 1.0, 0]])
    if view == LEFT:
        return np.array([[1.0, 0, 0], [0, 0, 1.0]])
    across = np.array([-view[1], view[0], 0.0]) * (1.0 if view[0] > 0 else -1.0)
    return np.stack([across, np.array([0, 0, 1.0])])


def seen(view: Sequence[float], points: Sequence[Sequence[float]], *, rounding: float = 0.0) -> BaseGeometry:
    """Return the outline of points of space in the picture plane of a view, with rounded corners."""
    shape: BaseGeometry = shapely.Polygon(np.array(points) @ picture_axes(view).T).buffer(0)
    if rounding:
        # Shrink, grow twice, shrink: rounds the convex and the concave corners.
        shape = shape.buffer(-rounding, quad_segs=4).buffer(2 * rounding, quad_segs=4).buffer(-rounding, quad_segs=4)
    return shape
