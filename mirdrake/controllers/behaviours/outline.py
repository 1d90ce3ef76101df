"""Outline of a vehicle for obstacle avoidance: its volume, and the box about its x axis; also without a URDF."""

import math
from functools import lru_cache
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.vehicles.outline import measure_outline, measure_parts
from mirdrake.worlds.clearance import Part, Volume

_CLEARANCE = 0.06  # ground clearance of an ordinary car over its wheelbase


class ShapedVehicle(Protocol):
    """A vehicle as a driver uses it; with `urdf`, `packages` and `spec.base_link` it is measured."""

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
    """Return the box around a vehicle's collision shapes, with all joints at zero.

    See :func:`mirdrake.vehicles.outline.measure_outline`. A vehicle without a URDF, or without such shapes, is taken
    for an ordinary car: 0.3 wheelbases behind and 1.4 before its rear axle, 0.7 wide and 0.6 high.
    """
    urdf = getattr(vehicle, "urdf", None)
    if urdf:
        spec, packages = vehicle.spec, getattr(vehicle, "packages", {})  # type: ignore[attr-defined]
        box = measure_outline(urdf, packages=packages, base_link=spec.base_link)
        if box is not None:
            return Outline(box.rear, box.front, max(-box.right, box.left), box.top)
    length = vehicle.geometry.wheelbase
    return Outline(-0.3 * length, 1.4 * length, 0.35 * length, 0.6 * length)


def volume_of(vehicle: ShapedVehicle) -> Volume:
    """Return the volume of a vehicle's collision shapes, with all joints at zero, else of :func:`outline_of`."""
    urdf, radii = getattr(vehicle, "urdf", None), getattr(vehicle.geometry, "wheel_radii", ())
    radius = min(radii, default=math.inf)
    if urdf:
        spec, packages = vehicle.spec, getattr(vehicle, "packages", {})  # type: ignore[attr-defined]
        wheels = spec.joints.wheels.names()
        measured = _measured_volume(urdf, tuple(sorted(packages.items())), spec.base_link, frozenset(wheels), radius)
        if measured is not None:
            return measured
    # Vehicles without a model, such as stand-ins of tests, are boxes.
    box, floor = outline_of(vehicle), _CLEARANCE * vehicle.geometry.wheelbase
    sides = (box.rear, box.front), (-box.half_width, box.half_width), (floor, box.height)
    return Volume.of([Part(np.array(list(product(*sides))), False)], radius)


@lru_cache(maxsize=16)
def _measured_volume(
    urdf: str, packages: tuple[tuple[str, str], ...], base_link: str, wheels: frozenset[str], radius: float
) -> Volume | None:
    """Return the volume of the collision shapes of a URDF; None without such shapes. Several parts of a run ask for it.

    Args:
        urdf: text without xacro.
        packages: names and folders of packages.
        base_link: link whose frame is B.
        wheels: names of the joints that the wheels turn about.
        radius: of the smallest wheel [m].
    """
    parts = measure_parts(urdf, packages=dict(packages), base_link=base_link, wheels=wheels)
    return Volume.of([Part(*part) for part in parts], radius) if parts else None
