"""Base of the drivers: the data of an entry of ``control`` in a diagram file, and the system it becomes.

A new kind of driver is one file with its system and a subclass of :class:`Driver`, and one line in
:data:`mirdrake.controllers.drivers.DRIVER_KINDS`.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol

from pydantic import Field

from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.drivable_line import Track
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.yaml_io import Angle, Duration, Schema, where

_STEERING_RANGE = 0.5 * math.pi

SteeringAngle = Annotated[
    Angle,
    Field(gt=-_STEERING_RANGE, lt=_STEERING_RANGE, description="set-point of the bicycle angle, positive left [rad]"),
]
Reaction = Annotated[Duration, Field(ge=0.0, description="delay of the brakes that the braking profile allows for [s]")]
DecisionPeriod = Annotated[Duration, Field(gt=0.0, le=0.2, description="time between decisions [s]")]


class DrivenWorld(Protocol):
    """The properties of a world that a driver uses."""

    @property
    def tracks(self) -> Mapping[str, Track]:
        """Tracks by name."""


class Driver(Schema):
    """One kind of driver; the fields of a subclass are its settings in a file."""

    kind: str

    @abstractmethod
    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> LeafSystem:
        """Return the driver as a system with an output port ``command`` (speed m/s, steering rad, stamp s).

        Args:
            vehicle: vehicle to drive.
            world: its world.
            where: ``file:line: path`` of this entry, for errors, when the entry does not know its own place.
            folder: folder of the user's modules, in addition to the import path and the working directory.

        Raises:
            ConfigError: the settings do not fit the vehicle or the world.
        """

    def event_periods(self, folder: Path | str | None = None) -> tuple[float | None, ...]:  # noqa: ARG002
        """Return the periods of the events of the driver's system [s], None for an unknown one; default: `period`.

        Args:
            folder: folder of the user's modules.
        """
        return (getattr(self, "period", None),)

    def resolve_paths(self, folder: Path) -> None:
        """Make paths of files absolute that are relative to the folder of the diagram file."""

    def place(self, key: str, given: str) -> str:
        """Return where a setting was written, for errors; `given` if the entry does not know its own place."""
        return where(self, key) if self._source else given or "control"


def track_to_follow(world: DrivenWorld, name: str | None) -> Track:
    """Return the track of a name, or the first one.

    Raises:
        ConfigError: the world has no track, or none of this name.
    """
    if not world.tracks:
        asked = "no track to follow" if name is None else f"no track '{name}'; it has none"
        raise ConfigError(f"the world has {asked}")
    if name is None:
        return next(iter(world.tracks.values()))
    if name not in world.tracks:
        raise ConfigError(f"unknown track '{name}'; {did_you_mean(name, world.tracks)}")
    return world.tracks[name]


class BehaviourDriver(Driver):
    """A driver that a system computes from the scan of the surroundings.

    Attributes:
        system: class of the system; its arguments are the vehicle and this entry.
    """

    system: ClassVar[type[Any]]

    def make_system(self, vehicle: ShapedVehicle, *_: Any, **__: Any) -> LeafSystem:
        """Return the driver as a system with the inputs ``state`` and ``ranges`` and the output ``command``."""
        result: LeafSystem = self.system(vehicle, self)
        return result
