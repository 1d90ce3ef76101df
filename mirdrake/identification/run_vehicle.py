"""Dimensions of the vehicle of a run, which its folder contains."""

from pathlib import Path
from typing import NamedTuple

from mirdrake.assembly.scene import read_scene
from mirdrake.core.errors import MirdrakeError
from mirdrake.single_track import estimate_parameters


class KnownVehicle(NamedTuple):
    """Dimensions of a vehicle.

    Attributes:
        name: name of the vehicle in the run.
        wheelbase: [m].
        mass: [kg].
        front_length: centre of mass to front axle [m].
        front_drive: front axle's share of the drive force [1].
        front_brake: front axle's share of the braking force [1].
    """

    name: str
    wheelbase: float
    mass: float
    front_length: float
    front_drive: float
    front_brake: float


def vehicle_of_run(path: Path) -> KnownVehicle | None:
    """Return the dimensions of the first vehicle of a run; None for another log, or a run without its scene."""
    if not (path / "scene").is_dir():
        return None
    try:
        name, vehicle = next(iter(read_scene(path).vehicles.items()))
        parameters = estimate_parameters(vehicle)
    except (MirdrakeError, StopIteration):
        return None  # a damaged scene does not make the signals unusable
    return KnownVehicle(
        name, vehicle.geometry.wheelbase, parameters.mass, parameters.front_length, parameters.front_drive,
        parameters.front_brake,
    )  # fmt: skip
