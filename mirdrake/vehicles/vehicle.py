"""A vehicle folder into a checked :class:`Vehicle`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.paths import find
from mirdrake.vehicles.geometry import VehicleGeometry, measure_geometry
from mirdrake.vehicles.inspect_urdf import check_actuators, check_urdf, resolve_meshes
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.spec import ControlSpec, Drive, VariantSpec, VehicleSpec
from mirdrake.vehicles.xacro_render import Urdf, render_xacro
from mirdrake.yaml_io import Source, load_yaml
from mirdrake.yaml_io import where as where_in

MAIN_FILE = "main.urdf.xacro"
VARIANT_MARK = "@"
"""Between the name of a vehicle and that of its variant: ``bolt@published``."""


@dataclass(frozen=True)
class Vehicle:
    """A vehicle that is known to load and to have four wheels, two of them steered.

    Attributes:
        name: of the folder, and of the variant if there is one.
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
        name: of a folder in a ``models`` folder, or a path; with ``@<variant>`` behind it one of its variants.
        arguments: values of the ``<xacro:arg>`` of its main file, over those of the variant. ``drive`` also replaces
            the one of vehicle.yaml.
        where: prefix of errors about `name` and `arguments`, for example ``"drive.yaml:4: vehicles.ego"``.

    Raises:
        ConfigError: no such vehicle or variant, or one of the YAML files is wrong.
        ModelError: the xacro files, the URDF or the meshes are wrong.
    """
    folder, variant = find_vehicle(name, where=where)
    change = VariantSpec(description="as it stands")
    if variant is not None:
        known = variants(folder)
        if variant not in known:
            prefix = f"{where}: " if where else ""
            raise ConfigError(f"{prefix}{folder.name} has no variant '{variant}'; {did_you_mean(variant, known)}")
        change = load_yaml(known[variant], VariantSpec)
    spec = load_yaml(folder / "vehicle.yaml", VehicleSpec, over=_part(change, "vehicle"))
    control = load_yaml(folder / "control.yaml", ControlSpec, over=_part(change, "control"))
    sensors = load_yaml(folder / "sensors.yaml", SensorsSpec, over=_part(change, "sensors"))
    given = {name: str(value) for name, value in (arguments or {}).items()}
    values = change.arguments | given
    if "drive" in values:
        spec = _with_drive(spec, values["drive"], where if "drive" in given else where_in(change, "arguments"))
    at = where if given or variant is None else where_in(change, "arguments")
    urdf = render_xacro(folder / MAIN_FILE, arguments=values, defaults={"drive": spec.drive}, where=at)
    label = folder.name if variant is None else f"{folder.name}{VARIANT_MARK}{variant}"
    return make_vehicle(urdf, folder=folder, spec=spec, control=control, sensors=sensors, name=label)


def find_vehicle(name: str, *, where: str = "") -> tuple[Path, str | None]:
    """Folder of a vehicle, and the variant that the name asks for.

    Args:
        name: of a folder in a ``models`` folder, or a path, with or without ``@<variant>``.
        where: prefix of the error message.

    Raises:
        ConfigError: no such vehicle.
    """
    model, mark, variant = name.rpartition(VARIANT_MARK)
    if not mark or Path(name, "vehicle.yaml").is_file():  # a folder may have the mark in its name
        return find("models", name, where=where), None
    return find("models", model, where=where), variant


def variants(folder: Path) -> dict[str, Path]:
    """The variants of a vehicle folder with their files, sorted by name."""
    return {path.stem: path for path in sorted(folder.glob("variants/*.yaml"))}


def _part(change: VariantSpec, key: str) -> tuple[Any, Source] | None:
    """One part of a variant as a tree to lay over a file."""
    data = getattr(change, key)
    return (data, (change._source or Source(key, {}))._replace(prefix=(key,))) if data else None


def make_vehicle(
    urdf: Urdf,
    *,
    folder: Path,
    spec: VehicleSpec,
    control: ControlSpec,
    sensors: SensorsSpec,
    name: str | None = None,
) -> Vehicle:
    """Check an expanded model against its specs, and measure it; its name is the folder's if none is given.

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
        name=name or folder.name,
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
