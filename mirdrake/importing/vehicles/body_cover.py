"""Share of a car's plan view that shapes cover, and the size of a typical body."""

from collections.abc import Iterable

import numpy as np
import shapely
from pydrake.math import RigidTransform

from mirdrake.importing.shape import Shape
from mirdrake.importing.vehicles.car import Layout
from mirdrake.importing.vehicles.round_shapes import Bounds, bounds_in
from mirdrake.vehicles.estimates import estimate

LARGEST = (3.0, 2.5, 2.0)
"""Length, width and height of a car over its wheelbase, beyond which shapes are flags, beams or scenery."""

COVERED = 0.3
"""Share of wheelbase x track that a body covers at least, seen from above; masts, sensors and plates cover less."""

_NEAR = 0.02  # of the wheelbase, between shapes that are connected
_INVISIBLE = 0.05  # opacity of shapes that are ignored


def body_boxes(shapes: Iterable[Shape], layout: Layout) -> list[Bounds]:
    """Return the bounding boxes in base_link of visible shapes that are not larger than a car."""
    limits = np.array(LARGEST) * layout.wheelbase
    opaque = (shape for shape in shapes if shape.rgba is None or shape.rgba[3] >= _INVISIBLE)
    # Only shapes of a plausible size count: a ground plane or a sky box is not a body.
    boxes = [bounds_in(shape, RigidTransform()) for shape in opaque]
    return [box for box in boxes if box is not None and (box[1] - box[0] <= limits).all()]


def plan_cover(boxes: Iterable[Bounds], layout: Layout) -> float:
    """Return the share of wheelbase x track that boxes cover in the plan view.

    Touching boxes count with their common convex outline, so that the tubes of a frame cover the area between them.
    """
    side, near = 0.5 * min(layout.tracks), _NEAR * layout.wheelbase
    plan = shapely.box(0.0, -side, layout.wheelbase, side)
    areas = [shapely.box(*low[:2], *high[:2]) for low, high in boxes]
    groups = shapely.get_parts(shapely.union_all([area.buffer(0.5 * near, join_style="mitre") for area in areas]))
    outlines = []
    for group in groups:
        members = [area for area in areas if area.intersects(group)]
        outlines.append(shapely.union_all(members).convex_hull)
    return float(shapely.union_all(outlines).intersection(plan).area / plan.area)


def usual_bounds(layout: Layout) -> Bounds:
    """Return the bounding box of a typical body in base_link, from wheelbase, track and wheels."""
    usual = estimate(
        mass=1.0,
        wheelbase=layout.wheelbase,
        track=sum(layout.tracks) / 2.0,
        wheel_radius=sum(layout.radii) / 2.0,
        wheel_width=sum(layout.widths) / 2.0,
    )
    middle, half = layout.wheelbase / 2.0, np.array([usual.length, usual.width]) / 2.0
    lower = np.array([middle - half[0], -half[1], usual.ground_clearance])
    upper = np.array([middle + half[0], half[1], usual.height])
    return lower, upper
