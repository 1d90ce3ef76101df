"""Signals, signs and stop lines of OpenDRIVE files.

After ASAM OpenDRIVE, chapter "Signals": a signal is valid for the lanes of its orientation, or for those of its
`validity`. Types are those of the standard for lights (1000001 and following), and of the German and American
catalogues of signs for stop (206, R1-1), yield (205, R1-2) and stop line (294).
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.network import DRIVEN, Control, Note, Signal, StopLine, signal_name
from mirdrake.worlds.networks.opendrive_links import lane_id
from mirdrake.worlds.networks.opendrive_road import RoadLanes
from mirdrake.worlds.opendrive_parts import Places, number_of

_SIGNS: Mapping[str, Control] = {"206": "stop", "R1-1": "stop", "205": "yield", "R1-2": "yield"}
_STOP_LINE = "294"
_FOR_OTHERS = {"1000002", "1000007", "1000013", "1000015"}  # lights for pedestrians and cyclists
_NEAR = 15.0  # [m] of a stop line from the signal that it belongs to


@dataclass(frozen=True)
class _Mark:
    """A signal or a stop line on the lanes that it is valid for, by id, with its station on each [m]."""

    kind: Control
    name: str | None
    places: dict[str, float]


def read_signals(
    root: Element, roads: Mapping[str, RoadLanes], lanes: Mapping[str, Lane], places: Places
) -> tuple[dict[str, Signal], tuple[StopLine, ...], tuple[Note, ...]]:
    """Return the signals by name, the stop lines, and the signals without effect, one line for each type.

    Args:
        root: element of the file.
        roads: its roads by id.
        lanes: their lanes by id.
        places: line of each element, for messages.
    """
    # Signals of one controller switch together.
    groups = {
        control.get("signalId", ""): controller.get("id", "")
        for controller in root.iterfind("controller")
        for control in controller.iterfind("control")
    }
    signals: dict[str, Signal] = {}
    marks: list[_Mark] = []
    lines: list[_Mark] = []
    unread: Counter[str] = Counter()
    objects: Counter[str] = Counter()
    for road in roads.values():
        for element in road.element.iterfind("signals/signal"):
            code = element.get("type", "")
            valid = _valid_places(element, road, lanes, places)
            if code == _STOP_LINE:
                lines.append(_Mark("none", None, valid))
                continue
            # Signals without effect remain in the world, for drawing, but nothing stops at them.
            kind = _kind(element)
            signal = _signal(element, road, kind, tuple(valid), groups, places, taken=signals)
            signals[signal.name] = signal
            if kind == "none":
                unread[code or "none"] += 1
            else:
                marks.append(_Mark(kind, signal.name if kind == "lights" else None, valid))
        for element in road.element.iterfind("objects/object"):
            text = " ".join(element.get(key, "") for key in ("type", "subtype", "name"))
            # Files name stop lines that are objects in several ways.
            if re.search(r"stop[ _]?line", text, re.IGNORECASE):
                lines.append(_Mark("none", None, _valid_places(element, road, lanes, places)))
            else:
                objects[element.get("type") or "none"] += 1

    # Only after all signals are known, because a reference may precede the signal that it names.
    for road in roads.values():
        marks += _references(road, signals, lanes, places)
    notes = [Note(f"signs of type {code}, without effect", f"{count}") for code, count in sorted(unread.items())]
    notes += [Note(f"objects of type {kind}", f"{count}") for kind, count in sorted(objects.items())]
    return signals, tuple(_stop_lines(marks, lines, lanes)), tuple(notes)


def _kind(element: Element) -> Control:
    code = element.get("type", "")
    # Any dynamic signal is a traffic light, whatever its country's code, unless it is for others.
    if element.get("dynamic") == "yes" and code not in _FOR_OTHERS:
        return "lights"
    return _SIGNS.get(code, "none")


def _signal(
    element: Element,
    road: RoadLanes,
    kind: Control,
    valid: tuple[str, ...],
    groups: Mapping[str, str],
    places: Places,
    *,
    taken: Mapping[str, Signal],
) -> Signal:
    """Return a signal at its place."""
    own = element.get("id", "")
    name = signal_name("signal", own)
    name = f"{name}_{len(taken)}" if name in taken else name
    x, y, z, yaw = road.place(number_of(element, "s", places), number_of(element, "t", places, 0.0))
    # Valid for the traffic against the reference line.
    if element.get("orientation") == "-":
        yaw += math.pi
    return Signal(
        name,
        kind,
        x,
        y,
        z + number_of(element, "zOffset", places, 0.0),
        math.remainder(yaw, 2.0 * math.pi),
        valid,
        code=element.get("type", ""),
        label=element.get("name", ""),
        group=groups.get(own),
    )


def _references(
    road: RoadLanes, signals: dict[str, Signal], lanes: Mapping[str, Lane], places: Places
) -> Iterator[_Mark]:
    """Yield the signals of other roads that are also valid for a road, and add its lanes to them."""
    for element in road.element.iterfind("signals/signalReference"):
        signal = signals.get(signal_name("signal", element.get("id", "")))
        if signal is None or signal.kind == "none":
            continue
        valid = _valid_places(element, road, lanes, places)
        signals[signal.name] = replace(signal, lanes=tuple(dict.fromkeys((*signal.lanes, *valid))))
        yield _Mark(signal.kind, signal.name if signal.kind == "lights" else None, valid)


def _valid_places(element: Element, road: RoadLanes, lanes: Mapping[str, Lane], places: Places) -> dict[str, float]:
    """Return the station [m] of an element on each lane for motor vehicles that it is valid for."""
    s = min(max(number_of(element, "s", places), 0.0), road.length)
    section = road.section_at(s)
    ranges = [
        sorted(round(number_of(validity, key, places)) for key in ("fromLane", "toLane"))
        for validity in element.iterfind("validity")
    ]
    orientation = element.get("orientation", "none")
    found: dict[str, float] = {}
    for number in road.sections[section].lanes:
        lane = lanes.get(lane_id(road.id, section, number))
        if lane is None or lane.kind not in DRIVEN:
            continue

        # Lanes that are stated take precedence over the direction for which a signal is valid.
        if ranges:
            is_valid = any(low <= number <= high for low, high in ranges)
        else:
            is_valid = orientation not in {"+", "-"} or (lane.direction > 0) == (orientation == "+")
        if is_valid:
            # Stations on the road decrease along lanes against it; `interp` needs them to increase.
            order = slice(None, None, lane.direction)
            found[lane.id] = float(np.interp(s, lane.road_s[order], lane.s[order]))
    return found


def _stop_lines(marks: list[_Mark], lines: list[_Mark], lanes: Mapping[str, Lane]) -> Iterator[StopLine]:
    """Yield one stop line for each signal on each lane: the painted one nearby, else at the signal itself.

    Painted lines without a signal are stop lines without a reason to stop.
    """
    painted: dict[str, list[float]] = {}
    for line in lines:
        for lane, s in line.places.items():
            painted.setdefault(lane, []).append(s)
    done: dict[str, list[float]] = {}
    found: list[tuple[int, StopLine]] = []
    # Lights first: signs beside them hold only while they are out of order.
    for number, mark in sorted(enumerate(marks), key=lambda row: row[1].kind != "lights"):
        for lane, s in mark.places.items():
            near = [line for line in painted.get(lane, []) if abs(line - s) < _NEAR]
            at = min(near, key=lambda line: abs(line - s)) if near else s
            # One stop line per place, even if several signals or signs belong to it; the first one holds.
            if any(abs(other - at) < 1.0 for other in done.get(lane, [])):
                continue
            done.setdefault(lane, []).append(at)
            stop = StopLine(f"{lane}@{at:.4g}", lane, min(at, lanes[lane].length), mark.kind, mark.name)
            found.append((number, stop))
    yield from (stop for _, stop in sorted(found, key=lambda row: row[0]))  # in the order of the file
    for lane, stations in painted.items():
        for s in stations:
            if not any(abs(other - s) < 1.0 for other in done.get(lane, [])):
                yield StopLine(f"{lane}@{s:.4g}", lane, s, "none")
