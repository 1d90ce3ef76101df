"""Overlaps of props by the law of `world check`, fast enough to be drawn while a prop is dragged."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import shapely
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.editor.scene import Scene
from mirdrake.world_checks.overlaps import LEAST_DEPTH, Neighbours
from mirdrake.world_checks.separation import TOLERANCE, separate
from mirdrake.worlds.props import PlacedProp, make_primitive

MOST_MARKS = 200
"""Overlaps that are looked for."""

COARSE = 0.01
"""Accuracy of depths while a prop is dragged [m]; they are drawn in cm."""

_REACH = 0.5  # [m] around a moved prop, in which others are looked at


@dataclass(frozen=True)
class Mark:
    """An overlap of two props: their names, depth [m], and a point in the middle of it [m]."""

    names: tuple[str, str]
    depth: float
    x: float
    y: float


def load_machine_code() -> None:
    """Find the overlap of two boxes: the first one takes half a second, in which the machine code is loaded."""
    box = PlacedProp("box", make_primitive("box", (1.0, 1.0, 1.0)), RigidTransform())
    separate(box, box, tolerance=COARSE)


def mark_overlaps(scene: Scene) -> list[Mark]:
    """Return all overlaps of a scene."""
    return _marks(scene, scene.near, scene.near.pairs())


def mark_moved(scene: Scene, moved: Sequence[tuple[PlacedProp, float, float, float]]) -> list[Mark]:
    """Return the overlaps of props that are displaced, with each other and with those that are not.

    Args:
        scene: before the displacement.
        moved: props, displacement in x and y [m] and turn about their own origin [rad].
    """
    names = {placed.name for placed, *_ in moved}
    displaced = [_displaced(placed, dx, dy, turn) for placed, dx, dy, turn in moved]
    around = shapely.box(*shapely.total_bounds([placed.footprint for placed in displaced])).buffer(_REACH)
    others = [scene.world.props[index] for index in scene.near.touching(around)]
    near = Neighbours([*displaced, *(placed for placed in others if placed.name not in names)])
    return _marks(scene, near, (pair for pair in near.pairs() if pair[0] < len(displaced)), tolerance=COARSE)


def _displaced(placed: PlacedProp, dx: float, dy: float, turn: float) -> PlacedProp:
    x, y, z = placed.X_WP.translation()
    rotation = RollPitchYaw(0.0, 0.0, turn).ToRotationMatrix() @ placed.X_WP.rotation()
    return replace(placed, X_WP=RigidTransform(rotation, [x + dx, y + dy, z]))


def _marks(
    scene: Scene, near: Neighbours, pairs: Iterable[tuple[int, int]], *, tolerance: float = TOLERANCE
) -> list[Mark]:
    # Cheap tests come first: this runs after each edit, and nearly all pairs are only close to each other.
    rules, marks = scene.world.rules, list[Mark]()
    for a, b in pairs:
        first, second = near.props[a], near.props[b]
        if rules is not None and rules.may_overlap(first, second):
            continue
        if next(near.colliding(a, b), None) is None:
            continue
        depth = separate(first, second, tolerance=tolerance).depth
        # Depths below this are rounding of poses and touching faces, as those of props on a shelf.
        if depth > LEAST_DEPTH:
            shared = shapely.intersection(first.footprint, second.footprint)
            # Footprints that only touch have no centroid.
            middle = shapely.centroid(shared)
            x, y = (middle.x, middle.y) if not middle.is_empty else first.X_WP.translation()[:2]
            marks.append(Mark((first.name, second.name), depth, float(x), float(y)))
            if len(marks) >= MOST_MARKS:
                break
    return [mark for mark in marks if math.isfinite(mark.depth)]
