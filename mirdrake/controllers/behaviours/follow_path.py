"""Paths given as points: a track of straights, with arcs in its corners."""

import math
from collections.abc import Sequence
from itertools import pairwise

from mirdrake.core.errors import ConfigError
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.tracks import Track


def track_through(points: Sequence[tuple[float, float]], *, radius: float) -> Track:
    """An open track along a polyline, its corners rounded by arcs.

    Args:
        points: x, y in the world (2 or more) [m].
        radius: of the arcs [m]; smaller where the straights between corners are too short: each corner has half of the
            straight to the next one.

    Raises:
        ConfigError: fewer than two points, two in one place, or a corner that turns back on itself.
    """
    if len(points) < 2:
        raise ConfigError(f"points: a path needs at least two, got {len(points)}")
    legs, headings = [], []
    for number, ((x0, y0), (x1, y1)) in enumerate(pairwise(points)):
        legs.append(math.hypot(x1 - x0, y1 - y0))
        headings.append(math.atan2(y1 - y0, x1 - x0))
        if legs[-1] < 1e-6:
            raise ConfigError(f"points: {number} and {number + 1} are in the same place, ({x0:g}, {y0:g}) m; drop one")
    turns = [math.remainder(b - a, 2.0 * math.pi) for a, b in pairwise(headings)]
    cuts = [0.0]  # how much of the straights a corner takes away [m]
    for number, turn in enumerate(turns):
        if abs(turn) > math.radians(170.0):
            raise ConfigError(f"points: the path turns back on itself at point {number + 1}; a car needs a wider turn")
        room = min(
            legs[number] * (1.0 if number == 0 else 0.5), legs[number + 1] * (1.0 if number == len(turns) - 1 else 0.5)
        )
        cuts.append(min(radius * math.tan(0.5 * abs(turn)), room))
    cuts.append(0.0)
    pieces = []
    for number, leg in enumerate(legs):
        straight = leg - cuts[number] - cuts[number + 1]
        if straight > 1e-9:
            pieces.append(Piece(straight, 0.0, 0.0))
        if number < len(turns) and abs(turns[number]) > 1e-9:
            curvature = math.copysign(math.tan(0.5 * abs(turns[number])) / cuts[number + 1], turns[number])
            pieces.append(Piece(turns[number] / curvature, curvature, curvature))
    return Track(pieces, start=(*points[0], headings[0]), closed=False, name="path")
