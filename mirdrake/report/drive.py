"""The drive from above: the map with the driven lines, their colours, and close views of the largest lateral errors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas
from markupsafe import Markup
from numpy.typing import NDArray

from mirdrake.report.drive_layers import DrivenLine, Place, centre_lines, driven_lines, marks, place_circle
from mirdrake.report.map_props import props
from mirdrake.report.map_sheet import PAGE, Box, Sheet
from mirdrake.report.svg import SCALE_STEPS
from mirdrake.report.vehicle_charts import VehicleSignals
from mirdrake.report.words import format_quantity, format_time
from mirdrake.report.world_map import draw_figure, signals, surfaces
from mirdrake.worlds import Track, World, make_world

ACTOR_COLOUR = "muted"
"""Colour of the paths of actors."""

VEHICLE_COLOURS = ("main", "own1", "own2", "own3", "own4")

_SIZES = {"wide": (960.0, 220.0, 700.0), "narrow": (400.0, 140.0, 480.0)}
"""Versions of the map: width, least and largest height [px]."""

_MARGIN, _FOOT = 26.0, 26.0  # [px] around the map, and below it for the scale bar
_INSET = 300.0  # [px] size of a close view
_LEAST = 5.0  # [m] least size of the region


@dataclass(frozen=True)
class ColourScale:
    """Quantity that colours the driven line, with the texts of its ends."""

    quantity: str
    low: str
    high: str


@dataclass(frozen=True)
class DriveMap:
    """The map of a drive.

    Attributes:
        picture: the map, in a wide and a narrow version.
        scale: scale of the colours of the line; None if it has one colour.
        places: close views with their captions.
        roads: whether there are tracks on it; `props` and `lines` likewise.
    """

    picture: Markup
    scale: ColourScale | None
    places: list[tuple[Markup, str]]
    roads: bool
    props: bool
    lines: bool
    actors: bool = False


def draw_drive(
    names: Sequence[str],
    signals: pandas.DataFrame,
    world: World | None,
    actors: pandas.DataFrame | None = None,
    followed: Mapping[str, Track | None] | None = None,
) -> DriveMap | None:
    """Return the map of a drive; None if there is nothing to draw.

    Args:
        names: names of the vehicles.
        signals: signals of all vehicles.
        world: world of the run; None if it is not known.
        actors: samples of the actors; their paths are grey.
        followed: tracks of vehicles by their names; the others are on the track nearest to their start.
    """
    # Without a world, an empty one: the driven line is drawn on its own.
    world = world if world is not None else make_world({"mirdrake": "world/1"})
    tracks = list(world.tracks.values())
    lines: list[DrivenLine] = []
    places: list[tuple[Place, str]] = []
    scale: ColourScale | None = None
    # Actors first: lines of vehicles are drawn over theirs.
    for actor in world.actors:
        if actors is not None and f"{actor.name}.x" in actors:
            x, y = (actors[f"{actor.name}.{key}"].to_numpy(dtype=float) for key in ("x", "y"))
            lines.append(DrivenLine(x, y, ACTOR_COLOUR, name=actor.name))
    for index, name in enumerate(names):
        vehicle = VehicleSignals(signals, name)
        if not vehicle.has("x", "y"):
            continue
        # One vehicle has its line coloured by a quantity; several have a colour each.
        classes, scale = _colour_classes(vehicle) if len(names) == 1 else (None, None)
        lines.append(DrivenLine(vehicle["x"], vehicle["y"], VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)], classes))
        track = (followed or {}).get(name) or own_track(vehicle, world)
        places += _worst_places(vehicle, track.width if track else 3.0, places, count=3 if len(names) == 1 else 1)
    if not lines and not tracks:
        return None
    # Places of the largest errors are marked on the map and drawn again in close view.
    spots = [place for place, _ in places]
    views = [
        (_draw_place(world, lines, place, f"Close view of place {number}. {caption}"), caption)
        for number, (place, caption) in enumerate(places, start=1)
    ]
    return DriveMap(
        _draw_map(world, lines, spots),
        scale,
        views,
        bool(tracks),
        bool(world.props),
        any(len(x.points) for x in lines),
        actors=any(line.colour == ACTOR_COLOUR for line in lines),
    )


def own_track(vehicle: VehicleSignals, world: World, name: str | None = None) -> Track | None:
    """Return the track against which a vehicle was measured: that of its driver, or the nearest one to its start.

    Args:
        vehicle: signals of the vehicle.
        world: world of the run.
        name: name of the track that its driver follows, if any.

    Returns:
        the track; None in a world without tracks.
    """
    tracks = world.tracks
    if name in tracks:
        return tracks[name]
    if len(tracks) < 2 or not vehicle.has("x", "y"):
        return next(iter(tracks.values()), None)
    # The same rule by which a simulation chooses the track of a vehicle without one.
    points = np.column_stack((vehicle["x"], vehicle["y"]))
    points = points[np.isfinite(points).all(axis=1)]
    x, y = points[0].tolist() if len(points) else (0.0, 0.0)
    return min(tracks.values(), key=lambda track: abs(float(track.project(x, y)[1])))


def _draw_map(world: World, lines: Sequence[DrivenLine], places: Sequence[Place]) -> Markup:
    """Draw tracks and driven lines with start, end and direction, in two versions for wide and narrow screens."""
    bounds = _bounds(world, lines)
    description = "The track from above with the driven line." if world.tracks else "The driven line from above."
    pictures = []
    # Two pictures, of which the page shows one: text in a picture that is scaled would be too small on a telephone.
    for kind, (width, *heights) in _SIZES.items():
        sheet = Sheet.around(bounds, width, (heights[0], heights[1]), margin=_MARGIN, foot=_FOOT)
        # Thinner lines at a small scale, where parts of the track come close to each other.
        thickness = 2.4 if sheet.scale > 1.5 else 1.7
        layers = [surfaces, signals, props, driven_lines(lines, width=thickness, arrows=True)]
        layers.append(marks(lines, places))
        pictures.append(draw_figure(world, sheet, PAGE, layers, kind=f"plot map {kind}", description=description))
    return Markup("\n").join(pictures)


def _draw_place(world: World, lines: Sequence[DrivenLine], place: Place, description: str) -> Markup:
    """Draw a close view of one place, with the centre line of the road."""
    reach = place.reach
    bounds = (place.x - reach, place.y - reach, place.x + reach, place.y + reach)
    sheet = Sheet.around(bounds, _INSET, (_INSET, _INSET))
    # The path of a small error lies on the middle of the road, which is drawn above it.
    layers = [surfaces, signals, props, driven_lines(lines, width=2.0), centre_lines]
    layers.append(place_circle(place))
    return draw_figure(world, sheet, PAGE, layers, kind="plot place", description=description)


def _bounds(world: World, lines: Sequence[DrivenLine]) -> Box:
    """Return the box around all tracks and lines [m]."""
    corners = [np.reshape(track.area.bounds, (2, 2)) for track in world.tracks.values()]
    corners += [line.points for line in lines if len(line.points)]
    points = np.concatenate(corners) if corners else np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2.0, np.maximum(high - low, _LEAST) / 2.0
    return (*(middle - half).tolist(), *(middle + half).tolist())


def _colour_classes(vehicle: VehicleSignals) -> tuple[NDArray[np.intp] | None, ColourScale | None]:
    """Return classes 0 … SCALE_STEPS - 1 along the drive: of the speed if it varies, else of the lateral error."""
    speed = vehicle["vx"] if vehicle.has("vx") else np.full(len(vehicle.time), np.nan)
    # Percentiles: a start from standstill alone does not count as varying speed.
    spread = np.nanpercentile(speed, (5, 95)) if np.isfinite(speed).any() else (0.0, 0.0)
    varies = spread[1] - spread[0] > 0.15 * max(abs(spread[1]), 0.1)
    if vehicle.has("lateral_error") and not varies:
        values, quantity, unit = np.abs(vehicle["lateral_error"]), "size of the lateral error", "m"
        low, high = 0.0, float(np.nanmax(values))
    elif np.isfinite(speed).any():
        values, quantity, unit = speed, "speed", "m/s"
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
    else:
        return None, None
    # A constant quantity has no scale.
    if high - low < 1e-6:
        return None, None
    share = np.nan_to_num((values - low) / (high - low))
    classes = np.clip((share * SCALE_STEPS).astype(np.intp), 0, SCALE_STEPS - 1)
    # To two digits of the range: a car at rest has -0.0005 m/s, which is 0 on a scale to 5 m/s.
    places = 1 - math.floor(math.log10(high - low))
    texts = (format_quantity(round(value, places) + 0.0, unit, digits=2) for value in (low, high))
    return classes, ColourScale(quantity, *texts)


def _worst_places(
    vehicle: VehicleSignals, road_width: float, taken: Sequence[tuple[Place, str]], *, count: int
) -> list[tuple[Place, str]]:
    """Return the places with the largest lateral error: at most `count` that do not overlap, with captions."""
    if not vehicle.has("lateral_error", "x", "y"):
        return []
    error, x, y = vehicle["lateral_error"], vehicle["x"], vehicle["y"]
    # NaN must not be the largest: argmax would return it.
    size = np.where(np.isfinite(x) & np.isfinite(y), np.nan_to_num(np.abs(error)), 0.0)
    # The view covers the road and its surroundings; very large errors are limited to 60 m.
    reach = min(max(2.5 * road_width, 4.0 * float(size.max())), 60.0)
    for place, _ in taken:
        # The surroundings of a place are cleared, so that the next one is elsewhere on the road.
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
        # Places with half of the largest error are not worth a view.
        if size.max() < 0.5 * abs(float(error[worst])):
            break
    return places
