"""Schemas of `powertrain.differential` of vehicle.yaml.

A kind states the largest difference of the torques of the two wheels that it sustains; below it the wheels turn
together. The law is in :mod:`mirdrake.plant.powertrain.differential`.
"""

from math import inf
from typing import Annotated, Literal

from pydantic import Field

from mirdrake.core.kinds import SelectedByKind
from mirdrake.core.yaml_io import Schema, Torque


class Differential(Schema):
    """Differential of an axle."""

    kind: str

    def locking(self, torque: float) -> float:
        """Return the largest difference of the torques of both wheels [N m]; each kind defines it.

        Args:
            torque: torque of the axle [N m], positive where it accelerates the vehicle.
        """
        raise NotImplementedError


class OpenDifferential(Differential):
    """Both wheels always get the same torque."""

    kind: Literal["open"] = "open"

    def locking(self, torque: float) -> float:
        """Return the largest difference of the torques; see the base class."""
        _ = torque
        return 0.0


class _Coupled(Differential):
    """Differential that couples the wheels, through half shafts that twist."""

    stiffness: Annotated[float, Field(gt=0)] = Field(
        default=4000.0, description="[N m/rad] torque of the coupling over the difference of the wheels' angles"
    )


class LockedDifferential(_Coupled):
    """Both wheels turn at the same speed."""

    kind: Literal["locked"] = "locked"

    def locking(self, torque: float) -> float:
        """Return the largest difference of the torques; see the base class."""
        _ = torque
        return inf


class ClutchDifferential(_Coupled):
    """Limited slip by clutches: preload, and a share of the torque that the ramps give."""

    kind: Literal["clutch"] = "clutch"
    preload: Torque = Field(default=0.0, ge=0, description="[N m] difference of the torques without a driving torque")
    drive_lock: float = Field(
        default=0.4, ge=0, le=1, description="[-] locking value: difference over sum of the torques when driving"
    )
    coast_lock: float = Field(default=0.2, ge=0, le=1, description="[-] the same when the motor brakes")

    def locking(self, torque: float) -> float:
        """Return the largest difference of the torques; see the base class."""
        return self.preload + abs(torque) * (self.drive_lock if torque >= 0.0 else self.coast_lock)


class TorqueSensingDifferential(_Coupled):
    """Limited slip by friction of gears: the wheel with more grip gets up to `bias_ratio` times the other's torque."""

    kind: Literal["torque_sensing"] = "torque_sensing"
    bias_ratio: float = Field(default=2.5, ge=1, description="[-] torque bias ratio: larger over smaller torque")
    preload: Torque = Field(default=0.0, ge=0, description="[N m] difference of the torques without a driving torque")

    def locking(self, torque: float) -> float:
        """Return the largest difference of the torques; see the base class.

        From T1 = B T2 and T1 + T2 = T the difference is T (B - 1) / (B + 1).
        """
        return self.preload + abs(torque) * (self.bias_ratio - 1.0) / (self.bias_ratio + 1.0)


DIFFERENTIALS: dict[str, type[Differential]] = {
    "open": OpenDifferential,
    "locked": LockedDifferential,
    "clutch": ClutchDifferential,
    "torque_sensing": TorqueSensingDifferential,
}
"""Classes by kind; a new one is one class and one line here."""

AnyDifferential = Annotated[Differential, SelectedByKind(DIFFERENTIALS, by_name=True)]


class Differentials(Schema):
    """Differentials of the driven axles."""

    front: AnyDifferential = Field(default_factory=OpenDifferential, description="[-] of the front axle")
    rear: AnyDifferential = Field(default_factory=OpenDifferential, description="[-] of the rear axle")
