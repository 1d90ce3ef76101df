"""OpenSCENARIO 1.x scenarios as worlds: the road network, the ego vehicle with a test, actors with their steps, props.

Every action that is not a step of an actor is listed with its trigger, one line each.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

from mirdrake.core.errors import ConfigError
from mirdrake.core.xml_reader import count_unread
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.roads.osc_file import Entity, Scenario, Spot, find_spot
from mirdrake.importing.roads.road_world import RoadWorld, ground_text, note_changes, number, pose, station
from mirdrake.importing.roads.storyboard import Board, conditions, described, read_steps
from mirdrake.importing.target import plain_name
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.opendrive_network import read_network

_BEFORE, _AHEAD = 50.0, 1500.0  # [m] of the track of the ego vehicle behind and ahead of it
_SHORTEST = 1.0  # [m] of that track
# Elements that are read; those whose parts are read or reported with them; those that describe the file.
_READ = {"RoadNetwork", "Entities", "ScenarioObject", "Vehicle", "Pedestrian", "MiscObject"}
_LEAVES = {
    "ParameterDeclarations", "CatalogLocations", "LogicFile", "BoundingBox", "CatalogReference", "Storyboard",
}  # fmt: skip
_METADATA = {"FileHeader", "Properties", "SceneGraphFile"}
_EGO = ("ego", "ego_vehicle", "hero", "host", "vut")


def read_scenario_world(source: Path, name: str) -> RoadWorld:
    """Return the world of an OpenSCENARIO file.

    Raises:
        ConfigError: the scenario, or its road network, has faults or is missing.
    """
    scenario = Scenario(source)
    made = RoadWorld("", [source])
    map_file, network = scenario.map_file(), None
    if map_file is not None:
        if not map_file.is_file():
            logic = scenario.root.find("RoadNetwork/LogicFile")
            place = scenario.where(scenario.root if logic is None else logic)
            raise ConfigError(
                f"no such file: '{map_file.name}'; put the road network where the scenario names it", where=place
            )
        network = read_network(map_file)
        made.sources.append(map_file)
        made.files = {"map.xodr": map_file.read_bytes()}
        note_changes(network, map_file, made.changes)

    entities = {entity.name: entity for entity in scenario.entities()}
    # The Init actions state where each entity is and how fast; a test of the world repeats them for the ego vehicle.
    spots, speeds = _init(scenario, entities, network, made.changes)
    # An entity with a usual name of the ego vehicle, else the first one with a position.
    ego = next((n for n in entities if n.lower() in _EGO), next(iter(spots), ""))
    name_of_ego = plain_name(ego or "ego")
    board = Board(scenario, entities, network, spots, dict(speeds), (ego, "ego"))
    steps = read_steps(board, made.changes)

    # Entities that move, or that a trigger refers to, are actors; others are props.
    ground = ground_text(network, map_file or source, made.changes)
    lines = ["mirdrake: world/1", f"name: {name}", "", f"ground: {ground}"]
    lines += [f"network: {{xodr: {name}/map.xodr}}"] if network is not None else []
    if ego in spots:
        lines += _ego(name_of_ego, spots[ego], speeds.get(ego, 0.0), network)
    others = {key: spot for key, spot in spots.items() if key != ego}
    # A step belongs to a moving actor, also if the actor only waits for another one.
    needed = board.referenced | set(steps)
    moving = [key for key in others if entities[key].prop and (speeds.get(key, 0.0) > 0.0 or key in needed)]
    props = [_prop(entities[key], spot) for key, spot in others.items() if key not in moving]
    lines += ["", "props:", *props] if props else []
    if moving:
        lines += ["", "actors:", *(_actor(entities[key], spots[key], speeds.get(key, 0.0)) for key in moving)]
    if made_steps := {key: rows for key, rows in steps.items() if key in moving}:
        lines += ["", "scenario:"]
        for key, rows in made_steps.items():
            lines += [f"  {plain_name(key)}:", *(f"    - {row}" for row in rows)]
    # A stop trigger is a condition on the whole scenario, for which a test of mirdrake has its duration.
    stop = " or ".join(conditions(scenario, scenario.root.find("Storyboard/StopTrigger")))
    if ego in spots:
        on_track = _track(spots[ego], network) is not None
        lines += _test(name_of_ego, on_track=on_track, speed=speeds.get(ego, 0.0), scenario=scenario)
        made.checks.append("The driver of the test does not react to others; replace its behaviour by your own.")
    if stop:
        why = "the test has a duration"
        made.changes.add(Code.ELEMENT, display_path(source), "end of the scenario", stop, "duration", why)
    _report_rest(scenario, made.changes)
    # Every entity ends as ego, actor, prop or a row of the report; none disappears without one.
    for key, entity in entities.items():
        if key not in spots:
            why = "no position at the beginning that is on the network"
            made.changes.add(Code.MODEL, display_path(source), f"entity '{key}'", entity.kind, None, why)
        elif key in others and key not in moving and speeds.get(key, 0.0) > 0.0:
            old = f"{entity.kind}, {speeds[key]:.4g} m/s"
            made.changes.add(
                Code.POPULATION, display_path(source), f"entity '{key}'", old, "prop", "no actor of this kind"
            )
    made.text = "\n".join(lines) + "\n"
    made.entries = len(others)
    return made


def _ego(name: str, spot: Spot, speed: float, network: Network | None) -> list[str]:
    """Return a track along the lane of the ego vehicle, if there is one, and its start."""
    lines = []
    if (part := _track(spot, network)) is not None:
        places = f"from: {spot.lane}@{station(part[0])}, to: {spot.lane}@{station(part[1])}"
        lines += ["", "tracks:", f"  {name}_lane: {{route: {{{places}}}}}"]
    return [*lines, "", "start:", f"  {name}: {{{pose(*spot.pose)}, speed: {number(speed)}}}"]


def _track(spot: Spot, network: Network | None) -> tuple[float, float] | None:
    """Return the part of the lane of the ego vehicle that is its track [m]; None without a lane or on a shorter one."""
    if network is None or spot.lane is None:
        return None
    begin, end = max(spot.s - _BEFORE, 0.0), min(spot.s + _AHEAD, network.lanes[spot.lane].length)
    return (begin, end) if end - begin > _SHORTEST else None


def _actor(entity: Entity, spot: Spot, speed: float) -> str:
    """Return an entry of `actors`: on its lane, or straight ahead."""
    if spot.lane is not None:
        place = f"on_lane: {{lane: {spot.lane}, s: {station(spot.s)}, offset: {number(spot.offset)}}}"
    else:
        x, y, yaw = spot.pose
        # A path for one minute at the speed of the actor.
        end = _ahead(x, y, yaw, max(speed, 1.0) * 60.0)
        place = f"path: [[{number(x)}, {number(y)}], [{number(end[0])}, {number(end[1])}]]"
    return f"  - {{actor: {entity.prop}, name: {plain_name(entity.name)}, {place}, speed: {number(speed)}}}"


def _test(name: str, *, on_track: bool, speed: float, scenario: Scenario) -> list[str]:
    """Return a test that drives the ego vehicle along its track, if it has one, for the duration of the scenario."""
    times = [
        scenario.number(element, "value")
        for element in scenario.root.iterfind("Storyboard/StopTrigger//SimulationTimeCondition")
    ]
    duration = min([*times, 600.0]) if times else 20.0
    driver = f"kind: path_tracking, track: {name}_lane, speed: {number(max(speed, 1.0))}"
    if not on_track:
        driver = "kind: blind"
    rows = [f"name: {plain_name(scenario.path.stem)}", f"start: {name}"]
    rows += [f"behaviour: {{{driver}}}", f"duration: {number(max(duration, 1.0))} s", "expect: [never collision]"]
    return ["", "tests:", f"  - {rows[0]}", *(f"    {row}" for row in rows[1:])]


def _prop(entity: Entity, spot: Spot) -> str:
    """Return an entry of `props`; the pose of a prop is that of its middle."""
    x, y, yaw = spot.pose
    middle = _ahead(x, y, yaw, entity.middle)
    length, width, height = (max(side, 0.05) for side in entity.size)
    box = f"box: [{number(length)}, {number(width)}, {number(height)}]"
    part = box if entity.prop is None else f"prop: {entity.prop}"
    return f"  - {{{part}, name: {plain_name(entity.name)}, {pose(*middle, yaw)}}}"


def _ahead(x: float, y: float, yaw: float, distance: float) -> tuple[float, float]:
    return x + distance * math.cos(yaw), y + distance * math.sin(yaw)


# --- init ---------------------------------------------------------------------------------------------------------


def _init(
    scenario: Scenario, entities: Mapping[str, Entity], network: Network | None, changes: Changes
) -> tuple[dict[str, Spot], dict[str, float]]:
    """Return the spots and speeds [m/s] of entities at the beginning; relative ones after those that they refer to."""
    spots: dict[str, Spot] = {}
    speeds: dict[str, float] = {}
    waiting = list(scenario.root.iterfind("Storyboard/Init/Actions/Private"))
    teleports = {
        private.get("entityRef", ""): position
        for private in waiting
        if (position := private.find("PrivateAction/TeleportAction/Position")) is not None
    }
    # A position may refer to an entity further down, so that passes are repeated until nothing is left.
    for _ in range(len(teleports) + 1):
        for key, position in teleports.items():
            if (
                key in entities
                and key not in spots
                and (spot := find_spot(scenario, position, network, spots)) is not None
            ):
                spots[key] = spot
    # Likewise for relative speeds.
    for _ in range(len(waiting) + 1):
        for private in waiting:
            key = private.get("entityRef", "")
            for target in private.iterfind("PrivateAction/LongitudinalAction/SpeedAction/SpeedActionTarget"):
                speed = _speed(scenario, target, speeds)
                if speed is not None:
                    speeds.setdefault(key, speed)
    # Actions that are neither position nor speed, such as controllers, have no counterpart at the start.
    for private in waiting:
        for action in private.iterfind("PrivateAction"):
            kind = next(iter(action), None)
            known = (
                action.find("TeleportAction") is not None or action.find("LongitudinalAction/SpeedAction") is not None
            )
            if kind is not None and not known:
                part = f"action on '{private.get('entityRef')}' at the beginning"
                changes.add(
                    Code.ELEMENT, scenario.where(kind), part, _described(kind), None, "not a position or a speed"
                )
    return spots, speeds


def _report_rest(scenario: Scenario, changes: Changes) -> None:
    """Add the actions at the beginning that belong to no entity, and all elements that are not read."""
    for tag in ("GlobalAction", "UserDefinedAction"):
        for action in scenario.root.iterfind(f"Storyboard/Init/Actions/{tag}"):
            kind = next(iter(action), action)
            old, why = described(scenario, kind), "a world states surroundings by keys of its own"
            changes.add(Code.ELEMENT, scenario.where(kind), f"{kind.tag} at the beginning", old, None, why)
    for tag, count in count_unread(scenario.root, read=_READ, leaves=_LEAVES, metadata=_METADATA).items():
        why = "without counterpart in a world"
        changes.add(Code.ELEMENT, display_path(scenario.path), f"elements <{tag}>", str(count), None, why)


def _speed(scenario: Scenario, target: Element, speeds: Mapping[str, float]) -> float | None:
    """Return the speed of a target [m/s]; None if it is relative to an entity whose speed is not known yet."""
    absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
    if absolute is not None:
        return scenario.number(absolute, "value")
    if relative is None or scenario.text(relative, "entityRef") not in speeds:
        return None
    base, value = speeds[scenario.text(relative, "entityRef")], scenario.number(relative, "value")
    return base * value if relative.get("speedTargetValueType") == "factor" else base + value


def _described(element: Element) -> str:
    """Return the names of an element and its first descendants."""
    names = [element.tag]
    while len(element) and len(names) < 3:
        element = element[0]
        names.append(element.tag)
    return " ".join(names)
