"""Who drives: all drivers as data, told apart by their ``kind``, and classes of the user's own.

A new driver is one schema with a ``make_system`` method, in :mod:`mirdrake.controllers.spec` or in
:mod:`mirdrake.controllers.behaviours.spec`, and a line in :data:`DriverSpec`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.behaviours.spec import (
    BlindSpec,
    DriveToNearestSpec,
    FollowPathSpec,
    HoldLaneSpec,
    ObstacleStopperSpec,
    StraightAndAvoidSpec,
    World,
)
from mirdrake.controllers.spec import ConstantSpec, PathTrackingSpec, ScheduleSpec
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.user_systems import make_own_system
from mirdrake.core.vectors import COMMAND
from mirdrake.core.yaml_io import Schema, Source, validate

_OWN = "module:Class"


class OwnDriverSpec(Schema):
    """A class of the user's own, as ``module:Class``; the rest are parameters of its constructor.

    It is a LeafSystem with an output port ``command`` of 3 elements (speed m/s, steering rad, stamp s). Its constructor
    also gets ``vehicle`` and ``world`` if it names them; inputs called ``state``, ``ranges`` or like another output of
    the vehicle are connected.
    """

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    kind: str = Field(description="module:Class [-]")

    def make_system(
        self, vehicle: ShapedVehicle, world: World, *, where: str = "", folder: Path | None = None
    ) -> LeafSystem:
        """The driver as a system.

        Args:
            vehicle: what is driven.
            world: where.
            where: ``file:line: path`` of this spec, for errors.
            folder: where the module may lie, besides the import path and the working directory.

        Raises:
            ConfigError: no such module or class, it refuses its parameters, or it is no driver.
        """
        offered = {"vehicle": vehicle, "world": world}
        driver = make_own_system(self.kind, dict(self.model_extra or {}), where=where, folder=folder, offered=offered)
        if not driver.HasOutputPort("command") or driver.GetOutputPort("command").size() != len(COMMAND):
            ports = [driver.get_output_port(number).get_name() for number in range(driver.num_output_ports())]
            raise ConfigError(
                f"{where}: {self.kind} is no driver: it needs an output port 'command' of 3 elements (speed m/s, "
                f"steering rad, stamp s); its output ports are {', '.join(ports) or 'none'}"
            )
        return driver


def _tag(value: Any) -> Any:
    kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
    return _OWN if isinstance(kind, str) and ":" in kind else kind


def _mapping(value: Any) -> Any:
    """A bare kind stands for a driver with its defaults."""
    return {"kind": value} if isinstance(value, str) else value


DriverSpec = Annotated[
    Annotated[BlindSpec, Tag("blind")]
    | Annotated[ConstantSpec, Tag("constant")]
    | Annotated[DriveToNearestSpec, Tag("drive_to_nearest_and_stop")]
    | Annotated[FollowPathSpec, Tag("follow_path")]
    | Annotated[HoldLaneSpec, Tag("hold_lane")]
    | Annotated[ObstacleStopperSpec, Tag("obstacle_stopper")]
    | Annotated[PathTrackingSpec, Tag("path_tracking")]
    | Annotated[ScheduleSpec, Tag("schedule")]
    | Annotated[StraightAndAvoidSpec, Tag("straight_and_avoid")]
    | Annotated[OwnDriverSpec, Tag(_OWN)],
    Discriminator(_tag),
    BeforeValidator(_mapping),
]
"""Any driver: a kind, a mapping with a ``kind``, or a class of the user's own as ``module:Class``."""


DRIVERS: dict[str, type[Schema]] = {
    tag.tag: spec for spec, tag in (get_args(member) for member in get_args(get_args(DriverSpec)[0])) if tag.tag != _OWN
}
"""The drivers that have a kind of their own, by it."""


def make_driver(
    behaviour: str | Mapping[str, Any],
    vehicle: ShapedVehicle,
    world: World,
    *,
    source: Source | None = None,
    folder: Path | None = None,
) -> LeafSystem:
    """The driver of a vehicle in a world.

    Args:
        behaviour: a kind, ``"straight_and_avoid"``; a mapping with ``kind`` and its settings; or a class of the
            user's own, see :class:`OwnDriverSpec`.
        vehicle: what is driven.
        world: where.
        source: where `behaviour` was written, for errors.
        folder: where a user's module may lie, besides the import path and the working directory.

    Raises:
        ConfigError: unknown kind or setting, a setting out of range, or a class that is no driver.
    """
    source = source or Source("driver", {})
    settings: Any = _mapping(behaviour)
    kind, place = _tag(settings), source.where()
    if not isinstance(settings, Mapping) or not isinstance(kind, str):
        fault = "needs a 'kind'" if isinstance(settings, Mapping) else f"{settings!r} is not a mapping with a 'kind'"
        raise ConfigError(f"{place}: {fault}")
    if kind == _OWN:
        own = validate(dict(settings), OwnDriverSpec, source)
        return own.make_system(vehicle, world, where=place, folder=folder)
    if kind not in DRIVERS:
        raise ConfigError(
            f"{source.where('kind')}: unknown kind '{kind}'; {did_you_mean(kind, DRIVERS)}, or a class of your own as "
            "module:Class"
        )
    spec: Any = validate(dict(settings), DRIVERS[kind], source)
    system: LeafSystem = spec.make_system(vehicle, world, where=place)
    return system
