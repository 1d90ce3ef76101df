"""Scene of a diagram: the world laid out and the vehicles loaded.

::

    DiagramSpec ── make_scene ──► Scene ── assemble ──► Assembly
                                    │
                                    └─ write_scene ──► RUN/scene/ ── read_scene ──► Scene

A scene is made once. A run folder carries it, so that whatever reads the run (report, recording, replay, export) shows
the world, the vehicles and the mounted sensors as they were, even if their files have changed since::

    RUN/scene/world.lock     all that was settled in the world, with a hash
    RUN/scene/ego.urdf       the vehicle ego, xacro arguments applied
    RUN/scene/scene.json     the world and the vehicles as data, and the meshes: their files and the hashes of these

Only meshes are read from where they are; :attr:`Scene.changes` lists those that have changed or gone.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from xml.dom import minidom
from xml.parsers.expat import ExpatError

from pydrake.geometry import Convex

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError, one_line
from mirdrake.core.files import write_file
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import Source, display_path, validate, where
from mirdrake.core.yaml_tree import merge_over
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.mounts import change_mounts
from mirdrake.vehicles.spec import JOINT_LOOPS, ControlSpec
from mirdrake.vehicles.stored import read_vehicle, vehicle_data
from mirdrake.vehicles.vehicle import check_pedals
from mirdrake.worlds import World
from mirdrake.worlds.lock import lock_text, mesh_files
from mirdrake.worlds.relief import relief_files
from mirdrake.worlds.scenery import scenery_file
from mirdrake.worlds.stored import read_world, world_data

FOLDER, FILE, LOCK = "scene", "scene.json", "world.lock"
FORMAT = "scene/1"

_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RuntimeError,  # of Drake
    ExpatError,
)
"""Exceptions raised by reading damaged data."""

_DATA = "mirdrake://"  # begins a reference to a file that is shipped with mirdrake


@dataclass(frozen=True)
class Scene:
    """A world and the vehicles in it.

    Attributes:
        world: laid out.
        vehicles: by their names in the diagram, with the diagram's changes to control and mounted sensors.
        changes: of a scene that was read from a run folder: the meshes that have changed or gone since, one line each.
    """

    world: World
    vehicles: dict[str, Vehicle]
    changes: tuple[str, ...] = field(default=(), compare=False)

    @cached_property
    def files(self) -> dict[str, str | bytes]:
        """Return the files of a scene in a run folder: their contents by name.

        Raises:
            WorldError: a file of a prop cannot be read.
            OSError: a file of heights cannot be read.
        """
        # Heights are copied, because the ground of a run must stay that of the run.
        heights = {
            name: path.read_bytes()
            for name, path in relief_files(self.world.spec.ground.relief, self.world.path).items()
        }
        grids = {name: f"{digest(content)[:16]}{Path(name).suffix}" for name, content in heights.items()}
        data = {
            "mirdrake": FORMAT,
            "world": world_data(self.world, _reference),
            "vehicles": {
                name: vehicle_data(vehicle)
                | {"packages": {key: _reference(Path(path)) for key, path in vehicle.packages.items()}}
                for name, vehicle in self.vehicles.items()
            },
            "meshes": {_reference(path): _digest_of(path) for path in _meshes(self)},
            **({"grids": grids} if grids else {}),
        }
        urdfs = {f"{name}.urdf": vehicle.urdf for name, vehicle in self.vehicles.items()}
        copies = {grids[name]: content for name, content in heights.items()}
        return {FILE: json.dumps(data, indent=1) + "\n", LOCK: lock_text(self.world), **urdfs, **copies}


# --- from a diagram ------------------------------------------------------------------------------------------------


def make_scene(spec: DiagramSpec, vehicles: Mapping[str, Vehicle] | None = None) -> Scene:
    """Lay out the world of a diagram and load its vehicles.

    Args:
        spec: the diagram.
        vehicles: its vehicles by name, if they are loaded already; those of the world's actors are loaded here.

    Raises:
        ConfigError, ModelError, WorldError: what is wrong, on one line each.
    """
    world = spec.world.load(where=where(spec, "world"))
    loaded = dict(vehicles or {name: load_vehicle_of(spec, name) for name in spec.vehicles})
    for actor in world.moving:
        if actor.name in spec.vehicles:
            raise ConfigError(
                f"'{actor.name}' is the name of a vehicle of the diagram; rename the actor",
                where=where(actor.spec, "name"),
            )
    for actor in world.full_actors:
        loaded[actor.name] = load_vehicle(actor.model, where=where(actor.spec, "actor"))
    return Scene(world, loaded)


def load_vehicle_of(spec: DiagramSpec, name: str) -> Vehicle:
    """Return the vehicle of an entry of ``vehicles``, with the diagram's changes to its control and mounted sensors."""
    entry = spec.vehicles[name]
    vehicle = load_vehicle(entry.model, arguments=entry.arguments, where=where(spec, "vehicles", name, "model"))
    source = entry._source or Source("diagram", {}, ("vehicles", name))
    if entry.control:
        place = source._replace(prefix=(*source.prefix, "control"))
        control = change_control(vehicle.control, entry.control, source=place)
        # Changed control may use pedals, which the file's own did not.
        check_pedals(vehicle.spec, control)
        vehicle = replace(vehicle, control=control)
    vehicle = _without_replaced_loops(vehicle, spec, name)
    if not entry.mounts:
        return vehicle
    source = source._replace(prefix=(*source.prefix, "mounts"))
    return replace(vehicle, sensors=change_mounts(vehicle.sensors, entry.mounts, source=source))


def _without_replaced_loops(vehicle: Vehicle, spec: DiagramSpec, name: str) -> Vehicle:
    """Return the vehicle without the joint loops that a system of the diagram replaces: Drake's servos are left out."""
    replaced = [block for block in JOINT_LOOPS if f"{name}.control.{block}" in spec.systems]
    if not replaced:
        return vehicle
    control = vehicle.control.model_copy(update={"disable": [*vehicle.control.disable, *replaced]})
    return replace(vehicle, control=control)


def change_control(control: ControlSpec, changes: Mapping[str, Any], *, source: Source) -> ControlSpec:
    """Return control data with changed entries; an entry of another kind is replaced as a whole.

    Args:
        control: of a vehicle.
        changes: a part of control.yaml.
        source: where the changes were written, for errors.

    Raises:
        ConfigError: no such entry, or a value out of range.
    """
    below = (control._source or Source("control", {}))._replace(prefix=())
    data, places = merge_over(control.model_dump(exclude_unset=True), below, dict(changes), source)
    return validate(data, ControlSpec, places)


# --- in a run folder -----------------------------------------------------------------------------------------------


def write_scene(scene: Scene, folder: Path) -> None:
    """Write a scene into a run folder.

    Raises:
        RunError: it cannot be written.
    """
    place = folder / FOLDER
    for name, content in scene.files.items():
        place.mkdir(exist_ok=True)
        write_file(place / name, content)


def read_scene(folder: Path) -> Scene:
    """Return the scene of a run folder.

    Raises:
        RunError: the folder carries no scene, or a damaged one.
    """
    path = folder / FOLDER / FILE
    if not path.is_file():
        raise RunError(
            f"carries no scene (no file {FOLDER}/{FILE}), so it cannot be drawn; run its spec.yaml again",
            where=str(folder),
        )
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        # A run folder may come from another version of mirdrake.
        if data["mirdrake"] != FORMAT:
            raise RunError(f"format {data['mirdrake']!r} is not known; known: {FORMAT}", where=display_path(path))
        return _read(data, path.parent)
    except MirdrakeError:
        raise
    except _DAMAGE as error:
        raise RunError(f"damaged: {one_line(error)[:200]}", where=display_path(path)) from None


def changed_files(scene: Scene, folder: Path) -> list[str]:
    """Return what differs from the scene that a run folder carries, if any: ``the world`` and meshes."""
    place = folder / FOLDER
    try:
        lock = (place / LOCK).read_text(encoding="utf-8")
        meshes = dict(json.loads((place / FILE).read_text(encoding="utf-8"))["meshes"])
        paths = {_resolve(reference): recorded for reference, recorded in meshes.items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return []
    changed = [path for path, recorded in paths.items() if not path.is_file() or _digest_of(path) != recorded]
    return ["the world"] * (lock != lock_text(scene.world)) + [display_path(path) for path in changed]


def _read(data: Mapping[str, Any], place: Path) -> Scene:
    changes = []
    for reference, recorded in data["meshes"].items():
        mesh = _resolve(reference)
        now = _digest_of(mesh) if mesh.is_file() else None
        if now is None:
            changes.append(f"{display_path(mesh)}: is missing; the run is shown without it")
        elif now != recorded:
            changes.append(f"{display_path(mesh)}: has changed since the run; it is shown as it is now")
    grids = {name: place / copy for name, copy in data.get("grids", {}).items()}
    world = read_world(data["world"], _find, location=display_path(place / FILE), grids=grids)
    # Missing meshes are left out, so that an old run can still be drawn.
    world.spec.scenery[:] = [mesh for mesh in world.spec.scenery if scenery_file(world, mesh).is_file()]
    vehicles = {}
    for name, entry in data["vehicles"].items():
        packages = {key: str(_resolve(reference)) for key, reference in entry["packages"].items()}
        urdf = (place / f"{name}.urdf").read_text(encoding="utf-8")
        known = {key: folder for key, folder in packages.items() if Path(folder).is_dir()}
        vehicles[name] = read_vehicle(
            entry, urdf=_without_missing(urdf, packages), packages=known, place=display_path(place / FILE)
        )
    return Scene(world, vehicles, tuple(changes))


# --- meshes --------------------------------------------------------------------------------------------------------


def _reference(path: Path) -> str:
    """Return a file or folder as text: relative to the bundled data if it is one of these, else its absolute path."""
    path = Path(os.path.abspath(path))
    root = data_root()
    return f"{_DATA}{path.relative_to(root).as_posix()}" if path.is_relative_to(root) else str(path)


def _resolve(reference: str) -> Path:
    """Return the path of a reference."""
    return data_root() / reference.removeprefix(_DATA) if reference.startswith(_DATA) else Path(reference)


def _find(reference: str) -> Path | None:
    """Return the file of a reference, if it exists."""
    path = _resolve(reference)
    return path if path.is_file() else None


def _meshes(scene: Scene) -> list[Path]:
    """Return all existing mesh files of a scene, with the buffers and pictures that they refer to."""
    roots: list[Path] = []
    for vehicle in scene.vehicles.values():
        document = minidom.parseString(vehicle.urdf)
        addresses = [mesh.getAttribute("filename") for mesh in document.getElementsByTagName("mesh")]
        roots += [_mesh_path(address, vehicle.packages) for address in addresses]
    roots += [scenery_file(scene.world, mesh) for mesh in scene.world.spec.scenery]
    world = scene.world
    for prop in dict.fromkeys([*(placed.prop for placed in world.props), *(actor.prop for actor in world.actors)]):
        roots += [prop.visual] if prop.visual is not None else []
        roots += [Path(solid.shape.source().path()) for solid in prop.solids if isinstance(solid.shape, Convex)]
    files = [file for root in dict.fromkeys(roots) if root.is_file() for file in mesh_files(root)]
    return sorted({Path(os.path.abspath(file)) for file in files if file.is_file()})


def _mesh_path(address: str, packages: Mapping[str, str]) -> Path:
    """Return the file of a URI in a rendered URDF."""
    for scheme in ("package://", "model://"):
        if address.startswith(scheme):
            package, _, rest = address.removeprefix(scheme).partition("/")
            return Path(packages.get(package, os.devnull)) / rest
    return Path(address.removeprefix("file://"))


def _without_missing(urdf: str, packages: Mapping[str, str]) -> str:
    """Return a URDF without the visual and collision elements whose mesh is missing; the same text if none is."""
    document: Any = minidom.parseString(urdf)
    changed = False
    for mesh in document.getElementsByTagName("mesh"):
        if not _mesh_path(mesh.getAttribute("filename"), packages).is_file():
            element = mesh.parentNode.parentNode  # mesh in geometry in visual or collision
            element.parentNode.removeChild(element)
            changed = True
    return document.toxml() if changed else urdf


def _digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    # Time and size are part of the cache's key: a changed file is read again.
    status = path.stat()
    return _digest(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4096)
def _digest(path: Path, _changed: int, _size: int) -> str:
    return digest(path.read_bytes())
