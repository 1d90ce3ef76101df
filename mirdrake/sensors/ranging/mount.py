"""Keys of all sensors that cast rays."""

from math import copysign, pi
from typing import TYPE_CHECKING, Any, ClassVar, Self

from pydantic import Field, model_validator
from pydrake.systems.framework import System

from mirdrake.core.yaml_io import Length
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.ranging.world import instance_bodies, ray_world

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

ROUNDED_TURN = 6.3
"""Full turn rounded to two digits [rad]: the largest allowed angle between first and last beam; shortened to 2π."""

MAX_RAYS = 1_000_000
"""Largest number of rays of a scan; each needs about 0.2 kB."""


class Ranging(SensorMount):
    """Keys of every sensor that measures distances.

    Attributes:
        system: class of its system, called with the world of rays, the frame and the mount.
    """

    system: ClassVar[Any]

    near: Length = Field(gt=0, description="[m] smallest measurable distance")
    far: Length = Field(gt=0, description="[m] largest measurable distance")
    resolution: Length = Field(default=0.0, ge=0, description="[m] resolution; 0: continuous")
    noise: Length = Field(default=0.0, ge=0, description="[m] standard deviation of the range")
    lost_beams: float = Field(default=0.0, ge=0, lt=1, description="[-] probability that a beam has no return")
    own_vehicle: bool = Field(default=False, description="[-] whether its own vehicle gives returns")

    @model_validator(mode="after")
    def _near_before_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) must be below far ({self.far:g} m)")
        return self

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> System:
        """Return the system.

        It does not see its own vehicle, as it would be inside its housing and look through its mounting. With
        `own_vehicle` only the link of its frame is hidden, unless that is the vehicle's base.

        Raises:
            MissingDependencyError: embreex is not installed.
        """
        frame = parts.plant.GetFrameByName(self.frame, part.instance)
        carrier = int(frame.body().index())
        hidden: tuple[int, ...] = (carrier,) if carrier != int(part.base.index()) else ()
        if not self.own_vehicle:
            hidden = tuple(instance_bodies(parts.plant, part.instance))
        return self.system(ray_world(parts), frame, self, stream=stream, hidden=hidden)


class Turning(Ranging):
    """Keys of every rotating laser; it makes `rate` revolutions per second."""

    rolling: bool = Field(
        default=True, description="[-] whether each column is measured at its own time (rolling scan)"
    )


def ascending(a: float, b: float) -> tuple[float, float]:
    """Return the smaller and the larger of two values."""
    return min(a, b), max(a, b)


def within_turn(start: float, end: float) -> float:
    """Return the last angle of a fan of beams [rad], where a rounded full turn such as 6.28319 is shortened to 2π.

    Raises:
        ValueError: the fan is wider than a full turn.
    """
    if abs(end - start) > ROUNDED_TURN + 1e-9:
        raise ValueError(f"from {start:g} to {end:g} rad is more than a full turn of {2.0 * pi:.6g} rad")
    if abs(end - start) > 2.0 * pi + 1e-6:
        return start + copysign(2.0 * pi, end - start)
    return end


def check_rays(columns: int, rows: int) -> None:
    """Check that the rays of a scan fit into memory."""
    if columns * rows > MAX_RAYS:
        raise ValueError(
            f"{columns} columns x {rows} rows are {columns * rows} rays per scan and need about "
            f"{columns * rows * 2e-7:.1f} GB; allowed: at most {MAX_RAYS} rays"
        )
