"""Collision shapes of bodies and their convex hulls, with errors for meshes that Drake cannot read."""

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId, Role, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from mirdrake.core.drake_errors import mesh_fault
from mirdrake.core.errors import ModelError

Array = NDArray[np.float64]

_SIGNS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)


def hull_points(inspector: SceneGraphInspector, geometry: GeometryId) -> Array | None:
    """Return the corners (n, 3) of the hull of a mesh or convex shape in its frame [m], None for other shapes.

    Raises:
        ModelError: Drake cannot read the mesh; it reads it only when the hull is needed.
    """
    try:
        hull = inspector.GetConvexHull(geometry)
    except RuntimeError as error:
        reason = f"Drake cannot read its mesh: {mesh_fault(str(error))}"
        raise ModelError(reason, where=f"shape '{inspector.GetName(geometry)}'") from None
    return None if hull is None else np.array([hull.vertex(index) for index in range(hull.num_vertices())])


def solids_of(plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody) -> list[GeometryId]:
    """Return the collision shapes of a body; its geometries without proximity properties do not collide."""
    shapes = plant.GetCollisionGeometriesForBody(body)
    return [shape for shape in shapes if inspector.GetProperties(shape, Role.kProximity) is not None]


def bounding_points(inspector: SceneGraphInspector, X_WF: RigidTransform, geometry: GeometryId) -> Array | None:
    """Return points (n, 3) in W that bound a shape of a frame F [m]; None for an unbounded one.

    They are the corners of its hull, or those of its bounding box.

    Raises:
        ModelError: as of :func:`hull_points`.
    """
    points = hull_points(inspector, geometry)
    if points is None:
        box = inspector.GetObbInGeometryFrame(geometry)
        if box is None:
            return None
        half = _SIGNS * np.asarray(box.half_width())
        points = half @ box.pose().rotation().matrix().T + box.pose().translation()
    X_WG = X_WF @ inspector.GetPoseInFrame(geometry)
    placed: Array = points @ X_WG.rotation().matrix().T + X_WG.translation()
    return placed
