"""Right of way in junctions: for every conflict of two lanes the one that has priority.

In this order, after the usual traffic codes (Vienna Convention on Road Traffic, article 18): the priorities that the
file states; a stop or yield sign on one of the two approaches; a vehicle that turns across the oncoming traffic
yields to it; a vehicle yields to one from the right. With a stop sign on every approach, first come is first served.
Lights decide before all of these; they remain valid for turns under green.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.network import Control, Junction, Network

_TURN = math.radians(30.0)  # least heading change of a turn
_BACK = 30.0  # [m] before a junction in which a sign belongs to it

Rule = Literal["lights", "priority", "all_way_stop", "right_before_left"]


@dataclass(frozen=True)
class _Approach:
    """How a lane of a junction is entered."""

    control: Control
    """lights, stop or yield on the approach"""
    yaw: float
    """heading on entry [rad]"""
    turn: float
    """heading change through the junction [rad], + left"""
    entry: str
    """lane before the junction, or the lane itself"""


def decide(network: Network, root: Element | None = None) -> tuple[dict[str, Junction], frozenset[tuple[str, str]]]:
    """Return the junctions of a network by id, and pairs of lanes of which the first has priority.

    Args:
        network: lanes, signals and stop lines.
        root: element of an OpenDRIVE file with stated priorities.
    """
    stated = _stated(root)
    names = {} if root is None else {e.get("id", ""): e.get("name", "") for e in root.iterfind("junction")}
    inner: dict[str, list[str]] = {}
    for lane in network.driving():
        if lane.junction is not None:
            inner.setdefault(lane.junction, []).append(lane.id)
    controls = controls_of(network)
    approaches = {name: _approach(network.lanes, name, controls) for lanes in inner.values() for name in lanes}
    junctions = {
        id_: Junction(id_, names.get(id_, ""), tuple(lanes), _rule([approaches[name] for name in lanes], id_, stated))
        for id_, lanes in inner.items()
    }
    # Only pairs whose order is decided are returned; between the others the first to arrive drives.
    pairs: set[tuple[str, str]] = set()
    for conflict in network.conflicts:
        a, b = (network.lanes[name] for name in conflict.lanes)
        # Lanes that split have no conflict: their vehicles come one after the other.
        if conflict.kind == "split" or a.junction is None or a.junction != b.junction:
            continue
        sign = _compare(a, b, approaches, stated.get(a.junction, set()), network.left_hand)
        if junctions[a.junction].rule != "all_way_stop" and sign:
            pairs.add((a.id, b.id) if sign > 0 else (b.id, a.id))
    return junctions, frozenset(pairs)


def _stated(root: Element | None) -> dict[str, set[tuple[str, str]]]:
    """Return the priorities of each junction in the file: pairs of roads, the first with priority."""
    rows: dict[str, set[tuple[str, str]]] = {}
    for junction in [] if root is None else root.iterfind("junction"):
        for priority in junction.iterfind("priority"):
            pair = priority.get("high", ""), priority.get("low", "")
            rows.setdefault(junction.get("id", ""), set()).add(pair)
    return rows


def controls_of(network: Network) -> dict[str, Control]:
    """Return the strongest control of each lane with a stop line: lights, stop or yield."""
    order: tuple[Control, ...] = ("none", "yield", "stop", "lights")
    controls: dict[str, Control] = {}
    for line in network.stop_lines:
        controls[line.lane] = max(controls.get(line.lane, "none"), line.kind, key=order.index)
    return controls


def _approach(lanes: Mapping[str, Lane], name: str, controls: Mapping[str, Control]) -> _Approach:
    """Return the approach of a lane of a junction."""
    lane = first = last = lanes[name]
    control = controls.get(name, "none")
    # Within the junction there may be several sections; before it the sign is on one of the last lanes.
    back = 0.0
    # Only while there is one way back: a sign before a branch need not be meant for this lane.
    while len(first.predecessors) == 1 and back < _BACK and control == "none":
        first = lanes[first.predecessors[0]]
        if first.junction not in {None, lane.junction}:
            break
        back += first.length if first.junction is None else 0.0
        control = controls.get(first.id, "none")
    begin = lanes[entry_of(lanes, name)]
    while len(last.successors) == 1 and lanes[last.successors[0]].junction == lane.junction:
        last = lanes[last.successors[0]]
    # Lanes with a common entry belong to one approach, whose vehicles do not meet each other.
    entry = begin.predecessors[0] if begin.predecessors else begin.id
    turn = math.remainder(float(last.yaw[-1] - begin.yaw[0]), 2.0 * math.pi)
    return _Approach(control, float(begin.yaw[0]), turn, entry)


def entry_of(lanes: Mapping[str, Lane], name: str) -> str:
    """Return the first lane of a junction on the only way to one of its lanes; a lane without junction is its own."""
    junction = lanes[name].junction
    for _ in lanes:  # a ring within a junction has no first lane
        ways = lanes[name].predecessors
        if junction is None or len(ways) != 1 or lanes[ways[0]].junction != junction:
            break
        name = ways[0]
    return name


def _rule(approaches: Iterable[_Approach], id_: str, stated: Mapping[str, set[tuple[str, str]]]) -> Rule:
    controls = {approach.entry: approach.control for approach in approaches}
    if "lights" in controls.values():
        return "lights"
    # One stop sign alone is a minor road; all of them together are an all-way stop.
    if len(controls) > 1 and set(controls.values()) == {"stop"}:
        return "all_way_stop"
    return "priority" if id_ in stated or set(controls.values()) & {"stop", "yield"} else "right_before_left"


def _compare(
    a: Lane, b: Lane, approaches: Mapping[str, _Approach], stated: set[tuple[str, str]], left_hand: bool
) -> int:
    """Return 1 if the first lane has priority, -1 if the second has it, 0 if neither."""
    # Priorities of the file come first, then signs, then the rules of the road.
    if (a.road, b.road) in stated or (b.road, a.road) in stated:
        return 1 if (a.road, b.road) in stated else -1
    first, second = approaches[a.id], approaches[b.id]
    signed = [approach.control in {"stop", "yield"} for approach in (first, second)]
    if signed[0] != signed[1]:
        return -1 if signed[0] else 1
    if first.entry == second.entry:
        return 0
    apart = math.remainder(second.yaw - first.yaw, 2.0 * math.pi)  # + : the second comes from the right
    # Oncoming: who turns across the other's lane waits, left in right-hand traffic, right in left-hand traffic.
    if abs(apart) > math.radians(135.0):
        across = [(-approach.turn if left_hand else approach.turn) > _TURN for approach in (first, second)]
        return 0 if across[0] == across[1] else (-1 if across[0] else 1)
    # Nearly the same direction: they merge, and neither comes from the right.
    if abs(apart) < math.radians(45.0):
        return 0
    # Right before left; the first lane has priority if the second one comes from its left.
    return -1 if apart > 0.0 else 1
