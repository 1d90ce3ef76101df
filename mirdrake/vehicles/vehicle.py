"""A vehicle folder into a checked :class:`Vehicle`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.paths import find
from mirdrake.vehicles.geometry import VehicleGeometry, measure_geometry
from mirdrake.vehicles.inspect_urdf import check_actuators, check_urdf, resolve_meshes
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.spec import ControlSpec, Drive, SensorsSpec, VehicleSpec
from mirdrake.vehicles.xacro_render import Urdf, render_xacro
from mirdrake.yaml_io import load_yaml

MAIN_FILE = "main.urdf.xacro"


@dataclass(frozen=True)
class Vehicle:
    """A vehicle that is known to load and to have four wheels, two of them steered.

    Attributes:
        name: of the folder.
        folder: absolute path.
        spec: vehicle.yaml.
        control: control.yaml.
        sensors: sensors.yaml.
        urdf: URDF text, meshes as ``package://`` addresses.
        geometry: measured on the kinematics.
        packages: package name -> folder, for Drake's PackageMap.
        warnings: what xacro and Drake's parser had to say, each with file and line.
    """

    name: str
    folder: Path
    spec: VehicleSpec
    control: ControlSpec
    sensors: SensorsSpec
    urdf: str
    geometry: VehicleGeometry
    packages: Mapping[str, str]
    warnings: tuple[str, ...] = ()


def load_vehicle(name: str, *, arguments: Mapping[str, str] | None = None, where: str = "") -> Vehicle:
    """Load and check a vehicle.

    Args:
        name: of a folder in a ``models`` folder, or a path.
        arguments: values of the ``<xacro:arg>`` of its main file. ``drive`` also replaces the one of vehicle.yaml.
        where: prefix of errors about `name` and `arguments`, for example ``"drive.yaml:4: vehicles.ego"``.

    Raises:
        ConfigError: no such vehicle, or one of the YAML files is wrong.
        ModelError: the xacro files, the URDF or the meshes are wrong.
    """
    folder = find("models", name, where=where)
    spec = load_yaml(folder / "vehicle.yaml", VehicleSpec)
    control = load_yaml(folder / "control.yaml", ControlSpec)
    sensors = load_yaml(folder / "sensors.yaml", SensorsSpec)
    given = {name: str(value) for name, value in (arguments or {}).items()}
    if "drive" in given:
        spec = _with_drive(spec, given["drive"], where)
    urdf = render_xacro(folder / MAIN_FILE, arguments=given, defaults={"drive": spec.drive}, where=where)
    return make_vehicle(urdf, folder=folder, spec=spec, control=control, sensors=sensors)


def make_vehicle(urdf: Urdf, *, folder: Path, spec: VehicleSpec, control: ControlSpec, sensors: SensorsSpec) -> Vehicle:
    """Check an expanded model against its specs, and measure it.

    Raises:
        ConfigError: a spec names something that the URDF does not have.
        ModelError: the URDF or its meshes are wrong.
    """
    check_urdf(urdf, spec=spec, sensors=sensors)
    text, packages, mesh_warnings = resolve_meshes(urdf, folder)
    plant, scene_graph, drake_warnings = parse_urdf(text, packages=packages, where_line=urdf.where_line)
    joints = {joint.get("name", ""): joint for joint in urdf.root.findall("joint")}

    def place(joint: str) -> str:
        return urdf.where(joints[joint])

    check_actuators(plant, spec=spec, where=place, warnings=drake_warnings)
    geometry = measure_geometry(plant, scene_graph, spec=spec, where=place)
    return Vehicle(
        name=folder.name,
        folder=folder,
        spec=spec,
        control=control,
        sensors=sensors,
        urdf=text,
        geometry=geometry,
        packages=packages,
        warnings=(*urdf.warnings, *mesh_warnings, *drake_warnings),
    )


def _with_drive(spec: VehicleSpec, drive: str, where: str) -> VehicleSpec:
    """The spec with another driven axle."""
    allowed = get_args(Drive)
    if drive not in allowed:
        prefix = f"{where}: " if where else ""
        raise ConfigError(f"{prefix}argument drive: '{drive}' is not allowed; {did_you_mean(drive, allowed)}")
    return spec.model_copy(update={"drive": drive})
