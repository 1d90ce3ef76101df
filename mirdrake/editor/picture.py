"""The scene as JSON for the page: outlines in W as paths of SVG, elements with handles and values."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import MirdrakeError, Place
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_edit import REMOVED, scalar_text, value_at
from mirdrake.core.yaml_io import display_path
from mirdrake.core.yaml_items import find_span, source_of
from mirdrake.editor.elements import Element
from mirdrake.editor.marks import Mark
from mirdrake.editor.scene import Scene, prop_key
from mirdrake.world_checks.faults import Fault
from mirdrake.worlds.drawing import make_drawing
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import World

_TOLERANCE = 0.02  # [m] of outlines of the ground and roads
_SMALL = 1.0  # [m], what is smaller is hard to see on the map of a street
_CAR_HEIGHT = 1.5  # [m] of a full vehicle as it is drawn
_MOST_FIELDS = 60  # values of an element in the panel


def make_picture(scene: Scene) -> Json:
    """Return what the page draws: the ground with its areas and lines, props, starts, goals, and the elements."""
    drawing = make_drawing(scene.world)
    areas = [
        {"layer": area.layer, "name": area.name, "surface": area.surface or "", "d": path_of(area.area)}
        for area in drawing.areas
        # Props have outlines of their own, which the page can drag.
        if area.layer not in {"prop", "ground"}
    ]
    lines = [
        {"layer": line.layer, "name": line.name, "d": _polyline(line.points), "width": line.width, "dash": line.dash}
        for line in drawing.lines
    ]
    # Lines to follow that are not roads can be selected as well.
    lines += [
        {"layer": "centre", "name": name, "d": _polyline(_centre_line(track)), "width": 0.0, "dash": None}
        for name, track in scene.world.tracks.items()
        if name not in scene.world.roads()
    ]
    return {
        "name": scene.world.name,
        "bounds": list(drawing.bounds),
        "view": list(view_of(scene.world)),
        "ground": scene.world.ground.surface,
        "areas": areas,
        "lines": lines,
        "clear": [path_of(area) for area in scene.world.rules.clear] if scene.world.rules is not None else [],
        "props": [*(_prop(placed) for placed in scene.world.props), *_actors(scene.world)],
        "starts": [
            {"name": start.name, "key": f"start/{start.name}", "x": start.x, "y": start.y, "yaw": start.yaw}
            for start in drawing.starts
        ],
        "elements": {key: _element(scene, element) for key, element in scene.elements.items()},
    }


def view_of(world: World) -> tuple[float, float, float, float]:
    """Return the part of a world with its contents: smallest x and y, largest x and y [m]."""
    boxes = [placed.footprint.bounds for placed in world.props]
    boxes += [track.bounds for track in world.tracks.values()]
    boxes += [] if world.network is None else [world.network.bounds]
    boxes += [patch.area.bounds for patch in world.patches]
    # Starts are points; a margin makes their vehicles visible.
    boxes += [(start.x - 6.0, start.y - 6.0, start.x + 6.0, start.y + 6.0) for start in world.starts.values()]
    boxes += [(x - 3.0, y - 3.0, x + 3.0, y + 3.0) for x, y, _ in (world.actor_start(actor) for actor in world.moving)]
    boxes += [goal.area.bounds for goal in world.goals.values() if goal.area is not None]
    low, high = np.min([box[:2] for box in boxes], axis=0), np.max([box[2:] for box in boxes], axis=0)
    # A small world is not enlarged beyond 30 m across.
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, 15.0)
    return (*map(float, middle - half), *map(float, middle + half))  # type: ignore[return-value]


def path_of(area: BaseGeometry) -> str:
    """Return polygons as the data of an SVG path in W [m]."""
    simple = shapely.simplify(area, _TOLERANCE)
    return "".join(
        _polyline(np.asarray(ring.coords)[:, :2], closed=True)
        for polygon in shapely.get_parts(simple)
        if polygon.geom_type == "Polygon"
        for ring in (polygon.exterior, *polygon.interiors)
    )


def _polyline(points: Array, *, closed: bool = False) -> str:
    data = "L".join(f"{x:.3f} {y:.3f}" for x, y in points.tolist())
    return f"M{data}{'Z' if closed else ''}"


def mark_json(marks: Sequence[Mark]) -> list[Json]:
    """Return overlaps for the page."""
    return [
        {"names": list(mark.names), "depth": round(mark.depth, 4), "x": round(mark.x, 3), "y": round(mark.y, 3)}
        for mark in marks
    ]


def error_json(error: MirdrakeError, path: Path) -> list[Json]:
    """Return the faults of a text for the page; `path` is that of the world file."""
    return [fault_json(Fault("file", fault.text, fault.where), path) for fault in error.faults]


def fault_json(fault: Fault, path: Path) -> Json:
    """Return a fault for the page; its text leaves out the name of the world file, whose path is given."""
    text, line = str(fault), None
    if isinstance(fault.where, Place) and fault.where.file == display_path(path) and fault.where.line is not None:
        line = fault.where.line
        text = f"{Place(f'line {line}', path=fault.where.path)}: {fault.message}"
    names = list(fault.names)
    return {"kind": fault.kind, "text": text, "title": str(fault), "line": line, "names": names, "depth": fault.depth}


def _prop(placed: PlacedProp) -> Json:
    x, y, _ = placed.X_WP.translation().tolist()
    R = placed.X_WP.rotation().matrix()
    color = None if placed.color is None else [round(255.0 * part) for part in placed.color]
    return {
        "name": placed.name, "kind": placed.prop.name, "key": prop_key(placed), "d": path_of(placed.footprint),
        "x": round(x, 4), "y": round(y, 4), "yaw": round(math.atan2(R[1, 0], R[0, 0]), 5),
        "top": round(placed.top, 3), "color": color, "random": placed.random, "static": placed.static,
        "length": round(placed.prop.size[0], 3), "small": max(placed.prop.size[:2]) < _SMALL,
    }  # fmt: skip


def _actors(world: World) -> Iterator[Json]:
    entries = {spec.name: entry for spec, entry in zip(world.spec.actors, world.actor_entries, strict=True)}
    for actor in world.actors:
        placed = actor.placed(*world.actor_start(actor))
        yield {**_prop(replace(placed, order=(entries[actor.name],))), "key": f"actors/{entries[actor.name]}"}
    for full in world.full_actors:
        x, y, yaw = world.actor_start(full)
        yield {
            "name": full.name, "kind": full.model, "key": f"actors/{entries[full.name]}",
            "d": path_of(full.area(x, y, yaw)), "x": round(x, 4), "y": round(y, 4), "yaw": round(yaw, 5),
            "top": _CAR_HEIGHT, "color": None, "random": False, "static": False, "length": round(full.length, 3),
            "small": False,
        }  # fmt: skip


def _centre_line(track: Track) -> Array:
    return np.column_stack(track.point(np.append(track.stations(sagitta=_TOLERANCE), track.length), 0.0))


def _element(scene: Scene, element: Element) -> Json:
    span = find_span(scene.text, element.path)
    handles = [
        {
            "name": handle.name,
            # JSON has no NaN, which marks an element without position.
            "x": round(handle.x, 4) if math.isfinite(handle.x) else None,
            "y": round(handle.y, 4) if math.isfinite(handle.y) else None,
            "lock": handle.lock,
        }
        for handle in element.handles
    ]
    return {
        "kind": element.kind,
        "label": element.label,
        "layout": element.layout,
        "lines": [span.first_line, span.last_line] if span else None,
        "handles": handles,
        "outlines": [
            {"role": outline.role, "d": _polyline(outline.points), "moves": outline.moves}
            for outline in element.outlines
        ],
        "points": element.points is not None,
        "closed": element.closed,
        "fields": list(_fields(scene.text, _raw(scene.data, element.path), element.path))[:_MOST_FIELDS],
    }


def _raw(data: Any, path: Sequence[str]) -> Any:
    value = value_at(data, path)
    # The start of a world without starts is not in its file.
    return {} if value is REMOVED else value


def _fields(text: str, raw: Any, path: tuple[str, ...], label: str = "") -> Iterator[Json]:
    """Yield the values below a part of the file with their text; a short list of values is one of them."""
    if isinstance(raw, Mapping):
        for key, value in raw.items():
            yield from _fields(text, value, (*path, key), f"{label}.{key}" if label else key)
    # A list of plain values, such as a position, is one field; a list of entries is not.
    elif isinstance(raw, list) and any(isinstance(item, list | Mapping) for item in raw):
        for index, item in enumerate(raw):
            yield from _fields(text, item, (*path, str(index)), f"{label}[{index}]")
    elif isinstance(raw, list):
        span = find_span(text, path)
        source = text[span.start : span.end] if span else None
        yield {"path": list(path), "label": label, "text": source, "value": ", ".join(map(str, raw))}
    else:
        value = raw if isinstance(raw, str) else scalar_text(raw)
        yield {"path": list(path), "label": label, "text": source_of(text, path), "value": value}
