"""Single elements of SDF files: versions, poses, shapes and materials; errors name ``file:line``."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.importing.gazebo_xml import XmlFiles
from mirdrake.importing.packages import Packages
from mirdrake.importing.sdf.colours import Rgba, colour_of
from mirdrake.importing.sdf.frames import Frame, Scope
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import make_pose, read_number, read_numbers

DEEPEST = 20
"""Largest nesting depth of models and includes."""

FARTHEST = 4.5e4
"""Largest coordinate [m]; the ground of a world is at most 100 km wide."""

SMALLEST, LARGEST = 1e-3, 1e4
"""Sides of a shape of a world [m]."""

HEIGHTMAP = "terrain is not imported; a grid of ground.relief can read its picture"
"""Reason for rejecting a heightmap as a shape."""

_MOST_POINTS = 400  # of an outline
_LARGEST_ANGLE = 1e6  # [rad]


def version_of(root: Element) -> tuple[int, ...]:
    """Return the version of SDF that a file states; 1.6 if it states none."""
    try:
        return tuple(int(part) for part in (root.get("version") or "1.6").split("."))
    except ValueError:
        return (1, 6)


def text_of(element: Element, path: str) -> str:
    """Return the stripped text of an element below another one; "" if there is none."""
    return (element.findtext(path) or "").strip()


def is_true(text: str) -> bool:
    """Return whether a text means true."""
    return text.strip().lower() in {"1", "true"}


def read_pose(element: Element | None, files: XmlFiles, version: tuple[int, ...]) -> tuple[RigidTransform, str]:
    """Return a ``<pose>`` and the name of the frame it is relative to; "" if it names none.

    Raises:
        ModelError: the pose does not consist of finite numbers, its quaternion is zero, or it is more than 45 km away.
    """
    if element is None:
        return RigidTransform(), ""
    where = files.where(element)
    # Before SDF 1.7 a pose named its frame by the attribute `frame`.
    relative = element.get("relative_to") or (element.get("frame") if version < (1, 7) else "") or ""
    if element.get("rotation_format", "euler_rpy") == "quat_xyzw":
        values = read_numbers(element.text, count=7, default=[0, 0, 0, 0, 0, 0, 1], where=where, what="<pose>")
        norm = float(np.linalg.norm(values[3:]))
        if norm < 1e-9:
            raise ModelError("<pose>: the quaternion is zero", where=where)
        x, y, z, w = values[3:] / norm
        X = RigidTransform(Quaternion(w, x, y, z), values[:3])
    else:
        values = read_numbers(element.text, count=6, default=[0.0] * 6, where=where, what="<pose>")
        angles = np.radians(values[3:]) if is_true(element.get("degrees", "")) else values[3:]
        if np.abs(angles).max() > _LARGEST_ANGLE:
            raise ModelError(f"<pose>: angle of {np.abs(angles).max():g} rad; at most 1e6 rad is allowed", where=where)
        X = make_pose(values[:3], angles)
    # Poses farther away come from damaged files or wrong units, and make numbers inaccurate.
    distance = float(np.abs(values[:3]).max())
    if distance > FARTHEST:
        raise ModelError(f"<pose>: {distance:g} m away; at most {FARTHEST:g} m is allowed", where=where)
    return X, relative


def read_placement(element: Element, include: Element | None, full: str, scope: Scope, files: XmlFiles) -> Frame:
    """Return the frame of a model.

    Args:
        element: its ``<model>``.
        include: the ``<include>`` whose pose and placement frame take precedence; None for none.
        full: full name of the model.
        scope: scope of the model or include.
        files: give the places.
    """
    pose = element.find("pose")
    if include is not None and include.find("pose") is not None:
        pose = include.find("pose")
    X, relative = read_pose(pose, files, scope.version)
    given = include.findtext("placement_frame") if include is not None else None
    spot = (given or element.get("placement_frame") or "").strip()
    placed = f"{full}::{spot}" if spot not in {"", "__model__"} else ""
    return Frame(X, scope.base(relative), files.where(include if include is not None else element), placed)


def read_frame(element: Element, files: XmlFiles, scope: Scope, *, default: str | None = None) -> Frame:
    """Return the frame of an element by its ``<pose>``; `default` is the full name of its base if the pose names none.

    Raises:
        ModelError: as of :func:`read_pose`.
    """
    X, relative = read_pose(element.find("pose"), files, scope.version)
    return Frame(X, default if default is not None and not relative else scope.base(relative), files.where(element))


@dataclass(frozen=True)
class ReadShape:
    """The geometry of a ``<visual>`` or ``<collision>``.

    Attributes:
        shape: without its pose; None if the geometry is empty or not supported.
        tag: tag of the geometry; "" if there is none.
        remark: why the shape is missing or differs from the source; "" for neither.
    """

    shape: Shape | None
    tag: str = ""
    remark: str = ""


def read_shape(element: Element, files: XmlFiles, packages: Packages, folder: Path, *, check_sizes: bool) -> ReadShape:
    """Return the geometry of a ``<visual>`` or ``<collision>``.

    Args:
        element: the visual or collision.
        files: give the places.
        packages: find meshes.
        folder: folder of the file.
        check_sizes: reject sides below 1 mm or above 10 km, and scales that leave nothing of a mesh. Without it, sizes
            are returned as written.

    Raises:
        ModelError: a size is missing, not a number, or not allowed.
    """
    geometry = element.find("geometry")
    inner = next(iter(geometry), None) if geometry is not None else None
    if geometry is None or inner is None or inner.tag in {"empty", "image"}:
        return ReadShape(None)
    where, tag = files.where(inner), inner.tag

    def size(name: str, count: int = 1) -> tuple[float, ...]:
        # Old versions of SDF have sizes as attributes.
        text = inner.findtext(name) if inner.find(name) is not None else inner.get(name)
        if text is None or not text.strip():
            raise ModelError(f"<{tag}> without <{name}>", where=where)
        values = read_numbers(text, count=count, default=[], where=where, what=f"<{name}>").tolist()
        # Sizes outside of this range come from millimetres or damaged files, and spoil contact and rendering.
        if check_sizes and not all(SMALLEST <= value <= LARGEST for value in values):
            worst = next(value for value in values if not SMALLEST <= value <= LARGEST)
            raise ModelError(f"{tag} with a side of {worst:g} m; allowed are 1 mm to 10 km", where=where)
        return tuple(values)

    # The frame of a cone is at its base in SDF; Drake has no cone with that frame.
    remark = ""
    if tag == "box":
        shape = Shape("box", size("size", 3))
    elif tag in {"cylinder", "capsule"}:
        shape = Shape(tag, (*size("radius"), *size("length")))
    elif tag == "cone":
        shape, remark = Shape("cylinder", (*size("radius"), *size("length"))), "a cylinder around it"
    elif tag == "sphere":
        shape = Shape("sphere", size("radius"))
    elif tag == "ellipsoid":
        shape = Shape("ellipsoid", size("radii", 3))
    elif tag == "plane":
        # An infinite plane keeps its edges as a hint for the size of the ground; its normal may be of any length.
        normal = read_numbers(inner.findtext("normal"), count=3, default=[0, 0, 1], where=where, what="<normal>")
        if not normal.any():
            raise ModelError("<plane>: its normal has no direction", where=where)
        edges = read_numbers(inner.findtext("size"), count=2, default=[0, 0], where=where, what="<size>")
        a, b, c = normal.tolist()
        shape = Shape("plane", tuple(edges.tolist()), scale=(a, b, c))
    elif tag == "mesh":
        shape, remark = _read_mesh(inner, files, packages, folder, check_scale=check_sizes)
    elif tag == "polyline":
        shape = _read_outline([child for child in geometry if child.tag == "polyline"], files)
    else:
        return ReadShape(None, tag, HEIGHTMAP if tag == "heightmap" else f"<{tag}> is not supported")
    return ReadShape(shape, tag, remark)


def _read_mesh(
    element: Element, files: XmlFiles, packages: Packages, folder: Path, *, check_scale: bool
) -> tuple[Shape, str]:
    """Return a mesh shape, and a remark if its file is missing or not at its address."""
    where, address = files.where(element), text_of(element, "uri") or (element.get("filename") or "")
    scale = read_numbers(element.findtext("scale"), count=3, default=[1.0] * 3, where=where, what="<scale>")
    if check_scale and not np.all((np.abs(scale) > 1e-9) & (np.abs(scale) < 1e9)):
        raise ModelError(f"<scale> '{text_of(element, 'scale')}'; allowed are factors of 1e-9 to 1e9", where=where)
    path, remark = packages.resolve(address, folder=folder) if address else (None, "it has no <uri>")
    a, b, c = scale.tolist()
    submesh, center = text_of(element, "submesh/name"), is_true(text_of(element, "submesh/center"))
    return Shape("mesh", mesh=path, address=address, scale=(a, b, c), submesh=submesh, center=center), remark


def _read_outline(elements: list[Element], files: XmlFiles) -> Shape:
    """Return extruded outlines, those within others as holes: kind polyline, size (height,) [m].

    The area is in `submesh` as WKT.
    """
    area: shapely.Geometry = shapely.Polygon()
    heights = []
    for element in elements:
        where = files.where(element)
        points = [
            read_numbers(point.text, count=2, default=[], where=files.where(point), what="<point>")
            for point in element.findall("point")
        ]
        if not 3 <= len(points) <= _MOST_POINTS or min(map(len, points)) < 2:
            raise ModelError(f"<polyline> of {len(points)} points; 3 to {_MOST_POINTS} are allowed", where=where)
        if max(float(np.abs(point).max()) for point in points) > FARTHEST:
            raise ModelError(f"<polyline> reaches further than {FARTHEST:g} m", where=where)
        # Even-odd rule: an outline within another one is a hole.
        area = shapely.symmetric_difference(area, shapely.make_valid(shapely.Polygon(points)))
        heights.append(read_number(element.findtext("height"), where=where, what="<height>") or 1.0)
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and part.area > SMALLEST**2]
    if not parts or not SMALLEST <= max(heights) <= LARGEST:
        where = files.where(elements[0])
        raise ModelError("<polyline> encloses no area, or its height is not 1 mm to 10 km", where=where)
    return Shape("polyline", (max(heights),), submesh=shapely.MultiPolygon(parts).wkt)


def read_colour(element: Element | None) -> Rgba | None:
    """Return the colour of a ``<material>``; None if it has none that is understood."""
    if element is None:
        return None
    for key in ("diffuse", "ambient"):
        try:
            values = [float(word) for word in text_of(element, key).split()]
        except ValueError:
            continue
        if len(values) in (3, 4) and all(0.0 <= value <= 1.0 for value in values):
            a, b, c, d = (*values, 1.0)[:4]
            return (a, b, c, d)
    return colour_of(text_of(element, "script/name") or (element.text or "").strip())


def read_mu(element: Element, files: XmlFiles) -> float | None:
    """Return the friction coefficient of a ``<collision>``; None if it states none.

    Raises:
        ModelError: the coefficient is not a number.
    """
    for path in ("surface/friction/ode/mu", "surface/friction/bullet/friction"):
        value = read_number(element.findtext(path), where=files.where(element), what="<mu>")
        if value is not None:
            return value
    return None


def model_file(folder: Path) -> Path | None:
    """Return the SDF file of a model folder: that of the newest version its model.config names; None without one."""
    config = folder / "model.config"
    if config.is_file():
        # The newest version that exists, as Gazebo chooses.
        named: dict[tuple[int, ...], Path] = {}
        for entry in XmlFiles().parse(config).findall("sdf"):
            try:
                version = tuple(int(part) for part in entry.get("version", "1.0").split("."))
            except ValueError:
                version = (0,)
            named[version] = folder / (entry.text or "").strip()
        newest = next((path for _, path in sorted(named.items(), reverse=True) if path.is_file()), None)
        if newest is not None:
            return newest
    return folder / "model.sdf" if (folder / "model.sdf").is_file() else None
