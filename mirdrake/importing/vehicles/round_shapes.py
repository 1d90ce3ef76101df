"""Round shapes about a joint axis: wheels, by their collision or visual shapes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.meshes.convert import MeshError, mesh_bounds
from mirdrake.importing.shape import Shape, Vector
from mirdrake.importing.vehicles.kinematics import Tree

ROUND = 0.1
"""Largest relative difference of two extents of a round shape, due to tread blocks, valves and coarse meshes."""

LARGEST = 100.0
"""Radius and width beyond which nothing is a wheel [m]."""

SPHERE_WIDTH = 0.4
"""Width over diameter of a wheel whose only shape is a sphere: between tyres of cars (0.33) and of models (0.5)."""

Bounds = tuple[Vector, Vector]
_ALONG = np.cos(np.deg2rad(10.0))


@dataclass(frozen=True)
class Round:
    """A shape that is round about the y axis of a frame W.

    Attributes:
        radius: [m].
        width: width along the axis [m].
        centre: centre in W [m].
        shape: what was measured.
        role: "collision" or "visual".
        width_from: origin of the width, if not the shape itself.
    """

    radius: float
    width: float
    centre: Vector
    shape: Shape
    role: str
    width_from: str = ""


def bounds_in(shape: Shape, X_FL: RigidTransform) -> Bounds | None:
    """Return the bounding box of a shape along the axes of a frame F; None if it has no size or no file."""
    if not np.isfinite(shape.size).all():
        return None
    try:
        lower, upper = mesh_bounds(replace(shape, X_LG=X_FL.multiply(shape.X_LG)))
    except MeshError:
        return None
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()) or (upper < lower).any():
        return None
    return lower, upper


def join_bounds(boxes: Iterable[Bounds | None]) -> Bounds | None:
    """Return the bounding box of boxes."""
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    return np.min([low for low, _ in known], axis=0), np.max([high for _, high in known], axis=0)


def find_rounds(tree: Tree, links: Iterable[str], X_MW: RigidTransform) -> list[Round]:
    """Return the round shapes of links that turn together, collision before visual, largest first.

    Args:
        tree: tree of the model.
        links: links that turn about the axis.
        X_MW: frame with its y axis along the joint's axis.
    """
    collisions: list[Round] = []
    visuals: list[Round] = []
    for name in links:
        link = tree.model.links[name]
        X_WL = X_MW.inverse().multiply(tree.poses[name])
        collisions += _rounds(link.collisions, X_WL, "collision")
        visuals += _rounds(link.visuals, X_WL, "visual")
    size: Callable[[Round], float] = lambda item: -item.radius  # noqa: E731
    collisions.sort(key=size)
    visuals.sort(key=size)
    return [_with_width(item, visuals) for item in (*collisions, *visuals)]


def _rounds(shapes: Iterable[Shape], X_WL: RigidTransform, role: str) -> list[Round]:
    rounds = []
    for shape in shapes:
        # The edges of a box may be equal by chance, so that a box is never round.
        if shape.kind in ("box", "plane"):
            continue
        X_WG = X_WL.multiply(shape.X_LG)
        # The axis of a cylinder is its z; it has to be along the axis y of the wheel.
        if shape.kind in ("cylinder", "capsule") and abs(X_WG.rotation().matrix()[1, 2]) > _ALONG:
            radius, length = shape.size[:2]
            width = length + (2.0 * radius if shape.kind == "capsule" else 0.0)
            if 0.0 < radius < LARGEST and 0.0 < width < LARGEST and np.isfinite(X_WG.translation()).all():
                rounds.append(Round(radius, width, X_WG.translation(), shape, role))
            continue
        # Any other shape is round if its extents across the axis are equal.
        box = bounds_in(shape, X_WL)
        if box is None:
            continue
        extent = box[1] - box[0]
        if (
            extent.min() > 0.0
            and extent.max() < LARGEST
            and abs(extent[0] - extent[2]) <= ROUND * max(extent[0], extent[2])
        ):
            radius = 0.25 * (extent[0] + extent[2])
            rounds.append(Round(float(radius), float(extent[1]), 0.5 * (box[0] + box[1]), shape, role))
    return rounds


def _with_width(item: Round, visuals: list[Round]) -> Round:
    """Return a sphere with the width of the largest visual, else of a typical wheel; other shapes unchanged."""
    if item.shape.kind != "sphere":
        return item
    flat = [look for look in visuals if look.shape.kind != "sphere" and 0.5 < look.radius / item.radius < 2.0]
    if flat:
        return replace(item, width=flat[0].width, width_from="the visual's width")
    return replace(item, width=2.0 * SPHERE_WIDTH * item.radius, width_from=f"{SPHERE_WIDTH:g} of the diameter")
