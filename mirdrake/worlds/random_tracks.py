"""Random closed tracks: corners of a random polygon, rounded by arcs with clothoids at their ends.

The corners are at equal steps of the angle about the origin, with random deviations, and at random distances from it,
so that the polygon is star-shaped and does not cross itself. Each corner is rounded by an arc with transitions; the
rest of each side is straight, so the track closes exactly. An attempt is repeated with other numbers if a corner does
not fit between its neighbours with the least radius, or if two parts of the track are too near to one another.

The tangent length of a corner, from the corner to the start of its rounding, is proportional to its radius R: a
rounding of R = 1 that starts at the origin along x and ends at (x, y) after a turn by a has x - y / tan(a).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from pydantic import Field, model_validator

from mirdrake.core.digest import digest
from mirdrake.core.errors import WorldError
from mirdrake.core.yaml_io import Angle, Length, Schema
from mirdrake.worlds.pieces import Array, Piece, Placement, advance
from mirdrake.worlds.segments import ArcSpec

ATTEMPTS = 500
"""Polygons that are tried."""

_STRAIGHTEST = math.radians(8.0)  # corners that turn less are left out
_SIDE_SHARE = 0.47  # part of a side that the rounding of a corner may take
_STEP = 1.0  # [m] spacing of the points at which distances are checked


class RandomTrackSpec(Schema):
    """A random closed track, which depends on the seed of the world and the name of the track."""

    length: Length = Field(ge=50.0, le=20_000.0, description="length of the centre line [m]")
    corners: int = Field(9, ge=3, le=60, description="corners of the polygon that is rounded [-]")
    min_radius: Length = Field(8.0, ge=1.0, le=1e4, description="smallest radius [m]")
    max_radius: Length = Field(40.0, ge=1.0, le=1e4, description="largest radius [m]")
    irregularity: float = Field(
        0.5, ge=0.0, le=0.9, description="variation of the distances of the corners from the middle, as a share [-]"
    )
    transition: Angle = Field(
        math.radians(20.0), ge=0.0, le=1.5, description="angle of the clothoid at each end of a bend, at most [rad]"
    )
    gap: Length = Field(6.0, ge=0.0, le=1e3, description="least distance of the centre line from other parts [m]")
    seed: int | None = Field(None, ge=0, description="of this track; by default that of the world [-]")

    @model_validator(mode="after")
    def _radii(self) -> "RandomTrackSpec":
        if self.min_radius > self.max_radius:
            raise ValueError(f"min_radius ({self.min_radius:g} m) is above max_radius ({self.max_radius:g} m)")
        return self


def random_pieces(spec: RandomTrackSpec, *, seed: int, name: str) -> tuple[list[Piece], Placement]:
    """Return the pieces of a random closed track, and its start in the middle of its longest straight, facing along x.

    Args:
        spec: parameters.
        seed: seed of the world.
        name: name of the track; tracks of one world differ.

    Raises:
        WorldError: no track with these parameters was found.
    """
    own = seed if spec.seed is None else spec.seed
    # The name is part of the seed, so that two random tracks of a world differ.
    random = np.random.Generator(np.random.PCG64([own, int(digest(name)[:8], 16)]))
    for _ in range(ATTEMPTS):
        corners = _polygon(spec, random)
        pieces = _rounded(spec, corners, random)
        if pieces is None:
            continue
        scale = spec.length / math.fsum(piece.length for piece in pieces)
        pieces = [Piece(p.length * scale, p.start_curvature / scale, p.end_curvature / scale) for p in pieces]
        sharpest = max(max(abs(p.start_curvature), abs(p.end_curvature)) for p in pieces)
        # Checked after the scaling, which changes the radii.
        if sharpest * spec.min_radius <= 1.0 + 1e-9 and _has_gaps(pieces, spec.gap):
            return pieces, (0.0, 0.0, 0.0)
    raise WorldError(
        f"no random track was found in {ATTEMPTS} attempts; increase length, or reduce corners, min_radius, "
        "irregularity or gap"
    )


def _polygon(spec: RandomTrackSpec, random: np.random.Generator) -> Array:
    """Return the corners of a random star-shaped polygon, anticlockwise (n, 2) [m]."""
    count = spec.corners
    angles = (np.arange(count) + random.uniform(-0.35, 0.35, count)) * (2.0 * math.pi / count)
    distances = random.uniform(1.0 - spec.irregularity, 1.0 + spec.irregularity, count)
    points = distances[:, np.newaxis] * np.column_stack((np.cos(angles), np.sin(angles)))
    around = float(np.hypot(*(points - np.roll(points, 1, axis=0)).T).sum())
    # A little longer than wanted, because rounding shortens the polygon; the pieces are scaled afterwards.
    result: Array = points * (1.1 * spec.length / around)
    return result


def _rounded(spec: RandomTrackSpec, corners: Array, random: np.random.Generator) -> list[Piece] | None:
    """Return the pieces along a rounded polygon; None if a corner is too tight."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths, headings = np.hypot(*sides.T), np.arctan2(sides[:, 1], sides[:, 0])
    turns = [math.remainder(b - a, 2.0 * math.pi) for a, b in zip(np.roll(headings, 1), headings, strict=True)]
    wanted = random.uniform(spec.min_radius, spec.max_radius, len(corners))
    bends: list[list[Piece]] = []
    tangents: list[float] = []
    for index, (turn, radius) in enumerate(zip(turns, wanted.tolist(), strict=True)):
        # Nearly straight corners need huge radii for their length, nearly reversed ones an infinite tangent length.
        if abs(turn) < _STRAIGHTEST or abs(turn) > 0.9 * math.pi:
            return None
        transition = min(spec.transition, 0.45 * abs(turn))
        # Of radius 1: lengths are proportional to the radius, which is chosen below to fit.
        unit = ArcSpec(radius=1.0, angle=turn, transition=transition if transition > 1e-3 else 0.0).pieces()
        tangent = _tangent_length(unit)
        # Less than half of a side, so that a straight remains between two roundings.
        room = _SIDE_SHARE * min(float(lengths[index]), float(lengths[index - 1]))
        radius = min(radius, room / tangent)
        if radius < spec.min_radius:
            return None
        bends.append([Piece(p.length * radius, p.start_curvature / radius, p.end_curvature / radius) for p in unit])
        tangents.append(radius * tangent)
    straights = [
        float(lengths[index]) - tangents[index] - tangents[(index + 1) % len(corners)] for index in range(len(corners))
    ]
    return _joined(bends, straights)


def _joined(bends: Sequence[list[Piece]], straights: Sequence[float]) -> list[Piece]:
    """Return bends and straights in driving order, from the middle of the longest straight."""
    first = int(np.argmax(straights))
    order = [(first + 1 + index) % len(bends) for index in range(len(bends))]
    half = Piece(0.5 * straights[first], 0.0, 0.0)
    pieces = [half]
    for index in order:
        pieces += bends[index]
        if index != first:
            pieces.append(Piece(straights[index], 0.0, 0.0))
    return [*pieces, half]


def _tangent_length(pieces: Sequence[Piece]) -> float:
    """Return the distance from the start of a symmetric bend to the intersection of its end tangents [m]."""
    pose: Placement = (0.0, 0.0, 0.0)
    for piece in pieces:
        pose = advance(pose, piece)
    x, y, turn = pose
    return x - y / math.tan(turn)


def _has_gaps(pieces: Sequence[Piece], gap: float) -> bool:
    """Return whether parts of a closed line that are far along it are at least a distance [m] apart."""
    points, pose = [], (0.0, 0.0, 0.0)
    for piece in pieces:
        steps = max(1, math.ceil(piece.length / _STEP))
        for step in range(steps):
            share = step / steps
            end = piece.start_curvature + share * (piece.end_curvature - piece.start_curvature)
            points.append(
                advance(pose, Piece(share * piece.length, piece.start_curvature, end))[:2] if step else pose[:2]
            )
        pose = advance(pose, piece)
    ring: Any = shapely.linearrings(np.asarray(points))
    if not bool(shapely.is_valid(shapely.polygons(ring))):
        return False
    # A band as wide as the gap is a ring with one hole, unless parts of the track are nearer than the gap.
    band: Any = shapely.buffer(ring, 0.5 * gap)
    return gap == 0.0 or (band.geom_type == "Polygon" and len(band.interiors) == 1)
