"""Shapes of a world seen from above: one description for every picture.

Plans, track maps and sketches of suites draw these areas, lines and arrows in their own styles.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds.networks.paint import stop_mark
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.props import Color
from mirdrake.worlds.spec import MarkingSpec
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import World, track_mu, verge

EDGE_LINE_INSET = 0.05
"""Distance from the edge of a road to an edge line [m]."""

AreaLayer = Literal["ground", "verge", "network", "road", "patch", "goal", "prop"]
LineLayer = Literal["marking", "gate"]


@dataclass(frozen=True)
class DrawnArea:
    """An area of a world."""

    layer: AreaLayer
    name: str
    """name of the track, patch, goal or prop, kind of lanes of the network; "" for the ground"""
    area: BaseGeometry
    """polygon in W [m]"""
    surface: str | None = None
    """surface of the ground, verge, road or patch; None if it has no appearance of its own"""
    mu: float | None = None
    """friction coefficient of the ground, road or patch [-]"""
    color: Color | None = None
    """red, green, blue of a prop, 0 .. 1"""
    top: float = 0.0
    """height of the highest point of a prop [m]"""


@dataclass(frozen=True)
class DrawnLine:
    """A line of a world."""

    layer: LineLayer
    name: str
    """name of the track of a marking, or of the goal of a gate"""
    points: Array
    """(n, 2) in W [m]"""
    width: float = 0.0
    """width of the paint of a marking [m]"""
    dash: tuple[float, float] | None = None
    """lengths of a dash and of the gap behind it [m]; None for a continuous line"""


@dataclass(frozen=True)
class DrawnStart:
    """A start: position [m] and heading [rad] in W."""

    name: str
    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class DrawnSignal:
    """A traffic light or sign of the network: position [m] and heading [rad] of the traffic that it faces, in W."""

    name: str
    kind: str
    """lights, stop or yield"""
    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class WorldDrawing:
    """A world seen from above; later areas and lines are on top.

    Attributes:
        name: name of the world.
        bounds: smallest x and y, largest x and y of the ground [m].
        areas: ground, verges, lanes of the network, tracks, patches and goals in this order, then props by height.
        lines: markings and gates.
        starts: starts.
        signals: traffic lights and signs.
    """

    name: str
    bounds: tuple[float, float, float, float]
    areas: tuple[DrawnArea, ...]
    lines: tuple[DrawnLine, ...]
    starts: tuple[DrawnStart, ...]
    signals: tuple[DrawnSignal, ...] = ()

    def layer(self, layer: AreaLayer) -> list[DrawnArea]:
        """Return the areas of one layer."""
        return [area for area in self.areas if area.layer == layer]


def make_drawing(world: World) -> WorldDrawing:
    """Return the shapes of a world seen from above."""
    # The ground fills the picture; everything else is drawn on it.
    ground, specs = world.ground, world.spec.tracks
    areas = [DrawnArea("ground", "", shapely.box(*ground.extent), ground.surface, ground.mu)]
    lines: list[DrawnLine] = []

    # The order is that of drawing: verges, network, roads and patches from the lowest to the highest.
    for name, track in world.roads().items():
        surface = specs[name].verge
        if surface is not None and surface != ground.surface:
            areas.append(DrawnArea("verge", name, verge(track), surface))
    # Roads of tracks are drawn from the track itself, which also has verges and markings.
    areas += [
        DrawnArea("network", road.name, road.area, road.surface, road.mu)
        for road in world.road_areas
        if not road.is_track
    ]
    lines += _network_lines(world)
    for name, track in world.roads().items():
        areas.append(DrawnArea("road", name, track.area, specs[name].surface, track_mu(specs[name])))
        for marking in specs[name].markings:
            dash = marking.dash if marking.kind == "dashed" else None
            lines.append(DrawnLine("marking", name, marking_points(track, marking), marking.width, dash))
    areas += [DrawnArea("patch", patch.name, patch.area, patch.surface, patch.mu) for patch in world.patches]
    # Laps have no place, so that nothing is drawn for them.
    for name, goal in world.goals.items():
        if goal.area is not None:
            areas.append(DrawnArea("goal", name, goal.area))
        elif goal.gate is not None:
            lines.append(DrawnLine("gate", name, _gate_points(world.tracks[goal.gate[0]], goal.gate[1])))
    areas += [
        DrawnArea("prop", placed.name, placed.footprint, color=placed.color, top=placed.top)
        # Low props first, so that high ones cover them.
        for placed in sorted(world.props, key=lambda placed: placed.top)
    ]
    starts = tuple(DrawnStart(name, start.x, start.y, start.yaw) for name, start in world.starts.items())
    signals = () if world.network is None else world.network.signals.values()
    shown = tuple(
        DrawnSignal(signal.name, signal.kind, signal.x, signal.y, signal.yaw)
        for signal in signals
        if signal.kind != "none"
    )
    return WorldDrawing(world.name, ground.extent, tuple(areas), tuple(lines), starts, shown)


def marking_points(track: Track, marking: MarkingSpec) -> Array:
    """Return the centre line of a marking, (n, 2) in W [m]."""
    inset = EDGE_LINE_INSET + marking.width / 2.0
    if marking.line == "start":
        ends = [inset - float(track.right_width(0.0)), float(track.left_width(0.0)) - inset]
        return np.column_stack(track.point(0.0, ends))
    s = np.append(track.stations(), track.length)
    sides = {"left": track.left_width(s) - inset, "right": inset - track.right_width(s), "center": np.zeros_like(s)}
    return np.column_stack(track.point(s, sides[marking.line]))


def _network_lines(world: World) -> list[DrawnLine]:
    """Return road marks and stop lines of the network."""
    network, spec = world.network, world.spec.network
    if network is None or spec is None or not spec.markings:
        return []
    painted = [*network.markings, *(stop_mark(network, line) for line in network.stop_lines)]
    return [DrawnLine("marking", "lanes", line.points, line.width, line.dash) for line in painted]


def _gate_points(track: Track, s: float) -> Array:
    """Return the ends of a line across a track, (2, 2) in W [m]."""
    return np.column_stack(track.point(s, [-float(track.right_width(s)), float(track.left_width(s))]))
