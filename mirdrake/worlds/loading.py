"""Worlds from their files: parameters and chance settled, tracks, patches, props, starts and goals laid out.

::

    worlds/<name>.yaml ── load_world ──► WorldSpec ── make_world ──► World
"""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.paths import data_root, find
from mirdrake.core.yaml_io import Source, load_yaml, read_tree, validate, where
from mirdrake.worlds.arrange import Arranger
from mirdrake.worlds.draw import Draw, settle_tree
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.props_spec import GroupSpec, PatchSpec
from mirdrake.worlds.regions import Patch, Places, make_region
from mirdrake.worlds.rules import Rules
from mirdrake.worlds.spec import GoalSpec, GroundSpec, OnTrackSpec, StartSpec, WorldSpec
from mirdrake.worlds.track_layout import make_track
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.values import Number
from mirdrake.worlds.world import SURFACE_MU, Goal, Ground, Start, World

_MARGIN = 50.0  # [m] ground beyond the tracks
_BARE_SIZE = 400.0  # [m] side of the ground of a world without tracks
_SETTLED = ("ground", "tracks", "lights", "sky", "start", "goals", "rules")


def load_world(name: str, *, where: str = "", overrides: Iterable[str] = ()) -> World:
    """The world of that name or file.

    Args:
        name: a name below worlds/ or a path of a YAML file.
        where: prefix of the message when there is no such world, for example ``"drive.yaml:3: world"``.
        overrides: ``"dotted.path=value"`` texts, see :func:`mirdrake.core.yaml_io.parse_yaml`; for example
            ``"params.cars=20"`` or ``"seed=3"``.

    Raises:
        ConfigError: no such world, or the file has faults.
        WorldError: the world cannot be laid out.
    """
    path = find("worlds", name, where=where)
    return _make(*read_tree(path, overrides=overrides), path=path)


def make_world(data: WorldSpec | Mapping[str, Any], *, path: Path | None = None) -> World:
    """A world from its description.

    Args:
        data: the checked description, or the same as plain data, in which texts may stand for values.
        path: the file it came from; other files are looked for beside it.

    Raises:
        ConfigError: the description has faults.
        WorldError: a track does not close or folds in its bends, a length is wrong, a start is outside the world; all
            faults, one per line.
    """
    if isinstance(data, WorldSpec):
        return _lay_out(data, path=path)
    return _make(dict(data), Source("world", {}), path=path)


def _make(data: Any, source: Source, *, path: Path | None) -> World:
    """A world from plain data: values settled, checked, laid out."""
    if isinstance(data, dict):
        data = dict(data)
        seed = data.get("seed", 0)
        draw = Draw(seed if isinstance(seed, int) else 0, "", {})
        parameters: dict[str, Number | str] = {}
        given = data.get("params")
        if isinstance(given, dict):
            for key, value in given.items():
                so_far = Draw(draw.seed, "", parameters)
                if isinstance(value, str):
                    parameters[key] = so_far.parameter(value, f"params.{key}", place=source.where("params", key))
                elif isinstance(value, int | float) and not isinstance(value, bool):
                    parameters[key] = value
        data["params"] = parameters if isinstance(given, dict) and len(parameters) == len(given) else given or {}
        draw = Draw(draw.seed, "", parameters)
        for key in _SETTLED:
            if key in data:
                data[key] = settle_tree(data[key], draw, source, (key,))
        tests = data.get("tests")
        if isinstance(tests, list):
            data["tests"] = [
                {k: settle_tree(v, draw, source, ("tests", i, k)) if k in {"behaviour", "duration"} else v
                 for k, v in test.items()} if isinstance(test, dict) else test
                for i, test in enumerate(tests)
            ]  # fmt: skip
    return _lay_out(validate(data, WorldSpec, source), path=path)


def _lay_out(spec: WorldSpec, *, path: Path | None) -> World:
    folder = path.parent if path is not None else Path.cwd()
    faults: list[str] = []

    # Tracks and the ground, which is as large as they need.
    tracks: dict[str, Track] = {}
    for name, track_spec in spec.tracks.items():
        try:
            tracks[name] = make_track(track_spec, name=name, folder=folder)
        except (ConfigError, WorldError) as error:
            faults.append(str(error))
    if faults:
        raise WorldError("\n".join(faults))
    ground = _make_ground(spec.ground, tracks)

    # Friction patches, starts and goals.
    draw = Draw(spec.seed, "", spec.params)
    patches: dict[str, Patch] = {}
    for index, patch_spec in enumerate(spec.ground.patches):
        try:
            patch = _make_patch(patch_spec, index, Places(tracks, patches), draw)
            patches[patch.name] = patch
        except ConfigError as error:
            faults.append(str(error))
    starts: dict[str, Start] = {}
    for name, start_spec in (spec.start or {"origin": _default_start(tracks, ground)}).items():
        try:
            starts[name] = _make_start(start_spec, tracks, ground)
        except WorldError as error:
            faults.append(str(error))
    goals: dict[str, Goal] = {}
    for name, goal_spec in spec.goals.items():
        try:
            goals[name] = _make_goal(name, goal_spec, tracks)
        except WorldError as error:
            faults.append(str(error))
    if faults:
        raise WorldError("\n".join(faults))

    faults += [
        f"{where(mesh, 'file')}: no such glTF or OBJ file: {mesh.file[:200]!r}"
        for mesh in spec.scenery
        if not (folder / mesh.file).is_file() or Path(mesh.file).suffix.lower() not in {".gltf", ".obj", ".glb"}
    ]
    if faults:
        raise ConfigError("\n".join(faults))

    # Props, where the rules let them stand.
    places = Places(tracks, patches)
    rules = Rules(spec.rules, places, starts, goals, draw)
    props, homeless = _make_props(spec, places, rules, draw, folder)
    name = spec.name or (path.stem if path else "world")
    return World(
        name, spec, path, tracks, starts, ground, tuple(patches.values()), goals, tuple(props), tuple(homeless), rules
    )


def _make_props(
    spec: WorldSpec, places: Places, rules: Rules, draw: Draw, folder: Path
) -> tuple[list[PlacedProp], list[str]]:
    libraries: dict[str, GroupSpec] = {}
    for index, name in enumerate(spec.use):
        file = folder / name
        if not file.is_file():
            raise ConfigError(f"{where(spec, 'use', index)}: no such file: {name}")
        libraries |= load_yaml(file, WorldSpec).groups

    def find_group(name: str) -> GroupSpec | None:
        if name in spec.groups or name in libraries:
            return spec.groups.get(name) or libraries[name]
        file = data_root() / "worlds" / "groups" / f"{name}.yaml"
        return load_yaml(file, WorldSpec).groups.get(name) if name.isidentifier() and file.is_file() else None

    def group_names() -> list[str]:
        shipped = (file.stem for file in (data_root() / "worlds" / "groups").glob("*.yaml"))
        return sorted({*spec.groups, *libraries, *shipped})

    arranger = Arranger(
        places,
        groups=find_group,
        group_names=group_names,
        folder=folder,
        min_gap=rules.min_gap,
        allowed=rules.allow,
        may_overlap=rules.may_overlap,
    )
    return arranger.arrange(spec.props, draw.below("props"))


def _make_patch(spec: PatchSpec, index: int, places: Places, draw: Draw) -> Patch:
    name = spec.name or f"patch_{index}"
    if name in places.patches:
        raise ConfigError(f"{where(spec, 'name')}: there is a '{name}' already; give each patch its own name")
    mu = draw.number(spec.mu, "", "mu", spec) if spec.mu is not None else SURFACE_MU[spec.surface or "asphalt"]
    if not 0.0 < mu <= 2.0:
        raise ConfigError(f"{where(spec, 'mu')}: {mu:g}; a friction coefficient is above 0 and at most 2")
    return Patch(name, make_region(spec, places, draw.below(f"ground.patches.{name}")), spec.surface, mu)


def _make_goal(name: str, spec: GoalSpec, tracks: Mapping[str, Track]) -> Goal:
    if spec.gate is not None:
        if spec.gate.track not in tracks:
            hint = did_you_mean(spec.gate.track, tracks) if tracks else "the world has none"
            raise WorldError(f"{where(spec.gate, 'track')}: unknown track '{spec.gate.track}'; {hint}")
        return Goal(name, gate=(spec.gate.track, spec.gate.s))
    if spec.laps is not None:
        return Goal(name, laps=spec.laps)
    assert spec.at is not None
    return Goal(name, area=shapely.Point(spec.at).buffer(spec.radius or 1.0))


def _make_ground(spec: GroundSpec, tracks: dict[str, Track]) -> Ground:
    mu = SURFACE_MU[spec.surface] if spec.mu is None else spec.mu
    if tracks:
        boxes = np.array([track.bounds for track in tracks.values()])
        low, high = boxes[:, :2].min(axis=0) - _MARGIN, boxes[:, 2:].max(axis=0) + _MARGIN
    else:
        low, high = np.full(2, -_BARE_SIZE / 2.0), np.full(2, _BARE_SIZE / 2.0)
    if spec.size is not None:
        middle, half = (low + high) / 2.0, np.array(spec.size) / 2.0
        low, high = middle - half, middle + half
    extent = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    return Ground(spec.surface, mu, extent, spec.slope.grade, spec.slope.heading)


def _default_start(tracks: Mapping[str, Track], ground: Ground) -> StartSpec:
    """The origin, or where the first track begins if the origin is not on the ground."""
    xmin, ymin, xmax, ymax = ground.extent
    if not tracks or (xmin <= 0.0 <= xmax and ymin <= 0.0 <= ymax):
        return StartSpec()
    return StartSpec(on_track=OnTrackSpec(track=next(iter(tracks))))


def _make_start(spec: StartSpec, tracks: dict[str, Track], ground: Ground) -> Start:
    if spec.on_track is None:
        x, y = spec.at or (0.0, 0.0)
        ground.check_place(x, y, where=where(spec, "at"))
        return Start(x, y, _folded(spec.yaw or 0.0), spec.speed)
    on_track = spec.on_track
    if on_track.track not in tracks:
        raise WorldError(
            f"{where(spec, 'on_track', 'track')}: unknown track '{on_track.track}'; "
            f"{did_you_mean(on_track.track, tracks)}"
        )
    track = tracks[on_track.track]
    if not 0.0 <= on_track.s <= track.length:
        raise WorldError(
            f"{where(spec, 'on_track', 's')}: start outside the world: s = {on_track.s:g} m; the track is "
            f"{track.length:g} m long"
        )
    side = track.left_width(on_track.s) if on_track.offset > 0.0 else track.right_width(on_track.s)
    if abs(on_track.offset) > side:
        raise WorldError(
            f"{where(spec, 'on_track', 'offset')}: start outside the world: {on_track.offset:g} m beside the centre "
            f"line; the edge of the road is {side:g} m away there; make it at most that"
        )
    x, y, yaw = track.pose_at(on_track.s)
    x, y = x - on_track.offset * math.sin(yaw), y + on_track.offset * math.cos(yaw)
    return Start(x, y, _folded(yaw), spec.speed, on_track.track, on_track.s)


def _folded(angle: float) -> float:
    """The angle within [-π, π]."""
    return math.remainder(angle, 2.0 * math.pi)
