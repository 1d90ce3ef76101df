"""Behaviours: their arithmetic in closed form, and each of them driving a kinematic car."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from shapely import affinity

from mirdrake.actors.road_ahead import ROAD_AHEAD, next_lines
from mirdrake.controllers.behaviours.base import View
from mirdrake.controllers.behaviours.drive_to_nearest import DriveToNearest
from mirdrake.controllers.behaviours.fan import REACH
from mirdrake.controllers.behaviours.follow_path import FollowPathSpec, track_through
from mirdrake.controllers.behaviours.hold_lane import HoldLane, HoldLaneSpec, Lane
from mirdrake.controllers.behaviours.laws import (
    approach_speed,
    bend_speed,
    brake_speed,
    free_distance,
    gap_to,
    line_curvature,
    stopping_distance,
)
from mirdrake.controllers.behaviours.obstacle_stopper import published_speed
from mirdrake.controllers.behaviours.outline import Outline, outline_of
from mirdrake.controllers.behaviours.straight_and_avoid import free_ways, turning
from mirdrake.controllers.drivers import DRIVERS, DriverSpec
from mirdrake.controllers.path_tracking import PathGains
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.yaml_io import Schema, Source, parse_tree, parse_yaml, validate
from mirdrake.sensors.range_scan import RangeScan
from mirdrake.worlds.lights import Light
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.tracks import Track
from tests.marks import mostly_slow
from tests.stand_ins import CarStandIn, PropStandIn, WorldStandIn

STEP, BRAKES = 0.005, 5.0
BOX = Outline(-0.8, 3.4, 0.9, 1.6)


CAR = CarStandIn()
FRONT, HALF = outline_of(CAR).front, outline_of(CAR).half_width


class KinematicCar(LeafSystem):
    """Bicycle with limited steering rate; its speed follows the command with a lag and limited acceleration."""

    def __init__(self, *, start=(0.0, 0.0, 0.0), speed=0.0, lag=0.15, brakes=BRAKES):
        super().__init__()
        self.lag, self.brakes = lag, brakes
        self.command = self.DeclareVectorInputPort("command", 3)
        self.index = self.DeclareDiscreteState([*start, speed, 0.0])
        self.state = self.DeclareVectorOutputPort("state", BasicVector(12), self._calc, {self.all_state_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0.0, self._update)

    def _calc(self, context, output):
        x, y, yaw, speed, steering = context.get_discrete_state(self.index).value()
        output.SetFromVector([x, y, 0, 0, 0, yaw, speed, 0, 0, 0, 0, speed * math.tan(steering) / 2.6])

    def _update(self, context, values):
        x, y, yaw, speed, steering = context.get_discrete_state(self.index).value().tolist()
        speed_setpoint, angle, _ = self.command.Eval(context)
        rate = (speed_setpoint - speed) / self.lag if self.lag else (speed_setpoint - speed) / STEP
        speed += STEP * min(max(rate, -self.brakes), 3.0)
        steering += min(max(angle - steering, -0.5 * STEP), 0.5 * STEP)
        turn = speed * math.tan(steering) / 2.6
        middle = yaw + 0.5 * STEP * turn
        x, y = x + STEP * speed * math.cos(middle), y + STEP * speed * math.sin(middle)
        values.set_value(self.index, [x, y, yaw + STEP * turn, speed, steering])


@dataclass
class Drive:
    """Samples of a drive every 20 ms: t, x, y, yaw, speed, clearance to the footprints."""

    rows: np.ndarray

    t = property(lambda self: self.rows[:, 0])
    x = property(lambda self: self.rows[:, 1])
    y = property(lambda self: self.rows[:, 2])
    speed = property(lambda self: self.rows[:, 4])
    clearance = property(lambda self: self.rows[:, 5])


class DriverFile(Schema):
    behaviour: DriverSpec


def make_driver(behaviour, world, *, source=None, folder=None):
    """Return the driver of a behaviour as it is written in a file."""
    source = source or Source("driver", {})
    spec = validate({"behaviour": behaviour}, DriverFile, source).behaviour
    return spec.make_system(CAR, world, where=source.where("behaviour"), folder=folder)


LINE = 800.0
"""Place of a stop line on the x axis [m]."""


class LightsAhead(LeafSystem):
    """The road ahead of a car on the x axis: no other vehicle, and traffic lights by the place of their stop line."""

    def __init__(self, lights):
        super().__init__()
        self.lights, self.state = lights, self.DeclareVectorInputPort("state", 12)
        self.DeclareVectorOutputPort("road_ahead", BasicVector(len(ROAD_AHEAD)), self._calc)

    def _calc(self, context, output):
        front, time = self.state.Eval(context)[0] + FRONT, context.get_time()
        lights = [(line - front, *light.phase(time)) for line, light in self.lights.items() if line - front > -1.0]
        output.SetFromVector([math.inf, 0.0, *next_lines(math.inf, lights)])


def drive(behaviour, props=(), *, duration, tracks=None, lights=None, **car):
    """Return a kinematic car driven by a behaviour until the time is over or it touches a prop."""
    world: Any = WorldStandIn(list(props), tracks or {})
    driver = behaviour if isinstance(behaviour, LeafSystem) else make_driver(behaviour, world)
    builder = DiagramBuilder()
    plant, sensor = builder.AddSystem(KinematicCar(**car)), builder.AddSystem(RangeScan(world, CAR))
    builder.AddSystem(driver)
    builder.Connect(plant.state, sensor.state)
    if driver.HasInputPort("state"):
        builder.Connect(plant.state, driver.GetInputPort("state"))
    if driver.HasInputPort("ranges"):
        builder.Connect(sensor.ranges, driver.GetInputPort("ranges"))
    if driver.HasInputPort("road_ahead"):
        ahead = builder.AddSystem(LightsAhead(lights or {}))
        builder.Connect(ahead.get_output_port(), driver.GetInputPort("road_ahead"))
        builder.Connect(plant.state, ahead.state)
    builder.Connect(driver.GetOutputPort("command"), plant.command)
    simulator = Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_context())
    simulator.Initialize()
    solid = shapely.union_all([prop.footprint for prop in props])
    outline, rows = outline_of(CAR), []
    body = shapely.box(outline.rear, -outline.half_width, outline.front, outline.half_width)
    for number in range(round(duration / 0.02) + 1):
        simulator.AdvanceTo(number * 0.02)
        x, y, yaw, speed, _ = context.get_discrete_state(plant.index).value().tolist()
        placed = affinity.translate(affinity.rotate(body, yaw, origin=(0, 0), use_radians=True), x, y)
        clearance = float(shapely.distance(placed, solid)) if props else math.inf
        rows.append((number * 0.02, x, y, yaw, speed, clearance))
        if clearance == 0.0:
            break
    return Drive(np.array(rows))


def post(x, y, radius=0.2):
    return PropStandIn(f"post at {x}, {y}", shapely.Point(x, y).buffer(radius))


def block(x0, y0, x1, y1):
    return PropStandIn(f"block at {x0}, {y0}", shapely.box(x0, y0, x1, y1))


# --- arithmetic ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", mostly_slow([25.0, 15.0, 36.0]))
def test_traffic_brakes_for_a_red_light_from_any_speed_at_its_comfortable_deceleration(speed):
    road = Track([Piece(1000.0, 0.0, 0.0)], closed=False)
    driver = {"kind": "traffic", "speed": speed, "reaction": 0.3, "deceleration": 2.0, "line_distance": 1.0}
    red = Light("light", green=0.0, amber=0.0, red=1e4, offset=0.0, lines=())
    needed = speed * 0.3 + speed**2 / (2.0 * 2.0)
    begin = LINE - FRONT - 1.0 - needed
    start = begin - 2.0 * speed
    run = drive(
        driver, tracks={"main": road}, lights={LINE: red}, speed=speed, start=(start, 0.0, 0.0), duration=2.0 + speed
    )
    # In front of v t + v²/(2 a) the speed is the set-point, and behind it at most that of the braking profile, which
    # has the deceleration a v/(v + a t). The car lags by 0.15 s, and by a period of the driver.
    assert np.all(run.speed[run.x < begin] > speed - 1e-9)
    after = (run.x > begin) & (run.speed > 0.5)
    assert np.max(-np.diff(run.speed)[after[1:]]) / 0.02 < 2.0
    rest = np.maximum(LINE - FRONT - 1.0 - run.x[after], 0.0)
    assert np.all(run.speed[after] < np.sqrt(0.6**2 + 4.0 * rest) - 0.6 + 2.0 * (0.15 + 0.02))
    assert -2.0 <= run.x[-1] + FRONT - LINE <= 0.0


@pytest.mark.slow
@pytest.mark.parametrize("speed", [11.0, 20.0, 36.0])
def test_traffic_passes_no_light_that_becomes_red_at_any_time(speed):
    # A comfortable stop needs v t + v²/(2 a): 33.6, 106 and 335 m. Within the amber of 3 s, with t to spare, the line
    # is reached from 29.7, 54 and 97 m. In between it must stop, with up to v/(2 (3 s - 2 t)).
    road, amber = Track([Piece(1200.0, 0.0, 0.0)], closed=False), 3.0
    needed, reached = speed * 0.3 + speed**2 / 4.0, (amber - 0.3) * speed
    passed = []
    for rest in np.linspace(0.8 * reached, 1.1 * needed, 9):
        start = LINE - FRONT - rest - speed
        light = Light("light", green=1.0, amber=amber, red=100.0, offset=0.0, lines=())
        driver = {"kind": "traffic", "speed": speed}
        run = drive(driver, tracks={"main": road}, lights={LINE: light}, speed=speed, start=(start, 0.0, 0.0),
                    duration=2.0 + amber + speed, brakes=9.0)  # fmt: skip
        crossed = np.flatnonzero(run.x + FRONT >= LINE)
        passed.append(crossed.size > 0)
        if passed[-1]:
            assert light.state(run.t[crossed[0]]) == 1.0
        else:
            assert -2.0 <= run.x[-1] + FRONT - LINE <= 0.0
    assert passed[0]
    assert not passed[-1]


def test_the_braking_profile_stops_within_its_gap():
    assert brake_speed(9.0, deceleration=2.0, reaction=0.0) == pytest.approx(6.0)
    assert brake_speed(0.0, deceleration=2.0, reaction=0.3) == 0.0
    assert brake_speed(-3.0, deceleration=2.0, reaction=0.3) == 0.0
    assert brake_speed(math.inf, deceleration=2.0, reaction=0.3) == math.inf
    for gap in (0.02, 0.5, 3.0, 40.0):
        speed = brake_speed(gap, deceleration=3.0, reaction=0.4)
        assert stopping_distance(speed, deceleration=3.0, reaction=0.4) == pytest.approx(gap)
        assert speed * 0.4 + speed**2 / 6.0 == pytest.approx(gap)


def test_no_speed_is_higher_than_the_car_can_stop_from_within_the_range_of_the_scan():
    braking = {"distance": 5.0, "deceleration": 3.0, "reaction": 0.3}
    fastest = approach_speed(math.inf, period=0.05, **braking)
    # v (T + t) + v²/(2 a) = 50 - 5, solved for v.
    assert fastest == pytest.approx(-3.0 * 0.35 + math.sqrt((3.0 * 0.35) ** 2 + 2.0 * 3.0 * 45.0), abs=1e-12)
    assert fastest == pytest.approx(15.415, abs=1e-3)
    # An obstacle that came within the range right after the last decision does not ask for less than that speed.
    late = REACH - fastest * 0.05
    assert approach_speed(late, period=0.05, **braking) == pytest.approx(fastest, abs=1e-12)
    assert approach_speed(late - 0.1, period=0.05, **braking) < fastest
    assert approach_speed(20.0, period=0.05, **braking) == brake_speed(15.0, deceleration=3.0, reaction=0.3)


def test_bends_are_braked_for_in_time():
    limits = {"lateral_acceleration": 3.0, "deceleration": 2.0, "reaction": 0.5}
    # A bend of 12 m radius allows 6 m/s. It is 9 m away: v 0.5 + (v² - 36)/4 = 9.
    assert bend_speed([0.0, 1 / 12], [0.0, 9.0], **limits) == pytest.approx(-1.0 + math.sqrt(1.0 + 36.0 + 36.0))
    # In the bend it is 6 m/s, also just before it, and never less.
    assert bend_speed([-1 / 12, 0.0], [0.0, 9.0], **limits) == pytest.approx(6.0)
    assert bend_speed([0.0, 1 / 12], [0.0, 0.1], **limits) == pytest.approx(6.0)
    assert bend_speed([1 / 48, 1 / 12], [0.0, 200.0], **limits) == pytest.approx(12.0)


def first_contact(point, curvature, box, reach, step=0.002):
    """Return the free distance by sampling poses along the path."""
    distances = np.arange(0.0, reach, step)
    turn = curvature * distances
    dx = point[0] - (np.sin(turn) / curvature if curvature else distances)
    dy = point[1] - ((1.0 - np.cos(turn)) / curvature if curvature else 0.0)
    x, y = np.cos(turn) * dx + np.sin(turn) * dy, np.cos(turn) * dy - np.sin(turn) * dx
    met = (x > box.rear) & (x < box.front) & (np.abs(y) < box.half_width)
    return distances[np.argmax(met)] if met.any() else reach


def test_the_free_distance_is_where_the_box_first_meets_a_point():
    generator = np.random.default_rng(5)
    places = generator.uniform((-3.0, -9.0), (14.0, 9.0), (60, 2))
    places = places[(places[:, 0] < -0.9) | (places[:, 0] > 3.5) | (np.abs(places[:, 1]) > 1.0)]
    places = np.vstack((places, [[0.5, 0.95], [-0.7, -1.0], [2.5, 0.93], [2.5, -0.93], [3.41, 0.0]]))
    curvatures = np.array([0.0, 0.02, 0.1, 0.25, -0.02, -0.1, -0.25])
    met = 0
    for position in places:
        free = free_distance(position[None], curvatures, BOX, reach=15.0)
        tried = [first_contact(position, curvature, BOX, 15.0) for curvature in curvatures]
        np.testing.assert_allclose(free, tried, atol=0.01)
        met += int(np.sum(free < 15.0))
    assert met > 40
    together = free_distance(places, curvatures, BOX, reach=15.0)
    alone = [free_distance(position[None], curvatures, BOX, reach=15.0) for position in places]
    np.testing.assert_allclose(together, np.min(alone, axis=0))


def test_the_free_distance_in_closed_form():
    assert free_distance(np.array([[10.0, 0.5]]), [0.0], BOX)[0] == pytest.approx(6.6)
    assert free_distance(np.array([[10.0, 0.95]]), [0.0], BOX)[0] == math.inf
    assert free_distance(np.array([[2.0, 0.5]]), [0.0, 0.1], BOX).tolist() == [0.0, 0.0]
    assert free_distance(np.empty((0, 2)), [0.0, 0.1], BOX, reach=7.0).tolist() == [7.0, 7.0]
    # On the circle of the front end's middle, a quarter turn on.
    radius = 5.0
    rho, ahead = math.hypot(radius, BOX.front), math.atan2(BOX.front, radius)
    bearing = ahead + 0.5 * math.pi
    position = np.array([[rho * math.sin(bearing), radius - rho * math.cos(bearing)]])
    assert free_distance(position, [0.2], BOX)[0] == pytest.approx(0.5 * math.pi * radius)
    # Behind the axle only the tail, which swings out, meets a point at the outer side.
    rho, bearing = radius + BOX.half_width + 0.02, -0.08
    position = np.array([[rho * math.sin(bearing), radius - rho * math.cos(bearing)]])
    swing = math.acos((radius + BOX.half_width) / rho) + bearing
    assert position[0, 1] < -BOX.half_width
    assert free_distance(position, [0.2, -0.2, 0.0], BOX, reach=9.0) == pytest.approx([swing * radius, 9.0, 9.0])


def test_the_gap_is_that_of_the_whole_front_edge():
    points = np.array([[5.4, 0.0], [5.4, 0.9], [6.4, -4.9], [3.4, 1.4]])
    np.testing.assert_allclose(gap_to(points, BOX), [2.0, 2.0, 5.0, 0.5])


def test_a_path_is_free_as_far_as_its_circle_is():
    rng = np.random.default_rng(3)
    driver = make_driver("straight_and_avoid", WorldStandIn())
    box = driver.outline
    angles = np.linspace(-0.5, 0.5, 11)
    paths = driver._paths(turning(0.0, angles, math.inf, 48))
    compared = 0
    for _ in range(200):
        point = np.array([[rng.uniform(box.front, 12.0), rng.uniform(-6.0, 6.0)]])
        exact = free_distance(point, np.tan(angles) / 2.6, box, reach=12.0)
        found = np.minimum(free_ways([0.0], point, paths, box)[0] * 0.25, 12.0)
        # Straight ahead it is exact; a corner of the box can miss a point between two poses.
        assert found[5] == pytest.approx(exact[5], abs=1e-9)
        deep = free_distance(point, np.tan(angles) / 2.6, box._replace(half_width=box.half_width - 0.25), reach=12.0)
        both = (deep < 11.5) & (deep < exact + 0.3)  # not only a corner
        assert np.all(np.abs(found - exact)[both] < 0.3)
        compared += both.sum()
    assert compared > 150


def test_a_predicted_path_turns_with_the_rate_of_the_steering():
    # At 4 m/s and 0.5 rad/s the angle changes by 1/32 rad in a step of 0.25 m.
    driver, change = make_driver("straight_and_avoid", WorldStandIn()), 0.03125
    angles = turning(-0.1, np.array([0.4]), change, 48)
    s = np.arange(48) * 0.25 + 0.125
    np.testing.assert_allclose(angles[0], np.minimum(-0.1 + 0.125 * s, 0.4))
    # The yaw angle is the integral of the curvature tan(δ) / L; of tan(a + b s) it is -ln cos(a + b s) / b.
    x, y, yaw = (column[0] for column in driver._paths(angles))
    ramp = (math.log(math.cos(-0.1)) - math.log(math.cos(0.4))) / 0.125 / 2.6
    assert yaw[-1] == pytest.approx(ramp + math.tan(0.4) / 2.6 * (12.0 - 4.0), abs=2e-4)
    assert math.hypot(np.diff(x)[0], np.diff(y)[0]) == pytest.approx(0.25)


def test_the_ways_to_parallel_lines_converge_as_the_law_of_the_line():
    """An offset decays as (1 + s/d) exp(-s/d), as below; a far line is approached at 27 degrees."""
    driver = make_driver("straight_and_avoid", WorldStandIn())
    offsets = np.array([0.1, -0.2, 6.0])
    wanted, angles = driver._ways_to(offsets, 0.0, 3.0, np.full(48, 0.5), 0.0, math.inf, 48)
    paths = driver._paths(angles)
    s = np.arange(49) * 0.25
    decay = (1.0 + s / 3.0) * np.exp(-s / 3.0)
    np.testing.assert_allclose(offsets[:2, None] + paths.y[:2], offsets[:2, None] * decay, atol=0.005)
    wish = [driver.law.steering(line_curvature(e, 0.0, distance=3.0)) for e in offsets]
    assert wanted == pytest.approx([*wish[:2], -0.5])
    assert wish[2] < -0.5
    assert np.degrees(paths.yaw[2].min()) == pytest.approx(-math.degrees(math.atan(0.5)), abs=1.0)
    # The rate of the steering limits the first steps: 0.01 rad in each.
    assert driver._ways_to(offsets, 0.0, 3.0, np.full(48, 0.5), 0.0, 0.01, 48)[1][2, :3] == pytest.approx(
        [-0.01, -0.02, -0.03]
    )


def test_the_way_back_to_the_line_keeps_half_of_the_clearance():
    """A post beside the front end, 0.35 m away: the way back to the line 0.5 m aside would pass at 0.21 m."""
    driver = make_driver("straight_and_avoid", WorldStandIn())
    aside = driver.outline.half_width + 0.35
    memory = np.full(4 + 2 * 256, math.nan)
    memory[:4] = 0.0, -0.5, 0.0, 0.0  # the line, along x, and the steering angle

    def steering(x):
        view = View(0.0, 0.0, 0.0, 4.0, np.empty(0), np.array([[x, -aside]]))
        return driver.decide(view, memory.copy()).steering

    assert steering(3.5) == 0.0
    assert steering(0.5) == pytest.approx(driver.law.steering(line_curvature(0.5, 0.0, distance=3.2)))


def test_the_return_to_the_line_decays_over_its_distance():
    """By e'' = -(2/d) e' - e/d² an offset without slope decays as (1 + s/d) exp(-s/d)."""
    s, y, yaw, step = 0.0, 0.1, 0.0, 0.001
    while s < 9.0:
        curvature = float(line_curvature(y, yaw, distance=3.0))
        y, yaw, s = y + step * math.sin(yaw), yaw + step * curvature, s + step * math.cos(yaw)
    assert y == pytest.approx(0.1 * 4.0 * math.exp(-3.0), rel=0.01)


def test_the_published_stopper_is_a_switch_at_five_metres():
    distances = [0.0, 4.999, 5.0, 5.001, 5.5, 6.0, 50.0, math.inf]
    law = [7.0 * np.sign(np.clip(dist - 5.0, 0.0, 1.0)) for dist in distances]
    assert [published_speed(7.0, dist) for dist in distances] == law == [0, 0, 0, 7, 7, 7, 7, 7]


# --- driving -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("props", "past"),
    [
        ([post(20.0, y) for y in (-2.0, -1.0, 0.0, 1.0, 2.0)], 24.0),
        ([post(15.0, 0.1), post(30.0, -0.1), post(45.0, 0.2)], 50.0),
        ([post(20.0, y) for y in (-8, -7, -6, -5, -4, -3, -2, -1, 0, 1, 2)], 24.0),
        ([block(20.0, -1.5, 24.5, 0.8), block(20.0, 5.5, 24.5, 8.0)], 28.0),
        ([block(18.0, -12.0, 19.0, 0.5), block(34.0, -0.5, 35.0, 12.0)], 40.0),
    ],
    ids=["row across", "row along", "wide row", "parked cars", "chicane"],
)
@pytest.mark.parametrize("speed", [3.0, 6.0])
def test_it_steers_around_obstacles_and_returns_to_its_line(props, past, speed):
    run = drive({"kind": "straight_and_avoid", "speed": speed}, props, duration=(past + 30.0) / speed + 8.0)
    assert run.clearance.min() > 0.25
    assert run.x[-1] > past
    assert abs(run.y[-1]) < 0.1


def test_it_drives_straight_on_where_nothing_is_in_the_way():
    run = drive(
        {"kind": "straight_and_avoid", "speed": 5.0},
        [block(10.0, 2.0, 30.0, 3.0), block(10.0, -3.0, 30.0, -2.0)],
        duration=10.0,
    )
    assert np.abs(run.y).max() < 1e-9
    assert run.speed.max() == pytest.approx(5.0, abs=0.01)
    assert run.x[-1] > 40.0


@pytest.mark.parametrize("speed", [3.0, 8.0])
def test_it_stops_where_no_gap_is_wide_enough(speed):
    run = drive({"kind": "straight_and_avoid", "speed": speed}, [block(30.0, -40.0, 31.0, 40.0)], duration=20.0)
    assert run.speed[-1] < 0.01
    assert 0.8 < run.clearance[-1] < 1.5
    assert run.clearance.min() > 0.8


@pytest.mark.parametrize(
    "props",
    [
        [post(20.0, 0.0, 0.5)],
        [post(20.0, 5.0, 0.5), post(26.0, -14.0, 0.5)],
        [block(25.0, -20.0, 26.0, 20.0)],
        [block(15.0, -6.0, 19.0, -4.0)],
    ],
    ids=["ahead", "aside", "wall", "box"],
)
@pytest.mark.parametrize("speed", [2.0, 6.0])
def test_it_stops_two_metres_before_the_nearest_object(props, speed):
    run = drive({"kind": "drive_to_nearest_and_stop", "speed": speed}, props, duration=25.0)
    assert run.speed[-1] < 1e-3
    assert run.clearance[-1] == pytest.approx(2.0, abs=0.1)
    assert run.clearance.min() > 1.9


def test_it_drives_on_while_there_is_no_object():
    run = drive({"kind": "drive_to_nearest_and_stop", "speed": 3.0}, duration=5.0)
    assert run.speed[-1] == pytest.approx(3.0, abs=0.01)
    assert run.y[-1] == 0.0


@pytest.mark.parametrize("speed", [5.0, 10.0])
def test_the_profile_stops_in_time_at_any_speed(speed):
    wall = block(45.0, -3.0, 46.0, 3.0)
    run = drive({"kind": "obstacle_stopper", "speed": speed, "distance": 5.0}, [wall], duration=20.0, speed=speed)
    assert run.speed[-1] < 1e-3
    assert run.clearance[-1] == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "distance", "deceleration"),
    [
        ("obstacle_stopper", 5.0, 3.0),
        ("drive_to_nearest_and_stop", 2.0, 2.0),
        ("straight_and_avoid", 1.0, 3.0),
        ("hold_lane", 2.0, 2.0),
    ],
)
def test_a_fast_driver_stops_before_what_comes_within_its_range(kind, distance, deceleration):
    """With a set-point of 30 m/s: the speed is that of the assured clear distance, and the gap is kept."""
    wall, road = block(150.0, -60.0, 151.0, 60.0), track_through([(0, 0), (400, 0)], radius=9.0)
    run = drive({"kind": kind, "speed": 30.0}, [wall], tracks={"main": road}, speed=10.0, duration=35.0)
    steady = run.speed[run.x < 150.0 - FRONT - REACH - 1.0]
    lag = deceleration * 0.35  # reaction and period
    fastest = math.sqrt(lag**2 + 2.0 * deceleration * (REACH - distance)) - lag
    assert steady.max() == pytest.approx(fastest, abs=0.01)
    assert run.speed[-1] < 0.01
    assert distance - 0.1 < run.clearance[-1] < distance + 0.5
    # The published switch has no such limit: it commands its set-point up to the distance, and hits.
    if kind == "obstacle_stopper":
        published = {"kind": kind, "speed": 30.0, "as_published": True}
        assert drive(published, [wall], speed=10.0, duration=35.0).clearance[-1] == 0.0


def test_the_profile_looks_along_the_curve():
    steering = math.atan(2.6 / 20.0)
    spec = {"kind": "obstacle_stopper", "speed": 4.0, "steering": steering, "distance": 2.0}
    run = drive(spec, [block(30.0, -3.0, 31.0, 3.0), post(20.0, 20.0)], duration=20.0)
    assert run.speed[-1] < 1e-3
    assert run.clearance[-1] == pytest.approx(2.0, abs=0.3)
    assert run.y[-1] > 12.0


@pytest.mark.parametrize("speed", [5.0, 6.0, 10.0])
def test_the_published_stopper_is_in_time_only_when_slow(speed):
    """It rests 5 m - v t - v^2/(2 a) from the wall, with t up to a period; when that is negative, it hits."""
    wall = block(45.0, -3.0, 46.0, 3.0)
    spec = {"kind": "obstacle_stopper", "speed": speed, "as_published": True}
    run = drive(spec, [wall], duration=20.0, speed=speed, lag=0.0)
    rest = 5.0 - speed**2 / (2.0 * BRAKES)
    late = speed * (0.05 + STEP)
    if rest - late > 0.0:
        assert rest - late <= run.clearance[-1] <= rest + speed * STEP
        assert run.speed[-1] == 0.0
    else:
        assert rest < 0.0
        assert run.clearance[-1] == 0.0
        after = 5.0 + FRONT - 45.0 + run.x[-1]
        assert run.speed[-1] == pytest.approx(math.sqrt(speed**2 - 2.0 * BRAKES * after), rel=0.25)


def test_the_published_stopper_does_not_see_beside_its_tenth_of_a_radian():
    """A corner that the car's side hits is outside the fan of 0.1 rad for the last 8 m."""
    corner = block(30.0, 0.8, 31.0, 5.0)
    assert HALF > 0.8
    run = drive({"kind": "obstacle_stopper", "speed": 3.0, "as_published": True}, [corner], duration=20.0)
    assert run.clearance[-1] == 0.0
    run = drive({"kind": "obstacle_stopper", "speed": 3.0}, [corner], duration=20.0)
    assert run.clearance[-1] == pytest.approx(5.0, abs=0.1)


def test_the_blind_driver_hits():
    run = drive({"kind": "blind", "speed": 5.0}, [post(20.0, 0.0)], duration=10.0)
    assert run.clearance[-1] == 0.0
    assert run.speed[-1] == pytest.approx(5.0, abs=0.01)


def test_it_follows_a_path_of_points_blind_to_obstacles():
    spec = {"kind": "follow_path", "points": [[0, 0], [25, 0], [25, 25], [60, 25]], "speed": 4.0}
    run = drive(spec, [post(45.0, 30.0)], duration=40.0)
    path = shapely.LineString([(0, 0), (25, 0), (25, 25), (60, 25)])
    away = shapely.distance(shapely.points(run.x, run.y), path)
    assert away.max() < 2.2  # the corners are rounded: (sqrt(2) - 1) times their radius
    assert (run.x[-1], run.y[-1]) == pytest.approx((60.0, 25.0), abs=0.5)
    assert drive(spec, [post(25.0, 12.0)], duration=40.0).clearance[-1] == 0.0


def test_it_follows_the_first_track_of_the_world():
    tracks = {
        "main": track_through([(0, 0), (40, 0)], radius=9.0),
        "other": track_through([(0, 5), (40, 5)], radius=9.0),
    }
    run = drive({"kind": "follow_path"}, tracks=tracks, duration=8.0, start=(0.0, 1.0, 0.0))
    assert abs(run.y[-1]) < 0.05
    run = drive({"kind": "follow_path", "track": "other"}, tracks=tracks, duration=8.0, start=(0.0, 4.0, 0.0))
    assert run.y[-1] == pytest.approx(5.0, abs=0.05)


OVAL = Track([Piece(40.0, 0.0, 0.0), Piece(12.0 * math.pi, 1 / 12, 1 / 12)] * 2, closed=True)


@pytest.mark.parametrize("offset", [-2.0, 0.0, 2.0])
def test_it_keeps_its_lane_and_stops_before_an_obstacle_in_it(offset):
    position = OVAL.point(95.0, offset)
    beside = OVAL.point(60.0, offset + 2.6)
    run = drive(
        {"kind": "hold_lane", "offset": offset, "speed": 5.0},
        [post(float(position[0]), float(position[1])), post(float(beside[0]), float(beside[1]))],
        tracks={"main": OVAL},
        start=(0.0, offset, 0.0),
        duration=35.0,
    )
    s, lateral = OVAL.project(run.x, run.y)
    assert np.abs(lateral - offset).max() < 0.3
    assert run.speed[-1] < 1e-3
    assert run.clearance[-1] == pytest.approx(2.0, abs=0.3)
    assert s[-1] > 80.0


def test_it_brakes_for_an_obstacle_within_the_stopping_distance_of_a_command_above_a_lowered_set_point():
    straight = Track([Piece(300.0, 0.0, 0.0)], closed=False)
    driver = HoldLane(CAR, straight, HoldLaneSpec(kind="hold_lane", speed=10.0))
    simulator = Simulator(driver)
    context = simulator.get_mutable_context()
    driver.state.FixValue(context, [20.0, 0, 0, 0, 0, 0, 10.0, 0, 0, 0, 0, 0])
    driver.ranges.FixValue(context, np.full(driver.ranges.size(), math.inf))
    simulator.AdvanceTo(0.2)
    assert driver.GetOutputPort("command").Eval(context)[0] == pytest.approx(10.0)
    driver.set_gains(context, PathGains(3.0))
    ranges = np.full(driver.ranges.size(), math.inf)
    ranges[len(ranges) // 2] = 20.0
    driver.ranges.FixValue(context, ranges)
    simulator.AdvanceTo(0.24)  # one update
    highest = brake_speed(18.0, deceleration=2.0, reaction=0.3)
    assert 7.0 < highest < 8.0
    assert driver.GetOutputPort("command").Eval(context)[0] == pytest.approx(highest)


def test_a_lane_is_as_long_as_its_circle():
    lane = Lane(OVAL, 2.0)
    assert lane.length == pytest.approx(80.0 + 2.0 * math.pi * 10.0)
    s = np.linspace(0.0, lane.length, 50, endpoint=False)
    x, y, _ = lane.pose(s)
    back, lateral = lane.project(x, y)
    np.testing.assert_allclose(np.mod(back - s + 1.0, lane.length), 1.0, atol=1e-6)
    np.testing.assert_allclose(lateral, 0.0, atol=1e-9)
    h = 1e-4
    ahead = np.array(lane.pose(s + h)[:2]) - np.array(lane.pose(s)[:2])
    np.testing.assert_allclose(np.hypot(*ahead) / h, 1.0, atol=1e-3)
    with pytest.raises(ConfigError, match="beyond the centre of the bend"):
        Lane(OVAL, 12.5)


def test_an_open_lane_goes_straight_on_beyond_its_ends():
    lane = Lane(track_through([(0, 0), (20, 0)], radius=9.0), 1.5)
    x, y, _ = lane.pose(np.array([-2.0, 25.0]))
    np.testing.assert_allclose([x, y], [[-2.0, 25.0], [1.5, 1.5]], atol=1e-9)
    s, lateral = lane.project(np.array([15.0]), np.array([1.0]))
    assert (s[0], lateral[0]) == pytest.approx((15.0, -0.5))


# --- paths of points -----------------------------------------------------------------------------------------------


def test_corners_are_rounded_by_arcs_that_touch_both_straights():
    track = track_through([(0, 0), (20, 0), (20, 30)], radius=6.0)
    assert track.length == pytest.approx(14.0 + 6.0 * math.pi / 2 + 24.0)
    assert track.min_radius == pytest.approx(6.0)
    x, y, yaw = track.pose_at(track.length)
    assert (x, y, yaw) == pytest.approx((20.0, 30.0, math.pi / 2))
    assert track_through([(0, 0), (4, 0), (8, 4), (20, 4)], radius=90.0).pose_at(1e9)[1] == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0, 0)], "at least two"),
        ([(0, 0), (0, 0), (1, 0)], "0 and 1 are in the same place"),
        ([(0, 0), (10, 0), (1, 0.1)], "turns back on itself at point 1"),
    ],
)
def test_impossible_paths_are_rejected(points, message):
    with pytest.raises(ConfigError, match=message):
        track_through(points, radius=5.0)


# --- systems and specs ---------------------------------------------------------------------------------------------


def test_the_command_is_there_from_the_start_and_bears_its_time():
    driver = make_driver({"kind": "obstacle_stopper", "speed": 4.0, "steering": "5 deg"}, WorldStandIn())
    simulator = Simulator(driver)
    context = simulator.get_mutable_context()
    driver.GetInputPort("state").FixValue(context, np.zeros(12))
    driver.GetInputPort("ranges").FixValue(context, np.full(181, math.inf))
    simulator.Initialize()
    command = driver.GetOutputPort("command")
    assert command.Eval(context) == pytest.approx([4.0, math.radians(5.0), 0.0])
    simulator.AdvanceTo(0.12)
    assert command.Eval(context) == pytest.approx([4.0, math.radians(5.0), 0.1])


def test_an_unstable_simulation_is_named():
    driver = make_driver("straight_and_avoid", WorldStandIn())
    simulator = Simulator(driver)
    context = simulator.get_mutable_context()
    driver.GetInputPort("state").FixValue(context, np.full(12, math.nan))
    driver.GetInputPort("ranges").FixValue(context, np.full(181, math.inf))
    with pytest.raises(RunError, match="StraightAndAvoid: the vehicle is at"):
        simulator.Initialize()


@pytest.mark.parametrize("kind", sorted(set(DRIVERS) - {"constant", "path_tracking", "schedule"}))
def test_every_behaviour_runs_with_its_defaults(kind):
    run = drive(kind, [post(30.0, 12.0)], tracks={"main": OVAL}, duration=2.0)
    assert run.speed[-1] > 1.0


def test_every_number_has_a_description():
    for kind, spec in DRIVERS.items():
        for name, entry in spec.model_fields.items():
            assert entry.description, f"{kind}.{name}"
            assert entry.description.count("[") >= 1, f"{kind}.{name}"


def test_a_behaviour_comes_by_its_kind_with_settings_or_as_a_class():
    assert isinstance(make_driver("drive_to_nearest_and_stop", WorldStandIn()), DriveToNearest)
    driver = make_driver({"kind": "drive_to_nearest_and_stop", "distance": "250 cm"}, WorldStandIn())
    assert driver.spec.distance == 2.5
    assert make_driver({"kind": "constant", "speed": 2.0}, WorldStandIn()).GetOutputPort("command").size() == 3


_TREE = """
tests:
  - name: stops
    behaviour:
      kind: blind
      speed: 3
"""
SOURCE = parse_tree(_TREE, "lot.yaml")[1]._replace(prefix=("tests", 0))


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        ("straight_and_avoit", "lot.yaml:5: tests.0.behaviour.kind: unknown kind 'straight_and_avoit'; did you mean"),
        (7, "lot.yaml:4: tests.0.behaviour: 7 is not a mapping with a 'kind'"),
        ({"speed": 3}, "lot.yaml:4: tests.0.behaviour: needs a 'kind'"),
        ({"kind": "blind", "speed": -1}, "lot.yaml:6: tests.0.behaviour.speed: "),
        ({"kind": "blind", "sped": 1}, "lot.yaml:4: tests.0.behaviour.sped: "),
        ("follow_path", "lot.yaml:4: tests.0.behaviour.track: the world has no track to follow"),
        ("nowhere_at_all:Driver", "lot.yaml:4: tests.0.behaviour: module 'nowhere_at_all' cannot be imported"),
    ],
)
def test_wrong_behaviours_are_rejected_in_one_line(behaviour, message):
    with pytest.raises(ConfigError) as caught:
        make_driver(behaviour, WorldStandIn(), source=SOURCE)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


OWN = """
from pydrake.systems.framework import BasicVector, LeafSystem

class Slow(LeafSystem):
    def __init__(self, speed=1.0, *, vehicle=None):
        super().__init__()
        self.speed, self.vehicle = speed, vehicle
        self.DeclareVectorOutputPort("command", BasicVector(3), self.calc)

    def calc(self, context, output):
        output.SetFromVector([self.speed, 0.0, context.get_time()])

class Mute(LeafSystem):
    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("answer", BasicVector(1), lambda context, output: None)

class Broken(LeafSystem):
    def __init__(self):
        raise ValueError("not today")
"""


def test_a_user_class_drives(tmp_path):
    (tmp_path / "my_drivers.py").write_text(OWN, encoding="utf-8")

    def make(behaviour):
        return make_driver(behaviour, WorldStandIn(), source=SOURCE, folder=tmp_path)

    driver = make({"kind": "my_drivers:Slow", "speed": 2.0})
    assert driver.speed == 2.0
    assert driver.vehicle is CAR
    assert make("my_drivers:Slow").speed == 1.0
    for behaviour, message in [
        ("my_drivers:Mute", "my_drivers:Mute is not a driver: it needs an output port 'command' of 3 elements"),
        ("my_drivers:Broken", "my_drivers:Broken cannot be made: ValueError: not today"),
        ("my_drivers:Slwo", "'Slwo' is not a Drake system in my_drivers; did you mean 'Slow'?"),
        ({"kind": "my_drivers:Slow", "sped": 1}, "my_drivers:Slow has no parameter 'sped'; did you mean 'speed'?"),
    ]:
        with pytest.raises(ConfigError) as caught:
            make(behaviour)
        assert str(caught.value).startswith("lot.yaml:")
        assert message in str(caught.value)


def test_specs_check_what_belongs_together():
    with pytest.raises(ConfigError, match="a path is one of them"):
        parse_yaml("{kind: follow_path, track: a, points: [[0, 0], [1, 0]]}", FollowPathSpec)
    spec = parse_yaml("{kind: hold_lane, track: mian}", HoldLaneSpec, name="d.yaml")
    with pytest.raises(ConfigError, match=r"d\.yaml:1: track: unknown track 'mian'; did you mean 'main'\?"):
        spec.make_system(CAR, WorldStandIn(tracks={"main": OVAL}))
    spec = parse_yaml("{kind: hold_lane, offset: 9}", HoldLaneSpec, name="d.yaml")
    with pytest.raises(ConfigError, match=r"d\.yaml:1: track: path tracking: the track turns with radius 3\.0"):
        spec.make_system(CAR, WorldStandIn(tracks={"main": OVAL}))
    assert isinstance(
        parse_yaml("kind: hold_lane", HoldLaneSpec).make_system(CAR, WorldStandIn(tracks={"m": OVAL})), HoldLane
    )
