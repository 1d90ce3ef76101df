"""OpenSCENARIO 1.x scenarios as worlds: the road network, the start of the ego vehicle, and the other entities.

Actions and conditions of the storyboard are listed, one line each.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.roads.osc_file import Entity, Scenario, Spot, find_spot
from mirdrake.importing.roads.road_world import RoadWorld, note_changes, number, pose
from mirdrake.importing.target import plain_name
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.opendrive_network import read_network

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
                f"{place}: no such file: '{map_file.name}'; put the road network where the scenario names it"
            )
        network = read_network(map_file)
        made.sources.append(map_file)
        made.files = {"map.xodr": map_file.read_bytes()}
        note_changes(network, map_file, made.changes)

    entities = {entity.name: entity for entity in scenario.entities()}
    spots, speeds = _init(scenario, entities, network, made.changes)
    ego = next((n for n in entities if n.lower() in _EGO), next(iter(spots), None))
    lines = ["mirdrake: world/1", f"name: {name}", "", "ground: {surface: grass}"]
    lines += [f"network: {{xodr: {name}/map.xodr}}"] if network is not None else []
    if ego is not None and ego in spots:
        lines += [
            "",
            "start:",
            f"  {plain_name(ego)}: {{{pose(*spots[ego].pose)}, speed: {number(speeds.get(ego, 0.0))}}}",
        ]
    others = [_prop(entities[key], spot) for key, spot in spots.items() if key != ego]
    if others:
        lines += ["", "props:", *others]
    for key, entity in entities.items():
        if key not in spots:
            why = "no position at the beginning that is on the network"
            made.changes.add(Code.MODEL, shown(source), f"entity '{key}'", entity.kind, None, why)
        elif key != ego:
            old = f"{entity.kind}, {speeds.get(key, 0.0):.4g} m/s"
            why = "it stands where it begins; motion is listed below"
            made.changes.add(Code.POPULATION, shown(source), f"entity '{key}'", old, "prop", why)
    _list_storyboard(scenario, made.changes)
    made.text = "\n".join(lines) + "\n"
    made.entries = len(others)
    return made


def _prop(entity: Entity, spot: Spot) -> str:
    """Return an entry of `props`; the pose of a prop is that of its middle."""
    x, y, yaw = spot.pose
    middle = _ahead(x, y, yaw, entity.middle)
    length, width, height = (max(side, 0.05) for side in entity.size)
    box = f"box: [{number(length)}, {number(width)}, {number(height)}]"
    what = box if entity.prop is None else f"prop: {entity.prop}"
    return f"  - {{{what}, name: {plain_name(entity.name)}, {pose(*middle, yaw)}}}"


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
    for _ in range(len(teleports) + 1):
        for key, position in teleports.items():
            if (
                key in entities
                and key not in spots
                and (spot := find_spot(scenario, position, network, spots)) is not None
            ):
                spots[key] = spot
    for _ in range(len(waiting) + 1):
        for private in waiting:
            key = private.get("entityRef", "")
            for target in private.iterfind("PrivateAction/LongitudinalAction/SpeedAction/SpeedActionTarget"):
                speed = _speed(scenario, target, speeds)
                if speed is not None:
                    speeds.setdefault(key, speed)
    for private in waiting:
        for action in private.iterfind("PrivateAction"):
            kind = next(iter(action), None)
            known = (
                action.find("TeleportAction") is not None or action.find("LongitudinalAction/SpeedAction") is not None
            )
            if kind is not None and not known:
                what = f"action on '{private.get('entityRef')}' at the beginning"
                changes.add(
                    Code.ELEMENT, scenario.where(kind), what, _described(kind), None, "not a position or a speed"
                )
    return spots, speeds


def _speed(scenario: Scenario, target: Element, speeds: Mapping[str, float]) -> float | None:
    """Return the speed of a target [m/s]; None if it is relative to an entity whose speed is not known yet."""
    absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
    if absolute is not None:
        return scenario.number(absolute, "value")
    if relative is None or scenario.text(relative, "entityRef") not in speeds:
        return None
    base, value = speeds[scenario.text(relative, "entityRef")], scenario.number(relative, "value")
    return base * value if relative.get("speedTargetValueType") == "factor" else base + value


# --- the storyboard -----------------------------------------------------------------------------------------------


def _list_storyboard(scenario: Scenario, changes: Changes) -> None:
    """Add one change for each action, with its trigger, and for the stop trigger."""
    for group in scenario.root.iterfind("Storyboard/Story/Act/ManeuverGroup"):
        actors = ", ".join(reference.get("entityRef", "") for reference in group.iterfind("Actors/EntityRef"))
        for event in group.iterfind("Maneuver/Event"):
            trigger = " or ".join(_conditions(scenario, event.find("StartTrigger"))) or "at once"
            for action in event.iterfind("Action"):
                kind = next(iter(action), action)
                name = action.get("name") or event.get("name") or "action"
                old = f"{_values(scenario, kind)} when {trigger}"
                why = "actions of the storyboard are not part of the world file yet"
                changes.add(
                    Code.POPULATION, scenario.where(action), f"'{name}' of {actors or 'nobody'}", old, None, why
                )
    stop = " or ".join(_conditions(scenario, scenario.root.find("Storyboard/StopTrigger")))
    if stop:
        element = scenario.root.find("Storyboard/StopTrigger")
        assert element is not None
        why = "the duration belongs to a test"
        changes.add(Code.ELEMENT, scenario.where(element), "end of the scenario", stop, None, why)


def _conditions(scenario: Scenario, trigger: Element | None) -> Iterator[str]:
    """Yield the groups of conditions of a trigger as text: all conditions of a group must hold."""
    for group in [] if trigger is None else trigger.iterfind("ConditionGroup"):
        texts = []
        for condition in group.iterfind("Condition"):
            edge, delay = condition.get("conditionEdge", "none"), scenario.number(condition, "delay", 0.0)
            entities = ", ".join(e.get("entityRef", "") for e in condition.iter("EntityRef"))
            leaf = _leaf(condition)
            text = _values(scenario, leaf) + (f" of {entities}" if entities else "")
            text += f", {edge} edge" if edge not in {"none", ""} else ""
            texts.append(text + (f", {delay:g} s later" if delay else ""))
        yield " and ".join(texts)


def _leaf(condition: Element) -> Element:
    """Return the element of a condition that states it, for example <SimulationTimeCondition>."""
    for element in condition.iter():
        if element.tag.endswith("Condition") and element.tag not in {
            "Condition",
            "ByValueCondition",
            "ByEntityCondition",
            "EntityCondition",
        }:
            return element
    return condition


def _described(element: Element) -> str:
    """Return the names of an element and its first descendants."""
    names = [element.tag]
    while len(element) and len(names) < 3:
        element = element[0]
        names.append(element.tag)
    return " ".join(names)


def _values(scenario: Scenario, element: Element) -> str:
    """Return an element as text, with the values of all its attributes and parameters."""
    parts = [
        " ".join([part.tag, *(f"{key}={scenario.text(part, key)}" for key in part.attrib if key != "name")])
        for part in element.iter()
        if part.attrib
    ]
    return ", ".join(parts) or element.tag
