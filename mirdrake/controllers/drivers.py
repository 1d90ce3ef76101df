"""Registry of the drivers: all kinds, and the user's own classes.

::

    control:
      ego: {kind: path_tracking, track: main, speed: 5 m/s}
      other: {kind: obstacle_stopper, speed: 5, as_published: true}
      third: {kind: schedule, rows: [{time: 0, speed: 0}, {time: 4 s, speed: 18 km/h, steering: 0.1}]}
      fourth: {kind: "my_module:MyDriver", gain: 2}

A new driver is one file with a subclass of :class:`~mirdrake.controllers.driver.Driver` and one line in
:data:`DRIVER_KINDS`.
"""

from collections.abc import Mapping
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from mirdrake.controllers.behaviours.blind import BlindSpec
from mirdrake.controllers.behaviours.drive_to_nearest import DriveToNearestSpec
from mirdrake.controllers.behaviours.follow_path import FollowPathSpec
from mirdrake.controllers.behaviours.hold_lane import HoldLaneSpec
from mirdrake.controllers.behaviours.obstacle_stopper import ObstacleStopperSpec
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.behaviours.straight_and_avoid import StraightAndAvoidSpec
from mirdrake.controllers.driver import DrivenWorld, Driver
from mirdrake.controllers.path_tracking import PathTrackingSpec
from mirdrake.controllers.platoon import AccSpec, CaccSpec
from mirdrake.controllers.schedule import ConstantSpec, ScheduleSpec
from mirdrake.controllers.traffic_driver import TrafficDriverSpec
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.user_systems import make_user_system, sampling_period
from mirdrake.core.vectors import COMMAND

DRIVER_KINDS: tuple[type[Driver], ...] = (
    AccSpec,
    BlindSpec,
    CaccSpec,
    ConstantSpec,
    DriveToNearestSpec,
    FollowPathSpec,
    HoldLaneSpec,
    ObstacleStopperSpec,
    PathTrackingSpec,
    ScheduleSpec,
    StraightAndAvoidSpec,
    TrafficDriverSpec,
)
"""Class of each kind."""

DRIVERS: dict[str, type[Driver]] = {
    get_args(driver.model_fields["kind"].annotation)[0]: driver for driver in DRIVER_KINDS
}
"""The same, by the kind in a file."""

_OWN = "module:Class"


class OwnDriverSpec(Driver):
    """A user's class, as ``module:Class``; the other keys are arguments of its constructor.

    It is a LeafSystem with an output port ``command`` of 3 elements (speed m/s, steering rad, stamp s). Its constructor
    also gets ``vehicle`` and ``world`` if it has such arguments; inputs called ``state``, ``ranges`` or like another
    output of the vehicle are connected.
    """

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    kind: str = Field(description="module:Class [-]")

    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> LeafSystem:
        """Return the driver as a system.

        Raises:
            ConfigError: no such module or class, it rejects its parameters, or it is not a driver.
        """
        offered = {"vehicle": vehicle, "world": world}
        driver = make_user_system(self.kind, dict(self.model_extra or {}), where=where, folder=folder, offered=offered)
        if not driver.HasOutputPort("command") or driver.GetOutputPort("command").size() != len(COMMAND):
            ports = [driver.get_output_port(number).get_name() for number in range(driver.num_output_ports())]
            raise ConfigError(
                f"{self.kind} is not a driver: it needs an output port 'command' of 3 elements (speed m/s, "
                f"steering rad, stamp s); its output ports are {', '.join(ports) or 'none'}",
                where=where,
            )
        return driver

    def event_periods(self, folder: Path | str | None = None) -> tuple[float | None, ...]:
        """Return the period that its class states; see :func:`mirdrake.core.user_systems.sampling_period`."""
        return (sampling_period(self.kind, self.model_extra or {}, folder=folder),)


def _tag(value: Any) -> Any:
    kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
    return _OWN if isinstance(kind, str) and ":" in kind else kind


def _mapping(value: Any) -> Any:
    """Return a mapping with a kind; a bare kind is a driver with its defaults."""
    return {"kind": value} if isinstance(value, str) else value


_TAGGED: list[Any] = [Annotated[driver, Tag(kind)] for kind, driver in DRIVERS.items()]
_TAGGED.append(Annotated[OwnDriverSpec, Tag(_OWN)])

if TYPE_CHECKING:
    DriverSpec = Driver
else:
    DriverSpec = Annotated[reduce(or_, _TAGGED), Discriminator(_tag), BeforeValidator(_mapping)]
"""Any driver: a kind, a mapping with a ``kind``, or a user's class as ``module:Class``."""
