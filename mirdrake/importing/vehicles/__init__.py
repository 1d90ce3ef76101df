"""Import of vehicles from ROS and Gazebo packages into vehicle folders.

::

    .urdf .xacro .sdf ── read_source ──► SourceModel    read.py, read_urdf.py, read_sdf.py, ...
    SourceModel ── recognise ──► Roles                  recognise.py, round_shapes.py, kinematics.py, driven.py
    Roles ── repair ──► Car, Changes                    repair.py: straighten.py, masses.py, limits.py, sensors.py, ...
    Car ── write_car ──► folder                         write.py, shapes.py, report.py, templates/
    all of it: import_vehicle ──► ImportResult          here; without the last step: plan_import ──► ImportPlan

The new folder appears when it is complete. Every difference from the source is a Change, listed in its README.md.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import staging
from mirdrake.importing.changes import Change
from mirdrake.importing.meshes.convex import CUT_TIME
from mirdrake.importing.places import Places
from mirdrake.importing.vehicles.car import Car
from mirdrake.importing.vehicles.check import check_loads
from mirdrake.importing.vehicles.model import SourceModel, shorten_places
from mirdrake.importing.vehicles.read import read_source
from mirdrake.importing.vehicles.recognise import recognise
from mirdrake.importing.vehicles.repair import repair
from mirdrake.importing.vehicles.report import assumptions
from mirdrake.importing.vehicles.write import write_car
from mirdrake.vehicles.scaffold import check_name, vehicle_place
from mirdrake.vehicles.spec import Drive
from mirdrake.vehicles.vehicle import Vehicle, load_vehicle

__all__ = ["Change", "ImportPlan", "ImportResult", "import_vehicle", "plan_import"]


@dataclass(frozen=True)
class ImportResult:
    """Result of an import.

    Attributes:
        folder: folder of the vehicle.
        vehicle: loaded from it.
        changes: everything that differs from the source.
        warnings: sentences for the user that come first.
        assumptions: what was assumed and changes how the vehicle drives.
    """

    folder: Path
    vehicle: Vehicle
    changes: tuple[Change, ...]
    warnings: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True)
class ImportPlan:
    """Result that an import would have.

    Attributes:
        folder: folder of the vehicle.
        car: repaired; its meshes are not converted yet.
        model: model as read.
        places: short names of the source files.
        obstacle: why the folder cannot be written as things are, such as an existing vehicle of that name; else empty.
    """

    folder: Path
    car: Car
    model: SourceModel
    places: Places
    obstacle: str = ""

    @property
    def changes(self) -> tuple[Change, ...]:
        """All changes except those of meshes."""
        return tuple(dict.fromkeys(map(self.places.change, self.car.changes)))


def import_vehicle(
    path: Path | str,
    *,
    name: str | None = None,
    folder: Path | str | None = None,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
    drive: Drive | None = None,
    force: bool = False,
    convex_time: float = CUT_TIME,
    progress: Callable[[str], None] | None = None,
    finish: Callable[[Path], None] | None = None,
) -> ImportResult:
    """Make a vehicle folder from a URDF, xacro or SDF file.

    Args:
        path: the file, or the folder of a package or model.
        name: name of the vehicle; that of the model if left out.
        folder: parent of the new vehicle folder; ``models`` in the working directory if left out.
        packages: ROS package name -> folder, besides those found around the file.
        arguments: values of xacro arguments.
        drive: driven axle: front, rear or all; what the files state if left out.
        force: replace a vehicle of that name.
        convex_time: time limit for cutting collision meshes into convex parts [s]; those left become their convex
            hulls.
        progress: called with the current step.
        finish: called with the complete folder before it takes its place.

    Raises:
        ConfigError: name, place or drive are not allowed.
        ModelError: the files cannot be read, or describe no car; nothing is written then.
        MissingDependencyError: a mesh format needs a package that is not installed.
    """
    show_progress = progress or _ignore_progress
    if not convex_time >= 0.0:
        raise ConfigError(f"convex_time {convex_time:g} is not allowed; seconds from 0 on")
    # Errors of name and place come before the source is read.
    if name is not None:
        check_name(name)
        vehicle_place(name, folder=folder, force=force)
    plan = plan_import(
        path,
        name=name,
        folder=folder,
        packages=packages,
        arguments=arguments,
        drive=drive,
        force=force,
        progress=progress,
    )
    if plan.obstacle:
        # All planning is done before anything is written; an existing folder is the last obstacle.
        raise ConfigError(plan.obstacle)
    car, target = plan.car, plan.folder
    # The folder is built elsewhere and published when it is complete, so that a failed import leaves nothing.
    with staging(target.parent) as stage:
        building = stage.path / target.name
        building.mkdir()
        show_progress("converting meshes")
        write_car(car, plan.model, building, places=plan.places, convex_time=convex_time)
        show_progress("loading")
        # The written files are loaded as a user would load them: an import that cannot be loaded is a fault.
        check_loads(building)
        if finish is not None:
            finish(building)
        stage.publish()
    changes, assumed = tuple(dict.fromkeys(car.changes)), tuple(assumptions(car))
    return ImportResult(target, load_vehicle(str(target)), changes, tuple(car.warnings), assumed)


def plan_import(
    path: Path | str,
    *,
    name: str | None = None,
    folder: Path | str | None = None,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
    drive: Drive | None = None,
    force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> ImportPlan:
    """Return what :func:`import_vehicle` would make with the same arguments; nothing is written or converted.

    Raises:
        ConfigError: name or drive are not allowed.
        ModelError: the files cannot be read, or describe no car.
    """
    show_progress = progress or _ignore_progress
    if drive is not None and drive not in get_args(Drive):
        raise ConfigError(f"drive '{drive}' is not allowed; {did_you_mean(drive, get_args(Drive))}")
    if name is not None:
        check_name(name)
    show_progress("reading")
    model = read_source(Path(path), packages=packages, arguments=arguments)
    name = name or _plain(model.name)
    target, obstacle = Path(folder or "models") / name, ""
    # A plan may be shown for an existing vehicle; only the import itself rejects its folder.
    try:
        vehicle_place(name, folder=folder, force=force)
    except ConfigError as error:
        obstacle = str(error)
    places = shorten_places(model)
    show_progress("recognising wheels and steering")
    roles = recognise(model, drive)
    show_progress("repairing")
    car = repair(model, roles, name=name)
    return ImportPlan(target, car, model, places, obstacle)


def _ignore_progress(_text: str) -> None:
    """Ignore a progress message."""


def _plain(name: str) -> str:
    """Return a folder name made of a model's name."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").lower()[:64]
    return plain if re.match(r"[a-z]", plain) else f"vehicle_{plain}"[:64].rstrip("_")
