"""A vehicle folder into a checked :class:`Vehicle`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

from mirdrake.core.errors import ConfigError, did_you_mean, not_found
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import SchemaT, Source, display_path, load_yaml, read_tree
from mirdrake.core.yaml_io import where as where_in
from mirdrake.tyres.registry import kinds_with_slip
from mirdrake.vehicles.geometry import VehicleGeometry, measure_geometry
from mirdrake.vehicles.inspect_urdf import check_actuators, check_urdf, resolve_meshes
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.spec import ControlSpec, Drive, VariantSpec, VehicleSpec
from mirdrake.vehicles.suspension import measure_spring_loads
from mirdrake.vehicles.xacro_render import Urdf, render_xacro

MAIN_FILE = "main.urdf.xacro"
FILES = ("vehicle.yaml", "control.yaml", "sensors.yaml", MAIN_FILE)
"""Files of every vehicle folder; further .xacro files, meshes/ and variants/ are optional."""

VARIANT_MARK = "@"
"""Between the name of a vehicle and that of its variant: ``bolt@published``."""


@dataclass(frozen=True)
class Vehicle:
    """A vehicle that is known to load and to have four wheels, two of them steered.

    Attributes:
        name: name of the folder, and of the variant if there is one.
        folder: absolute path.
        spec: vehicle.yaml.
        control: control.yaml.
        sensors: sensors.yaml.
        urdf: URDF text, meshes as ``package://`` addresses.
        geometry: measured on the kinematics.
        packages: package name -> folder, for Drake's PackageMap.
        warnings: warnings of xacro and of Drake's parser, each with file and line.
        spring_loads: load of each spring of the suspension at rest [N] (4); empty without springs.
        link_places: name of a link -> ``file:line`` in its source.
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
    spring_loads: tuple[float, ...] = ()
    link_places: Mapping[str, str] = field(default_factory=dict)


def load_vehicle(name: str, *, arguments: Mapping[str, str] | None = None, where: str = "") -> Vehicle:
    """Load and check a vehicle.

    Args:
        name: name of a folder in a ``models`` folder, or a path; with ``@<variant>`` behind it one of its variants.
        arguments: values of the ``<xacro:arg>`` of its main file, over those of the variant. ``drive`` also replaces
            the one of vehicle.yaml.
        where: prefix of errors about `name` and `arguments`, for example ``"drive.yaml:4: vehicles.ego"``.

    Raises:
        ConfigError: no such vehicle or variant, or one of the YAML files is wrong.
        ModelError: the xacro files, the URDF or the meshes are wrong.
    """
    folder, variant = find_vehicle(name, where=where)
    change = load_variant(folder, variant, where=where)
    spec = load_part(folder, "vehicle", VehicleSpec, change)
    control = load_part(folder, "control", ControlSpec, change)
    sensors = load_part(folder, "sensors", SensorsSpec, change)
    # Missing tyre files are reported now, with the line of vehicle.yaml, not in the middle of a run.
    spec.tyres.property_files(folder, lambda key: where_in(spec, "tyres", key))
    check_pedals(spec, control)
    given = {name: str(value) for name, value in (arguments or {}).items()}
    values = change.arguments | given
    # The argument changes the model and the spec: both must have the same driven axle.
    if "drive" in values:
        spec = with_drive(spec, values["drive"], where if "drive" in given else where_in(change, "arguments"))
    location = where if given or variant is None else where_in(change, "arguments")
    urdf = render_xacro(folder / MAIN_FILE, arguments=values, defaults={"drive": spec.drive}, where=location)
    label = folder.name if variant is None else f"{folder.name}{VARIANT_MARK}{variant}"
    return make_vehicle(urdf, folder=folder, spec=spec, control=control, sensors=sensors, name=label)


def find_vehicle(name: str, *, where: str = "") -> tuple[Path, str | None]:
    """Return the folder of a vehicle, and the variant in its name; None without.

    Args:
        name: name of a folder in a ``models`` folder, or a path, with or without ``@<variant>``.
        where: prefix of the error message.

    Raises:
        ConfigError: no such vehicle.
    """
    model, mark, variant = name.rpartition(VARIANT_MARK)
    if not mark or Path(name, "vehicle.yaml").is_file():  # a folder may have the mark in its name
        return find("models", name, where=where), None
    return find("models", model, where=where), variant


def variants(folder: Path) -> dict[str, Path]:
    """Return the variants of a vehicle folder with their files, sorted by name."""
    return {path.stem: path for path in sorted(folder.glob("variants/*.yaml"))}


def load_variant(folder: Path, variant: str | None, *, where: str = "") -> VariantSpec:
    """Return the differences of a variant from the files of the folder, with those of its base; none without a variant.

    Raises:
        ConfigError: the folder has no such variant, its file is wrong, or its base has a base as well.
    """
    if variant is None:
        return VariantSpec(description="without a variant")
    known = variants(folder)
    if variant not in known:
        raise not_found("variant", variant, known, of=folder.name, where=where)
    change = load_yaml(_file(known[variant]), VariantSpec)
    if change.base is None:
        return change
    # The variant is merged over its base, key by key, as it is over the files of the folder.
    place = where_in(change, "base")
    if change.base not in known or change.base == variant:
        raise not_found("variant", change.base, known, of=folder.name, where=place)
    if load_yaml(_file(known[change.base]), VariantSpec).base is not None:
        raise ConfigError(f"variant '{change.base}' has a base as well; name one without a base", where=place)
    return load_yaml(_file(known[change.base]), VariantSpec, over=read_tree(_file(known[variant])))


def load_part(folder: Path, key: str, schema: type[SchemaT], change: VariantSpec) -> SchemaT:
    """Return one of the YAML files of a vehicle folder, merged with a variant.

    Args:
        folder: folder of the vehicle.
        key: name of the file and of the part of the variant: vehicle, control or sensors.
        schema: format of the file.
        change: the variant.

    Raises:
        ConfigError: the file is wrong.
    """
    data = getattr(change, key)
    over = (data, (change._source or Source(key, {}))._replace(prefix=(key,))) if data else None
    return load_yaml(_file(folder / f"{key}.yaml"), schema, over=over)


def _file(path: Path) -> Path:
    """Return the path of a regular file; reading a pipe or a device would not end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ConfigError("is not a file", where=display_path(path))
    return path


def make_vehicle(
    urdf: Urdf, *, folder: Path, spec: VehicleSpec, control: ControlSpec, sensors: SensorsSpec, name: str | None = None
) -> Vehicle:
    """Check an expanded model against its specs, and measure it; its name is the folder's if none is given.

    Raises:
        ConfigError: a spec names something that the URDF does not have.
        ModelError: the URDF or its meshes are wrong.
    """
    # Cheap checks of the text come first: their messages have lines and reasons, those of Drake often not.
    check_urdf(urdf, spec=spec, sensors=sensors)
    text, packages, mesh_warnings = resolve_meshes(urdf, folder)
    plant, scene_graph, drake_warnings = parse_urdf(text, packages=packages, where_line=urdf.where_line)
    joints = {joint.get("name", ""): joint for joint in urdf.root.findall("joint")}

    def place(joint: str) -> str:
        return urdf.where(joints[joint])

    # Drake ignores some transmissions with a warning, so the result is checked, too.
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
        warnings=(*map(str, urdf.warnings), *mesh_warnings, *drake_warnings),
        spring_loads=measure_spring_loads(plant, spec=spec, geometry=geometry, where=place),
        link_places={link.get("name", ""): urdf.where(link) for link in urdf.root.findall("link")},
    )


def check_pedals(spec: VehicleSpec, control: ControlSpec) -> None:
    """Check that the tyres have a tyre law if the wheels are driven by pedals: only these take wheel torques.

    Raises:
        ConfigError: the wheels are driven by pedals, and the tyres have no law.
    """
    if control.wheel_speed.uses_pedals and not spec.tyres.has_slip:
        raise ConfigError(
            f"pedals drive tyres of kind {' or '.join(kinds_with_slip())}, "
            f"and those of vehicle.yaml are {spec.tyres.kind}; write tyres there, or take kind servo",
            where=where_in(control.wheel_speed, "kind"),
        )


def with_drive(spec: VehicleSpec, drive: str, where: str) -> VehicleSpec:
    """Return the spec with another driven axle."""
    allowed = get_args(Drive)
    if drive not in allowed:
        raise ConfigError(f"argument drive: '{drive}' is not allowed; {did_you_mean(drive, allowed)}", where=where)
    return spec.model_copy(update={"drive": drive})
