"""The box around a vehicle's collision shapes, measured on its URDF."""

from functools import lru_cache
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from pydrake.geometry import CalcObb, HalfSpace, Role
from pydrake.multibody.tree import BodyIndex

from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.vehicles.parse import parse_urdf


class ShapedVehicle(Protocol):
    """What is needed of a vehicle; one that also has `urdf`, `packages` and `spec.base_link` is measured."""

    @property
    def geometry(self) -> SteeringGeometry:
        """Lengths and steering limits."""


class Outline(NamedTuple):
    """A box about the x axis of a vehicle's frame B, in B.

    Attributes:
        rear: x of its rear end [m].
        front: x of its front end [m].
        half_width: half of its width [m].
        height: of its top over B [m].
    """

    rear: float
    front: float
    half_width: float
    height: float


def outline_of(vehicle: ShapedVehicle) -> Outline:
    """The box around a vehicle's collision shapes, all joints at zero.

    Exact for boxes along the axes and for wheels; of other shapes their oriented boxes count. A vehicle without a URDF
    is taken for an ordinary car: 0.3 wheelbases behind and 1.4 before its rear axle, 0.7 wide and 0.6 high.
    """
    urdf = getattr(vehicle, "urdf", None)
    if urdf:
        packages = tuple(sorted(getattr(vehicle, "packages", {}).items()))
        measured = _measure(urdf, packages, vehicle.spec.base_link)  # type: ignore[attr-defined]
        if measured is not None:
            return measured
    length = vehicle.geometry.wheelbase
    return Outline(-0.3 * length, 1.4 * length, 0.35 * length, 0.6 * length)


def front_of(vehicle: ShapedVehicle) -> float:
    """How far the front bumper is ahead of the rear axle [m]; see :func:`outline_of`."""
    return outline_of(vehicle).front


@lru_cache(maxsize=16)
def _measure(urdf: str, packages: tuple[tuple[str, str], ...], base_link: str) -> Outline | None:
    """The box of a URDF text, None if it has no collision shape."""
    plant, scene_graph, _ = parse_urdf(urdf, packages=dict(packages), where_line=str)
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    base = plant.GetFrameByName(base_link)
    corners = []
    for number in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(number))
        X_BL = plant.CalcRelativeTransform(context, base, body.body_frame())
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            if inspector.GetProperties(geometry, Role.kProximity) is None or isinstance(shape, HalfSpace):
                continue
            box = CalcObb(shape)
            signs = np.array(list(product((-1.0, 1.0), repeat=3)))
            X_BO = X_BL.multiply(inspector.GetPoseInFrame(geometry)).multiply(box.pose())
            corners.append(X_BO.multiply((signs * box.half_width()).T))
    if not corners:
        return None
    points = np.hstack(corners)
    low, high = points.min(axis=1).tolist(), points.max(axis=1).tolist()
    return Outline(low[0], high[0], max(-low[1], high[1]), high[2])
