"""Import of Gazebo worlds into world files.

::

    .world .sdf ── read_world ──► SourceWorld     read_world.py, read_model.py, read_crowd.py
    SourceWorld ── make_ground ──► GroundText     ground.py: planes, floors, roads
    SourceWorld ── Converter ──► Entry, ...       convert.py: known.py, prop_folder.py, surfaces.py
    Entry, ... ── settle ──► Entry, ...           settle.py: loose objects
    Entry, ... ── world_text ──► <name>.yaml      entry.py, text.py
    all of it: import_world ──► WorldImport       here

The new files appear when they are complete. Every difference from the source is a Change, listed in <name>.md beside
the world.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.math import RollPitchYaw

from mirdrake.core.errors import ModelError
from mirdrake.core.files import staging
from mirdrake.core.wording import plural
from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.places import Places, without_folder
from mirdrake.importing.sdf.search import Models
from mirdrake.importing.target import check_target, load_imported, plain_name
from mirdrake.importing.worlds.convert import Converter
from mirdrake.importing.worlds.entry import Entry, degrees, into_grids, number
from mirdrake.importing.worlds.ground import GroundText, make_ground
from mirdrake.importing.worlds.model import Array, SourceWorld
from mirdrake.importing.worlds.placed import find_overlaps, place, reach
from mirdrake.importing.worlds.read_world import read_world
from mirdrake.importing.worlds.settle import settle
from mirdrake.importing.worlds.starts import CAR, FreePlaces
from mirdrake.importing.worlds.text import report_text, world_text
from mirdrake.vehicles.scaffold import check_name
from mirdrake.world_checks import check_world
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.world_checks.support import find_unsupported
from mirdrake.worlds import World
from mirdrake.worlds.props import PlacedProp

__all__ = ["Change", "WorldImport", "import_world"]

_AHEAD = 30.0  # [m] to be free ahead of the origin, where a world without starts has its start
_REACH = 200.0  # [m] of the ground of a world without tracks and size
_FARTHEST = 2000.0  # [m] up to which the ground is widened to surfaces; solvers lose digits far from the origin
_MARGIN = 20.0  # [m] ground beyond the props
_MOST_PAIRS = 60  # overlaps that are named one by one
_MOST_ENTRIES = 5000  # of a world


@dataclass(frozen=True)
class WorldImport:
    """Result of an import.

    Attributes:
        path: path of the world file.
        world_text: its text.
        changes: everything that differs from the source.
        checks: sentences on what the user should check.
        entries: number of entries.
    """

    path: Path
    world_text: str
    changes: tuple[Change, ...]
    checks: tuple[str, ...] = ()
    entries: int = 0


def import_world(
    path: Path | str,
    *,
    name: str | None = None,
    folder: Path | str | None = None,
    packages: Mapping[str, Path] | None = None,
    strict: bool = False,
    force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> WorldImport:
    """Make a world file from a world of Gazebo: ``<name>.yaml``, ``<name>.md`` and the props below ``<name>/props/``.

    Args:
        path: the .world or .sdf file.
        name: name of the world; that of the source if left out.
        folder: folder of the result; ``worlds`` in the working directory if left out.
        packages: model or package name -> folder, besides those found around the file and on Gazebo's search paths.
        strict: reject a world if collision geometry would be left out.
        force: replace a world of that name.
        progress: called with the current step.

    Raises:
        ConfigError: name or place are not allowed.
        ModelError: the file cannot be read or holds no world, or, if strict, the first object that is missing; nothing
            is written then.
        MissingDependencyError: a mesh format needs a package that is not installed.
    """
    show_progress = progress or _ignore_progress
    source = Path(path)
    if name is not None:
        check_name(name)
    show_progress("reading")
    world = read_world(source, models=Models(source, packages))
    name = name or plain_name(world.name)
    target = Path(folder or "worlds")
    replaced = check_target(target, name, force=force, made={"props"})
    places = Places(source)
    # The new files appear together at the end, so that a failed import leaves the old world as it is.
    with staging(target) as stage:
        result = _build(world, name, stage.path, places, strict=strict, show_progress=show_progress)
        stage.publish(replaced)
    return WorldImport(target / f"{name}.yaml", *result)


def _build(
    world: SourceWorld, name: str, building: Path, places: Places, *, strict: bool, show_progress: Callable[[str], None]
) -> tuple[str, tuple[Change, ...], tuple[str, ...], int]:
    """Write the world into `building`; return its text, changes, checks and number of entries."""
    changes = world.changes
    # Ground first, since its height is subtracted from all objects.
    ground = make_ground(world, changes)
    converter = Converter(name, building, ground.height, changes, show_progress)
    entries = converter.entries(world)
    scenery = converter.scenery(ground.drawn)
    if strict and converter.lost:
        faults = list(dict.fromkeys(places.text(str(fault)) for fault in converter.lost))
        more = f"; {len(faults) - 1} more like it" if len(faults) > 1 else ""
        raise ModelError(f"{faults[0]}{more}; without strict it is left out and reported")
    if len(entries) > _MOST_ENTRIES:
        raise ModelError(
            f"{len(entries)} objects; a world has at most {_MOST_ENTRIES} entries", where=f"{world.files[0]}:1"
        )
    where = f"{world.files[0]}:1"
    suns = [sun for sun in world.suns if _shines(sun.direction)]
    for sun in world.suns:
        if sun is not (suns[0] if suns else None):
            why = "a world has one sun" if sun in suns else "it shines upwards; the sun has to be above the horizon"
            changes.add(Code.LIGHT, sun.where, f"directional light '{sun.name}'", "…", None, why)
    # Objects of the source may overlap, float or be buried; rules allow it in the new world.
    show_progress("placing")
    props = place(entries, building)
    if settle(entries, props, where, changes):
        props = place(entries, building)
    overlaps = _overlap_rules(props, where, changes)
    heights = _height_rules(props, where, changes)
    # Rules name single props, so entries are merged into grids only without rules.
    grids = into_grids(entries) if not overlaps and not heights else entries
    _widen(ground, props, where, changes)
    # Of the pose of a vehicle only x, y and yaw make a start on the ground.
    starts = {
        start: f"at: [{number(X.translation()[0])}, {number(X.translation()[1])}], "
        f"yaw: {degrees(RollPitchYaw(X.rotation()).yaw_angle())}"
        for start, X in converter.starts.items()
    }
    file = building / f"{name}.yaml"

    def write(starts: Mapping[str, str]) -> World:
        text = world_text(
            name, source=places.file(world.files[0]), ground=ground, suns=suns, starts=starts, entries=grids,
            scenery=scenery, overlaps=overlaps, heights=heights,
        )  # fmt: skip
        file.write_text(text, encoding="utf-8")
        return load_imported(file, world.files[0])

    show_progress("loading")
    laid = write(starts)
    # The world is loaded before the starts are known, because the search needs it laid out.
    show_progress("looking for a free start")
    free = FreePlaces(laid)
    first, remark = _free_start(laid, free, props)
    blocked = [start for start in starts if not free.is_start(laid.starts[start])]
    for start in blocked:
        why = f"no free space for a car of the size of {CAR}"
        changes.add(Code.START, where, f"start '{start}'", starts.pop(start), None, why)
    if first or blocked:
        laid = write({**first, **starts})
    if first:
        became = ", ".join(f"start '{label}': {keys}" for label, keys in first.items())
        changes.add(Code.START, where, "start", remark, became, f"free space for a car of the size of {CAR}")
    # The report lists what `mirdrake world check` would find.
    show_progress("checking")
    remaining = [without_folder(fault.text, building) for fault in check_world(laid, vehicle=CAR, first_steps=True)]
    checks = tuple(map(places.text, _checks(world, converter, props, grids, overlaps, ground)))
    checks += tuple(f"world check: {text}" for text in remaining)
    reported = tuple(dict.fromkeys(map(places.change, changes)))
    report = report_text(name, files=world.files, entries=grids, changes=reported, places=places, checks=checks)
    (building / f"{name}.md").write_text(report, encoding="utf-8")
    return file.read_text(encoding="utf-8"), reported, checks, len(grids)


def _free_start(world: World, free: FreePlaces, props: list[PlacedProp]) -> tuple[dict[str, str], str]:
    """Return a start with room for a car, and what is wrong with the first start of the source.

    It is on the track with the most room ahead along its line (the longest of several), else where the first start is,
    or as near to it as there is room. Nothing is returned if the first start of the source has room,
    if a world without starts has room ahead of its origin, or if no place has room.
    """
    name, start = next(iter(world.starts.items()))
    if world.spec.start and free.is_start(start):
        return {}, ""
    remark = "none" if not world.spec.start else f"no free space at '{name}'"
    new = next(word for word in ("road", "free", "free_start") if word not in world.spec.start)
    on_track = free.find_on_tracks()
    if on_track is not None:
        return {new: f"on_track: {{track: {on_track[0]}, s: {number(on_track[1])}}}"}, remark
    if free.is_free(start.x, start.y, start.yaw, ahead=_AHEAD):
        return {}, ""
    pose = free.find_near(start.x, start.y)
    # The last attempt is around the middle of all props.
    if pose is None and props:
        middle = np.mean([[*prop.footprint.centroid.coords[0]] for prop in props], axis=0)
        pose = free.find_near(float(middle[0]), float(middle[1]))
    if pose is None:
        return {}, ""
    new = next(word for word in ("free", "free_start") if word not in world.spec.start)
    return {new: f"at: [{number(pose[0])}, {number(pose[1])}], yaw: {degrees(pose[2])}"}, (
        remark if world.spec.start else "no free space ahead of the origin"
    )


def _height_rules(props: list[PlacedProp], where: str, changes: Changes) -> dict[str, float]:
    """Return tolerances for fixed objects above or below the ground in the source: name -> tolerance [m]."""
    near = Neighbours(props)
    # Rounded up to the next centimetre, so that the rule still holds with the digits of the file.
    off = {
        fault.names[0]: math.ceil(100.0 * (fault.depth or 0.0) + 1.0) / 100.0 for fault in find_unsupported(near, None)
    }
    fixed = {prop.name for prop in props if prop.static}
    off = {name: gap for name, gap in off.items() if name in fixed}
    if off:
        named = ", ".join(list(off)[:5]) + (" …" if len(off) > 5 else "")
        why = "fixed objects may float or be buried in the source"
        changes.add(
            Code.RULE, where, "height of objects", f"{len(off)} off the ground: {named}", "allowed by rules", why
        )
    return off if len(off) <= _MOST_PAIRS else {"*": max(off.values())}


def _shines(direction: Array) -> bool:
    length = float(np.linalg.norm(direction))
    return length > 1e-9 and float(direction[2]) < -1e-3 * length


def _overlap_rules(props: list[PlacedProp], where: str, changes: Changes) -> list[tuple[str, str]]:
    """Return the overlapping pairs of the source as rules; one rule for all if there are many."""
    pairs = find_overlaps(props)
    if not pairs:
        return []
    shown_pairs = ", ".join(f"{a} and {b}" for a, b in pairs[:5]) + (" …" if len(pairs) > 5 else "")
    was = f"{plural(len(pairs), 'pair')}: {shown_pairs}"
    why = "objects of a world may not overlap without a rule"
    changes.add(Code.RULE, where, "overlapping objects", was, "allowed by rules", why)
    return pairs if len(pairs) <= _MOST_PAIRS else [("*", "*")]


def _widen(ground: GroundText, props: list[PlacedProp], where: str, changes: Changes) -> None:
    """Widen the ground to all objects and patches; with tracks its size is centred on them."""
    far = max(reach(props), min(ground.reach, _FARTHEST))
    half = min(ground.size) / 2.0 if ground.size is not None else _REACH
    if ground.routes:
        bounds = np.array([route.track.bounds for route in ground.routes.values()])
        low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        middle = 0.5 * (low + high)
        wide = np.array(ground.size if ground.size is not None else (0.0, 0.0)) / 2.0
        wide = np.maximum(wide, far + _MARGIN) if far > wide.min() else wide
        # The ground is centred on the tracks, so that it has to reach back to objects around the origin.
        sides = 2.0 * np.maximum(wide + np.abs(middle), 0.5 * (high - low) + _MARGIN)
        ground.size = (float(np.ceil(sides[0])), float(np.ceil(sides[1])))
        return
    if far <= half:
        return
    side = 2.0 * float(np.ceil((far + _MARGIN) / 10.0) * 10.0)
    was = "size of the visual plane" if ground.size is not None else "400 m x 400 m"
    ground.size = (max(side, ground.size[0]), max(side, ground.size[1])) if ground.size else (side, side)
    why = "objects and surfaces are further out"
    changes.add(Code.GROUND, where, "ground", was, f"{ground.size[0]:g} m x {ground.size[1]:g} m", why)


def _checks(
    world: SourceWorld,
    converter: Converter,
    props: list[PlacedProp],
    entries: Sequence[Entry],
    overlaps: Sequence[tuple[str, str]],
    ground: GroundText,
) -> Sequence[str]:
    """Return what the user should check."""
    checks = []
    if converter.lost:
        count = len(converter.lost)
        checks.append(f"{plural(count, 'fault')} left out collision geometry: see below.")
    if any(change.code is Code.STAND_IN_UNSURE for change in world.changes):
        checks.append("Size and heading of props that replace models: not all were measured.")
    # Five centimetres: less is rounding of the source.
    buried = [prop.name for prop in props if prop.bottom < -0.05]
    if buried:
        checks.append(f"Below the ground: {', '.join(buried[:8])}{' …' if len(buried) > 8 else ''}.")
    if overlaps:
        checks.append("Objects overlap as in the source; rules allow it.")
    if not entries and not world.planes and not ground.patches and not ground.tracks:
        checks.append("The world is empty.")
    return checks


def _ignore_progress(_text: str) -> None:
    """Ignore a progress message."""
