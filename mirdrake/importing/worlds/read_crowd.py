"""Populations of Gazebo: copies of a model in a region, in the forms of SDF 1.4 and of later versions."""

from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.importing.gazebo_xml import XmlFiles
from mirdrake.importing.sdf.elements import FARTHEST, read_pose, text_of
from mirdrake.importing.values import read_number, read_numbers
from mirdrake.importing.worlds.model import Crowd, SourceObject

Element = ElementTree.Element


def read_crowd(
    element: Element, obj: SourceObject, name: str, where: str, tree: XmlFiles, version: tuple[int, ...]
) -> Crowd:
    """Return a ``<population>``.

    Args:
        element: it.
        obj: one of it; it gets the pose of the population.
        name: name of the population.
        where: ``file:line``.
        tree: knows the lines.
        version: version of the file.

    Raises:
        ModelError: count, region or distribution are none that there can be.
    """

    def number(path: str, default: float) -> float:
        value = read_number(element.findtext(path), where=where, what=f"<{path}>")
        if value is not None and abs(value) > FARTHEST:
            raise ModelError(f"<{path}> of {value:g}; at most {FARTHEST:g} is allowed", where=where)
        return default if value is None else value

    def numbers(path: str, count: int, default: list[float]) -> list[float]:
        text = element.findtext(path)
        return read_numbers(text, count=count, default=default, where=where, what=f"<{path}>").tolist()  # type: ignore[no-any-return]

    obj.X_WM, _ = read_pose(element.find("pose"), tree, version)
    kind = text_of(element, "distribution/type") or text_of(element, "distribution") or "random"
    crowd = Crowd(name, obj, kind, int(number("model_count", 1)), where=where)
    # SDF 1.4 has a region with corners, later versions a pose and a size.
    old = element.find("region") is not None  # as SDF 1.4 had it: corners of a box instead of pose and size
    low = numbers("region/cuboid/min", 3, [0.0] * 3)
    if kind == "grid":
        top = "region/cuboid" if old else "distribution"
        crowd.grid = (int(number(f"{top}/cols", 1)), int(number(f"{top}/rows", 1)))
        x, y, _ = numbers(f"{top}/step", 3, [0.5, 0.5, 0.0])
        crowd.step, crowd.count = (x, y), crowd.grid[0] * crowd.grid[1]
        if old:  # it begins in the corner
            move = np.array([x * (crowd.grid[0] - 1), y * (crowd.grid[1] - 1), 0.0]) / 2.0
            obj.X_WM = RigidTransform(low + move)
    elif old and element.find("region/cylinder") is not None:
        obj.X_WM = RigidTransform(np.array(numbers("region/cylinder/center", 3, [0.0] * 3)))
        crowd.radius = number("region/cylinder/radius", 1.0)
    elif old:
        # Corners of the box become its edges and the middle of its floor.
        edges = np.array(numbers("region/cuboid/max", 3, [1.0] * 3)) - low
        obj.X_WM = RigidTransform(low + np.array([*edges[:2], 0.0]) / 2.0)
        crowd.box = (float(edges[0]), float(edges[1]), float(edges[2]))
    elif element.find("cylinder") is not None:
        crowd.radius = number("cylinder/radius", 1.0)
    else:
        a, b, c = numbers("box/size", 3, [1.0] * 3)
        crowd.box = (a, b, c)
    # Each copy becomes a body of the plant: thousands cannot be simulated.
    if not 1 <= crowd.count <= 5000:
        raise ModelError(f"population of {crowd.count}; 1 to 5000 are allowed", where=where)
    if min([*(crowd.box or ())[:2], *([crowd.radius] if crowd.radius is not None else [])], default=1.0) < 1e-3:
        raise ModelError("population in a region without area", where=where)
    if kind not in {"random", "uniform", "grid", "linear-x", "linear-y", "linear-z"}:
        raise ModelError(f"distribution '{kind}' is not understood", where=where)
    return crowd
