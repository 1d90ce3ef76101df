"""OpenSCENARIO: cut-in, cut-out and deceleration as in UN R157 move as their closed forms.

The events have the elements of the public ALKS set; a lane change at a lateral rate is half a period of a cosine whose
largest lateral speed is that rate, and a change of speed has a constant rate (ASAM OpenSCENARIO 1.1, shapes).

The same groups with the figures, parameters and expressions of the public set are compared with what esmini recorded
for them: the states in its own regression test of the set (github.com/esmini/esmini, test/alks_suite.py), in steps of
0.05 s. They are those of versions since 2.34: before 2.27.5 a car that changed its lane moved at its speed along the
road ("adjust speed along s to maintain absolute speed"), and before 2.34.0 an action began one or two updates after
its condition ("make state transitions immediately").
"""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mirdrake.actors.crew import FullVehicle, make_crew, start_states
from mirdrake.actors.step import TimeStep
from mirdrake.importing.roads.openscenario import read_scenario_world
from mirdrake.importing.target import plain_name
from mirdrake.worlds import World, load_world
from tests.opendrive_maps import document, geometry, lane, road, section

DT = 0.02  # [s]
EGO, BEGIN = 60.0 / 3.6, 5.0  # [m/s], [m]
WIDTH, LANE = 3.5, -8.0  # [m] of a lane, and y of the middle of lane -3
BOX = (4.8, 1.4)  # [m] length of all cars, and their middle ahead of the rear axle
LATERAL = 2.0  # [m/s]
ROAD = document(
    road(
        "0",
        geometry(0.0, 0.0, 0.0, 1000.0),
        section(right=[lane(-1, "border", 2.75), *(lane(n) for n in (-2, -3, -4))]),
    )
)
Motion = Callable[[float], tuple[float, float]]


def entity(name: str) -> str:
    """Return a car."""
    box = f'<Center x="{BOX[1]}" y="0" z="0.75"/><Dimensions length="{BOX[0]}" width="1.9" height="1.5"/>'
    vehicle = f'<Vehicle name="car" vehicleCategory="car"><BoundingBox>{box}</BoundingBox></Vehicle>'
    return f'<ScenarioObject name="{name}">{vehicle}</ScenarioObject>'


def begin(name: str, lane_id: int, s: float, speed: float) -> str:
    """Return the position and the speed of a car at the beginning."""
    place = (
        f'<TeleportAction><Position><LanePosition roadId="0" laneId="{lane_id}" s="{s}"/></Position></TeleportAction>'
    )
    target = f'<SpeedActionTarget><AbsoluteTargetSpeed value="{speed}"/></SpeedActionTarget>'
    action = f'<SpeedAction><SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>{target}'
    moves = f"<LongitudinalAction>{action}</SpeedAction></LongitudinalAction>"
    actions = "".join(f"<PrivateAction>{one}</PrivateAction>" for one in (place, moves))
    return f'<Private entityRef="{name}">{actions}</Private>'


def event(name: str, action: str, condition: str) -> str:
    """Return an event of one action."""
    group = f'<Condition name="c" delay="0" conditionEdge="rising">{condition}</Condition>'
    trigger = f"<StartTrigger><ConditionGroup>{group}</ConditionGroup></StartTrigger>"
    named = f'<Action name="{name}Action"><PrivateAction>{action}</PrivateAction></Action>'
    return f'<Event name="{name}" priority="overwrite">{named}{trigger}</Event>'


def after(time: float) -> str:
    """Return a condition on the time."""
    return f'<ByValueCondition><SimulationTimeCondition value="{time}" rule="greaterThan"/></ByValueCondition>'


def ended(action: str) -> str:
    """Return the condition that an action has ended."""
    kind = 'storyboardElementType="action" state="endTransition"'
    leaf = f'<StoryboardElementStateCondition {kind} storyboardElementRef="{action}"/>'
    return f"<ByValueCondition>{leaf}</ByValueCondition>"


def near(subject: str, other: str, distance: float | str) -> str:
    """Return the condition that the free distance along the road is small."""
    what = 'relativeDistanceType="longitudinal" freespace="true" rule="lessThan" coordinateSystem="entity"'
    leaf = f'<RelativeDistanceCondition entityRef="{other}" value="{distance}" {what}/>'
    who = f'<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="{subject}"/></TriggeringEntities>'
    return f"<ByEntityCondition>{who}<EntityCondition>{leaf}</EntityCondition></ByEntityCondition>"


def lane_change(entity_ref: str, value: int, rate: float | str = LATERAL) -> str:
    """Return a lane change at a lateral rate."""
    dynamics = f'<LaneChangeActionDynamics dynamicsShape="sinusoidal" value="{rate}" dynamicsDimension="rate"/>'
    target = f'<LaneChangeTarget><RelativeTargetLane entityRef="{entity_ref}" value="{value}"/></LaneChangeTarget>'
    return f"<LateralAction><LaneChangeAction>{dynamics}{target}</LaneChangeAction></LateralAction>"


def speed_change(delta: float | str, rate: float | str) -> str:
    """Return a change of speed to that of the ego vehicle and more."""
    dynamics = f'<SpeedActionDynamics dynamicsShape="linear" value="{rate}" dynamicsDimension="rate"/>'
    relative = f'<RelativeTargetSpeed entityRef="Ego" value="{delta}" speedTargetValueType="delta" continuous="false"/>'
    target = f"<SpeedActionTarget>{relative}</SpeedActionTarget>"
    return f"<LongitudinalAction><SpeedAction>{dynamics}{target}</SpeedAction></LongitudinalAction>"


def scenario(folder: Path, cars: dict[str, tuple[int, float, float]], mover: str, *events: str) -> World:
    """Return the world of a scenario with an ego vehicle on lane -3; cars by name: lane, station [m], speed [m/s]."""
    everyone = {"Ego": (-3, BEGIN, EGO), **cars}
    actors = f'<Actors><EntityRef entityRef="{mover}"/></Actors>'
    group = f'<ManeuverGroup name="g">{actors}<Maneuver name="m">{"".join(events)}</Maneuver></ManeuverGroup>'
    at_once = f'<Condition name="s" delay="0" conditionEdge="rising">{after(0)}</Condition>'
    start = f"<StartTrigger><ConditionGroup>{at_once}</ConditionGroup></StartTrigger>"
    text = (
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="1"/>'
        '<RoadNetwork><LogicFile filepath="./road.xodr"/></RoadNetwork>'
        f"<Entities>{''.join(map(entity, everyone))}</Entities><Storyboard><Init><Actions>"
        f"{''.join(begin(name, *place) for name, place in everyone.items())}</Actions></Init>"
        f'<Story name="s"><Act name="a">{group}{start}</Act></Story></Storyboard></OpenSCENARIO>'
    )
    world, left_out = imported(folder, text)
    assert not left_out
    return world


def imported(folder: Path, text: str) -> tuple[World, list[str]]:
    """Return the world of a scenario, and what its import leaves out."""
    (folder / "road.xodr").write_text(ROAD, encoding="utf-8")
    (folder / "alks.xosc").write_text(text, encoding="utf-8")
    made = read_scenario_world(folder / "alks.xosc", "alks")
    (folder / "alks").mkdir()
    for name, content in made.files.items():
        (folder / "alks" / name).write_bytes(content)
    (folder / "alks.yaml").write_text(made.text, encoding="utf-8")
    return load_world(str(folder / "alks.yaml")), [change.part for change in made.changes if change.left_out]


def changes_lane(x: float, speed: float, y: float, left: int, time: float) -> Motion:
    """Return the motion of a car at a constant speed that changes its lane at a time."""
    duration = 0.5 * math.pi * WIDTH / LATERAL

    def place(t: float) -> tuple[float, float]:
        share = min(max((t - time) / duration, 0.0), 1.0)
        return x + speed * t, y + left * WIDTH * 0.5 * (1.0 - math.cos(math.pi * share))

    return place


def changes_speed(x: float, *parts: tuple[float, float]) -> Motion:
    """Return the motion of a car on lane -3 at the speed of the ego vehicle, then with accelerations from times on."""

    def place(t: float) -> tuple[float, float]:
        at, speed, now, a = x, EGO, 0.0, 0.0
        for time, then in (*parts, (math.inf, 0.0)):
            step = min(t, time) - now
            at, speed = at + speed * step + 0.5 * a * step * step, speed + a * step
            if t <= time:
                break
            now, a = time, then
        return at, LANE

    return place


def cut_in(folder: Path, distance: float) -> tuple[World, str, Motion]:
    """Return the fourth group: a slower car changes into the lane of the ego vehicle when that is near."""
    slower, ds = EGO - 20.0 / 3.6, 85.0
    world = scenario(
        folder, {"Other": (-4, BEGIN + ds, slower)}, "Other",
        event("CutIn", lane_change("Ego", 0), near("Ego", "Other", distance)),
    )  # fmt: skip
    # The boxes have the same size: the free distance is that of the axles less a length.
    time = (ds - BOX[0] - distance) / (EGO - slower)
    return world, "other", changes_lane(BEGIN + ds, slower, LANE - WIDTH, 1, time)


def cut_out(folder: Path) -> tuple[World, str, Motion]:
    """Return the fifth group: a car ahead leaves the lane before a standing one."""
    lead, standing, distance = BEGIN + EGO * 2.0, 220.0, 50.0
    world = scenario(
        folder, {"Standing": (-3, standing, 0.0), "Lead": (-3, lead, EGO)}, "Lead",
        event("CutOut", lane_change("Standing", 1), near("Lead", "Standing", distance)),
    )  # fmt: skip
    return world, "lead", changes_lane(lead, EGO, LANE, 1, (standing - lead - BOX[0] - distance) / EGO)


def varying_speed(folder: Path) -> tuple[World, str, Motion]:
    """Return the third group: a car ahead drives faster, then more slowly."""
    x = BEGIN + EGO * 2.0
    faster = event("Faster", speed_change(5.0, 1.0), after(4.0))
    slower = event("Slower", speed_change(-5.0, 1.0), ended("FasterAction"))
    world = scenario(folder, {"Lead": (-3, x, EGO)}, "Lead", faster, slower)
    return world, "lead", changes_speed(x, (4.0, 1.0), (9.0, -1.0), (19.0, 0.0))


def emergency_brake(folder: Path) -> tuple[World, str, Motion]:
    """Return the third group: a car ahead brakes to standstill."""
    x = BEGIN + EGO * 2.0
    world = scenario(folder, {"Lead": (-3, x, EGO)}, "Lead", event("Brake", speed_change(-EGO, 6.0), after(6.0)))
    return world, "lead", changes_speed(x, (6.0, -6.0), (6.0 + EGO / 6.0, 0.0))


FAMILIES: dict[str, Callable[[Path], tuple[World, str, Motion]]] = {
    "follow_lead_comfortable": varying_speed,
    "follow_lead_emergency": emergency_brake,
    "cut_in_no_collision": lambda folder: cut_in(folder, 30.0),
    "cut_in_unavoidable": lambda folder: cut_in(folder, 8.0),
    "cut_out_fully_blocking": cut_out,
}


def drive(world: World, name: str, duration: float) -> list[tuple[float, float, float]]:
    """Return time [s], x and y [m] of an actor, while the ego vehicle drives on at its speed."""
    number = [actor.name for actor in world.actors].index(name)
    ego = FullVehicle(world.actors[number].volume, 0, 0)
    lanes, crew, _ = make_crew(world, {"ego": ego}, 0)
    step, now = TimeStep(lanes, crew), start_states(world, lanes)
    claims = step.claims()
    rows = []
    for k in range(round(duration / DT)):
        vehicles = np.array([[BEGIN + EGO * k * DT, LANE, 0.0, EGO, 0.0]])
        after_step = np.empty_like(now)
        step(now, vehicles, k * DT, DT, after_step, claims)
        now = after_step
        rows.append(((k + 1) * DT, float(now["x"][number]), float(now["y"][number])))
    return rows


@pytest.mark.parametrize("family", FAMILIES)
def test_actors_of_a_scenario_move_as_its_closed_form(family: str, tmp_path: Path) -> None:
    world, name, expected = FAMILIES[family](tmp_path)
    worst = 0.0
    for time, x, y in drive(world, name, 20.0):
        worst = max(worst, math.dist((x, y), expected(time)))
    assert worst < 0.3
    # It did what the scenario says.
    begin_x, begin_y = expected(0.0)
    x, y = expected(20.0)
    assert abs(x - begin_x - EGO * 20.0) > 5.0 or abs(y - begin_y) == pytest.approx(WIDTH, abs=0.01)


PUBLIC = """
<OpenSCENARIO><FileHeader revMajor="1" revMinor="1"/>
<ParameterDeclarations>
 <ParameterDeclaration name="Ego_InitPosition_LaneId" parameterType="string" value="-3"/>
 <ParameterDeclaration name="Ego_InitSpeed_Ve0_kph" parameterType="double" value="60.0"/>
 <ParameterDeclaration name="Other_Model" parameterType="string" value="car"/>
 {values}
</ParameterDeclarations>
<CatalogLocations><VehicleCatalog><Directory path="./Catalogs"/></VehicleCatalog></CatalogLocations>
<RoadNetwork><LogicFile filepath="./road.xodr"/></RoadNetwork>
<Entities>
 <ScenarioObject name="Ego"><CatalogReference catalogName="VehicleCatalog" entryName="car_ego"/>
  <ObjectController><CatalogReference catalogName="ControllerCatalog" entryName="ALKSController"/></ObjectController>
 </ScenarioObject>
 {entities}
</Entities>
<Storyboard>
 <Init><Actions>
  <Private entityRef="Ego">
   <PrivateAction><TeleportAction><Position>
    <LanePosition roadId="0" laneId="$Ego_InitPosition_LaneId" offset="0.0" s="5.0"/>
   </Position></TeleportAction></PrivateAction>
   <PrivateAction><LongitudinalAction><SpeedAction>
    <SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>
    <SpeedActionTarget><AbsoluteTargetSpeed value="${{$Ego_InitSpeed_Ve0_kph / 3.6}}"/></SpeedActionTarget>
   </SpeedAction></LongitudinalAction></PrivateAction>
  </Private>
  {places}
 </Actions></Init>
 <Story name="ActivateALKSControllerStory"><Act name="ActivateALKSControllerAct">
  <ManeuverGroup maximumExecutionCount="1" name="ActivateALKSControllerManeuverGroup">
   <Actors selectTriggeringEntities="false"><EntityRef entityRef="Ego"/></Actors>
   <Maneuver name="ActivateALKSControllerManeuver">
    <Event name="ActivateALKSControllerEvent" priority="overwrite">
     <Action name="ActivateALKSControllerAction"><PrivateAction><ControllerAction>
      <ActivateControllerAction lateral="true" longitudinal="true"/>
     </ControllerAction></PrivateAction></Action>
     {activation}
    </Event>
   </Maneuver>
  </ManeuverGroup>
  {start}
 </Act></Story>
 <Story name="OtherStory"><Act name="OtherAct">
  <ManeuverGroup maximumExecutionCount="1" name="OtherManeuverGroup">
   <Actors selectTriggeringEntities="false"><EntityRef entityRef="{mover}"/></Actors>
   <Maneuver name="OtherManeuver">{events}</Maneuver>
  </ManeuverGroup>
  {start}
 </Act></Story>
</Storyboard></OpenSCENARIO>
"""
"""A scenario with the elements of the public set: parameters, expressions, catalogues, the controller of the ego
vehicle, relative positions and speeds."""

EGO_CONTROLLER = "'ActivateALKSControllerAction' of Ego"
MODELS = {"car_ego": 1.4, "car": 1.4, "blocking": 2.5}
"""Middle of cars of 5 m length ahead of their reference points [m]. From the messages of esmini: a free distance is
less than that of the reference points by 5 m between two cars, and by 3.9 m between a car and the one that blocks."""


def trigger(condition: str, delay: float = 0.0) -> str:
    """Return a start trigger of one condition, with a delay [s]."""
    one = f'<Condition name="c" delay="{delay}" conditionEdge="rising">{condition}</Condition>'
    return f"<StartTrigger><ConditionGroup>{one}</ConditionGroup></StartTrigger>"


def since(time: float) -> str:
    """Return the condition that a time has been reached."""
    return f'<ByValueCondition><SimulationTimeCondition value="{time}" rule="greaterOrEqual"/></ByValueCondition>'


def beside_ego(name: str, lanes: int, ahead: str, speed: str) -> str:
    """Return the position and the speed of a car at the beginning, both relative to the ego vehicle."""
    place = f'<RelativeLanePosition entityRef="Ego" dLane="{lanes}" ds="{ahead}" offset="0.0"/>'
    moves = f'<RelativeTargetSpeed entityRef="Ego" value="{speed}" speedTargetValueType="delta" continuous="false"/>'
    dynamics = '<SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>'
    action = f"<SpeedAction>{dynamics}<SpeedActionTarget>{moves}</SpeedActionTarget></SpeedAction>"
    return (
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction><Position>{place}</Position></TeleportAction>'
        f"</PrivateAction><PrivateAction><LongitudinalAction>{action}</LongitudinalAction></PrivateAction></Private>"
    )


def actions(condition: str, delay: float = 0.0, **parts: str) -> str:
    """Return an event with actions by name that begin with a condition."""
    rows = (f'<Action name="{key}"><PrivateAction>{part}</PrivateAction></Action>' for key, part in parts.items())
    name = next(iter(parts))
    return f'<Event name="{name}Event" priority="overwrite">{"".join(rows)}{trigger(condition, delay)}</Event>'


def public(
    folder: Path, others: dict[str, tuple[int, str, str]], mover: str, events: str, **values: float
) -> tuple[World, str]:
    """Return the world of a scenario as in the public set, and the actor that moves.

    Args:
        folder: folder to write to.
        others: cars by name: lanes to the left of the ego vehicle, distance ahead of it [m], speed less its own [m/s].
        mover: the car of the events.
        events: the events.
        values: values of the parameters.
    """
    (folder / "Catalogs").mkdir()
    entries = (
        f'<Vehicle name="{name}" vehicleCategory="car"><BoundingBox><Center x="{middle}" y="0" z="0.75"/>'
        '<Dimensions length="5" width="2" height="1.5"/></BoundingBox></Vehicle>'
        for name, middle in MODELS.items()
    )
    catalogue = f'<OpenSCENARIO><Catalog name="VehicleCatalog">{"".join(entries)}</Catalog></OpenSCENARIO>'
    (folder / "Catalogs" / "vehicles.xosc").write_text(catalogue, encoding="utf-8")
    references = (
        f'<ScenarioObject name="{name}"><CatalogReference catalogName="VehicleCatalog" '
        f'entryName="{"blocking" if name == "Blocking" else "$Other_Model"}"/></ScenarioObject>'
        for name in others
    )
    text = PUBLIC.format(
        values="".join(f'<ParameterDeclaration name="{key}" value="{value}"/>' for key, value in values.items()),
        entities="".join(references),
        places="".join(beside_ego(name, *place) for name, place in others.items()),
        activation=trigger(since(3.0)),
        start=trigger(since(0.0)),
        mover=mover,
        events=events,
    )
    world, left_out = imported(folder, text)
    # The test has a driver in place of the controller, and an acceleration of 0 has no effect.
    assert set(left_out) <= {EGO_CONTROLLER, "elements <ObjectController>", f"'Accelerate' of {mover}"}, left_out
    return world, plain_name(mover)


HEADWAY = "${$Headway_s * ($Ego_InitSpeed_Ve0_kph / 3.6)}"
STANDING = "${-$Ego_InitSpeed_Ve0_kph / 3.6}"


def public_speeds(folder: Path) -> tuple[World, str]:
    """Return the comfortable speed changes of the public set: 5 m/s up, and 10 s later 10 m/s down."""
    rise, fall = (speed_change(offset, "$Rate_mps2") for offset in ("$Offset_mps", "${-$Offset_mps}"))
    events = actions(since(10.0), Rise=rise) + actions(ended("Rise"), 10.0, Fall=fall)
    return public(folder, {"Lead": (0, HEADWAY, "0.0")}, "Lead", events, Headway_s=1.9, Rate_mps2=1.0, Offset_mps=5.0)


def public_brake(folder: Path) -> tuple[World, str]:
    """Return the deceleration of the public set, 10 m/s² after 10 s."""
    events = actions(since(10.0), Brake=speed_change(STANDING, "$Deceleration_mps2"))
    return public(folder, {"Lead": (0, HEADWAY, "0.0")}, "Lead", events, Headway_s=2.3, Deceleration_mps2=10.0)


def public_cut_in(folder: Path, distance: float, lateral: float) -> tuple[World, str]:
    """Return a cut-in of the public set: free distance at its begin [m], largest lateral speed [m/s]."""
    slower, ahead = "${$Relative_kph / 3.6}", "${$Distance_m + (-10.0 * ($Relative_kph / 3.6))}"
    change, rise = lane_change("Ego", 0, "$Lateral_mps"), speed_change("0.0", "$Rate_mps2")
    events = actions(near("Ego", "Other", "$Distance_m"), CutIn=change, Accelerate=rise)
    values = {"Relative_kph": -20.0, "Distance_m": distance, "Lateral_mps": lateral, "Rate_mps2": 0.0}
    return public(folder, {"Other": (-1, ahead, slower)}, "Other", events, **values)


def public_cut_out(folder: Path) -> tuple[World, str]:
    """Return the cut-out of the public set."""
    events = actions(near("Lead", "Blocking", "50.0"), CutOut=lane_change("Blocking", 1, "$Lateral_mps"))
    others = {"Blocking": (0, "495.0", STANDING), "Lead": (0, HEADWAY, "0.0")}
    return public(folder, others, "Lead", events, Headway_s=2.3, Lateral_mps=2.0)


RECORDED: dict[str, tuple[Callable[[Path], tuple[World, str]], list[tuple[float, float, float]]]] = {
    "4.3_1": (public_speeds, [(21.0, 429.292, -8.0), (54.4, 908.708, -8.0)]),
    "4.3_2": (public_brake, [(9.9, 208.333, -8.0), (12.0, 223.741, -8.0), (18.8, 223.741, -8.0)]),
    "4.4_1": (
        lambda folder: public_cut_in(folder, 30.0, 2.0),
        [(8.05, 180.0, -11.5), (10.4, 206.005, -9.899), (13.5, 240.307, -8.0)],
    ),
    "4.4_2": (
        lambda folder: public_cut_in(folder, 10.0, 3.0),
        [(8.0, 159.44, -11.5), (9.6, 177.185, -10.896), (10.05, 182.03, -9.649), (11.0, 192.401, -8.0)],
    ),
    "4.5_1 and 4.5_2": (public_cut_out, [(24.5, 451.666, -7.898), (30.0, 543.168, -4.5), (32.0, 576.501, -4.5)]),
}
"""Time [s], x and y [m] of the car that cuts in or out or changes its speed, as recorded by esmini."""


@pytest.mark.parametrize("name", RECORDED)
def test_actors_of_the_public_set_are_where_esmini_recorded_them(name: str, tmp_path: Path) -> None:
    make, states = RECORDED[name]
    world, mover = make(tmp_path)
    time, x, y = np.array(drive(world, mover, states[-1][0] + 0.1)).T
    for at, x_recorded, y_recorded in states:
        place = (np.interp(at, time, x), np.interp(at, time, y))
        assert math.dist(place, (x_recorded, y_recorded)) < 0.3, (at, place)
