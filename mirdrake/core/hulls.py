"""Convex hulls of shapes, with errors for meshes that Drake cannot read."""

from pydrake.geometry import GeometryId, PolygonSurfaceMesh, SceneGraphInspector

from mirdrake.core.errors import ModelError


def read_hull(inspector: SceneGraphInspector, geometry: GeometryId) -> PolygonSurfaceMesh | None:
    """Return the convex hull of a mesh or convex shape in its frame, None for other shapes.

    Raises:
        ModelError: Drake cannot read the mesh; it reads it only when the hull is needed.
    """
    try:
        return inspector.GetConvexHull(geometry)
    except RuntimeError as error:
        reason = " ".join(str(error).split()).rpartition(": ")[2][:200]
        raise ModelError(f"shape '{inspector.GetName(geometry)}': Drake cannot read its mesh: {reason}") from None
