"""Collision shapes of a vehicle, measured on its URDF: convex parts and their bounding box."""

from collections.abc import Collection, Mapping
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Convex, Cylinder, Mesh, Shape, Sphere
from pydrake.multibody.tree import BodyIndex

from mirdrake.core.hulls import solids_of
from mirdrake.vehicles.parse import parse_urdf

Array = NDArray[np.float64]

_CIRCLE = 32  # corners of a circle


class Outline(NamedTuple):
    """Bounding box of all collision shapes of a vehicle, in its frame B [m]."""

    rear: float
    front: float
    right: float
    left: float
    bottom: float
    top: float


def measure_outline(urdf: str, *, packages: Mapping[str, str], base_link: str) -> Outline | None:
    """Return the bounding box of the collision shapes of a URDF with all joints at zero, or None without shapes.

    It is exact for axis-aligned boxes and for wheels; other shapes are replaced by their oriented bounding boxes. Half
    spaces are ignored.

    Args:
        urdf: text without xacro.
        packages: folder of each package by name.
        base_link: link whose frame is B.

    Raises:
        ModelError: Drake cannot read the text.
    """
    shapes = _measure(urdf, tuple(sorted(packages.items())), base_link)
    if not shapes:
        return None
    points = np.hstack([shape.box for shape in shapes])
    (rear, right, bottom), (front, left, top) = points.min(axis=1).tolist(), points.max(axis=1).tolist()
    return Outline(rear, front, right, left, bottom, top)


def measure_parts(
    urdf: str, *, packages: Mapping[str, str], base_link: str, wheels: Collection[str]
) -> tuple[tuple[Array, bool], ...]:
    """Return the collision shapes of a URDF as convex parts, with all joints at zero; half spaces are ignored.

    Args:
        urdf: text without xacro.
        packages: folder of each package by name.
        base_link: link whose frame is B.
        wheels: names of the joints that the wheels turn about.

    Returns:
        of each part points whose convex hull it is (n, 3), in B [m], and whether it belongs to a wheel. What is round
        is a polygon around it, at most 0.5 % too wide.

    Raises:
        ModelError: Drake cannot read the text.
    """
    shapes = _measure(urdf, tuple(sorted(packages.items())), base_link)
    return tuple((shape.points, not shape.joints.isdisjoint(wheels)) for shape in shapes)


class _Shape(NamedTuple):
    """A collision shape."""

    points: Array
    """whose convex hull it is (n, 3), in B [m]"""
    box: Array
    """corners of its oriented box (3, 8), in B [m]"""
    joints: frozenset[str]
    """names of the joints that its body is the child of"""


@lru_cache(maxsize=16)
def _measure(urdf: str, packages: tuple[tuple[str, str], ...], base_link: str) -> tuple[_Shape, ...]:
    plant, scene_graph, _ = parse_urdf(urdf, packages=dict(packages), where_line=str)
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    # The outline is measured without the rest of the model, in the frame of base_link with all joints at zero.
    base = plant.GetFrameByName(base_link)
    joints: dict[int, set[str]] = {}
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        joints.setdefault(int(joint.child_body().index()), set()).add(joint.name())
    signs, shapes = np.array(list(product((-1.0, 1.0), repeat=3))), []
    # Body 0 is the world.
    for number in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(number))
        X_BL = plant.CalcRelativeTransform(context, base, body.body_frame())
        for geometry in solids_of(plant, inspector, body):
            # The box bounds every shape; only meshes and primitives with known points give a tighter outline.
            box = inspector.GetObbInGeometryFrame(geometry)
            if box is None:
                continue
            X_BG = X_BL @ inspector.GetPoseInFrame(geometry)
            corners = (X_BG @ box.pose()).multiply((signs * box.half_width()).T)
            points = _points_of(inspector.GetShape(geometry))
            mine = corners.T if points is None else X_BG.multiply(points.T).T
            shapes.append(_Shape(mine, corners, frozenset(joints.get(number, ()))))
    return tuple(shapes)


def _points_of(shape: Shape) -> Array | None:
    """Return points (n, 3) [m] whose convex hull is a shape, in its frame; None for shapes replaced by their box."""
    angle = 2.0 * np.pi * np.arange(_CIRCLE) / _CIRCLE
    # A polygon around the circle: 1 / cos(π / n) makes its sides touch the circle from outside.
    circle = np.column_stack((np.cos(angle), np.sin(angle))) / np.cos(np.pi / _CIRCLE)
    if isinstance(shape, Cylinder):
        ends = (-0.5 * shape.length(), 0.5 * shape.length())
        return np.vstack([np.column_stack((shape.radius() * circle, np.full(_CIRCLE, z))) for z in ends])
    if isinstance(shape, Sphere):
        tilts = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _CIRCLE // 2 + 1)
        rings = [np.column_stack((np.cos(tilt) * circle, np.full(_CIRCLE, np.sin(tilt)))) for tilt in tilts]
        return np.asarray(shape.radius() * np.vstack(rings))
    if isinstance(shape, Convex | Mesh):
        hull = shape.GetConvexHull()
        return np.array([hull.vertex(index) for index in range(hull.num_vertices())])
    return None
