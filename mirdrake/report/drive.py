"""The drive from above: the road and the lines on the map, what colours them, and which places get a close view."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas
import shapely

from mirdrake.report.figures import Array
from mirdrake.report.svg import SCALE_STEPS
from mirdrake.report.track_map import Line, Place, Road, draw_map, draw_place
from mirdrake.report.vehicle_charts import VehicleSignals
from mirdrake.report.words import format_quantity, format_time
from mirdrake.worlds import World

VEHICLE_COLOURS = ("main", "own1", "own2", "own3", "own4")


def load_roads(world: World | None) -> list[Road]:
    """The roads of a world as polylines; none if there is no world or no track."""
    roads = []
    for track in world.tracks.values() if world is not None else ():
        s = track.stations(sagitta=0.01)
        if track.closed:
            s[-1] = 0.0
        left, right, centre = (
            np.column_stack(track.point(s, offset)) for offset in (track.left_width(s), -track.right_width(s), 0.0)
        )
        roads.append(Road(left, right, centre, track.closed, track.width, track.edges))
    return roads


def outlines(world: World | None) -> list[Array]:
    """Outlines of the props of a world seen from above, each n x 2 [m], as they were placed."""
    props = world.props if world is not None else ()
    return [
        shapely.get_coordinates(part.exterior)
        for prop in props
        for part in shapely.get_parts(prop.footprint)
        if isinstance(part, shapely.Polygon)
    ]


def draw_drive(
    names: Sequence[str], signals: pandas.DataFrame, roads: Sequence[Road], props: Sequence[Array] = ()
) -> dict[str, Any] | None:
    """The map, its colour scale and the close views; None when nothing is to be seen.

    Args:
        names: of the vehicles.
        signals: of all of them.
        roads: of the world.
        props: outlines of what stands in it, each n x 2 [m].
    """
    lines: list[Line] = []
    places: list[tuple[Place, str]] = []
    scale: dict[str, str] = {}
    for index, name in enumerate(names):
        vehicle = VehicleSignals(signals, name)
        if not vehicle.has("x", "y"):
            continue
        classes, scale = _colour_classes(vehicle) if len(names) == 1 else (None, {})
        lines.append(Line(vehicle["x"], vehicle["y"], VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)], classes))
        places += _worst_places(vehicle, roads[0].width if roads else 3.0, places, count=3 if len(names) == 1 else 1)
    if not lines and not roads:
        return None
    spots = [place for place, _ in places]
    text = "The track from above with the driven line." if roads else "The driven line from above."
    picture = draw_map(roads, lines, spots, "map-", text, props)
    views = [
        (draw_place(roads, lines, place, f"place{number}-", f"Close view of place {number}. {caption}", props), caption)
        for number, (place, caption) in enumerate(places, start=1)
    ]
    return {
        "picture": picture,
        "scale": scale,
        "places": views,
        "roads": bool(roads),
        "props": bool(props),
        "lines": len(lines),
    }


def _colour_classes(vehicle: VehicleSignals) -> tuple[Any, dict[str, str]]:
    """Classes 0 … SCALE_STEPS - 1 along the drive: of the speed if it varies, else of the size of the lateral error."""
    speed = vehicle["vx"] if vehicle.has("vx") else np.full(len(vehicle.time), np.nan)
    spread = np.nanpercentile(speed, (5, 95)) if np.isfinite(speed).any() else (0.0, 0.0)
    varies = spread[1] - spread[0] > 0.15 * max(abs(spread[1]), 0.1)
    if vehicle.has("lateral_error") and not varies:
        values, what, unit = np.abs(vehicle["lateral_error"]), "size of the lateral error", "m"
        low, high = 0.0, float(np.nanmax(values))
    elif np.isfinite(speed).any():
        values, what, unit = speed, "speed", "m/s"
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
    else:
        return None, {}
    if high - low < 1e-6:
        return None, {}
    share = np.nan_to_num((values - low) / (high - low))
    classes = np.clip((share * SCALE_STEPS).astype(np.intp), 0, SCALE_STEPS - 1)
    return classes, {
        "what": what,
        "low": format_quantity(low, unit, digits=2),
        "high": format_quantity(high, unit, digits=2),
    }


def _worst_places(
    vehicle: VehicleSignals, road_width: float, taken: Sequence[tuple[Place, str]], *, count: int
) -> list[tuple[Place, str]]:
    """Where the lateral error is largest: at most `count` places that overlap none, each with a caption."""
    if not vehicle.has("lateral_error", "x", "y"):
        return []
    error, x, y = vehicle["lateral_error"], vehicle["x"], vehicle["y"]
    size = np.where(np.isfinite(x) & np.isfinite(y), np.nan_to_num(np.abs(error)), 0.0)
    reach = min(max(2.5 * road_width, 4.0 * float(size.max())), 60.0)
    for place, _ in taken:
        size[np.hypot(x - place.x, y - place.y) < 3.0 * reach] = 0.0
    places: list[tuple[Place, str]] = []
    while len(places) < count and size.max() > 1e-3:
        worst = int(size.argmax())
        caption = f"{vehicle.name}: " if count == 1 else ""
        side = "left" if error[worst] > 0.0 else "right"
        caption += f"{format_quantity(abs(float(error[worst])), 'm', digits=2)} to the {side}"
        caption += f" at {format_time(vehicle.time[worst])}"
        if vehicle.has("progress"):
            caption += f", {format_quantity(float(vehicle['progress'][worst]), 'm')} along the track"
        places.append((Place(float(x[worst]), float(y[worst]), reach), caption + "."))
        size[np.hypot(x - x[worst], y - y[worst]) < 3.0 * reach] = 0.0
        if size.max() < 0.5 * abs(float(error[worst])):
            break
    return places
