"""CommonRoad scenarios as worlds: lanelets as the network, static obstacles as props, goals, recorded traffic.

The states of dynamic obstacles become files ``recorded/<id>.csv`` with time, position of the middle, heading and speed,
which actors replay.
"""

import csv
import io
import math
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.core.xml_reader import XmlDocument, count_unread
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.roads.road_world import (
    RoadWorld,
    note_changes,
    number,
    pose,
    start_on_longest,
    station,
)
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.commonroad import number_at, parse_commonroad, points_of, read_commonroad
from mirdrake.worlds.networks.network import signal_name
from mirdrake.worlds.networks.routes import Place, find_route

_HEIGHTS = {"car": 1.5, "parkedVehicle": 1.5, "truck": 3.0, "bus": 3.0, "pedestrian": 1.75, "building": 6.0}
_ACTORS = {
    "bicycle": "cyclist", "bus": "van", "motorcycle": "cyclist", "pedestrian": "pedestrian", "priorityVehicle": "van",
    "truck": "van",
}  # fmt: skip
_ACTOR = "sedan"  # of all other types
_HEIGHT = 1.2  # [m] of obstacles of other types
_BEHIND, _BEYOND = 10.0, 20.0  # [m] of a route before the start and behind the middle of the goal
_DURATION = 30.0  # [s] of a test without a time of its goal
# Elements that are read; those whose parts are read or reported with them; those that describe the file.
_READ = {
    "location", "lanelet", "trafficSign", "trafficSignElement", "trafficLight", "intersection", "incoming",
    "staticObstacle", "dynamicObstacle", "obstacle",
}  # fmt: skip
_LEAVES = {
    "leftBound", "rightBound", "predecessor", "successor", "adjacentLeft", "adjacentRight", "stopLine", "laneletType",
    "trafficSignRef", "trafficLightRef", "trafficSignID", "additionalValue", "position", "cycle", "incomingLanelet",
    "successorsLeft", "successorsRight", "successorsStraight", "isLeftOf", "type", "role", "shape", "initialState",
    "trajectory", "occupancySet", "planningProblem",
}  # fmt: skip
_METADATA = {"scenarioTags", "geoNameId", "gpsLatitude", "gpsLongitude", "country", "virtual"}


def read_commonroad_world(source: Path, name: str) -> RoadWorld:
    """Return the world of a CommonRoad scenario.

    Raises:
        ConfigError: the file has faults.
    """
    document = parse_commonroad(source)
    root, network = document.root, read_commonroad(source)
    made = RoadWorld("", [source])
    files = {"map.xml": source.read_bytes()}
    note_changes(network, source, made.changes)

    # Obstacles by their role, which 2018b gives in a child.
    obstacles = [e for e in root if e.tag in {"staticObstacle", "dynamicObstacle", "obstacle"}]
    static = [e for e in obstacles if "static" in e.tag or e.findtext("role") == "static"]
    props = [prop for e in static if (prop := _prop(e, document, made.changes)) is not None]
    try:
        step = float(root.get("timeStepSize", "0.1"))
    except ValueError:
        raise ConfigError("timeStepSize should be a number in s", where=document.where(root)) from None
    recorded, actors = [e for e in obstacles if e not in static], []
    for element in recorded:
        table = _states(element, step, document)
        key = element.get("id", "")
        if table is None:
            made.changes.add(
                Code.MODEL, document.where(element), f"obstacle {key}", _type(element), None, "no trajectory"
            )
        else:
            files[f"recorded/{key}.csv"] = table
            motion = f"{{file: {name}/recorded/{key}.csv, point: middle}}"
            actors.append(f"  - {{actor: {_ACTORS.get(_type(element), _ACTOR)}, name: o{key}, recorded: {motion}}}")
    if actors:
        old = ", ".join(f"{count} × {kind}" for kind, count in sorted(Counter(map(_type, recorded)).items()))
        why = "they replay recorded/*.csv, at rest before and after it, without regard to vehicles, with sizes of props"
        made.changes.add(Code.POPULATION, document.where(recorded[0]), "dynamic obstacles", old, "actors", why)

    starts, goals = _problems(root, network, document, made.changes)
    tests, tracks = _tests(root, network, step, document, made)
    _report_rest(root, document, made.changes)
    lines = ["mirdrake: world/1", f"name: {name}", "", "ground: {surface: grass}"]
    # The programme of a light is the only part of `signals` that CommonRoad states; stop lines come from lanelets.
    lines += [f"network: {{commonroad: {name}/map.xml}}"]
    obeyed = {line.signal for line in network.stop_lines}
    programmes = (
        row
        for element in root.iterfind("trafficLight")
        for row in _programme(element, step, obeyed, document, made.changes)
    )
    if lights := list(programmes):
        lines += ["", "signals:", *lights]
    lines += ["", "tracks:", *tracks] if tracks else []
    lines += ["", "start:"]
    lines += [f"  {key}: {{{value}}}" for key, value in (starts or {"road": start_on_longest(network)}).items()]
    lines += ["", "goals:", *(f"  {key}: {{{value}}}" for key, value in goals.items())] if goals else []
    lines += ["", "props:", *props] if props else []
    lines += ["", "actors:", *actors] if actors else []
    lines += ["", "tests:", *tests] if tests else []
    # Obstacles of a scenario may overlap, which a world rejects without a rule.
    lines += ["", "rules:", '  - {allow_overlap: ["*", "*"]}'] if len(props) > 1 else []
    made.text, made.files = "\n".join(lines) + "\n", files
    made.entries = len(props) + len(network.driving())
    return made


def _type(element: Element) -> str:
    return element.findtext("type") or "unknown"


def _prop(element: Element, document: XmlDocument, changes: Changes) -> str | None:
    """Return an entry of `props` for a static obstacle: a box or a cylinder; None if it has no such shape."""
    key, kind, shape = element.get("id", ""), _type(element), element.find("shape")
    state = element.find("initialState")
    if shape is None or state is None:
        changes.add(Code.MODEL, document.where(element), f"obstacle {key}", kind, None, "no shape or no state")
        return None
    places = points_of(state.find("position"), document)
    if not len(places):
        changes.add(Code.MODEL, document.where(element), f"obstacle {key}", kind, None, "its position is an area")
        return None
    # CommonRoad is flat: heights come from the type of the obstacle.
    (x, y), yaw, height = places[0], number_at(state, "orientation", document, 0.0), _HEIGHTS.get(kind, _HEIGHT)
    rectangle, circle = shape.find("rectangle"), shape.find("circle")
    where = pose(float(x), float(y), yaw)
    if rectangle is not None:
        sides = [number_at(rectangle, side, document) for side in ("length", "width")]
        return f"  - {{box: [{number(sides[0])}, {number(sides[1])}, {height:g}], name: o{key}, {where}}}"
    if circle is not None:
        radius = number_at(circle, "radius", document)
        return f"  - {{cylinder: [{number(radius)}, {height:g}], name: o{key}, {where}}}"
    corners = points_of(shape.find("polygon"), document)
    if len(corners) < 3:
        changes.add(Code.SHAPE, document.where(element), f"obstacle {key}", kind, None, "no shape that a prop can have")
        return None
    # A polygon becomes the box around it, along its own axes.
    low, high = corners.min(axis=0), corners.max(axis=0)
    c, s = math.cos(yaw), math.sin(yaw)
    # Middle of the box in the frame of the obstacle, rotated by its heading.
    middle = np.array([[c, -s], [s, c]]) @ ((low + high) / 2.0) + places[0]
    size = high - low
    changes.add(
        Code.SHAPE, document.where(element), f"obstacle {key}", "polygon", "box around it", "props are convex solids"
    )
    box = f"box: [{number(size[0])}, {number(size[1])}, {height:g}]"
    return f"  - {{{box}, name: o{key}, {pose(float(middle[0]), float(middle[1]), yaw)}}}"


def _states(element: Element, step: float, document: XmlDocument) -> bytes | None:
    """Return the states of an obstacle as CSV; None without a trajectory of points."""
    states = [e for e in (element.find("initialState"), *element.iterfind("trajectory/state")) if e is not None]
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(("t_s", "x_m", "y_m", "yaw_rad", "speed_m_s"))
    for state in states:
        places = points_of(state.find("position"), document)
        if not len(places):
            return None
        time = number_at(state, "time", document, 0.0) * step
        yaw, speed = (number_at(state, key, document, 0.0) for key in ("orientation", "velocity"))
        writer.writerow((f"{time:.4f}", f"{places[0, 0]:.4f}", f"{places[0, 1]:.4f}", f"{yaw:.6f}", f"{speed:.4f}"))
    return rows.getvalue().encode() if len(states) > 1 else None


def _programme(
    element: Element, step: float, obeyed: Container[str | None], document: XmlDocument, changes: Changes
) -> Iterator[str]:
    """Yield the entry of `signals` for the cycle of a light that controls a line; red and amber together are red."""
    cycle = element.find("cycle")
    if cycle is None:
        return
    rows = [
        (part.findtext("color") or "", number_at(part, "duration", document) * step)
        for part in cycle.iterfind("cycleElement")
    ]
    times = {color: math.fsum(time for name, time in rows if name == color) for color, _ in rows}
    name = signal_name("light", element.get("id", ""))
    if times.get("green", 0.0) <= 0.0 or sum(color == "green" for color, _ in rows) != 1:
        old = ", ".join(f"{color} {time:g} s" for color, time in rows)
        why = "a programme has one green phase"
        changes.add(Code.ELEMENT, document.where(element), f"cycle of light '{name}'", old, None, why)
        return
    if name not in obeyed:
        why = "it controls no line; a line has one light"
        changes.add(Code.ELEMENT, document.where(element), f"cycle of light '{name}'", "", None, why)
        return
    red = math.fsum(time for color, time in times.items() if color not in {"green", "yellow"})
    whole = math.fsum(times.values())
    # A programme begins with green, a cycle with its first element: the difference goes into the offset.
    first = [color for color, _ in rows].index("green")
    before = math.fsum(time for _, time in rows[:first])
    # Negative: a cycle that starts `before` seconds earlier is the same light, later in its period.
    offset = (-number_at(cycle, "timeOffset", document, 0.0) * step - before) % whole
    phases = f"green: {number(times['green'])}, amber: {number(times.get('yellow', 0.0))}, red: {number(red)}"
    yield f"  {name}: {{programme: {{{phases}}}, offset: {number(offset)}}}"


def _problems(
    root: Element, network: Network, document: XmlDocument, changes: Changes
) -> tuple[dict[str, str], dict[str, str]]:
    """Return starts and goals of the planning problems; a goal that is an area becomes a disc around its middle."""
    starts: dict[str, str] = {}
    goals: dict[str, str] = {}
    for problem in root.iterfind("planningProblem"):
        key, state = f"p{problem.get('id', '')}", problem.find("initialState")
        places = points_of(None if state is None else state.find("position"), document)
        if state is not None and len(places):
            yaw, speed = (number_at(state, part, document, 0.0) for part in ("orientation", "velocity"))
            starts[key] = f"{pose(float(places[0, 0]), float(places[0, 1]), yaw)}, speed: {number(max(speed, 0.0))}"
        for i, goal in enumerate(problem.iterfind("goalState")):
            # A problem has one start, but may be solved by any of several goal states.
            label = key if not i else f"{key}_{i}"
            disc = next(_discs(goal.find("position"), network, document), None)
            changed_part = "goal without position" if disc is None else "area of the goal"
            if disc is None:
                changes.add(
                    Code.START,
                    document.where(goal),
                    f"goal {label}",
                    changed_part,
                    None,
                    "a goal of a world is a place",
                )
                continue
            x, y, radius = disc
            goals[label] = f"at: [{number(x)}, {number(y)}], radius: {number(radius)}"
            why = "goals are discs; times, speeds and headings of goals belong to tests"
            changes.add(Code.START, document.where(goal), f"goal {label}", changed_part, f"disc of {radius:.3g} m", why)
    return starts, goals


def _tests(
    root: Element, network: Network, step: float, document: XmlDocument, made: RoadWorld
) -> tuple[list[str], list[str]]:
    """Return tests of the planning problems whose goals can be reached on lanes, and the tracks of their drivers.

    The driver follows the shortest route to the first goal, with regard to others and to lights. The test ends when the
    time of the goal does.
    """
    tests: list[str] = []
    tracks: list[str] = []
    for problem in root.iterfind("planningProblem"):
        key, state, goal = f"p{problem.get('id', '')}", problem.find("initialState"), problem.find("goalState")
        places = points_of(None if state is None else state.find("position"), document)
        disc = None if goal is None else next(_discs(goal.find("position"), network, document), None)
        if state is None or goal is None or disc is None or not len(places):
            continue
        # The driver has to pass the middle of the goal, and the track begins behind the vehicle.
        first, last = (network.locate(float(x), float(y)) for x, y in (places[0], disc[:2]))
        ends = [
            (lane.id, min(max(s + more, 0.0), lane.length))
            for (lane, s, _), more in ((first, -_BEHIND), (last, _BEYOND))
        ]
        is_on_lanes = all(abs(offset) < float(lane.width_at(s)) / 2.0 for lane, s, offset in (first, last))
        if not is_on_lanes or not _leads_to(network, *ends):
            why = "no lanes for motor vehicles lead from its start to its goal"
            made.changes.add(Code.START, document.where(problem), f"test of {key}", "", None, why)
            continue
        begin, end = (f"{lane}@{station(s)}" for lane, s in ends)
        tracks.append(f"  {key}_route: {{route: {{from: {begin}, to: {end}}}}}")
        speed = max(number_at(state, "velocity", document, 0.0), first[0].speed_limit or 0.0, 1.0)
        # An interval of time has its end as the latest one.
        latest = goal.findtext("time/intervalEnd") or goal.findtext("time/exact")
        duration = float(latest or 0.0) * step or _DURATION
        tests += [
            f"  - name: {key}",
            f"    start: {key}",
            f"    goal: {key}",
            f"    behaviour: {{kind: traffic, track: {key}_route, speed: {number(speed)}}}",
            f"    duration: {number(min(max(duration, 1.0), 600.0))} s",
            "    expect: [never collision, eventually at goal]",
        ]
    return tests, tracks


def _leads_to(network: Network, start: Place, goal: Place) -> bool:
    """Return whether lanes lead from one place to another."""
    try:
        find_route(network, start, goal)
    except WorldError:
        return False
    return True


def _discs(position: Element | None, network: Network, document: XmlDocument) -> Iterator[tuple[float, float, float]]:
    """Yield discs for the areas of a goal: x, y and radius [m]."""
    for part in [] if position is None else position:
        if part.tag == "lanelet" and part.get("ref") in network.lanes:
            lane = network.lanes[part.get("ref", "")]
            middle_x, middle_y, _ = lane.pose(lane.length / 2.0)
            yield float(middle_x), float(middle_y), max(float(lane.width.max()) / 2.0, 1.0)
        elif part.tag in {"rectangle", "circle"}:
            centre = part.find("center")
            x, y = (0.0 if centre is None else number_at(centre, axis, document) for axis in "xy")
            size = number_at(part, "radius" if part.tag == "circle" else "width", document)
            yield x, y, max(size if part.tag == "circle" else size / 2.0, 0.5)
        elif part.tag == "point":
            yield number_at(part, "x", document), number_at(part, "y", document), 1.0


def _report_rest(root: Element, document: XmlDocument, changes: Changes) -> None:
    """Add what a world does not represent: one change for each kind of element."""
    # One row for each kind of element, with their number.
    for tag, count in count_unread(root, read=_READ, leaves=_LEAVES, metadata=_METADATA).items():
        first = next(root.iter(tag))
        changes.add(Code.ELEMENT, document.where(first), f"<{tag}>", str(count), None, "no counterpart")
    uncertain = [e for e in root.iter("initialState") if any(p.tag != "point" for p in e.find("position") or ())]
    if uncertain:
        changes.add(
            Code.START,
            display_path(Path(document.name)),
            "uncertain states",
            str(len(uncertain)),
            "middle",
            "a state is a value",
        )
