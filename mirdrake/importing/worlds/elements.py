"""Single elements of SDF files: numbers, poses, shapes and materials, each fault with its ``file:line``."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.importing.vehicles.gazebo_tags import colour_of
from mirdrake.importing.vehicles.model import Shape
from mirdrake.importing.vehicles.packages import Packages
from mirdrake.importing.vehicles.xml_lines import make_pose, parse_xml, read_number, read_numbers

Element = ElementTree.Element
SMALLEST, LARGEST = 1e-3, 1e4
"""Sides of a shape [m]."""

_WHY = {"heightmap": "terrain; the ground is a plane"}
_MOST_POINTS = 400  # of an outline

FARTHEST = 4.5e4
"""Largest coordinate [m]; the ground of a world is at most 100 km wide."""


class Tree:
    """The places of all elements that have been read."""

    def __init__(self) -> None:
        self._places: dict[Element, str] = {}

    def parse(self, path: Path) -> Element:
        """A file as a tree.

        Raises:
            ModelError: see :func:`mirdrake.importing.vehicles.xml_lines.parse_xml`.
        """
        root, places = parse_xml(path)
        self._places |= places
        return root

    def where(self, element: Element) -> str:
        """``file:line`` of an element."""
        return self._places.get(element, "")


def version_of(root: Element) -> tuple[int, ...]:
    """The version of the SDF language that a file says it is written in."""
    try:
        return tuple(int(part) for part in (root.get("version") or "1.6").split("."))
    except ValueError:
        return (1, 6)


def text_of(element: Element, path: str) -> str:
    """The text of an element below, without the space around it; "" if there is none."""
    return (element.findtext(path) or "").strip()


def truth(text: str) -> bool:
    """Whether a text says yes."""
    return text.strip().lower() in {"1", "true"}


def read_pose(element: Element | None, tree: Tree, version: tuple[int, ...]) -> tuple[RigidTransform, str]:
    """A ``<pose>``, and the name of the frame that it counts from; "" if it names none.

    Raises:
        ModelError: it is not made of finite numbers, or leads further than 45 km away.
    """
    if element is None:
        return RigidTransform(), ""
    where = tree.where(element)
    relative = element.get("relative_to") or (element.get("frame") if version < (1, 7) else "") or ""
    if element.get("rotation_format", "euler_rpy") == "quat_xyzw":
        values = read_numbers(element.text, count=7, default=[0, 0, 0, 0, 0, 0, 1], where=where, what="<pose>")
        norm = float(np.linalg.norm(values[3:]))
        if norm < 1e-9:
            raise ModelError(f"{where}: <pose>: its quaternion is zero")
        x, y, z, w = values[3:] / norm
        X = RigidTransform(Quaternion(w, x, y, z), values[:3])
    else:
        values = read_numbers(element.text, count=6, default=[0.0] * 6, where=where, what="<pose>")
        angles = np.radians(values[3:]) if truth(element.get("degrees", "")) else values[3:]
        if np.abs(angles).max() > 1e6:
            raise ModelError(f"{where}: <pose>: an angle of {np.abs(angles).max():g} rad makes no sense")
        X = make_pose(values[:3], angles)
    if np.abs(values[:3]).max() > FARTHEST:
        raise ModelError(f"{where}: <pose>: {np.abs(values[:3]).max():g} m away; worlds reach 45 km from their middle")
    return X, relative


def read_shape(element: Element, tree: Tree, models: Packages, folder: Path) -> tuple[Shape | None, str]:
    """The geometry of a ``<visual>`` or ``<collision>``, without its pose, and a remark.

    Args:
        element: the visual or collision.
        tree: knows the lines.
        models: find meshes.
        folder: of the file.

    Returns:
        the shape, or None if it is empty, unknown or a heightmap; and what there is to say about it, or "".

    Raises:
        ModelError: a size is missing, no number, or none that a shape can have.
    """
    geometry = element.find("geometry")
    if geometry is None:
        return None, ""
    inner = next(iter(geometry), None)
    if inner is None or inner.tag in {"empty", "image"}:
        return None, ""
    where = tree.where(inner)

    def size(tag: str, count: int = 1) -> tuple[float, ...]:
        text = inner.findtext(tag) if inner.find(tag) is not None else inner.get(tag)
        if text is None or not text.strip():
            raise ModelError(f"{where}: <{inner.tag}> without <{tag}>")
        values = read_numbers(text, count=count, default=[], where=where, what=f"<{tag}>")
        for value in values.tolist():
            if not SMALLEST <= value <= LARGEST:
                raise ModelError(f"{where}: {inner.tag} with a side of {value:g} m; allowed are 1 mm to 10 km")
        return tuple(values.tolist())

    if inner.tag == "box":
        shape = Shape("box", size("size", 3))
    elif inner.tag in {"cylinder", "capsule"}:
        shape = Shape(inner.tag, (*size("radius"), *size("length")))
    elif inner.tag == "cone":  # stands on its base; a cylinder around it
        shape = Shape("cylinder", (*size("radius"), *size("length")))
    elif inner.tag == "sphere":
        shape = Shape("sphere", size("radius"))
    elif inner.tag == "ellipsoid":
        shape = Shape("ellipsoid", size("radii", 3))
    elif inner.tag == "plane":
        normal = read_numbers(inner.findtext("normal"), count=3, default=[0, 0, 1], where=where, what="<normal>")
        if not normal.any():
            raise ModelError(f"{where}: <plane>: its normal has no direction")
        edges = read_numbers(inner.findtext("size"), count=2, default=[0, 0], where=where, what="<size>")
        a, b, c = normal.tolist()
        shape = Shape("plane", tuple(edges.tolist()), scale=(a, b, c))
    elif inner.tag == "mesh":
        return _mesh(inner, tree, models, folder)
    elif inner.tag == "polyline":
        shape = _outline([child for child in geometry if child.tag == "polyline"], tree)
    else:
        return None, _WHY.get(inner.tag, f"<{inner.tag}> is not understood")
    return shape, "a cylinder around it" if inner.tag == "cone" else ""


def _mesh(element: Element, tree: Tree, models: Packages, folder: Path) -> tuple[Shape, str]:
    where, address = tree.where(element), text_of(element, "uri") or (element.get("filename") or "")
    scale = read_numbers(element.findtext("scale"), count=3, default=[1.0] * 3, where=where, what="<scale>")
    if not np.all((np.abs(scale) > 1e-9) & (np.abs(scale) < 1e9)):
        raise ModelError(f"{where}: <scale> '{text_of(element, 'scale')}' leaves nothing of the mesh")
    path, remark = models.resolve(address, folder=folder) if address else (None, "it has no <uri>")
    a, b, c = scale.tolist()
    submesh, center = text_of(element, "submesh/name"), truth(text_of(element, "submesh/center"))
    return Shape("mesh", mesh=path, address=address, scale=(a, b, c), submesh=submesh, center=center), remark


def _outline(elements: list[Element], tree: Tree) -> Shape:
    """Outlines that are pulled up from z = 0, those within others as holes: kind polyline, size (height,) [m].

    The area stands as WKT in `submesh`.
    """
    area: shapely.Geometry = shapely.Polygon()
    heights = []
    for element in elements:
        where = tree.where(element)
        points = [
            read_numbers(point.text, count=2, default=[], where=tree.where(point), what="<point>")
            for point in element.findall("point")
        ]
        if not 3 <= len(points) <= _MOST_POINTS or min(map(len, points)) < 2:
            raise ModelError(f"{where}: <polyline> of {len(points)} points; 3 to {_MOST_POINTS} are allowed")
        if max(float(np.abs(point).max()) for point in points) > FARTHEST:
            raise ModelError(f"{where}: <polyline> reaches further than 45 km")
        area = shapely.symmetric_difference(area, shapely.make_valid(shapely.Polygon(points)))
        heights.append(read_number(element.findtext("height"), where=where, what="<height>") or 1.0)
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and part.area > SMALLEST**2]
    where = tree.where(elements[0])
    if not parts or not SMALLEST <= max(heights) <= LARGEST:
        raise ModelError(f"{where}: <polyline> encloses nothing; it needs an area, and a height of 1 mm to 10 km")
    return Shape("polyline", (max(heights),), submesh=shapely.MultiPolygon(parts).wkt)


def read_colour(element: Element | None) -> tuple[float, float, float, float] | None:
    """The colour of a ``<material>``; None if it has none that is understood."""
    if element is None:
        return None
    for key in ("diffuse", "ambient"):
        words = text_of(element, key).split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            continue
        if len(values) in (3, 4) and all(0.0 <= value <= 1.0 for value in values):
            a, b, c, d = (*values, 1.0)[:4]
            return (a, b, c, d)
    return colour_of(text_of(element, "script/name") or (element.text or "").strip())


def read_mu(element: Element, tree: Tree) -> float | None:
    """The friction coefficient of a ``<collision>``; None if it names none.

    Raises:
        ModelError: it is no number.
    """
    for path in ("surface/friction/ode/mu", "surface/friction/bullet/friction"):
        value = read_number(element.findtext(path), where=tree.where(element), what="<mu>")
        if value is not None:
            return value
    return None
