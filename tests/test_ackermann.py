"""Ackermann geometry, checked by drawing the wheels and their normals."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from mirdrake.controllers import Ackermann, AckermannSteering, AxleGeometry
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.gym.testing import assert_follows, drive

BOLT = AxleGeometry(2.6, 1.5, 1.5, 1.5, 0.6, 0.5)
SCRUBBED = AxleGeometry(2.6, front_track=1.56, rear_track=1.48, kingpin_track=1.36, steering_limit=0.6)
ANGLES = [-0.5, -0.2, -1e-3, -1e-9, 1e-9, 1e-3, 0.1, 0.2, 0.5]


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def meet(p, direction, q, other):
    """Return the intersection of the line through p along `direction` and that through q along `other`."""
    return p + direction * cross(q - p, other) / cross(direction, other)


def draw_wheels(geometry, left, right):
    """Return the centre and left-pointing axle direction of each wheel; the front ones turn about their kingpins."""
    wheels = []
    for side, angle in ((1.0, left), (-1.0, right)):
        axle = np.array([-math.sin(angle), math.cos(angle)])
        kingpin = np.array([geometry.wheelbase, side * geometry.kingpin_track / 2.0])
        wheels.append((kingpin + side * axle * (geometry.front_track - geometry.kingpin_track) / 2.0, axle))
    wheels += [(np.array([0.0, side * geometry.rear_track / 2.0]), np.array([0.0, 1.0])) for side in (1.0, -1.0)]
    return wheels


@pytest.mark.parametrize("geometry", [BOLT, SCRUBBED])
@pytest.mark.parametrize("steering", [-0.5, -0.2, -0.01, 0.01, 0.2, 0.5])
def test_normals_of_all_four_wheels_meet_in_one_point_on_the_rear_axle_line(geometry, steering):
    law = Ackermann(geometry)
    wheels = draw_wheels(geometry, *law.wheel_angles(steering))
    from_left = meet(*wheels[0], *wheels[2])
    from_right = meet(*wheels[1], *wheels[3])
    expected = np.array([0.0, geometry.wheelbase / math.tan(steering)])
    np.testing.assert_allclose(from_left, expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(from_right, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("geometry", [BOLT, SCRUBBED])
@pytest.mark.parametrize("steering", ANGLES)
def test_wheel_speeds_are_those_of_a_rigid_body_turning_about_that_point(geometry, steering):
    law = Ackermann(geometry)
    yaw_rate = math.tan(steering) / geometry.wheelbase  # at 1 m/s of the rear axle centre
    for (centre, axle), ratio in zip(
        draw_wheels(geometry, *law.wheel_angles(steering)), law.wheel_speed_ratios(steering), strict=True
    ):
        velocity = np.array([1.0 - yaw_rate * centre[1], yaw_rate * centre[0]])
        rolling = np.array([axle[1], -axle[0]])
        assert velocity @ rolling == pytest.approx(ratio, abs=1e-12)
        assert velocity @ axle == pytest.approx(0.0, abs=1e-12)


def test_bolt_at_0_2_rad_worked_by_hand():
    # R = 2.6 / tan 0.2 = 12.8261 m; left = atan(2.6/12.0762) = 0.212062, right = atan(2.6/13.5762) = 0.189220
    left, right = Ackermann(BOLT).wheel_angles(0.2)
    assert left == pytest.approx(0.212062, abs=1e-6)
    assert right == pytest.approx(0.189220, abs=1e-6)
    # rear 12.0762/12.8262 and 13.5762/12.8262; front hypot(12.0762, 2.6)/12.8262 and hypot(13.5762, 2.6)/12.8262
    expected = (0.963100, 1.077710, 0.941526, 1.058474)
    assert Ackermann(BOLT).wheel_speed_ratios(0.2) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("steering", [0.01, 0.1, 0.3, 0.5])
def test_cot_outer_minus_cot_inner_is_kingpin_track_over_wheelbase(steering):
    inner, outer = Ackermann(SCRUBBED).wheel_angles(steering)
    assert 1.0 / math.tan(outer) - 1.0 / math.tan(inner) == pytest.approx(1.36 / 2.6, rel=1e-10)


@pytest.mark.parametrize("steering", ANGLES)
def test_a_right_turn_is_the_mirror_image_of_a_left_turn(steering):
    law = Ackermann(SCRUBBED)
    left, right = law.wheel_angles(steering)
    assert law.wheel_angles(-steering) == (-right, -left)
    front_left, front_right, rear_left, rear_right = law.wheel_speed_ratios(steering)
    assert law.wheel_speed_ratios(-steering) == (front_right, front_left, rear_right, rear_left)


def test_straight_ahead_all_wheels_are_straight_and_have_equal_speeds():
    law = Ackermann(SCRUBBED)
    assert law.wheel_angles(0.0) == (0.0, 0.0)
    assert law.wheel_speed_ratios(0.0) == (1.0, 1.0, 1.0, 1.0)
    # No kink: the slope at 0 is 1 on both sides.
    for steering in (1e-7, -1e-7):
        left, right = law.wheel_angles(steering)
        assert left / steering == pytest.approx(1.0, abs=1e-6)
        assert right / steering == pytest.approx(1.0, abs=1e-6)


def test_at_the_limit_the_inner_wheel_is_at_its_limit_on_either_side():
    law = Ackermann(BOLT)
    assert law.limit == pytest.approx(math.atan(2.6 / (2.6 / math.tan(0.6) + 0.75)), abs=1e-15)
    assert law.limit == pytest.approx(0.5192, abs=1e-4)  # vehicles.md 2.1 gives 0.5191 for T = 1.501
    assert law.wheel_angles(law.clip(1.5))[0] == pytest.approx(0.6, abs=1e-12)
    assert law.wheel_angles(law.clip(-1.5))[1] == pytest.approx(-0.6, abs=1e-12)


@pytest.mark.parametrize(
    ("wheelbase", "track", "expected"), [(2.62, 1.301, 0.5292), (2.60, 1.501, 0.5191), (2.62, 1.29, 0.5297)]
)
def test_limits_of_the_reference_vehicles(wheelbase, track, expected):
    law = Ackermann(AxleGeometry(wheelbase, track, track, track, 0.6))
    assert law.limit == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize("steering", [*ANGLES, 0.0])
def test_bicycle_angle_and_curvature_come_back_from_the_wheel_angles(steering):
    law = Ackermann(SCRUBBED)
    assert law.bicycle_angle(*law.wheel_angles(steering)) == pytest.approx(steering, abs=1e-14)
    assert law.steering(law.curvature(steering)) == pytest.approx(steering, abs=1e-14)


def test_parallel_wheels_at_0_1_rad_have_the_mean_curvature_of_both():
    # cot 0.1 +- 0.75/2.6: tan = 0.100335/(1 +- 0.028943)
    law = Ackermann(BOLT)
    tangent = 0.5 * (0.1003347 / 1.0289427 + 0.1003347 / 0.9710573)
    assert law.bicycle_angle(0.1, 0.1) == pytest.approx(math.atan(tangent), abs=1e-7)


def test_rate_limit_of_0_5_rad_per_s_moves_0_01_rad_in_20_ms():
    law = Ackermann(BOLT)
    assert law.approach(0.1, 0.5, period=0.02) == pytest.approx(0.11, abs=1e-15)
    assert law.approach(0.1, -0.5, period=0.02) == pytest.approx(0.09, abs=1e-15)
    assert law.approach(0.1, 0.105, period=0.02) == 0.105
    assert law.approach(law.limit, 2.0, period=0.02) == law.limit


# --- the Unior -----------------------------------------------------------------------------------------------------


UNIOR = AxleGeometry(0.6, 0.5, 0.5, 0.42, 0.6)


def test_unior_steers_its_outer_wheel_at_half_the_input_and_keeps_the_ackermann_condition():
    law = Ackermann(UNIOR)
    left, right = law.unior_wheel_angles(0.6)
    assert right == 0.3
    assert 1.0 / math.tan(right) - 1.0 / math.tan(left) == pytest.approx(0.42 / 0.6, rel=1e-12)
    assert law.unior_wheel_angles(-0.6) == (-right, -left)
    assert law.unior_wheel_angles(0.0) == (0.0, 0.0)


def test_unior_equation_as_printed_with_positive_left_turns_the_outer_wheel_more():
    law = Ackermann(UNIOR)
    left, right = law.unior_wheel_angles(0.6, printed=True)
    assert left == 0.3
    assert right == pytest.approx(math.atan(1.0 / (1.0 / math.tan(0.3) - 0.7)), abs=1e-14)
    assert abs(right) > abs(left)
    assert law.unior_wheel_angles(-0.6, printed=True) == (-right, -left)


def test_unior_equation_as_printed_is_right_when_positive_turns_right():
    law = Ackermann(UNIOR)
    left, right = law.unior_wheel_angles(0.6, printed=True)
    mirrored_left, mirrored_right = law.unior_wheel_angles(-0.6)
    assert (left, right) == (-mirrored_left, -mirrored_right)


@pytest.mark.parametrize("steering", ANGLES)
def test_unior_input_turns_like_the_bicycle_angle(steering):
    law = Ackermann(UNIOR)
    wheels = law.unior_wheel_angles(law.unior_input(steering))
    assert law.bicycle_angle(*wheels) == pytest.approx(steering, abs=1e-14)


# --- the system ----------------------------------------------------------------------------------------------------


def steer(angle, **settings):
    builder = DiagramBuilder()
    system = builder.AddSystem(AckermannSteering(BOLT, **settings))
    source = builder.AddSystem(ConstantVectorSource([angle]))
    builder.Connect(source.get_output_port(), system.steering)
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    return system, simulator, system.GetMyMutableContextFromRoot(simulator.get_mutable_context())


def test_system_without_period_follows_at_once_and_has_no_state():
    system, _, context = steer(0.2)
    angles = [port.Eval(context).item() for port in (system.left, system.right)]
    np.testing.assert_allclose(angles, Ackermann(BOLT).wheel_angles(0.2))
    assert context.num_total_states() == 0
    names = [[signal.name for signal in signals_of(port) or ()] for port in (system.left, system.right)]
    assert names == [["left"], ["right"]]


def test_system_with_period_needs_0_4_s_for_0_2_rad():
    steering = AckermannSteering(BOLT, period=0.01)
    followed = drive(steering, inputs={"steering": 0.2}, duration=0.5, period=0.005)
    # At most 0.5 rad/s: an update at 0, 0.01 ... adds 0.005 rad, seen between it and the next.
    between = followed["steering_angle"].iloc[1::2]
    assert_follows(between, lambda t: min(0.5 * (t + 0.005), 0.2), atol=1e-12)
    assert followed["left"].iloc[0] == followed["right"].iloc[0] == 0.0
    last = followed[["left", "right"]].iloc[-1]
    np.testing.assert_allclose(last, Ackermann(BOLT).wheel_angles(0.2), atol=1e-12)


def test_system_starts_from_the_angle_in_its_context():
    steering = AckermannSteering(BOLT, period=0.01)
    held_signals = drive(
        steering,
        inputs={"steering": 0.2},
        duration=0.05,
        prepare=lambda context: steering.set_steering(context, 0.2),
    )
    assert_follows(held_signals["steering_angle"], 0.2, atol=1e-15)


def test_unior_linkage_is_limited_by_its_inner_wheel_too():
    system, _, context = steer(3.0, linkage="unior")
    left, right = (port.Eval(context).item() for port in (system.left, system.right))
    assert left == pytest.approx(0.6, abs=1e-12)
    assert 1.0 / math.tan(right) - 1.0 / math.tan(left) == pytest.approx(1.5 / 2.6, rel=1e-10)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Ackermann(AxleGeometry(0.0, 1.5, 1.5, 1.5, 0.6)),
            "steering geometry: wheelbase must be > 0 and finite [m], got 0 m",
        ),
        (
            lambda: Ackermann(AxleGeometry(2.6, 1.5, 1.5, 1.5, 35.0)),
            "steering geometry: steering_limit must be below pi/2 rad, got 35 rad; is it in degrees?",
        ),
        (
            lambda: AckermannSteering(BOLT, linkage="akermann"),  # type: ignore[arg-type]
            "AckermannSteering: unknown linkage 'akermann'; did you mean 'ackermann'? "
            "(allowed: ackermann, unior, unior_printed)",
        ),
    ],
)
def test_settings_that_are_invalid_are_rejected_in_one_line(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert str(caught.value) == message
