"""Worlds as plain data and back, for run folders.

Nothing is rounded or drawn again: the world that is read equals the one that was written to the last bit. Meshes are
referred to by their files. Rules, tests and unplaced props are left out: they are needed only while a world is made.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import shapely
from pydrake.geometry import Box, Convex, Shape
from pydrake.math import RigidTransform

from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Source, validate
from mirdrake.worlds.actors import lay_out_actors
from mirdrake.worlds.networks.stored import network_data, read_network_data
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.props import PlacedProp, Prop, Solid
from mirdrake.worlds.regions import Patch
from mirdrake.worlds.relief import in_files, make_relief
from mirdrake.worlds.slab import make_slab
from mirdrake.worlds.solids import SOLID_KINDS, kind_of, mesh_of
from mirdrake.worlds.spec import WorldSpec
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import Goal, Ground, Start, World

_GROUND = ("surface", "mu", "extent", "grade", "heading")  # fields of the ground that are stored

FindFile = Callable[[str], Path | None]
"""Returns the file of a reference, or None if it no longer exists."""

_LEFT_OUT: Any = {"include": True, "props": True, "groups": True, "rules": True, "tests": True, "ground": {"patches"}}


def world_data(world: World, refer: Callable[[Path], str]) -> Json:
    """Return a world as data for JSON.

    Args:
        world: the world.
        refer: returns the reference to a mesh file, a text.
    """
    # Props and actors of one kind share their entry.
    used = [placed.prop for placed in world.props] + [actor.prop for actor in world.actors]
    kinds = {kind: index for index, kind in enumerate(dict.fromkeys(used))}
    return {
        "name": world.name,
        "path": None if world.path is None else str(world.path),
        "spec": world.spec.model_dump(mode="json", by_alias=True, exclude=_LEFT_OUT),
        "tracks": {name: _track_data(track) for name, track in world.tracks.items()},
        "starts": {name: vars(start) for name, start in world.starts.items()},
        "ground": {name: getattr(world.ground, name) for name in _GROUND},
        "patches": [vars(patch) | {"area": shapely.to_wkb(patch.area, hex=True)} for patch in world.patches],
        "goals": {
            name: vars(goal) | {"area": None if goal.area is None else shapely.to_wkb(goal.area, hex=True)}
            for name, goal in world.goals.items()
        },
        "kinds": [_prop_data(kind, refer) for kind in kinds],
        "props": [_placed_data(placed, kinds[placed.prop]) for placed in world.props],
        **({} if world.network is None else {"network": network_data(world.network)}),
        "actors": {actor.name: kinds[actor.prop] for actor in world.actors},
    }


def read_world(
    data: Mapping[str, Any],
    find: FindFile,
    *,
    location: str = "world",
    grids: Mapping[str, Path] = MappingProxyType({}),
) -> World:
    """Return the world of the data of :func:`world_data`.

    Args:
        data: data of the world.
        find: returns the file of a reference. A prop whose mesh is missing is rendered by its solids; solids whose
            meshes are missing are left out, or replaced by the bounding box of the prop if none is left.
        location: file of the data, for messages.
        grids: copies of the files of heights, by their names in the world file; others are read where they were.

    Raises:
        ConfigError: the specification has faults.
        KeyError, TypeError, ValueError: the data are not those of a world.
    """
    # Props of one kind share their meshes, so that kinds are stored once and referred to by index.
    kinds = [_read_prop(kind, find) for kind in data["kinds"]]
    spec = validate(data["spec"], WorldSpec, Source(location, {}))
    path = None if data["path"] is None else Path(data["path"])
    tracks = {name: _read_track(name, track) for name, track in data["tracks"].items()}
    network = read_network_data(data["network"]) if data.get("network") else None
    # The ground is computed again from its specification, because the data do not hold its grids.
    folder = path.parent if path is not None else Path.cwd()
    relief = make_relief(in_files(spec.ground.relief, grids), tracks, folder, network)
    slab = make_slab(spec.tracks, tracks, network)
    # Actors are laid out again: their paths follow from the specification without random numbers.
    of_actors = {name: kinds[index] for name, index in data.get("actors", {}).items()}
    actors, full_actors, paths = lay_out_actors(spec, tracks, network, of_actors)
    return World(
        paths=paths,
        actors=actors,
        full_actors=full_actors,
        name=data["name"],
        spec=spec,
        path=path,
        tracks=tracks,
        starts={name: Start(**start) for name, start in data["starts"].items()},
        ground=Ground(**{**data["ground"], "extent": tuple(data["ground"]["extent"]), "relief": relief, "slab": slab}),
        patches=tuple(Patch(**{**patch, "area": shapely.from_wkb(patch["area"])}) for patch in data["patches"]),
        goals={name: _read_goal(goal) for name, goal in data["goals"].items()},
        # Placed objects are read and not arranged again, so that the world is that of the run.
        props=tuple(_read_placed(placed, kinds) for placed in data["props"]),
        network=network,
    )


# --- tracks and goals --------------------------------------------------------------------------------------------


def _track_data(track: Track) -> Json:
    return {
        "pieces": [list(piece) for piece in track.pieces],
        "start": [float(value) for value in track.start],
        "closed": track.closed,
        "width": track.width,
        "edges": None if track.edges is None else [row.tolist() for row in track.edges],
        "notes": list(track.notes),
    }


def _read_track(name: str, data: Mapping[str, Any]) -> Track:
    x, y, yaw = data["start"]
    edges = None if data["edges"] is None else tuple(np.array(row) for row in data["edges"])
    pieces = [Piece(*piece) for piece in data["pieces"]]
    given: Any = {"closed": data["closed"], "width": data["width"], "edges": edges, "notes": data["notes"]}
    return Track(pieces, start=(x, y, yaw), name=name, **given)


def _read_goal(data: Mapping[str, Any]) -> Goal:
    area, gate = data["area"], data["gate"]
    return Goal(
        data["name"],
        area=None if area is None else shapely.from_wkb(area),
        gate=None if gate is None else (gate[0], gate[1]),
        laps=data["laps"],
    )


# --- props -------------------------------------------------------------------------------------------------------


def _pose_data(X: RigidTransform) -> list[list[float]]:
    rows: list[list[float]] = X.GetAsMatrix34().tolist()
    return rows


def _read_pose(rows: Any) -> RigidTransform:
    matrix = np.vstack([np.array(rows, dtype=float), [0.0, 0.0, 0.0, 1.0]])
    return RigidTransform(matrix)


def _shape_data(shape: Shape, refer: Callable[[Path], str]) -> Json:
    kind, mesh = kind_of(shape), mesh_of(shape)
    return {kind.key: kind.sizes(shape)} if mesh is None else {"mesh": refer(mesh), "scale": kind.sizes(shape)}


def _read_shape(data: Mapping[str, Any], find: FindFile) -> Shape | None:
    if "mesh" in data:
        path = find(data["mesh"])
        return None if path is None else Convex(str(path), np.array(data["scale"]))
    kind = next(kind for kind in SOLID_KINDS if kind.key in data)
    return kind.make(data[kind.key])


def _prop_data(prop: Prop, refer: Callable[[Path], str]) -> Json:
    return vars(prop) | {
        "solids": [{"pose": _pose_data(solid.X_PS), **_shape_data(solid.shape, refer)} for solid in prop.solids],
        "visual": None if prop.visual is None else refer(prop.visual),
    }


def _read_prop(data: Mapping[str, Any], find: FindFile) -> Prop:
    solids = []
    for entry in data["solids"]:
        shape = _read_shape(entry, find)
        if shape is not None:
            solids.append(Solid(shape, _read_pose(entry["pose"])))
    # A prop whose meshes are gone is drawn as the box of its size.
    if not solids:
        middle = RigidTransform([0.0, 0.0, 0.5 * data["size"][2]])
        solids = [Solid(Box(*data["size"]), middle)]
    changed = {
        "solids": tuple(solids),
        "visual": None if data["visual"] is None else find(data["visual"]),
        "size": tuple(data["size"]),
        "scale": tuple(data["scale"]),
    }
    return Prop(**{**data, **changed})


def _placed_data(placed: PlacedProp, kind: int) -> Json:
    content = {field.name: getattr(placed, field.name) for field in fields(placed)}
    return content | {"prop": kind, "X_WP": _pose_data(placed.X_WP)}


def _read_placed(data: Mapping[str, Any], kinds: list[Prop]) -> PlacedProp:
    changed = {
        "prop": kinds[data["prop"]],
        "X_WP": _read_pose(data["X_WP"]),
        "color": None if data["color"] is None else tuple(data["color"]),
        "order": tuple(data["order"]),
    }
    return PlacedProp(**{**data, **changed})
