"""Events of an OpenSCENARIO storyboard as steps of `scenario:`.

A step has one trigger and one action. Triggers are times, and distances or headways of the ego vehicle; actions are
changes of speed and of lanes. Every other event is reported, with the reason.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.roads.osc_file import Entity, Scenario, Spot, lane_beside, lanes_between
from mirdrake.importing.roads.road_world import number
from mirdrake.importing.target import plain_name
from mirdrake.worlds.networks import Network

_STEP_RATE = 50.0  # [m/s²] of a change of speed without duration
_LONGEST = 60.0  # [s] of a lane change
_NEAR = 0.01  # [m/s] from the new speed, where a change of speed counts as ended
_BELOW, _ABOVE = {"lessThan", "lessOrEqual"}, {"greaterThan", "greaterOrEqual"}
_LEAVES = {"Condition", "ByValueCondition", "ByEntityCondition", "EntityCondition"}


class NotRepresentedError(Exception):
    """An event that is not a step; the text is the reason."""


@dataclass
class Board:
    """What is known while the events are read.

    Attributes:
        scenario: the scenario.
        entities: its entities by name.
        network: its road network.
        spots: positions at the beginning.
        speeds: speeds at the beginning, then those after the steps so far [m/s].
        ego: name of the ego vehicle, and its name in the world.
        lanes: number of lanes to the left of where an entity begins, after the steps so far.
        referenced: entities that triggers refer to, except the ego vehicle.
        ends: end of each change of speed, by the names of its action and its event.
    """

    scenario: Scenario
    entities: Mapping[str, Entity]
    network: Network | None
    spots: Mapping[str, Spot]
    speeds: dict[str, float]
    ego: tuple[str, str]
    lanes: dict[str, int] = field(default_factory=dict)
    referenced: set[str] = field(default_factory=set)
    ends: dict[str, "SpeedEnd"] = field(default_factory=dict)


@dataclass(frozen=True)
class SpeedEnd:
    """End of a change of speed.

    Attributes:
        actor: its actor.
        trigger: trigger of a step when the speed is reached.
        time: time of it [s]; None if the change begins with a distance.
    """

    actor: str
    trigger: str
    time: float | None


def read_steps(board: Board, changes: Changes) -> dict[str, list[str]]:
    """Return the steps of each entity as YAML; every event that is not a step is added to the changes."""
    steps: dict[str, list[str]] = {}
    scenario = board.scenario
    # Every action of every event ends as a step or as a row of the report with the reason.
    for act in scenario.root.iterfind("Storyboard/Story/Act"):
        if ends := " or ".join(conditions(scenario, act.find("StopTrigger"))):
            part = f"end of act '{act.get('name', '')}'"
            changes.add(Code.POPULATION, scenario.where(act), part, ends, None, "steps are not stopped")
        for group in act.iterfind("ManeuverGroup"):
            actors = [reference.get("entityRef", "") for reference in group.iterfind("Actors/EntityRef")]
            _report_group(scenario, group, actors, changes)
            for event in group.iterfind("Maneuver/Event"):
                for action in event.iterfind("Action"):
                    try:
                        for step in _steps(board, act, event, action, actors):
                            steps.setdefault(actors[0], []).append(step)
                    except NotRepresentedError as fault:
                        name = action.get("name") or event.get("name") or "action"
                        part = f"'{name}' of {', '.join(actors) or 'nobody'}"
                        when = " or ".join(conditions(scenario, event.find("StartTrigger"))) or "at once"
                        old = f"{described(scenario, next(iter(action), action))} when {when}"
                        changes.add(Code.POPULATION, scenario.where(action), part, old, None, str(fault))
                    else:
                        _report_approximations(board, event, action, actors, changes)
    return steps


def _report_group(scenario: Scenario, group: Element, actors: list[str], changes: Changes) -> None:
    """Add what a group of manoeuvres states beyond its events: manoeuvres of catalogues, and repetitions."""
    owner = ", ".join(actors) or "nobody"
    for reference in group.iterfind("CatalogReference"):
        part, old = f"manoeuvre of {owner}", described(scenario, reference)
        changes.add(
            Code.POPULATION, scenario.where(reference), part, old, None, "manoeuvres of catalogues are not read"
        )
    for element in (group, *group.iterfind("Maneuver/Event")):
        times = scenario.number(element, "maximumExecutionCount", 1.0)
        if times > 1.0:
            part = f"'{element.get('name', '')}' of {owner}: repetitions"
            changes.add(Code.POPULATION, scenario.where(element), part, f"{times:g}", "1", "a step is taken once")


def described(scenario: Scenario, element: Element) -> str:
    """Return an element as text, with the values of all its attributes and parameters."""
    parts = [
        " ".join([part.tag, *(f"{key}={scenario.text(part, key)}" for key in part.attrib if key != "name")])
        for part in element.iter()
        if part.attrib
    ]
    return ", ".join(parts) or element.tag


def conditions(scenario: Scenario, trigger: Element | None) -> Iterator[str]:
    """Yield the groups of conditions of a trigger as text: all conditions of a group must hold."""
    for group in [] if trigger is None else trigger.iterfind("ConditionGroup"):
        texts = []
        for condition in group.iterfind("Condition"):
            edge, delay = condition.get("conditionEdge", "none"), scenario.number(condition, "delay", 0.0)
            entities = ", ".join(e.get("entityRef", "") for e in condition.iter("EntityRef"))
            text = described(scenario, _leaf(condition)) + (f" of {entities}" if entities else "")
            text += f", {edge} edge" if edge not in {"none", ""} else ""
            texts.append(text + (f", {delay:g} s later" if delay else ""))
        yield " and ".join(texts)


def _leaf(condition: Element) -> Element:
    """Return the element that states a condition, for example <SimulationTimeCondition>."""
    for element in condition.iter():
        if element.tag.endswith("Condition") and element.tag not in _LEAVES:
            return element
    return condition


# --- steps --------------------------------------------------------------------------------------------------------


def _steps(board: Board, act: Element, event: Element, action: Element, actors: list[str]) -> Iterator[str]:
    """Yield the step of an action; none if it has no effect.

    Raises:
        NotRepresentedError: it is not a step.
    """
    if action.find("GlobalAction") is not None:
        raise NotRepresentedError("steps are those of actors")
    # A group of several actors would have to do the same at once, for which steps have no form.
    if len(actors) != 1 or actors[0] not in board.spots:
        raise NotRepresentedError("a step has one actor that is on the network")
    if actors[0] == board.ego[0]:
        raise NotRepresentedError("the driver of a test controls the ego vehicle")
    trigger, begin = _trigger(board, act, event, actors[0])
    speed, change = action.find(".//SpeedAction"), action.find(".//LaneChangeAction")
    if speed is not None:
        before = board.speeds.get(actors[0], 0.0)
        text, duration = _speed_change(board, speed, actors[0])
        _note_end(board, event, action, actors[0], before, None if begin is None else begin + duration)
    elif change is not None:
        text = _lane_change(board, change, actors[0])
    else:
        raise NotRepresentedError("steps change speed or lane")
    yield f"{{{trigger}, {text}}}"


def _trigger(board: Board, act: Element, event: Element, actor: str) -> tuple[str, float | None]:
    """Return the trigger of an event as YAML, and the time of it if that is known [s].

    Raises:
        NotRepresentedError: it is not one time, distance or headway.
    """
    # The trigger of the act has to fire before that of the event, so that both count.
    rows = [c for trigger in (act.find("StartTrigger"), event.find("StartTrigger")) for c in _all(trigger)]
    rows = [row for row in rows if not _is_start(board.scenario, row)]
    if not rows:
        return _at(0.0)
    if len(rows) > 1:
        raise NotRepresentedError("a step has one condition")
    # Each rejection below names the one reason, which the report shows beside the skipped event.
    (condition,) = rows
    leaf, delay = _leaf(condition), board.scenario.number(condition, "delay", 0.0)
    if condition.get("conditionEdge", "none") == "falling":
        raise NotRepresentedError("the condition of a step holds from some time on; it has no falling edge")
    rule = leaf.get("rule", "")
    if leaf.tag == "SimulationTimeCondition" and rule in _ABOVE:
        # Becoming greater than a time and reaching it are the same instant.
        return _at(max(board.scenario.number(leaf, "value"), 0.0) + delay)
    if leaf.tag == "StoryboardElementStateCondition":
        return _after_action(board, leaf, delay, actor)
    if leaf.tag not in {"RelativeDistanceCondition", "DistanceCondition", "TimeHeadwayCondition"} or rule not in _BELOW:
        raise NotRepresentedError(f"{leaf.tag} {rule}".strip() + " is not a condition of a step")
    value = board.scenario.number(leaf, "value")
    # An EntityCondition names its own entity outside of the leaf and the other one inside; the order does not matter.
    pair = {reference.get("entityRef") for reference in condition.iter("EntityRef")} | {leaf.get("entityRef")}
    other = next((name for name in pair if name not in {actor, None}), None)
    if actor not in pair or other is None or other not in board.spots:
        raise NotRepresentedError("a distance of a step is one between its actor and another vehicle")
    if delay:
        raise NotRepresentedError("a condition of a step has no delay")
    if other != board.ego[0]:
        if board.entities[other].prop is None:
            raise NotRepresentedError("a distance of a step is one between its actor and another vehicle or actor")
        board.referenced.add(other)
    label = board.ego[1] if other == board.ego[0] else plain_name(other)
    # OpenSCENARIO measures along the road, a step the straight distance: boxes and lateral offset are added.
    boxes, aside = _lengths(board, actor, other, leaf), _aside(board, actor, other)
    # A headway counts from the vehicle behind, with a floor on its speed because the time is infinite at rest.
    if leaf.tag == "TimeHeadwayCondition":
        behind = other if _is_ahead(board, actor, other) else actor
        speed = max(board.speeds.get(behind, 0.0), 0.1)
        return f"when: {label} within {number(math.hypot(value * speed + boxes, aside) / speed)} s", None
    return f"when: {label} within {number(math.hypot(value + boxes, aside))} m", None


def _at(time: float) -> tuple[str, float]:
    return f"at: {number(time)} s", time


def _note_end(board: Board, event: Element, action: Element, actor: str, before: float, time: float | None) -> None:
    """Remember the end of a change of speed from `before` [m/s], for steps that follow it."""
    speed = board.speeds[actor]
    reached = f"speed > {number(speed - _NEAR)}" if speed > before else f"speed < {number(speed + _NEAR)}"
    # Names are unique within a storyboard as a rule; of several equal ones the last one counts.
    for element in (action, event):
        if element.get("name"):
            board.ends[element.get("name", "")] = SpeedEnd(actor, f"when: {reached}", time)


def _after_action(board: Board, leaf: Element, delay: float, actor: str) -> tuple[str, float | None]:
    """Return the trigger of an event that begins when a change of speed of the same actor has ended, and its time [s].

    Raises:
        NotRepresentedError: it is another state, element or actor, or there is a delay after an unknown time.
    """
    # The name in a reference may have those of the elements around it before it: maneuver::event::action.
    name = board.scenario.text(leaf, "storyboardElementRef").rpartition("::")[2]
    states = {"endTransition", "completeState"}
    if leaf.get("storyboardElementType") not in {"action", "event"} or leaf.get("state") not in states:
        raise NotRepresentedError("a step begins after an action or event has ended, not in other states")
    end = board.ends.get(name)
    if end is None or end.actor != actor:
        raise NotRepresentedError("a step follows a change of speed of its own actor")
    if not delay:
        return end.trigger, end.time
    if end.time is None:
        raise NotRepresentedError("a delay after the end of an action needs one that begins at a time")
    return _at(end.time + delay)


def _all(trigger: Element | None) -> Iterator[Element]:
    """Yield the conditions of a trigger.

    Raises:
        NotRepresentedError: one of several groups is enough.
    """
    groups = [] if trigger is None else trigger.findall("ConditionGroup")
    if len(groups) > 1:
        raise NotRepresentedError("a step has one condition")
    for group in groups:
        yield from group.iterfind("Condition")


def _is_start(scenario: Scenario, condition: Element) -> bool:
    """Return whether a condition holds from the beginning on."""
    leaf = _leaf(condition)
    is_time = leaf.tag == "SimulationTimeCondition" and leaf.get("rule") in _ABOVE
    return is_time and scenario.number(leaf, "value") <= 0.0 and scenario.number(condition, "delay", 0.0) == 0.0


def _is_ahead(board: Board, first: str, second: str) -> bool:
    (x, y, yaw), (other_x, other_y, _) = board.spots[second].pose, board.spots[first].pose
    return (other_x - x) * math.cos(yaw) + (other_y - y) * math.sin(yaw) > 0.0


def _lengths(board: Board, first: str, second: str, leaf: Element) -> float:
    """Return the part of the distance of two reference points that is within their boxes [m], if it does not count."""
    if leaf.get("freespace") != "true":
        return 0.0
    ahead, behind = (first, second) if _is_ahead(board, first, second) else (second, first)
    front, rear = board.entities[behind], board.entities[ahead]
    return front.size[0] / 2.0 + front.middle + rear.size[0] / 2.0 - rear.middle


def _aside(board: Board, first: str, second: str) -> float:
    """Return the lateral distance of two entities at the beginning [m]."""
    (x, y, yaw), (other_x, other_y, _) = board.spots[second].pose, board.spots[first].pose
    return (other_y - y) * math.cos(yaw) - (other_x - x) * math.sin(yaw)


def _speed_change(board: Board, action: Element, actor: str) -> tuple[str, float]:
    """Return a change of speed at a constant rate, and its duration [s]."""
    dynamics, target = action.find("SpeedActionDynamics"), action.find("SpeedActionTarget")
    if dynamics is None or target is None:
        raise NotRepresentedError("no dynamics or no target")
    # Targets that follow another entity over time have no single speed.
    absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
    if absolute is not None:
        speed = board.scenario.number(absolute, "value")
    elif relative is not None and relative.get("continuous") != "true" and relative.get("entityRef") in board.speeds:
        value, base = board.scenario.number(relative, "value"), board.speeds[relative.get("entityRef", "")]
        speed = base * value if relative.get("speedTargetValueType") == "factor" else base + value
    else:
        raise NotRepresentedError("a change of speed has a target that is known at the beginning")
    before, value = board.speeds.get(actor, 0.0), board.scenario.number(dynamics, "value")
    # A step of OpenSCENARIO is instantaneous; actors have a finite rate.
    if dynamics.get("dynamicsShape") == "step":
        rate = _STEP_RATE
    else:
        # Mean rates: |Δv| / t over a time, |Δ(v²)| / (2 s) over a distance.
        by_time = abs(speed - before) / value if value > 0.0 else 0.0
        by_distance = abs(speed**2 - before**2) / (2.0 * value) if value > 0.0 else 0.0
        rate = {"rate": abs(value), "time": by_time, "distance": by_distance}.get(
            dynamics.get("dynamicsDimension", ""), 0.0
        )
    if rate <= 0.0:
        raise NotRepresentedError("without effect: the speed does not change, or its rate is 0")
    # Later actions of this entity and relative targets begin with this speed.
    board.speeds[actor] = speed
    rate = min(rate, _STEP_RATE)
    text = f"change_speed: {{to: {number(max(speed, 0.0))}, rate: {number(rate)}}}"
    return text, abs(max(speed, 0.0) - before) / rate


def _lane_change(board: Board, action: Element, actor: str) -> str:
    """Return a lane change to the next lane."""
    dynamics, target = action.find("LaneChangeActionDynamics"), action.find("LaneChangeTarget")
    if dynamics is None or target is None or board.network is None or board.spots[actor].lane is None:
        raise NotRepresentedError("no dynamics, no target, or the actor is not on a lane")
    lane = board.network.lanes[board.spots[actor].lane or ""]
    # Lane changes of this actor so far count, because targets are relative to the lane in which it is by then.
    now = lane_beside(lane.number, board.lanes.get(actor, 0) * lane.direction)
    absolute, relative = target.find("AbsoluteTargetLane"), target.find("RelativeTargetLane")
    if absolute is not None:
        wanted = round(board.scenario.number(absolute, "value"))
    elif relative is not None and (spot := board.spots.get(relative.get("entityRef", ""))) is not None and spot.lane:
        base = board.network.lanes[spot.lane]
        own = board.lanes.get(relative.get("entityRef", ""), 0)
        wanted = lane_beside(base.number, (own + round(board.scenario.number(relative, "value"))) * base.direction)
    else:
        raise NotRepresentedError("the target lane is not known")
    # Lane numbers increase to the left of the reference line; lanes against it have the opposite sides.
    left = lanes_between(now, wanted) * lane.direction
    if abs(left) == 1 and wanted * now < 0:
        raise NotRepresentedError("a step changes to a lane of the same direction; the target is one of the other")
    if abs(left) != 1:
        raise NotRepresentedError(f"a step changes to the next lane; the target is {abs(left)} lanes away")
    # A rate and a distance become a duration with the width of the lane and the speed at this point of the scenario.
    width = float(lane.width_at(board.spots[actor].s))
    value, shape = board.scenario.number(dynamics, "value"), dynamics.get("dynamicsShape", "")
    # The rate of a sinusoidal change is its largest lateral speed, π/2 of the mean one.
    peak = math.pi / 2.0 if shape == "sinusoidal" else 1.5 if shape == "cubic" else 1.0
    times = {
        "time": value,
        "rate": peak * width / value if value > 0.0 else 0.0,
        "distance": value / max(board.speeds.get(actor, 0.0), 0.1),
    }
    time = times.get(dynamics.get("dynamicsDimension", ""), 0.0) if shape != "step" else 0.1
    board.lanes[actor] = board.lanes.get(actor, 0) + left
    return f"change_lane: {'left' if left > 0 else 'right'} in {number(min(max(time, 0.1), _LONGEST))} s"


def _report_approximations(board: Board, event: Element, action: Element, actors: list[str], changes: Changes) -> None:
    """Add what a step represents in another way: profiles over time, and distances along the road."""
    where, name = board.scenario.where(action), action.get("name") or event.get("name") or "action"
    for tag in ("SpeedActionDynamics", "LaneChangeActionDynamics"):
        dynamics = action.find(f".//{tag}")
        shape = "" if dynamics is None else dynamics.get("dynamicsShape", "")
        # Shapes that a step has by itself need no remark.
        plain = {"linear", "step"} if tag == "SpeedActionDynamics" else {"cubic", "sinusoidal"}
        if shape and shape not in plain:
            new = "constant rate" if tag == "SpeedActionDynamics" else "smooth change of the same duration"
            changes.add(Code.POPULATION, where, f"'{name}' of {actors[0]}: profile", shape, new, "profiles are fixed")
    for condition in event.iter("Condition"):
        leaf = _leaf(condition)
        if leaf.tag in {"RelativeDistanceCondition", "DistanceCondition", "TimeHeadwayCondition"}:
            why = "converted for the lateral distance and boxes at the beginning"
            new = "distance of the rear axles"
            changes.add(
                Code.POPULATION, where, f"'{name}' of {actors[0]}: trigger", described(board.scenario, leaf), new, why
            )
