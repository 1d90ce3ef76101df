"""The box around a vehicle's collision shapes, measured on its URDF."""

from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Role
from pydrake.multibody.tree import BodyIndex

from mirdrake.vehicles.parse import parse_urdf


class Outline(NamedTuple):
    """The box around all collision shapes of a vehicle, in its frame B [m]."""

    rear: float
    front: float
    right: float
    left: float
    bottom: float
    top: float


def measure_outline(urdf: str, *, packages: Mapping[str, str], base_link: str) -> Outline | None:
    """The box around the collision shapes of a URDF, all joints at zero; None if it has no such shape.

    Exact for boxes along the axes and for wheels; of other shapes their oriented boxes count. Half spaces have no end
    and do not count.

    Args:
        urdf: text without xacro.
        packages: folder of each package by name.
        base_link: link whose frame is B.

    Raises:
        ModelError: Drake cannot read the text.
    """
    return _measure(urdf, tuple(sorted(packages.items())), base_link)


@lru_cache(maxsize=16)
def _measure(urdf: str, packages: tuple[tuple[str, str], ...], base_link: str) -> Outline | None:
    plant, scene_graph, _ = parse_urdf(urdf, packages=dict(packages), where_line=str)
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    base = plant.GetFrameByName(base_link)
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    corners = []
    for number in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(number))
        X_BL = plant.CalcRelativeTransform(context, base, body.body_frame())
        for geometry in plant.GetCollisionGeometriesForBody(body):
            box = inspector.GetObbInGeometryFrame(geometry)
            if box is None or inspector.GetProperties(geometry, Role.kProximity) is None:
                continue
            X_BO = X_BL @ inspector.GetPoseInFrame(geometry) @ box.pose()
            corners.append(X_BO.multiply((signs * box.half_width()).T))
    if not corners:
        return None
    points = np.hstack(corners)
    (rear, right, bottom), (front, left, top) = points.min(axis=1).tolist(), points.max(axis=1).tolist()
    return Outline(rear, front, right, left, bottom, top)
