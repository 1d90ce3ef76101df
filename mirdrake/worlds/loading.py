"""Loading of worlds: values are evaluated, then tracks, patches, props, starts and goals are laid out.

::

    worlds/<name>.yaml ── load_world ──► WorldSpec ── make_world ──► World
"""

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import shapely

from mirdrake.core.errors import ConfigError, MirdrakeError, WorldError, did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.maths import wrap_angle
from mirdrake.core.paths import data_root, find
from mirdrake.core.yaml_io import Source, display_path, load_yaml, parse_tree, read_tree, validate, where
from mirdrake.ground import Terrain
from mirdrake.worlds.actor_entries import evaluate_actors, evaluate_scenario
from mirdrake.worlds.actors import lay_out_actors
from mirdrake.worlds.arrange import Arranger
from mirdrake.worlds.draw import Draw, evaluate_tree
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.network_spec import make_network
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.props_spec import GroupSpec
from mirdrake.worlds.recorded import read_recording
from mirdrake.worlds.regions import NamedAreas, Patch, PatchSpec, make_region
from mirdrake.worlds.relief import make_relief
from mirdrake.worlds.rules import Rules
from mirdrake.worlds.shapes import MESH_SUFFIXES
from mirdrake.worlds.slab import make_slab
from mirdrake.worlds.spec import GoalSpec, OnTrackSpec, StartSpec, WorldSpec
from mirdrake.worlds.track_layout import make_track
from mirdrake.worlds.tracks import Track, check_station, find_track
from mirdrake.worlds.values import Number
from mirdrake.worlds.world import SURFACE_MU, Goal, Ground, Start, World

_MARGIN = 50.0  # [m] ground beyond the tracks
_BARE_SIZE = 400.0  # [m] side of the ground of a world without tracks
_EVALUATED = ("ground", "tracks", "network", "lights", "sky", "start", "goals", "rules", "signals")
_EVALUATED_IN_TESTS = {"behaviour", "duration", "others"}

_Made = TypeVar("_Made")


def load_world(name: str, *, where: str = "", overrides: Iterable[str] = ()) -> World:
    """Load the world of a name or a file.

    Args:
        name: a name below worlds/ or the path of a YAML file.
        where: prefix of the message if the world does not exist, for example ``"drive.yaml:3: world"``.
        overrides: ``"dotted.path=value"`` texts, see :func:`mirdrake.core.yaml_io.parse_yaml`; for example
            ``"params.cars=20"`` or ``"seed=3"``.

    Raises:
        ConfigError: the world does not exist, or the file has faults.
        WorldError: the world cannot be laid out.
    """
    path = find("worlds", name, where=where)
    return _make(*read_tree(path, overrides=overrides), path=path)


def parse_world(text: str, path: Path, *, seed: int | None = None) -> World:
    """Make a world from the text of a world file that need not be saved.

    Args:
        text: the text.
        path: its file; messages name it, and other files are relative to it.
        seed: instead of that of the file.

    Raises:
        ConfigError: the text has faults.
        WorldError: the world cannot be laid out.
    """
    data, source = parse_tree(text, display_path(path))
    if seed is not None and isinstance(data, dict):
        data = {**data, "seed": seed}
    return _make(data, source, path=path)


def make_world(data: WorldSpec | Mapping[str, Any], *, path: Path | None = None) -> World:
    """Make a world from its specification.

    Args:
        data: the specification, or plain data with expressions.
        path: file of the data; other files are relative to it.

    Raises:
        ConfigError: the specification has faults.
        WorldError: a track does not close or folds in its bends, a length is wrong, a start is outside the world; all
            faults, one per line.
    """
    if isinstance(data, WorldSpec):
        return _lay_out(data, path=path)
    return _make(dict(data), Source("world", {}), path=path)


def _make(data: Any, source: Source, *, path: Path | None) -> World:
    """Make a world from plain data: evaluate, validate, lay out."""
    actor_entries: tuple[int, ...] = ()
    if isinstance(data, dict):
        data, source, actor_entries = _evaluated(dict(data), source)
    return _lay_out(_validate(data, source), path=path, actor_entries=actor_entries)


def _validate(data: Any, source: Source) -> WorldSpec:
    """Validate the data of a world; faults of starts and goals state what only the whole file shows."""
    tracks: Any = None
    if isinstance(data, dict):
        _check_names(data, source)
        tracks = data.get("tracks")
    try:
        return validate(data, WorldSpec, source)
    except ConfigError as error:
        hint = did_you_mean("", tracks) if isinstance(tracks, dict) and tracks else "the world has no tracks"
        faults = [
            ConfigError(f"{fault.text}: the name of a track; {hint}", where=fault.where, code=fault.code)
            if fault.code == "missing_key" and fault.path[-1] == "track"
            else fault
            for fault in error.faults
        ]
        raise ConfigError(faults=faults) from None


def _check_names(data: Json, source: Source) -> None:
    """Reject a start or goal without a name, whose keys would be taken for names."""
    for key, schema in (("start", StartSpec), ("goals", GoalSpec)):
        entries = data.get(key)
        for name, entry in entries.items() if isinstance(entries, dict) else ():
            named = isinstance(entry, dict) and not schema.model_fields.keys().isdisjoint(entry)
            if name in schema.model_fields and not named:
                text = f"has no name; write {key}: {{NAME: {{{name}: …}}}}, with a name of your choice"
                raise source.error(text, key, code="missing_key")


def _evaluated(data: Json, source: Source) -> tuple[Json, Source, tuple[int, ...]]:
    """Return a world file with its parameters and the values outside of props evaluated, and its locations.

    The numbers are those of the entries of the actors, see :attr:`mirdrake.worlds.world.World.actor_entries`.
    """
    seed = data.get("seed", 0)
    # An invalid seed is reported by the validation below; here any number will do.
    draw = Draw(seed if isinstance(seed, int) else 0, "", {})
    # Parameters one after the other, because each may use those before it; invalid ones are left to the validation.
    parameters: dict[str, Number | str] = {}
    given = data.get("params")
    if isinstance(given, dict):
        for key, value in given.items():
            if isinstance(value, str):
                earlier = Draw(draw.seed, "", parameters)
                parameters[key] = earlier.parameter(value, f"params.{key}", location=source.where("params", key))
            elif isinstance(value, int | float) and not isinstance(value, bool):
                parameters[key] = value
    # If a parameter was invalid, the original data are kept, so that the validation sees and names it.
    data["params"] = parameters if isinstance(given, dict) and len(parameters) == len(given) else given or {}
    draw = Draw(draw.seed, "", parameters)
    # Values in props stay expressions: they are evaluated for each prop with its own random stream.
    for key in _EVALUATED:
        if key in data:
            data[key] = evaluate_tree(data[key], draw, source, (key,))
    tests = data.get("tests")
    if isinstance(tests, list):
        data["tests"] = [
            {
                key: evaluate_tree(value, draw, source, ("tests", i, key)) if key in _EVALUATED_IN_TESTS else value
                for key, value in test.items()
            }
            if isinstance(test, dict)
            else test
            for i, test in enumerate(tests)
        ]
    actor_entries: tuple[int, ...] = ()
    if "actors" in data:
        data["actors"], source, actor_entries = evaluate_actors(data["actors"], draw, source)
    if "scenario" in data:
        data["scenario"] = evaluate_scenario(data["scenario"], draw, source)
    return data, source, actor_entries


def _lay_out(spec: WorldSpec, *, path: Path | None, actor_entries: tuple[int, ...] = ()) -> World:
    folder = path.parent if path is not None else Path.cwd()
    name = spec.name or (path.stem if path else "world")

    # Tracks and the ground, which is as large as they need.
    faults: list[MirdrakeError] = []
    network = None if spec.network is None else make_network(spec.network, folder)
    tracks = _collect(
        spec.tracks,
        lambda name, track: make_track(track, name=name, folder=folder, seed=spec.seed, network=network),
        faults,
    )
    # Everything below needs the tracks, so that their faults are reported first, all at once.
    _raise(faults)
    ground = _make_ground(spec, tracks, network, folder)

    # Friction patches, starts and goals.
    draw = Draw(spec.seed, "", spec.params)
    patches: dict[str, Patch] = {}
    # One after the other, as a patch may refer to those before it by name.
    for index, patch_spec in enumerate(spec.ground.patches):
        try:
            patch = _make_patch(patch_spec, index, NamedAreas(tracks, patches), draw)
            patches[patch.name] = patch
        except ConfigError as error:
            faults.append(error)
    start_specs = spec.start or {"origin": _default_start(tracks, ground)}
    starts = _collect(start_specs, lambda _, start: _make_start(start, tracks, ground), faults)
    goals = _collect(spec.goals, lambda name, goal: _make_goal(name, goal, tracks), faults)
    _raise(faults)
    missing = [
        ConfigError(f"no such glTF or OBJ file: {mesh.file[:200]!r}", where=where(mesh, "file"))
        for mesh in spec.scenery
        if not (folder / mesh.file).is_file() or Path(mesh.file).suffix.lower() not in MESH_SUFFIXES
    ]
    if missing:
        raise ConfigError(faults=missing)

    # Props, where the rules allow them.
    areas = NamedAreas(tracks, patches)
    rules = Rules(spec.rules, areas, starts, goals, draw)
    props, unplaced = _make_props(spec, areas, rules, draw, folder, ground.terrain)
    for actor in spec.actors:
        read_recording(actor, folder)
    actors, full_actors, paths = lay_out_actors(spec, tracks, network)
    world = World(
        name, spec, path, tracks, starts, ground, tuple(patches.values()), goals, tuple(props), tuple(unplaced), rules,
        network, paths=paths, actors=actors, full_actors=full_actors, actor_entries=actor_entries,
    )  # fmt: skip
    world.lights, world.yield_lines  # noqa: B018 - reports faults of signals and lines
    return world


def _collect(
    specs: Mapping[str, Any], make: Callable[[str, Any], _Made], faults: list[MirdrakeError]
) -> dict[str, _Made]:
    """Return the objects made of all specifications by name; append the faults of those that are invalid."""
    made: dict[str, _Made] = {}
    for name, spec in specs.items():
        try:
            made[name] = make(name, spec)
        except MirdrakeError as error:
            faults.append(error)
    return made


def _raise(faults: list[MirdrakeError]) -> None:
    if faults:
        raise WorldError(faults=faults)


def _make_props(
    spec: WorldSpec, areas: NamedAreas, rules: Rules, draw: Draw, folder: Path, terrain: Terrain
) -> tuple[list[PlacedProp], list[WorldError]]:
    included: dict[str, GroupSpec] = {}
    # Included files contribute groups only; later files override earlier ones.
    for index, name in enumerate(spec.include):
        file = folder / name
        if not file.is_file():
            raise ConfigError(f"no such file: {name}", where=where(spec, "include", index))
        included |= load_yaml(file, WorldSpec).groups
    shipped = data_root() / "worlds" / "groups"

    def find_group(name: str) -> GroupSpec | None:
        # Groups of the file itself come first, then included ones, then those of the library.
        if name in spec.groups or name in included:
            return spec.groups.get(name) or included[name]
        file = shipped / f"{name}.yaml"
        return load_yaml(file, WorldSpec).groups.get(name) if name.isidentifier() and file.is_file() else None

    arranger = Arranger(
        areas,
        groups=find_group,
        group_names=lambda: sorted({*spec.groups, *included, *(file.stem for file in shipped.glob("*.yaml"))}),
        folder=folder,
        terrain=terrain,
        min_gap=rules.min_gap,
        allowed=rules.allow,
        may_overlap=rules.may_overlap,
    )
    return arranger.arrange(spec.props, draw.below("props"))


def _make_patch(spec: PatchSpec, index: int, areas: NamedAreas, draw: Draw) -> Patch:
    name = spec.name or f"patch_{index}"
    if name in areas.patches:
        raise ConfigError(f"'{name}' is used twice; give each patch its own name", where=where(spec, "name"))
    mu = draw.number(spec.mu, "", "mu", spec) if spec.mu is not None else SURFACE_MU[spec.surface or "asphalt"]
    if not 0.0 < mu <= 2.0:
        raise ConfigError(f"{mu:g}; a friction coefficient is above 0 and at most 2", where=where(spec, "mu"))
    return Patch(name, make_region(spec, areas, draw.below(f"ground.patches.{name}")), spec.surface, mu)


def _make_goal(name: str, spec: GoalSpec, tracks: Mapping[str, Track]) -> Goal:
    if spec.gate is not None:
        track = find_track(spec.gate.track, tracks, where=where(spec.gate, "track"))
        check_station(spec.gate.s, track, where=where(spec.gate, "s"))
        return Goal(name, gate=(spec.gate.track, spec.gate.s))
    if spec.laps is not None:
        return Goal(name, laps=spec.laps)
    assert spec.at is not None
    return Goal(name, area=shapely.Point(spec.at).buffer(spec.radius or 1.0))


def _make_ground(world: WorldSpec, tracks: dict[str, Track], network: Network | None, folder: Path) -> Ground:
    spec = world.ground
    mu = SURFACE_MU[spec.surface] if spec.mu is None else spec.mu
    boxes = np.array([road.bounds for road in (*tracks.values(), network) if road is not None])
    if len(boxes):
        # The ground covers all roads with a margin; without roads it is a square about the origin.
        low, high = boxes[:, :2].min(axis=0) - _MARGIN, boxes[:, 2:].max(axis=0) + _MARGIN
    else:
        low, high = np.full(2, -_BARE_SIZE / 2.0), np.full(2, _BARE_SIZE / 2.0)
    if spec.size is not None:
        # A given size keeps the middle, so that the roads stay in the middle of the ground.
        middle, half = (low + high) / 2.0, np.array(spec.size) / 2.0
        low, high = middle - half, middle + half
    extent = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    relief, slab = make_relief(spec.relief, tracks, folder, network), make_slab(world.tracks, tracks, network)
    return Ground(spec.surface, mu, extent, spec.slope.grade, spec.slope.heading, relief, slab)


def _default_start(tracks: Mapping[str, Track], ground: Ground) -> StartSpec:
    """Return a start at the origin, or at the start of the first track if the origin is not on the ground."""
    xmin, ymin, xmax, ymax = ground.extent
    if not tracks or (xmin <= 0.0 <= xmax and ymin <= 0.0 <= ymax):
        return StartSpec()
    return StartSpec(on_track=OnTrackSpec(track=next(iter(tracks))))


def _make_start(spec: StartSpec, tracks: dict[str, Track], ground: Ground) -> Start:
    # Start by coordinates: only the ground limits it.
    if spec.on_track is None:
        x, y = spec.at or (0.0, 0.0)
        ground.check_position(x, y, where=where(spec, "at"))
        return Start(x, y, wrap_angle(spec.yaw or 0.0), spec.speed)
    on_track = spec.on_track
    track = find_track(on_track.track, tracks, where=where(spec, "on_track", "track"))
    if not 0.0 <= on_track.s <= track.length:
        raise WorldError(
            f"start outside the world: s = {on_track.s:g} m; the track is {track.length:g} m long",
            where=where(spec, "on_track", "s"),
        )
    # Both sides may have different widths, which may vary along the track.
    side = track.left_width(on_track.s) if on_track.offset > 0.0 else track.right_width(on_track.s)
    if abs(on_track.offset) > side:
        raise WorldError(
            f"start outside the world: {on_track.offset:g} m beside the centre "
            f"line; the edge of the road is {side:g} m away there; make the offset at most that",
            where=where(spec, "on_track", "offset"),
        )
    x, y, yaw = track.pose_at(on_track.s)
    # Offset to the left of the direction of the track.
    x, y = x - on_track.offset * math.sin(yaw), y + on_track.offset * math.cos(yaw)
    return Start(x, y, wrap_angle(yaw), spec.speed, on_track.track, on_track.s)
