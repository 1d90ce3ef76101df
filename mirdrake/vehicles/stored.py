"""Conversion of a loaded vehicle to plain data and back, for run folders.

The data include the variant, the xacro arguments and the changes by the diagram. Meshes are not copied.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mirdrake.core.json_io import Json, finite_or_none
from mirdrake.core.yaml_io import Source, validate
from mirdrake.vehicles.geometry import VehicleGeometry
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.spec import ControlSpec, VehicleSpec
from mirdrake.vehicles.vehicle import Vehicle

Data = Json


def vehicle_data(vehicle: Vehicle) -> Data:
    """Return a vehicle as JSON data; URDF and packages are stored separately."""
    return {
        "name": vehicle.name,
        "folder": str(vehicle.folder),
        "spec": vehicle.spec.model_dump(mode="json"),
        "control": vehicle.control.model_dump(mode="json"),
        "sensors": vehicle.sensors.model_dump(mode="json"),
        "geometry": {key: finite_or_none(value) for key, value in vars(vehicle.geometry).items()},
        "spring_loads": list(vehicle.spring_loads),
    }


def read_vehicle(data: Mapping[str, Any], *, urdf: str, packages: Mapping[str, str], place: str = "vehicle") -> Vehicle:
    """Return the vehicle that :func:`vehicle_data` was given.

    Args:
        data: data of the vehicle.
        urdf: its URDF text.
        packages: package name -> folder.
        place: the file it was read from, for errors.

    Raises:
        ConfigError: one of its specs has faults.
        KeyError, TypeError: the data are not those of a vehicle.
    """
    source = Source(place, {})
    # The numbers of a product are in the mount already; its preset may have changed or gone since.
    mounts = data["sensors"]["mounts"]
    bare = {name: {key: value for key, value in mount.items() if key != "preset"} for name, mount in mounts.items()}
    sensors = validate({"mounts": bare}, SensorsSpec, source)
    for name, mount in sensors.mounts.items():
        mount.preset = mounts[name]["preset"]
    # JSON has no infinity: None stands for a missing limit.
    geometry = {key: math.inf if value is None else value for key, value in data["geometry"].items()}
    return Vehicle(
        name=data["name"],
        folder=Path(data["folder"]),
        spec=validate(data["spec"], VehicleSpec, source),
        control=validate(data["control"], ControlSpec, source),
        sensors=sensors,
        urdf=urdf,
        geometry=VehicleGeometry(**geometry),
        packages=dict(packages),
        spring_loads=tuple(data["spring_loads"]),
    )
