"""Road networks: lanes and their connections, stop lines, signals, conflicts of lanes and right of way."""

import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import not_found
from mirdrake.worlds.networks.conflicts import Conflict, find_conflicts
from mirdrake.worlds.networks.lane import Lane, close_gaps
from mirdrake.worlds.pieces import Array

Control = Literal["lights", "stop", "yield", "none"]

DRIVEN = frozenset({"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional", "stop"})
"""Kinds of lanes for motor vehicles."""


def signal_name(prefix: str, text: str) -> str:
    """Return a name of letters, digits and underscores for an id in a file: the id itself, if it is such a name."""
    plain = re.sub(r"\W+", "_", text, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"{prefix}_{plain}"


@dataclass(frozen=True)
class StopLine:
    """A line across a lane at which vehicles stop or yield."""

    name: str
    """unique in the network"""
    lane: str
    """lane that it crosses"""
    s: float
    """station on the lane [m]"""
    kind: Control
    """reason to stop there"""
    signal: str | None = None
    """lights that control it"""


@dataclass(frozen=True)
class Signal:
    """A traffic light or a sign at its place. Phases of lights are not part of the network."""

    name: str
    """unique in the network; letters, digits and underscores"""
    kind: Control
    """lights, stop, yield, or none for other signs"""
    x: float
    """[m]"""
    y: float
    """[m]"""
    z: float
    """height of its lower edge [m]"""
    yaw: float
    """direction in which the traffic that it faces drives [rad]"""
    lanes: tuple[str, ...] = ()
    """lanes that it controls"""
    code: str = ""
    """type of the sign in its country, for example 206"""
    label: str = ""
    """its name in the source"""
    group: str | None = None
    """controller of the source; the lights of a group have their phases in common"""


@dataclass(frozen=True)
class Junction:
    """A junction: its lanes and the rule by which conflicts on them are decided."""

    id: str
    name: str = ""
    lanes: tuple[str, ...] = ()
    """lanes within the junction"""
    rule: Literal["lights", "priority", "all_way_stop", "right_before_left"] = "right_before_left"
    """what decides first"""


@dataclass(frozen=True, eq=False)
class PaintedLine:
    """A road mark."""

    points: Array
    """its middle, N x 2 [m]"""
    width: float
    """[m]"""
    dash: tuple[float, float] | None = None
    """lengths of dashes and of gaps [m]; None: continuous"""
    color: Literal["white", "yellow"] = "white"


class Note(NamedTuple):
    """A part of the source of a network that is left out or approximated.

    Attributes:
        part: what it is.
        detail: how many there are, and what is done with them.
    """

    part: str
    detail: str


@dataclass(frozen=True, eq=False)
class Network:
    """A road network."""

    name: str
    lanes: dict[str, Lane]
    """by id"""
    stop_lines: tuple[StopLine, ...] = ()
    signals: dict[str, Signal] = field(default_factory=dict)
    """by name"""
    junctions: dict[str, Junction] = field(default_factory=dict)
    """by id"""
    priorities: frozenset[tuple[str, str]] = frozenset()
    """pairs of lanes in conflict: the first has priority over the second"""
    markings: tuple[PaintedLine, ...] = ()
    left_hand: bool = False
    """traffic drives on the left"""
    notes: tuple[Note, ...] = ()
    """parts of the source that are left out or approximated"""

    @cached_property
    def conflicts(self) -> tuple[Conflict, ...]:
        """Pairs of lanes for motor vehicles that overlap, with the stations on both between which they do."""
        return find_conflicts({lane.id: lane for lane in self.driving()})

    @cached_property
    def area(self) -> BaseGeometry:
        """The surface of all lanes for motor vehicles, as a polygon [m]."""
        return close_gaps([lane.area for lane in self.driving()])

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x and largest y of the lanes [m]."""
        xmin, ymin, xmax, ymax = shapely.total_bounds([lane.area for lane in self.lanes.values()])
        return float(xmin), float(ymin), float(xmax), float(ymax)

    def driving(self) -> list[Lane]:
        """Return the lanes for motor vehicles."""
        return [lane for lane in self.lanes.values() if lane.kind in DRIVEN]

    def lane(self, name: str, *, where: str = "") -> Lane:
        """Return the lane of an id.

        Raises:
            ConfigError: the lane does not exist; `where` is the prefix of the message.
        """
        if name not in self.lanes:
            raise not_found("lane", name, self.lanes, of=f"network '{self.name}'", where=where)
        return self.lanes[name]

    def yields(self, lane: str) -> tuple[Conflict, ...]:
        """Return the conflicts of a lane in which the other lane has priority."""
        return tuple(
            conflict
            for conflict in self.conflicts
            if lane in conflict.lanes and (conflict.other(lane), lane) in self.priorities
        )

    def locate(self, x: float, y: float, yaw: float | None = None) -> tuple[Lane, float, float]:
        """Return the lane for motor vehicles nearest to a point, and s [m] and the offset [m, + left] on it.

        Args:
            x: world x [m].
            y: world y [m].
            yaw: heading [rad]; of lanes at the same distance that with the nearest direction is returned.
        """
        lanes = self._driving
        point = shapely.Point(x, y)
        distances = shapely.distance([lane.area for lane in lanes], point)
        # A point may be on several lanes, as in a junction: all that contain it are compared.
        near = np.flatnonzero(distances < distances.min() + 1e-3)

        def rank(index: int) -> tuple[float, float]:
            s, offset = lanes[index].project(x, y)
            turn = 0.0 if yaw is None else 1.0 - float(np.cos(lanes[index].pose(s)[2] - yaw))
            # Rounded, so that lanes of nearly the same direction are compared by their distance.
            return round(turn, 3), abs(float(offset))

        best = lanes[min(near.tolist(), key=rank)]
        s, offset = best.project(x, y)
        return best, float(s), float(offset)

    def on_road(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Return whether points (world x, y [m], any shape) are on a lane for motor vehicles."""
        shapely.prepare(self.area)
        return np.asarray(shapely.contains_xy(self.area, x, y))

    @cached_property
    def _driving(self) -> list[Lane]:
        return self.driving()
