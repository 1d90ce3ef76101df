"""Lock file of a world: the result of random values, parameters and layouts, as YAML with a hash.

The same file, seed and parameters give the same bytes, in every process, folder and version of Python. Numbers are
rounded to 1e-9, areas start at their lowest corner, file names are relative to the world file or to models/, and every
prop has its own line, so that a comparison of two lock files shows which props moved.

Rules and tests are left out because they do not change the world.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import shapely
from pydrake.math import RigidTransform, RollPitchYaw
from shapely.geometry.base import BaseGeometry

from mirdrake.core.digest import digest
from mirdrake.core.errors import WorldError
from mirdrake.core.json_io import Json
from mirdrake.core.paths import resolved
from mirdrake.worlds.actors import Actor, FullActor
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.stored import network_data
from mirdrake.worlds.props import PlacedProp, Prop, prop_names
from mirdrake.worlds.relief import relief_content
from mirdrake.worlds.solids import kind_of
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import World, track_mu

LANGUAGE = "lock/1"
"""Format of a lock file."""

_DECIMALS = 9  # [m, rad]
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
_HEX = re.compile(r"[0-9a-f]{16,}")
_WORDS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}
_LINES = ("patches", "props", "actors", "full_actors")  # lists with a line for each item
_BLOCKS = ("tracks", "starts", "goals", "files")  # mappings with a line for each item


def lock_text(world: World) -> str:
    """Return the lock file of a world.

    Raises:
        WorldError: a file of a prop cannot be read.
    """
    return content_text(lock_content(world))


def lock_hash(world: World) -> str:
    """Return the SHA-256 of the content of a world, 64 hexadecimal digits; equal worlds have equal hashes.

    Raises:
        WorldError: a file of a prop cannot be read.
    """
    return content_hash(lock_content(world))


def content_text(content: Mapping[str, Any]) -> str:
    """Return the lock file of a content, see :func:`lock_content`."""
    lines = [f"mirdrake: {LANGUAGE}", f"hash: {_flow(content_hash(content))}"]
    # One line for each entry, so that a difference of two lock files names what has changed.
    for key, value in content.items():
        if key in _LINES and value:
            lines += [f"{key}:", *(f"- {_flow(item)}" for item in value)]
        elif key in _BLOCKS and value:
            lines.append(f"{key}:")
            for name, item in value.items():
                if key != "tracks":
                    lines.append(f"  {_flow(name)}: {_flow(item)}")
                    continue
                lines.append(f"  {_flow(name)}:")
                lines += [f"    {_flow(k)}: {_flow(v)}" for k, v in item.items() if k != "pieces"]
                lines += ["    pieces:", *(f"    - {_flow(piece)}" for piece in item["pieces"])]
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def content_hash(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the content of a lock file without `mirdrake` and `hash`, as JSON with sorted keys.

    Numbers have no exponent and no trailing zeros, so that the content read from a lock file has the hash in it.
    """
    rest = {key: value for key, value in content.items() if key not in {"mirdrake", "hash"}}
    return digest(_canonical(rest))


def lock_content(world: World) -> Json:
    """Return the content of a world as plain data; lengths in m, angles in rad.

    Raises:
        WorldError: a file of a prop cannot be read.
    """
    spec, ground, lights = world.spec, world.ground, world.spec.signals
    goals: Json = {}
    for name, goal in spec.goals.items():
        if goal.at is not None:
            goals[name] = {"at": _rounded(goal.at), "radius": _rounded(goal.radius or 1.0)}
        elif goal.gate is not None:
            goals[name] = {"gate": {"track": goal.gate.track, "s": _rounded(goal.gate.s)}}
        else:
            goals[name] = {"laps": goal.laps}
    # Keys of features that came later appear only if they are used, so that older lock files stay equal.
    return {
        "language": spec.mirdrake,
        "name": world.name,
        "seed": spec.seed,
        "params": dict(spec.params),
        "ground": {
            "surface": ground.surface, "mu": ground.mu, "extent": _rounded(ground.extent),
            "grade": _rounded(ground.grade), "heading": _rounded(ground.heading),
            **({"relief": _rounded(relief_content(spec.ground.relief, world.path))} if spec.ground.relief else {}),
        },
        "lights": _rounded(spec.lights.model_dump()),
        "sky": spec.sky,
        "patches": [
            {"name": patch.name, "surface": patch.surface, "mu": _rounded(patch.mu), "area": _rings(patch.area)}
            for patch in world.patches
        ],
        "tracks": {name: _track(world, name, track) for name, track in world.tracks.items()},
        **({} if world.network is None else {"network": _network(world, world.network)}),
        "starts": {
            name: {"pose": _rounded((start.x, start.y, start.yaw)), "speed": _rounded(start.speed)}
            | ({} if start.track is None else {"track": start.track, "s": _rounded(start.s)})
            for name, start in world.starts.items()
        },
        "goals": goals,
        "files": {name: digest(read_bytes(path)) for name, path in used_files(world).items()},
        **({"scenery": _rounded([mesh.model_dump() for mesh in spec.scenery])} if spec.scenery else {}),
        "props": [_prop(placed) for placed in world.props],
        **({"signals": {name: _rounded(light.model_dump()) for name, light in lights.items()}} if lights else {}),
        **({"yield_lines": [_rounded(entry.model_dump()) for entry in spec.yield_lines]} if spec.yield_lines else {}),
        **({"actors": [_actor(actor) for actor in world.actors]} if world.actors else {}),
        **({"full_actors": [_full_actor(actor) for actor in world.full_actors]} if world.full_actors else {}),
    }  # fmt: skip


def mesh_files(path: Path) -> list[Path]:
    """Return a mesh and the files that it names: buffers and pictures of a glTF, materials and pictures of an OBJ."""
    files, pictures = [path], []
    kind = path.suffix.lower()
    if kind == ".gltf":
        # The mesh file alone does not determine what is rendered: its buffers and pictures belong to the lock.
        data = json.loads(read_bytes(path))
        uris = [item.get("uri", "data:") for key in ("buffers", "images") for item in data.get(key, ())]
        files += [path.parent / uri for uri in uris if not uri.startswith("data:")]
    elif kind == ".obj":
        materials = re.findall(rb"(?m)^\s*mtllib[ \t]+(.+?)[ \t]*\r?$", read_bytes(path))
        files += [path.parent / name.decode(errors="replace") for name in materials]
        for material in files[1:]:
            names = re.findall(rb"(?m)^\s*map_\w+[ \t]+(?:.*[ \t])?(\S+)[ \t]*\r?$", read_bytes(material))
            pictures += [material.parent / name.decode(errors="replace") for name in names]
    return list(dict.fromkeys(files + pictures))


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises:
        WorldError: the file cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise WorldError(f"cannot be read: {error.strerror or error}", where=path.name) from None


# --- the inner parts ---------------------------------------------------------------------------------------------


def _prop(placed: PlacedProp) -> Json:
    """Return the entry of one prop."""
    prop = placed.prop
    entry: Json = {
        "name": placed.name, "kind": prop.name, "size": _rounded(prop.size), "solids": _solids_hash(prop),
        "pose": _pose(placed.X_WP), "static": placed.static, "color": _rounded(placed.color), "mu": prop.mu,
    }  # fmt: skip
    if not placed.static:
        entry["mass"] = _rounded(prop.mass)
    if prop.driven_over:
        entry["driven_over"] = True
    return entry


def _actor(actor: Actor) -> Json:
    """Return the entry of one actor."""
    # Without the default of `body`, so that lock files of older worlds remain valid.
    hidden = {"actor", "name", "color"} | ({"body"} if actor.spec.body == "ghost" else set())
    return {
        "name": actor.name, "kind": actor.prop.name, "solids": _solids_hash(actor.prop), "color": _rounded(actor.color),
        **_motion(actor, hidden),
    }  # fmt: skip


def _full_actor(actor: FullActor) -> Json:
    """Return the entry of one full vehicle of a world."""
    return {"name": actor.name, "model": actor.model, **_motion(actor, {"actor", "name", "body"})}


def _motion(actor: Actor | FullActor, hidden: set[str]) -> Json:
    """Return where an actor starts, its behaviour and its steps, without some keys."""
    given = actor.spec.model_dump(mode="json", exclude=hidden, exclude_none=True)
    if "recorded" in given:
        given["recorded"]["rows"] = digest(_canonical(given["recorded"]["rows"]))[:16]
    return {**_rounded(given), "steps": [_rounded(step.model_dump(exclude_none=True)) for step in actor.steps]}


@lru_cache(maxsize=4096)
def _solids_hash(prop: Prop) -> str:
    """Return the first 16 digits of the SHA-256 of the collision shapes of a prop."""
    parts: list[Json] = []
    for solid in prop.solids:
        sides: list[float | str] = [*kind_of(solid.shape).sizes(solid.shape)]
        if solid.mesh is not None:
            sides.insert(0, digest(read_bytes(solid.mesh)))
        parts.append({"shape": type(solid.shape).__name__, "sides": _rounded(sides), "pose": _pose(solid.X_PS)})
    return digest(_canonical(parts))[:16]


def _pose(X: RigidTransform) -> list[float]:
    """Return x, y, z [m], yaw, pitch, roll [rad]; a yaw or roll of -180 degrees is written as 180."""
    roll, pitch, yaw = RollPitchYaw(X.rotation()).vector()
    # Half a turn has two signs; one is chosen, so that equal poses have equal hashes.
    values: list[float] = _rounded([*X.translation(), yaw, pitch, roll])
    half_turn = round(float(np.pi), _DECIMALS)
    return [half_turn if index in (3, 5) and value == -half_turn else value for index, value in enumerate(values)]


def _track(world: World, name: str, track: Track) -> Json:
    spec = world.spec.tracks[name]
    entry: Json = {
        "start": _rounded(track.pose_at(0.0)), "length": _rounded(track.length), "width": _rounded(track.width),
        "closed": track.closed, "road": spec.road, "thickness": spec.thickness, "surface": spec.surface,
        "mu": track_mu(spec), "edges": spec.verge,
        "markings": [_rounded(marking.model_dump()) for marking in spec.markings],
    }  # fmt: skip
    if track.edges is not None:
        entry["widths"] = [_rounded(row) for row in np.column_stack(track.edges)]
    entry["pieces"] = [_rounded(piece) for piece in track.pieces]
    return entry


def _network(world: World, network: Network) -> Json:
    """Return the entry of the network: the digest of its lanes, and its signals and stop lines."""
    spec, data = world.spec.network, network_data(network)
    assert spec is not None
    # Lanes without banking have the text, and so the hash, of locks from before banking was read.
    data["lanes"] = [{k: v for k, v in lane.items() if k != "bank" or any(v)} for lane in data["lanes"]]
    return {
        "surface": spec.surface,
        "mu": spec.mu,
        "markings": spec.markings,
        "lanes": len(network.lanes),
        "content": digest(_canonical(_rounded(data))),
    }


def _rings(area: BaseGeometry) -> list[list[list[float]]]:
    """Return the rings of an area, holes after their exterior, each from its lowest corner on [m]."""
    rings = []
    for part in shapely.get_parts(shapely.normalize(area)):
        if part.geom_type == "Polygon":
            for ring in (part.exterior, *part.interiors):
                points = [_rounded(point) for point in shapely.get_coordinates(ring)[:-1]]
                # Polygons may begin at any corner, which must not change the hash.
                first = points.index(min(points))
                rings.append(points[first:] + points[:first])
    return rings


def used_files(world: World) -> dict[str, Path]:
    """Return the files that a world uses, by their names in a lock file; without world files and grids of heights.

    Raises:
        WorldError: a mesh cannot be read.
    """
    folder = world.path.parent if world.path is not None else Path.cwd()
    library = prop_names()
    files: dict[str, Path] = {}
    # Any source of a track (CSV, OpenDRIVE) states its file as `file`.
    for spec in world.spec.tracks.values():
        for value in dict(spec).values():
            if isinstance(name := getattr(value, "file", None), str):
                files[_named(folder / name, folder)] = folder / name
    if world.spec.network is not None:
        files[_named(folder / world.spec.network.file, folder)] = folder / world.spec.network.file
    for actor in world.spec.actors:
        if actor.recorded is not None:
            files[_named(folder / actor.recorded.file, folder)] = folder / actor.recorded.file
    for mesh in world.spec.scenery:
        # A glTF file refers to buffers and textures, which change the picture as well.
        files |= {_named(path, folder): path for path in mesh_files(folder / mesh.file)}
    for prop in dict.fromkeys([*(placed.prop for placed in world.props), *(actor.prop for actor in world.actors)]):
        meshes = [solid.mesh for solid in prop.solids if solid.mesh is not None]
        meshes += [prop.visual] if prop.visual is not None else []
        library_path = library.get(prop.name)
        # A prop of the library is locked by its folder, wherever it is installed; others by their own files.
        if library_path is not None and all(resolved(mesh).is_relative_to(resolved(library_path)) for mesh in meshes):
            for path in sorted(library_path.rglob("*")):
                inner = path.relative_to(library_path)
                if path.is_file() and not any(part.startswith((".", "__")) for part in inner.parts):
                    files[str(PurePosixPath("props", library_path.name, inner))] = path
            continue
        paths = [path for mesh in meshes for path in mesh_files(mesh)]
        paths += {mesh.parent / "prop.yaml" for mesh in meshes if (mesh.parent / "prop.yaml").is_file()}
        files |= {_named(path, folder): path for path in paths}
    return {name: files[name] for name in sorted(files)}


def _named(path: Path, folder: Path) -> str:
    """Return a path relative to the folder of the world; never an absolute one."""
    return PurePosixPath(os.path.relpath(resolved(path), resolved(folder))).as_posix()


def _rounded(value: Any) -> Any:
    """Return plain data with rounded floats."""
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, float | np.floating):
        return round(float(value), _DECIMALS)
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return [_rounded(item) for item in value]
    return value


def _number(value: float) -> str:
    """Return a number as text, without exponent and trailing zeros."""
    text = format(Decimal(repr(value)), "f")
    text = text.rstrip("0").rstrip(".") if "." in text else text
    # Minus zero and zero are the same value.
    return "0" if text == "-0" else text


def _canonical(value: Any) -> str:
    """Return plain data as JSON with sorted keys, numbers as in a lock file."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{json.dumps(key)}:{_canonical(value[key])}" for key in sorted(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(_canonical, value)) + "]"
    # Before numbers, because bool is a subclass of int.
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return json.dumps(value)
    return _number(value)


def _flow(value: Any) -> str:
    """Return plain data as YAML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str):
        # Quoted where YAML would read something else: a keyword, or digits that look like a number.
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS and not _HEX.fullmatch(value)
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    return _number(value)
