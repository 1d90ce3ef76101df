"""The box around a vehicle that behaviours keep clear of things: about its x axis, also without a URDF."""

from typing import NamedTuple, Protocol

from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.vehicles.outline import measure_outline


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


def front_of(vehicle: ShapedVehicle) -> float:
    """How far the front bumper is ahead of the rear axle [m]; see :func:`outline_of`."""
    return outline_of(vehicle).front
