"""Routes over the lanes of a network: the shortest one from place to place, with lane changes.

Dijkstra's algorithm (E. W. Dijkstra, "A note on two problems in connexion with graphs", Numerische Mathematik 1, 1959)
over lanes, entered where they begin or where a vehicle changes to them. A lane change costs 1 m, so that of two routes
of equal length the one with fewer changes is found.
"""

import heapq
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.network import DRIVEN, Network
from mirdrake.worlds.pieces import Array

_CHANGE_COST = 1.0  # [m]
_CHANGE = (10.0, 40.0)  # [m] shortest and longest distance over which a route changes lanes
_STEP = 1.0  # [m] between points of a lane change
_PLACE = re.compile(r"\s*([^@\s]+)\s*(?:@\s*(-?[\d.]+(?:e-?\d+)?)\s*m?)?\s*$")

Place = tuple[str, float]
"""A lane, and a station on it [m]."""


@dataclass(frozen=True)
class Leg:
    """A part of a route on one lane."""

    lane: str
    begin: float
    """station where the route enters the lane, or begins [m]"""
    end: float
    """station where it leaves the lane, or ends [m]"""
    change: bool = False
    """it is left to a lane beside it, not to a successor"""


@dataclass(frozen=True, eq=False)
class Route:
    """A route over lanes."""

    legs: tuple[Leg, ...]
    points: Array
    """N x 2 [m], in driving order"""
    width: Array
    """width of the lane at the points [m], N"""

    @property
    def lanes(self) -> tuple[str, ...]:
        """Lanes in driving order."""
        return tuple(leg.lane for leg in self.legs)

    @property
    def length(self) -> float:
        """Length along the points [m]."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())


def find_place(network: Network, place: str | Sequence[float], *, where: str = "") -> Place:
    """Return the lane and station of a place.

    Args:
        network: the network.
        place: ``lane@station``, for example ``"3.0.-1@40"``, a lane (its start), or x and y [m] on or near a lane.
        where: prefix of messages.

    Raises:
        ConfigError: the lane does not exist, or the station is not on it.
    """
    if not isinstance(place, str):
        lane, s, _ = network.locate(float(place[0]), float(place[1]))
        return lane.id, s
    match = _PLACE.match(place)
    if match is None:
        raise ConfigError(
            f"{place!r} is not a place; write lane@station, for example '3.0.-1@40', or [x, y]", where=where
        )
    lane, s = network.lane(match[1], where=where), float(match[2] or 0.0)
    if not 0.0 <= s <= lane.length:
        raise ConfigError(f"s = {s:.10g} m; lane '{lane.id}' is {lane.length:.10g} m long", where=where)
    return lane.id, s


def find_route(network: Network, start: Place, goal: Place, *, via: Sequence[Place] = ()) -> Route:
    """Return the shortest route by length.

    Args:
        network: the network.
        start: its first place.
        goal: its last place.
        via: places on the way.

    Raises:
        WorldError: no lanes lead from one place to the next.
    """
    legs: list[Leg] = []
    for begin, end in itertools.pairwise([start, *via, goal]):
        part = _shortest(network, begin, end)
        # Two parts meet on one lane.
        if legs and legs[-1].lane == part[0].lane and not legs[-1].change:
            part = [Leg(part[0].lane, legs.pop().begin, part[0].end, part[0].change), *part[1:]]
        legs += part
    points, width = _points(network, legs)
    return Route(tuple(legs), points, width)


# --- the search ---------------------------------------------------------------------------------------------------


def _shortest(network: Network, start: Place, goal: Place) -> list[Leg]:
    """Return the legs of the shortest route between two places.

    Raises:
        WorldError: there is none.
    """
    # A node is an entry into a lane: its id and station. Of a lane only the earliest entry at its start is needed,
    # and one by a change from each neighbour.
    counter = itertools.count()
    # The counter decides between equal costs: the first one entered, so that routes are reproducible.
    queue: list[tuple[float, int, Place, tuple[Place, bool] | None]] = [(0.0, next(counter), start, None)]
    came: dict[Place, tuple[Place, bool] | None] = {}
    finish: Place | None = None

    # The first time that a node leaves the queue it has its least cost; later entries are skipped.
    while queue:
        cost, _, node, before = heapq.heappop(queue)
        if node in came:
            continue
        came[node] = before
        name, s = node
        if node == goal:
            finish = node
            break
        lane = network.lanes[name]
        if name == goal[0] and goal[1] >= s:
            # The goal is a node of its own; it is reached along the lane, from an entry before it.
            heapq.heappush(queue, (cost + goal[1] - s, next(counter), goal, (node, False)))
        for following in lane.successors:
            if network.lanes[following].kind in DRIVEN:
                entry = (following, 0.0)
                heapq.heappush(queue, (cost + lane.length - s, next(counter), entry, (node, False)))
        for beside, at, end in _changes(network, lane, s):
            # A change that would end beyond the goal cannot reach it.
            if beside != goal[0] or at + end - s <= goal[1] + 1e-6:
                heapq.heappush(queue, (cost + _CHANGE_COST, next(counter), (beside, at), (node, True)))
    if finish is None:
        raise WorldError(
            f"no lanes lead from {start[0]}@{start[1]:.4g} to {goal[0]}@{goal[1]:.4g}; choose places in the direction "
            "of travel, or check the connections of the network"
        )

    # Backwards from the goal; each node knows the one before it and whether a lane change leads on.
    nodes: list[tuple[Place, bool]] = [(finish, False)]
    while (step := came[nodes[0][0]]) is not None:
        nodes.insert(0, step)
    legs: list[Leg] = []
    for ((name, s), change), ((following, at), _) in itertools.pairwise(nodes):
        if change:
            legs.append(Leg(name, s, s, change=True))
        # A ring may be its own successor: a smaller station is reached over its end.
        elif following == name and at >= s:
            legs.append(Leg(name, s, at))
        else:
            legs.append(Leg(name, s, network.lanes[name].length))
    return legs or [Leg(*start, start[1])]


def _changes(network: Network, lane: Lane, s: float) -> Iterator[tuple[str, float, float]]:
    """Yield the lanes beside a lane, the station there, and the station where a change of least length ends."""
    sides = ((lane.left, {"both", "left"}), (lane.right, {"both", "right"}))
    for name, allowed in sides:
        if name is not None and lane.change in allowed and lane.length - s >= _CHANGE[0]:
            x, y, _ = lane.pose(s)
            at, _ = network.lanes[name].project(x, y)
            yield name, round(float(at), 6), s + _CHANGE[0]


# --- its points ---------------------------------------------------------------------------------------------------


def _points(network: Network, legs: Sequence[Leg]) -> tuple[Array, Array]:
    """Return points of a route, and the width of the lane there; changes of lanes blend over up to 40 m."""
    points: list[Array] = []
    widths: list[Array] = []
    begin: float | None = None  # station after a change, where the blend has ended
    for i, leg in enumerate(legs):
        lane = network.lanes[leg.lane]
        s0 = leg.begin if begin is None else begin
        begin = None
        if not leg.change:
            inner = lane.s[(lane.s > s0 + 1e-3) & (lane.s < leg.end - 1e-3)]
            s = np.concatenate(([s0], inner, [leg.end]))
            points.append(np.column_stack(lane.pose(s)[:2]))
            widths.append(lane.width_at(s))
            continue
        # Changes in a row share what is left of the lane.
        after = list(itertools.takewhile(lambda row: row.change, legs[i:]))
        last = legs[i + len(after)]
        # What is left of the last lane, after the part that the blend before has used, is divided equally.
        room = max((last.end - last.begin - (s0 - leg.begin)) / len(after), 0.1)
        s = s0 + np.linspace(0.0, min(room, _CHANGE[1]), max(2, math.ceil(min(room, _CHANGE[1]) / _STEP) + 1))
        u = np.linspace(0.0, 1.0, len(s))
        weight = (u * u * u * (10.0 + u * (6.0 * u - 15.0)))[:, None]  # quintic: curvature is 0 at both ends
        beside = network.lanes[legs[i + 1].lane]
        here = np.column_stack(lane.pose(s)[:2])
        at, _ = beside.project(here[:, 0], here[:, 1])
        neighbour = np.column_stack(beside.pose(at)[:2])
        points.append((1.0 - weight) * here + weight * neighbour)
        # During a change the narrower of both lanes limits the road.
        widths.append(np.minimum(lane.width_at(s), beside.width_at(at)))
        begin = float(at[-1])
    place, width = np.vstack(points), np.concatenate(widths)
    # Parts share their end points.
    apart = np.append(True, np.hypot(*np.diff(place, axis=0).T) > 1e-3)
    return place[apart], width[apart]
