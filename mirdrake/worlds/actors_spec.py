"""Part of the world language: actors and the steps of their scenarios.

An actor is a prop that moves by its behaviour; contacts have no effect on its motion. With `body: full` it is a full
vehicle, whose driver follows that motion::

    actors:
      - {actor: sedan, name: lead, on_track: {track: main, s: 40}, speed: 50 km/h, behaviour: {kind: idm}}
      - {actor: sedan | van, name: traffic, along: {track: main, spacing: 30, count: 20}, behaviour: idm_mobil}
      - {actor: pedestrian, name: walker, path: [[30, -6], [30, 6]], speed: 1.4 +- 0.2,
         starts: {when: ego within 25 m}}
    scenario:
      lead:
        - {at: 5 s, change_speed: {to: 10 km/h, rate: 6 m/s^2}}
        - {when: gap < 8 m, change_lane: left in 3 s}

The entries of `actors` are evaluated for every actor, with random values from streams of its name. Steps of a scenario
are made in their order; a step waits for those before it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from mirdrake.core.errors import Place
from mirdrake.core.kinds import SelectedByKind
from mirdrake.core.yaml_io import Acceleration, Duration, Length, Schema, Speed, to_si, where
from mirdrake.worlds.schema_types import Label, Value, exactly_one

BEHAVIOURS: dict[str, str] = {
    "follow": "mirdrake.actors.behaviours.follow:Follow",
    "idm": "mirdrake.actors.behaviours.idm:Idm",
    "idm_mobil": "mirdrake.actors.behaviours.idm_mobil:IdmMobil",
    "walk": "mirdrake.actors.behaviours.walk:Walk",
}
"""Class of each behaviour of actors, imported when a file has one of that kind."""

_LARGEST = 1e6  # [m] of coordinates
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Coordinate = Annotated[Length, Field(ge=-_LARGEST, le=_LARGEST)]


class ActorBehaviour(Schema):
    """Base of the behaviours of actors."""

    kind: str


BEHAVIOUR_KINDS: SelectedByKind[ActorBehaviour] = SelectedByKind(BEHAVIOURS, by_name=True)
"""Classes of :data:`BEHAVIOURS` by kind."""

Behaviour = Annotated[ActorBehaviour, BEHAVIOUR_KINDS]


# --- triggers -----------------------------------------------------------------------------------------------------

_WITHIN = re.compile(r"(\w+) within (.+)", re.ASCII)
_PAST = re.compile(r"(\w+) past (\w+)@(.+)", re.ASCII)
_COMPARED = re.compile(r"(gap|speed) ([<>]) (.+)", re.ASCII)
_FORMS = "'ego within 25 m', 'ego within 4 s', 'ego past main@58', 'gap < 8 m', 'speed > 3 m/s'"

ConditionKind = Literal["distance", "time", "past", "gap_below", "gap_above", "speed_below", "speed_above"]


class Condition(Schema):
    """Condition for a trigger, parsed from a text."""

    kind: ConditionKind = Field(description="kind of the condition [-]")
    of: str | None = Field(default=None, description="vehicle or actor that it is about; default: the actor itself [-]")
    value: float = Field(description="distance, station, gap, time or speed [SI]")
    track: str | None = Field(default=None, description="track of a station [-]")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        # The distance of an actor to itself is zero: such a trigger would fire at once.
        if self.kind in {"distance", "time"} and self.of is None:
            raise ValueError(f"kind: {self.kind} needs of: the vehicle or actor that comes near")
        if self.kind == "past" and self.track is None:
            raise ValueError("kind: past needs track, whose station is the value")
        # Others than these would never hold, or always.
        least = "above 0" if self.kind in {"distance", "time", "gap_below", "speed_below"} else "0 or more"
        if self.kind != "past" and (self.value < 0.0 or (self.value == 0.0 and least == "above 0")):
            raise ValueError(f"{self.value:g}; it must be {least}")
        return self


def _condition(data: Any) -> Any:
    """Return the data of a condition that is given as a text."""
    if not isinstance(data, str):
        return data
    text = " ".join(data.split())
    if match := _WITHIN.fullmatch(text):
        of, given = match.groups()
        # The unit decides: seconds are a time to reach the other one, metres a distance. A parameter has none.
        if re.fullmatch(r"[-+.\deE]+", given):
            raise ValueError(f"{given} has no unit; write for example '{of} within {given} m', or s for a time")
        kind = "time" if re.search(r"\d\s*(s|ms|min)$", given) else "distance"
        return {"kind": kind, "of": of, "value": _number(given, "s" if kind == "time" else "m")}
    if match := _PAST.fullmatch(text):
        of, track, given = match.groups()
        return {"kind": "past", "of": of, "track": track, "value": _number(given, "m")}
    if match := _COMPARED.fullmatch(text):
        signal, sign, given = match.groups()
        kind = f"{signal}_{'below' if sign == '<' else 'above'}"
        return {"kind": kind, "value": _number(given, "m" if signal == "gap" else "m/s")}
    raise ValueError(f"{data[:60]!r} is not a condition; allowed are {_FORMS}")


def _number(text: str, unit: str) -> float:
    value = to_si(text, unit)
    if not isinstance(value, float):
        raise ValueError(f"{text!r} is not a number in {unit}; conditions are {_FORMS}")
    return value


ConditionText = Annotated[Condition, BeforeValidator(_condition, json_schema_input_type=Condition | str)]
"""A condition, or its text."""


class Trigger(Schema):
    """When something happens: `at` a time, or `when` a condition holds."""

    at: Annotated[Duration, Field(ge=0.0)] | None = Field(default=None, description="time since the start [s]")
    when: ConditionText | None = Field(default=None, description=f"condition, such as {_FORMS} [-]")

    @model_validator(mode="after")
    def _one_trigger(self) -> Self:
        exactly_one(self, ("at", "when"))
        return self


# --- steps of a scenario ------------------------------------------------------------------------------------------

_LANE_CHANGE = re.compile(r"(left|right)(?: in (.+))?")


class SpeedChange(Schema):
    """Change of speed at a constant rate."""

    to: Speed = Field(ge=0.0, le=100.0, description="new speed [m/s]")
    rate: Acceleration = Field(default=3.0, gt=0.0, le=50.0, description="acceleration or deceleration [m/s²]")


class LaneChange(Schema):
    """Change to the next lane."""

    to: Literal["left", "right"] = Field(description="side of the lane [-]")
    within: Duration = Field(default=4.0, gt=0.0, le=60.0, description="duration at the present speed [s]")


def _lane_change(data: Any) -> Any:
    """Return the data of a lane change that is given as a text."""
    if not isinstance(data, str):
        return data
    match = _LANE_CHANGE.fullmatch(" ".join(data.split()))
    if match is None:
        raise ValueError(f"{data[:40]!r} is not a lane change; write 'left in 3 s' or 'right'")
    side, time = match.groups()
    return {"to": side} | ({"within": time} if time else {})


LaneChangeText = Annotated[LaneChange, BeforeValidator(_lane_change, json_schema_input_type=LaneChange | str)]
"""A lane change, or its text."""


class Stop(Schema):
    """Braking to standstill; the actor waits until `go`."""

    rate: Acceleration = Field(default=3.0, gt=0.0, le=50.0, description="deceleration [m/s²]")


class Go(Schema):
    """Start after a stop, at the speed before it."""

    rate: Acceleration = Field(default=2.0, gt=0.0, le=50.0, description="acceleration [m/s²]")


ACTIONS = ("change_speed", "change_lane", "stop", "go")


class Step(Trigger):
    """A step of a scenario: a trigger and one action."""

    change_speed: SpeedChange | None = Field(default=None, description="change of speed at a constant rate [-]")
    change_lane: LaneChangeText | None = Field(default=None, description="change to the next lane: left in 3 s [-]")
    stop: Stop | None = Field(default=None, description="brake to standstill: {rate: 4 m/s^2} [-]")
    go: Go | None = Field(default=None, description="start after a stop: {rate: 2 m/s^2} [-]")

    @model_validator(mode="after")
    def _one_action(self) -> Self:
        exactly_one(self, ACTIONS)
        return self


# --- actors -------------------------------------------------------------------------------------------------------


class OnTrackLaneSpec(Schema):
    """A position on a track or in one of its lanes."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="s of its rear axle along the centre line of the track [m]")
    lane: int | Literal["left", "right"] | None = Field(
        default=None, description="number of the lane from the right, negative: oncoming; default: right [-]"
    )
    offset: Annotated[Length, Field(ge=-100.0, le=100.0)] = Field(
        default=0.0, description="offset to the left of the middle of the lane [m]"
    )


class OnLaneSpec(Schema):
    """A position on a lane of the network."""

    lane: str = Field(description="id of the lane [-]")
    s: Coordinate = Field(default=0.0, description="s of its rear axle along the lane [m]")
    offset: Annotated[Length, Field(ge=-100.0, le=100.0)] = Field(
        default=0.0, description="offset to the left of the middle of the lane [m]"
    )


class RecordedSpec(Schema):
    """Motion of an actor from a file: CSV, Parquet, or another format of recordings."""

    file: str = Field(min_length=1, description="path relative to the world file, for example RUN/actors.parquet [-]")
    of: str | None = Field(
        default=None, description="name before the columns x [m], y [m], yaw [rad]: lead for lead.x; default: none [-]"
    )
    point: Literal["rear_axle", "middle"] = Field(
        default="rear_axle", description="point of the actor that was recorded [-]"
    )
    begin: float = Field(default=0.0, description="time of the file at the start of a run [s]")
    rows: list[tuple[float, float, float, float]] = Field(
        default_factory=list,
        description="samples of the file: time since the start of a run, x, y and yaw [s, m, m, rad]",
    )


def _recorded(data: Any) -> Any:
    """Return the data of a recording that is given as the name of its file."""
    return {"file": data} if isinstance(data, str) else data


class ActorSpec(Schema):
    """An actor: a prop that moves along a path or a lane, or a full vehicle whose driver follows such a motion."""

    actor: str = Field(min_length=1, description="name of a prop; with body: full that of a vehicle [-]")
    name: Label = Field(description="its name [-]")
    on_track: OnTrackLaneSpec | None = Field(default=None, description="on a track or a lane of it [-]")
    on_lane: OnLaneSpec | None = Field(default=None, description="on a lane of the network [-]")
    path: Annotated[list[tuple[Coordinate, Coordinate]], Field(min_length=2, max_length=1000)] | None = Field(
        default=None, description="corners of its path [m]"
    )
    recorded: Annotated[RecordedSpec, BeforeValidator(_recorded, json_schema_input_type=RecordedSpec | str)] | None = (
        Field(default=None, description="file with its motion [-]")
    )
    radius: Annotated[Length, Field(ge=0.0, le=1000.0)] | None = Field(
        default=None, description="radius of the bends at the corners of the path; default: that of its kind [m]"
    )
    speed: Speed = Field(default=0.0, ge=0.0, le=100.0, description="speed and its set-point at the start [m/s]")
    behaviour: Behaviour = Field(
        default_factory=lambda: BEHAVIOUR_KINDS["follow"](kind="follow"), description="kind, or mapping with a kind [-]"
    )
    starts: Trigger | None = Field(default=None, description="it is at rest until then; default: it moves at once [-]")
    body: Literal["ghost", "solid", "full"] = Field(
        default="ghost",
        description="ghost: vehicles pass through it; solid: they collide with it; full: a full vehicle [-]",
    )
    color: tuple[Share, Share, Share] | str | None = Field(
        default=None, description="CSS colour, or red, green, blue, 0 to 1 [-]"
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("on_track", "on_lane", "path", "recorded"))
        # By value: the specification in a run folder has all defaults.
        idle = {
            "speed": self.speed != 0.0,
            "behaviour": self.behaviour.kind != "follow",
            "starts": self.starts is not None,
        }
        if self.recorded is not None and any(idle.values()):
            key = next(key for key, given in idle.items() if given)
            raise ValueError(f"{key} has no effect on a recorded motion; remove it")
        if self.radius is not None and self.path is None:
            raise ValueError("radius belongs to path")
        if self.body == "full" and self.behaviour.kind == "walk":
            raise ValueError("walk is a behaviour of pedestrians; a full vehicle has follow, idm or idm_mobil")
        if self.body == "full" and self.color is not None:
            raise ValueError("color has no effect on a full vehicle, which has its own colours; remove it")
        return self


class AlongSpec(Schema):
    """Several actors one behind the other on a track."""

    track: str = Field(description="name of the track [-]")
    lane: int | str | None = Field(
        default=None, description="number of the lane from the right, negative: oncoming; left or right [-]"
    )
    s: Value = Field(default=0.0, description="s of the first one along the centre line [m]")
    spacing: Value = Field(description="distance from one to the next along the track [m]")
    count: Value = Field(description="number of actors [-]")
    offset: Value = Field(default=0.0, description="offset to the left of the middle of the lane [m]")


class ActorEntry(ActorSpec):
    """A prop that moves, or several with `along`; with `body: full` a full vehicle."""

    name: Label | None = Field(default=None, description="its name; default: that of the prop and a number [-]")  # type: ignore[assignment]
    along: AlongSpec | None = Field(default=None, description="several on a track, one behind the other [-]")


ActorList = Annotated[list[ActorSpec], BeforeValidator(lambda data: data, json_schema_input_type=list[ActorEntry])]
"""Actors; JSON Schema sees the entries of a world file."""


def conditions(
    actors: Sequence[ActorSpec], scenario: Mapping[str, Sequence[Step]]
) -> Iterator[tuple[Place, str, Condition]]:
    """Yield the place, the actor and the condition of every trigger of a world file that has one."""
    triggers: list[tuple[str, Trigger]] = [(actor.name, actor.starts) for actor in actors if actor.starts is not None]
    triggers += [(name, step) for name, steps in scenario.items() for step in steps]
    for name, trigger in triggers:
        if trigger.when is not None:
            yield where(trigger, "when"), name, trigger.when
