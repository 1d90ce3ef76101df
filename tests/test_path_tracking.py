"""Path tracking: speed profile, drivable line, and a kinematic car on the tracks of these tests."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from mirdrake.controllers import (
    Ackermann,
    AxleGeometry,
    DrivingLimits,
    PathGains,
    PathTracker,
    PathTrackingSpec,
    make_centre_line,
    make_drivable_line,
    make_speed_profile,
)
from mirdrake.controllers.path_tracking import PathTables
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import parse_yaml

BOLT = AxleGeometry(2.6, 1.5, 1.5, 1.5, 0.6, 0.5)


class ArcTrack:
    """Straights and arcs, given as (length, curvature); positions from the closed form of each piece."""

    def __init__(self, pieces, *, closed=True):
        self.closed = closed
        self.pieces, self.starts = pieces, []
        s, pose = 0.0, (0.0, 0.0, 0.0)
        for length, curvature in pieces:
            self.starts.append((s, pose, curvature))
            pose = self._advance(pose, length, curvature)
            s += length
        self.length, self.end = s, pose
        self.grid = np.linspace(0.0, self.length, 4001)

    @staticmethod
    def _advance(pose, length, curvature):
        x, y, yaw = pose
        if curvature == 0.0:
            return x + length * math.cos(yaw), y + length * math.sin(yaw), yaw
        after = yaw + curvature * length
        return (
            x + (math.sin(after) - math.sin(yaw)) / curvature,
            y - (math.cos(after) - math.cos(yaw)) / curvature,
            after,
        )

    def pose(self, s):
        poses = []
        for value in np.atleast_1d(s):
            wrapped = value % self.length if self.closed else min(max(value, 0.0), self.length)
            start, pose, curvature = next(entry for entry in reversed(self.starts) if wrapped >= entry[0])
            poses.append(self._advance(pose, wrapped - start, curvature))
        x, y, yaw = np.array(poses).T
        return (x, y, yaw) if np.ndim(s) else (x[0], y[0], yaw[0])

    def project(self, x, y, *, near=None):
        gx, gy, yaw = self.pose(self.grid)
        i = int(np.argmin((gx - x) ** 2 + (gy - y) ** 2))
        return self.grid[i], math.cos(yaw[i]) * (y - gy[i]) - math.sin(yaw[i]) * (x - gx[i])


def make_rounded_rectangle(length=40.0, width=20.0, radius=6.0):
    corner = (radius * math.pi / 2.0, 1.0 / radius)
    half, side = (length / 2.0, 0.0), (width, 0.0)
    return ArcTrack([half, corner, side, corner, (length, 0.0), corner, side, corner, half])


def make_stadium(straight=40.0, radius=6.0):
    return ArcTrack([(straight, 0.0), (radius * math.pi, 1.0 / radius)] * 2)


def make_circle(radius):
    return ArcTrack([(2.0 * math.pi * radius, 1.0 / radius)])


class KinematicCar(LeafSystem):
    """Bicycle whose steering moves at a limited rate and whose speed follows the command; Runge-Kutta, 5 ms.

    State: x, y, yaw, speed, steering. A command arrives `delay` steps of 5 ms late; the speed lags `lag` seconds.
    """

    def __init__(self, *, rate=0.5, wheelbase=2.6, lag=0.0, delay=0, start=(0.0, 0.0, 0.0), speed=0.0, slip=0.0):
        super().__init__()
        self.rate, self.wheelbase, self.lag, self.delay, self.slip = rate, wheelbase, lag, delay, slip
        self.command = self.DeclareVectorInputPort("command", 3)
        self.index = self.DeclareDiscreteState([*start, speed, 0.0])
        self.queue = self.DeclareDiscreteState([0.0] * (2 * (delay + 1)))
        self.state = self.DeclareVectorOutputPort("state", BasicVector(12), self._calc, {self.all_state_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(0.005, 0.0, self._update)

    def _calc(self, context, output):
        x, y, yaw, speed, steering = context.get_discrete_state(self.index).value()
        turn = speed * math.tan(steering) / (self.wheelbase + self.slip * speed**2)
        output.SetFromVector([x, y, 0.0, 0.0, 0.0, yaw, speed, 0.0, 0.0, 0.0, 0.0, turn])

    def _update(self, context, values):
        x, y, yaw, speed, steering = context.get_discrete_state(self.index).value()
        queue = context.get_discrete_state(self.queue).value().tolist()
        queue = queue[2:] + self.command.Eval(context)[:2].tolist()
        speed_setpoint, steering_setpoint = queue[:2]
        h = 0.005
        speed = speed_setpoint if self.lag == 0.0 else speed + h / self.lag * (speed_setpoint - speed)
        steering += min(max(steering_setpoint - steering, -self.rate * h), self.rate * h)
        turn = speed * math.tan(steering) / (self.wheelbase + self.slip * speed**2)

        def slope(state):
            return np.array([speed * math.cos(state[2]), speed * math.sin(state[2]), turn])

        pose = np.array([x, y, yaw])
        k1 = slope(pose)
        k2 = slope(pose + 0.5 * h * k1)
        k3 = slope(pose + 0.5 * h * k2)
        k4 = slope(pose + h * k3)
        pose = pose + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        values.set_value(self.index, [*pose, speed, steering])
        values.set_value(self.queue, queue)


class Drive:
    """A tracker and a car in one diagram; `run` samples both every 20 ms."""

    def __init__(self, track, gains, *, geometry=BOLT, limits=None, **car):
        builder = DiagramBuilder()
        self.tracker = builder.AddSystem(PathTracker(track, geometry, gains=gains, limits=limits))
        self.car = builder.AddSystem(KinematicCar(**car))
        builder.Connect(self.car.state, self.tracker.state)
        builder.Connect(self.tracker.command, self.car.command)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.simulator.Initialize()
        self.context = self.tracker.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def sample(self):
        car = self.car.GetMyContextFromRoot(self.simulator.get_context())
        error, command = self.tracker.path_error.Eval(self.context), self.tracker.command.Eval(self.context)
        return np.array([*error, *command, *car.get_discrete_state(0).value()])

    def run(self, duration):
        start = self.simulator.get_context().get_time()
        rows = []
        for time in np.arange(start, start + duration, 0.02) + 0.019:
            self.simulator.AdvanceTo(time)
            rows.append(self.sample())
        names = (
            "lateral",
            "heading",
            "progress",
            "laps",
            "v_cmd",
            "steer_cmd",
            "stamp",
            "x",
            "y",
            "yaw",
            "speed",
            "steer",
        )
        return dict(zip(names, np.array(rows).T, strict=True))


# --- speed profile --------------------------------------------------------------------------------------------------


def test_speed_on_constant_curvature_is_the_root_of_lateral_acceleration_over_curvature():
    centre = make_centre_line(make_circle(20.0))
    line = make_drivable_line(
        centre, speed=30.0, wheelbase=2.6, steering_limit=0.5, steering_rate=0.5, limits=DrivingLimits(lateral=5.0)
    )
    np.testing.assert_allclose(line.speed, 10.0, rtol=1e-9)
    np.testing.assert_allclose(line.offset, 0.0, atol=1e-9)


def test_braking_into_a_corner_follows_v_squared_is_vc_squared_plus_2_a_s():
    ceiling = np.full(1001, 20.0)
    ceiling[500:600] = 5.0
    speed = make_speed_profile(ceiling, 0.1, acceleration=1.0, deceleration=2.0, closed=False)
    for distance in (0.1, 5.0, 20.0):  # sqrt(25 + 4 s): at 20 m 10.247 m/s
        assert speed[500 - round(distance * 10)] == pytest.approx(math.sqrt(25.0 + 4.0 * distance), rel=1e-12)
    assert speed[599 + 200] == pytest.approx(math.sqrt(25.0 + 2.0 * 20.0), rel=1e-12)


def test_the_profile_of_a_closed_track_brakes_across_the_start_line():
    ceiling = np.full(1000, 20.0)
    ceiling[20:40] = 5.0
    speed = make_speed_profile(ceiling, 0.1, acceleration=1.0, deceleration=2.0, closed=True)
    assert speed[970] == pytest.approx(math.sqrt(25.0 + 4.0 * 5.0), rel=1e-12)  # 5 m before the corner
    np.testing.assert_allclose(
        np.roll(speed, 300),
        make_speed_profile(np.roll(ceiling, 300), 0.1, acceleration=1.0, deceleration=2.0, closed=True),
        rtol=1e-12,
    )


def test_the_profile_equals_a_forward_and_a_backward_pass_point_by_point():
    random = np.random.default_rng(1)
    ceiling = random.uniform(2.0, 12.0, 300)
    slow = ceiling.copy()
    slow[-1] = min(slow[-1], 1.0)
    for i in range(1, 300):
        slow[i] = min(slow[i], math.sqrt(slow[i - 1] ** 2 + 2.0 * 1.5 * 0.2))
    for i in range(298, -1, -1):
        slow[i] = min(slow[i], math.sqrt(slow[i + 1] ** 2 + 2.0 * 2.5 * 0.2))
    fast = make_speed_profile(ceiling, 0.2, acceleration=1.5, deceleration=2.5, closed=False, end_speed=1.0)
    np.testing.assert_allclose(fast, slow, rtol=1e-10)


# --- drivable line --------------------------------------------------------------------------------------------------


def plan(track, speed, **limits):
    centre = make_centre_line(track)
    law = Ackermann(BOLT)
    line = make_drivable_line(
        centre,
        speed=speed,
        wheelbase=2.6,
        steering_limit=law.limit,
        steering_rate=0.5,
        limits=DrivingLimits(**limits),
    )
    return centre, line


@pytest.mark.parametrize("speed", [3.0, 5.0, 8.0, 12.0])
@pytest.mark.parametrize("track", [make_rounded_rectangle(), make_stadium()], ids=["rectangle", "stadium"])
def test_the_line_stays_within_tolerance_and_within_the_steering_rate(track, speed):
    centre, line = plan(track, speed)
    assert np.max(np.abs(line.offset)) < 0.06
    rate = np.abs(np.gradient(np.arctan(2.6 * line.curvature), centre.spacing)) * line.speed
    assert np.max(rate) < 0.41  # 0.5 less the fifth that is left to the feedback
    assert np.max(line.speed**2 * np.abs(line.curvature)) < 5.0 + 1e-9
    assert line.offset[0] == pytest.approx(line.offset[-1], abs=1e-9)


def test_headings_of_the_line_integrate_its_curvature():
    centre, line = plan(make_rounded_rectangle(), 5.0)
    x = centre.x - line.offset * np.sin(centre.yaw)
    y = centre.y + line.offset * np.cos(centre.yaw)
    yaw = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    turned = np.cumsum(line.curvature[1:-1]) * centre.spacing
    # Left out for small e: e' kappa e, at most 0.085 * 0.04 / 6 rad, and the third power of e'. Where an interval h
    # holds the start of a corner, a fraction f into it, its chord is off by kappa h f (1 - f)/2, at most kappa h/8.
    np.testing.assert_allclose(turned, yaw[1:] - yaw[0], atol=1e-3 + centre.spacing / 6.0 / 8.0)


def test_a_tighter_tolerance_is_bought_with_speed():
    _, line = plan(make_rounded_rectangle(), 5.0, tolerance=0.01)
    assert np.max(np.abs(line.offset)) < 0.012
    assert 1.5 < np.min(line.speed) < 4.0


def test_without_a_rate_limit_the_line_is_the_centre_line():
    centre = make_centre_line(make_rounded_rectangle())
    line = make_drivable_line(
        centre, speed=5.0, wheelbase=2.6, steering_limit=0.5, steering_rate=math.inf, limits=DrivingLimits()
    )
    assert np.max(np.abs(line.offset)) < 0.005


def test_a_track_too_tight_for_the_vehicle_is_rejected():
    # tan(0.5192)/2.6: the tightest radius at the rear axle centre is 2.6/tan(0.6) + 0.75 = 4.55 m
    with pytest.raises(ConfigError, match=r"radius 4.00 m at s = .* the vehicle needs at least 4.55 m"):
        PathTracker(make_rounded_rectangle(radius=4.0), BOLT, gains=PathGains(5.0))


def test_an_open_track_is_planned_to_a_stop_at_its_end():
    _, line = plan(ArcTrack([(50.0, 0.0)], closed=False), 10.0)
    assert line.speed[-1] == 0.0
    assert line.speed[-101] == pytest.approx(math.sqrt(2.0 * 2.0 * 10.0), rel=1e-9)  # 10 m before


# --- place on the track ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lateral", [-2.0, 0.0, 0.5, 3.0])
def test_projection_finds_arc_length_and_offset_of_a_point_set_beside_the_track(lateral):
    track = make_rounded_rectangle()
    tables = PathTables(make_centre_line(track))
    for s in np.linspace(0.05, track.length - 0.05, 57):
        x, y, yaw = track.pose(s)
        projection = tables.project(x - lateral * math.sin(yaw), y + lateral * math.cos(yaw), near=s - 1.0)
        assert projection is not None
        assert projection.s == pytest.approx(s, abs=2e-3)  # intervals with a corner's kink are off by a little
        assert projection.lateral == pytest.approx(lateral, abs=2e-4)


def test_projection_on_a_circle_is_exact_and_wraps_at_the_start_line():
    tables = PathTables(make_centre_line(make_circle(10.0)))
    x, y = 10.5 * math.sin(-0.01), 10.0 - 10.5 * math.cos(-0.01)  # 0.1 m before the start, 0.5 m to the right
    projection = tables.project(x, y, near=0.2)
    assert projection is not None
    assert projection.s == pytest.approx(2.0 * math.pi * 10.0 - 0.1, abs=1e-6)
    assert projection.lateral == pytest.approx(-0.5, abs=1e-9)
    assert projection.curvature == pytest.approx(0.1, rel=1e-9)


# --- driving --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [5.0, 8.0])
@pytest.mark.parametrize("track", [make_rounded_rectangle(), make_stadium()], ids=["rectangle", "stadium"])
def test_the_car_stays_within_6_cm_of_a_track_with_6_m_corners_without_clothoids(track, speed):
    drive = Drive(track, PathGains(speed, preview_time=0.02))
    log = drive.run(1.2 * track.length / 5.0)
    assert np.max(np.abs(log["lateral"])) < (0.05 if speed == 5.0 else 0.06)
    assert log["laps"][-1] > 1.0
    driving = log["laps"] > 0.2  # the start is the acceleration's
    assert np.max(np.abs(np.diff(log["steer"]))) <= 0.5 * 0.02 + 1e-9
    if speed == 5.0:
        assert np.mean(log["speed"][driving]) == pytest.approx(5.0, rel=0.002)


def test_with_a_delay_of_40_ms_and_a_lagging_speed_the_car_stays_within_6_cm():
    drive = Drive(make_rounded_rectangle(), PathGains(5.0), delay=8, lag=0.15)
    log = drive.run(38.0)
    assert np.max(np.abs(log["lateral"])) < 0.06


@pytest.mark.parametrize("delay", [0, 4, 8, 16])
@pytest.mark.parametrize("speed", [3.0, 8.0])
def test_a_wrong_guess_of_the_delay_costs_accuracy_but_never_stability(speed, delay):
    drive = Drive(make_rounded_rectangle(), PathGains(speed), delay=delay, lag=0.15)
    log = drive.run(50.0)
    assert np.max(np.abs(log["lateral"])) < 0.30


@pytest.mark.parametrize(("offset", "turn"), [(2.0, 0.0), (-4.0, 0.3), (0.0, 0.6), (3.0, -2.0), (0.0, math.pi)])
def test_the_car_finds_back_to_the_line_from_anywhere(offset, turn):
    drive = Drive(make_rounded_rectangle(), PathGains(5.0), start=(0.0, offset, turn), speed=4.0, delay=4)
    log = drive.run(45.0)
    assert np.max(np.abs(log["lateral"][-500:])) < 0.06


def test_on_a_circle_the_error_goes_to_zero():
    drive = Drive(make_circle(12.0), PathGains(5.0, preview_time=0.0), start=(0.0, 0.3, 0.0), speed=5.0)
    log = drive.run(20.0)
    assert abs(log["lateral"][-1]) < 1e-3
    assert log["steer"][-1] == pytest.approx(math.atan(2.6 / 12.0), abs=1e-4)


def test_an_offset_on_a_straight_decays_with_distance_by_the_critically_damped_second_order_law():
    # e(s) = e0 (1 + s/d) exp(-s/d), d = 1.5 m below 2.5 m/s; small enough that the steering rate does not bind
    track = ArcTrack([(100.0, 0.0)], closed=False)
    gains = PathGains(1.0, preview_time=0.0, convergence_distance=3.0)
    drive = Drive(track, gains, start=(1.0, 0.02, 0.0), speed=1.0)
    log = drive.run(12.0)
    s = log["progress"] - 1.0
    np.testing.assert_allclose(log["lateral"], 0.02 * (1.0 + s / 3.0) * np.exp(-s / 3.0), atol=4e-4)


def test_a_start_from_rest_accelerates_at_no_more_than_the_limit():
    drive = Drive(make_stadium(), PathGains(5.0), limits=DrivingLimits(acceleration=1.5))
    log = drive.run(5.0)
    assert np.max(np.diff(log["v_cmd"])) <= 1.5 * 0.02 + 1e-9
    assert log["v_cmd"][0] <= 1.5 * 0.02 + 1e-9
    reached = np.argmax(log["v_cmd"] > 4.8) * 0.02
    assert reached == pytest.approx(4.8 / 1.5, abs=0.05)


def test_known_understeer_is_taken_up_by_its_gradient():
    # tan(delta) = (L + K v^2) kappa; K = 0.01 s^2/m: at 5 m/s the car needs a tenth more steering
    start = (0.0, 0.0, 0.0)
    blind = Drive(make_circle(20.0), PathGains(5.0), slip=0.01, start=start, speed=5.0).run(15.0)
    aware = Drive(make_circle(20.0), PathGains(5.0, understeer_gradient=0.01), slip=0.01, start=start, speed=5.0).run(
        15.0
    )
    assert abs(blind["lateral"][-1]) > 0.03
    assert abs(aware["lateral"][-1]) < 0.005


def test_the_car_stops_at_the_end_of_an_open_track():
    track = ArcTrack([(30.0, 0.0), (10.0, 0.05)], closed=False)
    log = Drive(track, PathGains(5.0)).run(25.0)
    assert log["speed"][-1] < 0.05
    assert log["progress"][-1] == pytest.approx(40.0, abs=0.3)


def test_laps_and_progress_count_through_the_start_line():
    track = make_circle(10.0)
    log = Drive(track, PathGains(5.0), start=(0.0, 0.0, 0.0), speed=5.0).run(30.0)
    distance = np.cumsum(log["speed"]) * 0.02
    np.testing.assert_allclose(log["laps"][-1] * track.length, distance[-1], rtol=0.005)
    assert log["laps"][-1] > 2.0
    assert np.all((log["progress"] >= 0.0) & (log["progress"] < track.length))


# --- the system -----------------------------------------------------------------------------------------------------


def test_outputs_are_right_at_time_zero():
    drive = Drive(make_stadium(), PathGains(5.0), start=(10.0, 0.4, 0.1), speed=3.0)
    lateral, heading, progress, laps = drive.tracker.path_error.Eval(drive.context)
    assert (lateral, heading, progress, laps) == pytest.approx((0.4, 0.1, 10.0, 0.0), abs=1e-6)
    speed, steering, stamp = drive.tracker.command.Eval(drive.context)
    assert speed == 3.0
    assert steering < 0.0
    assert stamp == 0.0


def test_the_set_point_changes_in_the_context_without_a_rebuild():
    drive = Drive(make_circle(30.0), PathGains(4.0), speed=4.0)
    drive.run(4.0)
    drive.tracker.set_gains(drive.context, PathGains(6.0))
    assert drive.tracker.get_gains(drive.context) == PathGains(6.0)
    log = drive.run(4.0)
    assert log["speed"][-1] == pytest.approx(6.0, abs=1e-6)
    assert np.max(np.diff(log["v_cmd"])) <= 1.5 * 0.02 + 1e-9


def test_two_contexts_drive_at_their_own_speeds_and_a_repeated_run_gives_the_same_bits():
    drive = Drive(make_stadium(), PathGains(5.0))
    finals = []
    for speed in (5.0, 3.0, 5.0):
        context = drive.diagram.CreateDefaultContext()
        own = drive.tracker.GetMyMutableContextFromRoot(context)
        drive.tracker.set_gains(own, PathGains(speed))
        simulator = Simulator(drive.diagram, context)
        simulator.AdvanceTo(8.0)
        finals.append(drive.tracker.path_error.Eval(own))
    np.testing.assert_array_equal(finals[0], finals[2])
    assert finals[1][3] < finals[0][3]


def test_a_vehicle_put_elsewhere_is_found_again():
    drive = Drive(make_rounded_rectangle(), PathGains(5.0))
    drive.run(1.0)
    x, y, yaw = drive.tracker.track.pose(100.0)
    car = drive.car.GetMyMutableContextFromRoot(drive.simulator.get_mutable_context())
    car.SetDiscreteState(0, [x, y, yaw, 3.0, 0.0])
    drive.run(0.1)
    lateral, _, progress, _ = drive.tracker.path_error.Eval(drive.context)
    assert progress == pytest.approx(100.0, abs=1.0)
    assert abs(lateral) < 0.1


def test_ports_carry_names_and_units():
    tracker = PathTracker(make_stadium(), BOLT, gains=PathGains(5.0))
    assert [signal.name for signal in signals_of(tracker.path_error) or ()] == [
        "lateral",
        "heading",
        "progress",
        "laps",
    ]
    assert [signal.unit for signal in signals_of(tracker.command) or ()] == ["m/s", "rad", "s"]
    assert len(signals_of(tracker.state) or ()) == 12


def test_an_unstable_vehicle_ends_the_run_with_one_line():
    builder = DiagramBuilder()
    tracker = builder.AddSystem(PathTracker(make_stadium(), BOLT, gains=PathGains(5.0)))
    source = builder.AddSystem(ConstantVectorSource([math.nan] * 12))
    builder.Connect(source.get_output_port(), tracker.state)
    with pytest.raises(RunError, match="the vehicle is at"):
        Simulator(builder.Build()).Initialize()


class Vehicle:
    geometry = BOLT


class World:
    def __init__(self, **tracks):
        self.tracks = tracks


def test_the_spec_makes_the_system_and_names_an_unknown_track():
    spec = parse_yaml("kind: path_tracking\ntrack: mian\nspeed: 4", PathTrackingSpec, name="d.yaml")
    with pytest.raises(ConfigError) as caught:
        spec.make_system(Vehicle(), World(main=make_stadium()))
    assert str(caught.value) == "d.yaml:2: track: unknown track 'mian'; did you mean 'main'? (allowed: main)"
    tracker = spec.make_system(Vehicle(), World(mian=make_stadium()))
    assert tracker.get_gains(tracker.CreateDefaultContext()).speed == 4.0
