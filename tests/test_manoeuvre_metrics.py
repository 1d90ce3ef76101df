"""Handling metrics of signals with known results in closed form."""

import math

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.manoeuvres.base import Array, scaled
from mirdrake.manoeuvres.courses import (
    Body,
    Section,
    circle,
    clearance,
    eight,
    line_at,
    make_line,
    project_line,
    within,
)
from mirdrake.manoeuvres.drivers import make_rows
from mirdrake.manoeuvres.metrics.steady import (
    characteristic_speed,
    critical_speed,
    fit_line,
    means,
    understeer_constant_radius,
    understeer_constant_speed,
)
from mirdrake.manoeuvres.metrics.straight import (
    coast_times,
    creep,
    moves_off,
    road_load,
    standstill,
    stop_from,
    time_to_distance,
    time_to_speed,
)
from mirdrake.manoeuvres.metrics.transient import (
    FrequencyResponse,
    bandwidth,
    crossing,
    dwell_response,
    frequency_response,
    step_response,
)
from mirdrake.manoeuvres.open_loop import StepSteerSpec
from mirdrake.manoeuvres.profiles import make_profile, tabulate
from mirdrake.manoeuvres.record import Record, bicycle_angles, unwrapped
from mirdrake.manoeuvres.ride import time_in_air
from mirdrake.manoeuvres.straight import BrakingSpec

L, K = 2.6, 0.003  # wheelbase [m], understeer gradient [rad s²/m]
TIME = np.arange(0.0, 20.0, 0.01)


# --- steady ----------------------------------------------------------------------------------------------------------


def test_a_line_is_found_in_the_asked_range_only():
    x = np.linspace(0.0, 10.0, 101)
    y = np.where(x <= 4.0, 2.0 + 3.0 * x, 100.0)
    fit = fit_line(x, y, 1.0, 4.0)
    assert fit is not None
    assert (fit.slope, fit.offset) == pytest.approx((3.0, 2.0))
    assert (fit.low, fit.high, fit.count) == (1.0, 4.0, 31)
    assert fit.error < 1e-12
    assert fit_line(x, y, 20.0, 30.0) is None


def test_understeer_on_a_circle_is_the_slope_of_the_steering():
    lateral = np.linspace(0.5, 6.0, 50)
    fit = understeer_constant_radius(lateral, L / 100.0 + K * lateral, 1.0, 4.0)
    assert fit is not None
    assert fit.slope == pytest.approx(K)


def test_understeer_at_constant_speed_leaves_out_what_a_neutral_car_needs():
    lateral, speed = np.linspace(0.5, 6.0, 50), np.full(50, 27.0)
    fit = understeer_constant_speed(lateral, (L / 27.0**2 + K) * lateral, speed, L, 1.0, 4.0)
    assert fit is not None
    assert fit.slope == pytest.approx(K)


def test_characteristic_and_critical_speed():
    assert characteristic_speed(L, K) == pytest.approx(math.sqrt(L / K))
    assert critical_speed(L, -K) == pytest.approx(math.sqrt(L / K))
    assert math.isnan(characteristic_speed(L, -K))
    assert math.isnan(critical_speed(L, K))


def test_moving_means_keep_a_line_and_flatten_a_sine_over_its_period():
    assert means(TIME, 2.0 * TIME, 1.0)[500] == pytest.approx(2.0 * TIME[500])
    wave = np.sin(2.0 * math.pi * TIME)
    assert np.abs(means(TIME, wave, 1.0)[200:-200]).max() < 0.02


# --- transient -------------------------------------------------------------------------------------------------------


def test_a_first_order_answer_to_a_step():
    """90 % after ln(10) time constants, no overshoot."""
    steering = np.where(TIME > 2.0, 0.1, 0.0)
    answer = np.where(TIME > 2.0, 0.5 * (1.0 - np.exp(-(TIME - 2.0) / 0.3)), 0.0)
    response = step_response(TIME, steering, answer, last=2.0)
    assert response.start == pytest.approx(2.0, abs=0.011)
    assert response.response_time == pytest.approx(0.3 * math.log(10.0), abs=0.011)
    assert response.gain == pytest.approx(5.0)
    assert response.overshoot == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(response.peak_time)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_second_order_answer_to_a_step(sign):
    """Overshoot exp(-π ζ / √(1-ζ²)) after π / ω_d."""
    zeta, omega = 0.5, 6.0
    damped, since = omega * math.sqrt(1.0 - zeta**2), np.maximum(TIME - 2.0, 0.0)
    wave = np.cos(damped * since) + zeta * omega / damped * np.sin(damped * since)
    answer = sign * 0.4 * (1.0 - np.exp(-zeta * omega * since) * wave)
    response = step_response(TIME, np.where(TIME > 2.0, sign * 0.2, 0.0), answer, last=2.0)
    assert response.overshoot == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), rel=2e-3)
    assert response.peak_time == pytest.approx(math.pi / damped, abs=0.02)
    assert response.steady == pytest.approx(sign * 0.4, rel=1e-3)


@pytest.mark.parametrize("step", [0.01, 0.005, 0.001])
def test_peak_time_and_overshoot_do_not_depend_on_the_samples(step):
    """A parabolic peak at 2.5137 s, also with a ripple of 30 rad/s and 2 % of its height."""

    def peak(step, ripple):
        time = np.arange(0.0, 20.0, step)
        answer = np.where(time > 2.0, 1.0 + 0.2 * np.maximum(1.0 - ((time - 2.5137) / 0.4) ** 2, 0.0), 0.0)
        answer += np.where(time < 4.0, ripple * np.sin(30.0 * time), 0.0)
        response = step_response(time, np.where(time > 2.0 - 0.5 * step, 0.1, 0.0), answer, last=2.0)
        return response.start + response.peak_time, response.overshoot

    assert peak(step, 0.0) == pytest.approx((2.5137, 0.2), rel=1e-5)
    assert peak(step, 0.004) == pytest.approx(peak(1e-4, 0.004), rel=3e-4)
    assert peak(step, 0.004)[0] == pytest.approx(2.5137, abs=0.005)


@pytest.mark.parametrize("kind", ["sweep", "random"])
def test_the_frequency_response_of_a_lag_is_that_of_its_formula(kind):
    """G = 3 / (1 + i ω T): 45 degrees late at 1 / (2 π T)."""
    lag, step = 0.2, 0.002
    time = np.arange(0.0, 120.0, step)
    angle = make_profile({"kind": kind, "amplitude": 0.02, "first": 0.1, "last": 4.0, "length": 120.0})
    steering = np.array([angle(t) for t in time])
    keep = math.exp(-step / lag)
    answer = np.zeros_like(steering)
    for i in range(1, len(time)):
        answer[i] = keep * answer[i - 1] + (1.0 - keep) * 3.0 * 0.5 * (steering[i] + steering[i - 1])
    response = frequency_response(time, steering, answer, first=0.3, last=3.0, segment=15.0)
    exact = 3.0 / (1.0 + 2j * math.pi * response.frequency * lag)
    assert np.abs(response.gain / np.abs(exact) - 1.0).max() < 0.05
    assert np.abs(response.phase - np.angle(exact)).max() < 0.05
    assert response.coherence.min() > 0.98
    assert bandwidth(response, math.radians(45.0)) == pytest.approx(1.0 / (2.0 * math.pi * lag), rel=0.03)


def test_bandwidth_is_read_between_the_lines():
    f = np.array([0.5, 1.0, 2.0])
    response = FrequencyResponse(f, np.ones(3), np.radians([-20.0, -40.0, -80.0]), np.ones(3))
    assert bandwidth(response, math.radians(60.0)) == pytest.approx(1.5)
    assert math.isnan(bandwidth(response, math.radians(100.0)))
    assert response.at(1.5)[1] == pytest.approx(math.radians(-60.0))
    assert math.isnan(response.at(3.0)[0])


def test_the_largest_gain_is_the_top_of_a_parabola():
    f = np.arange(0.2, 3.0, 0.083)
    height = 5.0 - 2.0 * (f - 1.03) ** 2
    response = FrequencyResponse(f, height, np.zeros_like(f), np.ones_like(f))
    assert response.peak() == pytest.approx((1.03, 5.0))
    falling = FrequencyResponse(f, 5.0 - f, np.zeros_like(f), np.ones_like(f))
    assert falling.peak() == pytest.approx((0.2, 4.8))
    rising = FrequencyResponse(f, f, np.zeros_like(f), np.ones_like(f))
    assert rising.peak() == pytest.approx((f[-1], f[-1]))


def test_crossing_interpolates():
    assert crossing(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 0.0]), 1.0) == pytest.approx(0.5)
    assert crossing(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 0.0]), 1.0, after=1.0) == pytest.approx(1.5)
    assert math.isnan(crossing(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 3.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sine_with_dwell_from_recorded_signals(sign):
    """A yaw rate in step with the wheel that dies out with a time constant of 0.8 s after completion."""
    amplitude, frequency, dwell, start = math.radians(100.0), 0.7, 0.5, 1.0
    angle = make_profile(
        {"kind": "sine_with_dwell", "amplitude": sign * amplitude, "frequency": frequency, "dwell": dwell,
         "start": start}
    )  # fmt: skip
    time = np.arange(0.0, 6.0, 0.005)
    wheel = np.array([angle(t) for t in time])
    end = start + 1.0 / frequency + dwell
    tail = np.where(time > end, -sign * 0.1 * np.exp(-(time - end) / 0.8), 0.0)
    distance = sign * np.maximum(time - start, 0.0) * 2.0
    response = dwell_response(
        time, wheel, 0.2 * wheel + tail, distance, after_completion=(1.0, 1.75), after_beginning=1.07,
        threshold=math.radians(1.0),
    )  # fmt: skip
    begin = start + math.asin(0.01) / (2.0 * math.pi * frequency)
    assert response.begin == pytest.approx(begin, abs=1e-4)  # between the samples
    assert response.complete == pytest.approx(end, abs=0.005)  # the wheel jumps there
    assert response.peak == pytest.approx(0.2 * amplitude, rel=1e-3)
    assert response.ratios[0] == pytest.approx(0.1 * math.exp(-1.0 / 0.8) / (0.2 * amplitude), rel=0.02)
    assert response.displacement == pytest.approx(2.0 * (begin + 1.07 - start), abs=0.02)
    assert response.hand_wheel == pytest.approx(amplitude, rel=1e-3)


def test_a_wheel_that_never_turns_has_no_beginning_of_steer():
    nothing = np.zeros_like(TIME)
    response = dwell_response(
        TIME, nothing, nothing, nothing, after_completion=(1.0, 1.75), after_beginning=1.07, threshold=0.1
    )
    assert math.isnan(response.begin)
    assert all(math.isnan(ratio) for ratio in response.ratios)


# --- straight --------------------------------------------------------------------------------------------------------


def test_times_of_a_steady_acceleration():
    speed, distance = 3.0 * TIME, 1.5 * TIME**2
    assert time_to_speed(TIME, speed, 30.0, start=0.0) == pytest.approx(10.0)
    assert time_to_distance(TIME, distance, 37.5, start=0.0) == pytest.approx(5.0, abs=1e-3)
    assert time_to_distance(TIME, distance, 36.0, start=1.0) == pytest.approx(4.0, abs=1e-3)
    assert math.isnan(time_to_speed(TIME, speed, 1000.0, start=0.0))


def test_a_car_that_rocks_on_its_brakes_has_not_driven_off():
    rocking = np.where(TIME < 1.0, 0.08 * np.sin(30.0 * TIME), 0.0)
    speed = rocking + np.maximum(3.0 * (TIME - 1.2), 0.0)
    assert moves_off(TIME, speed, 0.05) == pytest.approx(1.2 + 0.05 / 3.0)
    assert moves_off(TIME, speed + 2.0, 0.05) == 0.0
    assert math.isnan(moves_off(TIME, rocking, 0.05))


def test_braking_at_eight_metres_a_second_squared():
    """(100 km/h)² / (2 · 8) = 48.2 m; both means are 8."""
    first = 100.0 / 3.6
    speed = np.maximum(30.0 - 8.0 * TIME, 0.0)
    distance = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)))
    stop = stop_from(TIME, speed, distance, first)
    assert stop.distance == pytest.approx(first**2 / 16.0, rel=1e-3)
    assert stop.time == pytest.approx(first / 8.0, rel=2e-3)
    assert stop.mean == pytest.approx(8.0, rel=1e-3)
    assert stop.developed == pytest.approx(8.0, rel=1e-3)
    assert math.isnan(stop_from(TIME, speed + 5.0, distance, first).distance)


@pytest.mark.parametrize("seed", range(5))
def test_motion_after_the_first_standstill_does_not_count_as_braking(seed):
    """Tyres and springs push a car back: its speed oscillates about zero after the stop."""
    random, time = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.001)
    slope, first = random.uniform(3.0, 11.0), random.uniform(5.0, 20.0)
    end = (first + 1.0) / slope
    swing = -random.uniform(0.1, 0.8) * np.sin(random.uniform(8.0, 30.0) * (time - end))
    speed = np.where(end > time, first + 1.0 - slope * time, swing)
    distance = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))
    assert standstill(time, speed, after=0.5 / slope) == pytest.approx(end, abs=2e-3)
    stop = stop_from(time, speed, distance, first)
    assert stop.time == pytest.approx(first / slope, rel=2e-3)
    assert stop.distance == pytest.approx(first**2 / (2.0 * slope), rel=2e-3)
    slow = np.maximum(first * np.exp(-time), 1e-6)  # only approaches zero
    assert standstill(time, slow, after=0.0) == pytest.approx(np.log(first / 0.02), rel=1e-3)


def test_a_record_that_is_cut_ends_at_that_time():
    n = 200
    time: Array = 0.005 * np.arange(n, dtype=np.float64)
    zero = np.zeros(n)
    speed: Array = 4.0 - 8.0 * time
    others = {"wheel": 3.0 * speed}
    record = Record("cut", time, zero, zero, zero, speed, zero, zero, zero, zero, 1.0, 15.0, others)
    cut = record.until(0.4983)
    assert cut.time[-1] == 0.4983
    assert cut.vx[-1] == pytest.approx(4.0 - 8.0 * 0.4983)
    assert cut.others["wheel"] == pytest.approx(3.0 * cut.vx)
    assert len(cut.time) == len(cut.roll) == 101
    assert cut.longitudinal_acceleration == pytest.approx(np.full(101, -8.0))


def test_road_load_of_a_coast_down():
    a, b, c, mass = 135.7, 0.151, 0.4788, 1757.7  # EPA, Chevrolet Bolt 2022
    time = np.arange(0.0, 250.0, 0.01)
    speed = np.empty_like(time)
    v = 118.0 / 3.6
    for i in range(len(time)):
        speed[i] = v
        half = v - 0.005 * (a + b * v + c * v * v) / mass
        v -= 0.01 * (a + b * half + c * half * half) / mass
    chosen = speed > 15.0 / 3.6
    measured = road_load(time[chosen], speed[chosen], mass)
    assert (measured.a, measured.c) == pytest.approx((a, c), rel=0.01)
    assert measured.at(100.0 / 3.6) == pytest.approx(a + b * 27.778 + c * 27.778**2, rel=1e-3)
    steps = [(115.0 / 3.6, 15.0 / 3.6), (100.0 / 3.6, 80.0 / 3.6), (60.0 / 3.6, 40.0 / 3.6)]
    assert coast_times(time, speed, steps) == pytest.approx([182.4, 22.4, 42.6], abs=0.1)  # computed by hand elsewhere


def test_creep_does_not_count_the_settling():
    x = np.where(TIME < 3.0, 1.0 - TIME / 3.0, 0.0) + 3e-4 * TIME
    speed, distance = creep(TIME, x, 4e-4 * TIME, settle=3.5)
    assert speed == pytest.approx(5e-4)
    assert distance == pytest.approx(5e-4 * (TIME[-1] - 3.5), rel=1e-2)


# --- records, profiles, courses -----------------------------------------------------------------------------------


def test_a_record_of_a_steady_turn_has_the_acceleration_of_its_centre_of_mass():
    v, r, ahead = 20.0, 0.2, 1.4
    n = len(TIME)
    record = Record(
        "turn", TIME, np.zeros(n), np.zeros(n), r * TIME, np.full(n, v), np.full(n, -0.5), np.full(n, r), np.zeros(n),
        np.full(n, 0.03), ahead, 16.0,
    )  # fmt: skip
    assert record.lateral_acceleration == pytest.approx(np.full(n, v * r))
    assert record.longitudinal_acceleration == pytest.approx(np.full(n, -(-0.5 + ahead * r) * r))
    assert record.sideslip[0] == pytest.approx(math.atan2(-0.5 + ahead * r, v))
    assert record.hand_wheel[0] == pytest.approx(0.48)
    assert record.distance[-1] == pytest.approx(v * TIME[-1])


def accelerations(time, vx):
    """Return the longitudinal accelerations of a straight drive."""
    zero = np.zeros(len(time))
    return Record("run", time, zero, zero, zero, vx, zero, zero, zero, zero, 1.0, 16.0).longitudinal_acceleration


@pytest.mark.parametrize("step", [0.00125, 0.0025, 0.005, 0.01])
def test_accelerations_are_slopes_of_parabolas_whatever_the_step(step):
    """Of a sine, in the window 2 T: 3 (sin x - x cos x) / x³ of its slope with x = ω T; exact for a parabola."""
    time = np.linspace(0.0, 2.0, round(2.0 / step) + 1)
    for frequency in (2.0, 8.0, 15.0):
        rate = 2.0 * math.pi * frequency
        x = 0.05 * rate
        gain = 3.0 * (math.sin(x) - x * math.cos(x)) / x**3
        inside = (time > 0.0501) & (time < 1.9499)
        errors = accelerations(time, np.sin(rate * time))[inside] - gain * rate * np.cos(rate * time[inside])
        assert np.abs(errors).max() < 5e-3 * rate
    assert accelerations(time, 1.0 + 3.0 * time - time**2) == pytest.approx(3.0 - 2.0 * time, abs=1e-9)


def test_angles_are_unwrapped_as_by_numpy():
    turned = np.linspace(0.0, 20.0, 300)
    wrapped = np.remainder(turned + math.pi, 2.0 * math.pi) - math.pi
    assert unwrapped(wrapped) == pytest.approx(turned)
    assert unwrapped(turned) is turned


def test_the_cotangent_of_the_bicycle_angle_is_the_mean_of_both_wheels():
    delta = np.array([-0.3, -1e-9, 0.0, 0.2])
    t = np.tan(delta)
    left, right = np.arctan(t / (1.0 - 0.3 * t)), np.arctan(t / (1.0 + 0.3 * t))
    assert bicycle_angles(left, right) == pytest.approx(delta, abs=1e-9)


def test_a_dwelling_sine_stays_at_its_second_peak():
    angle = make_profile({"kind": "sine_with_dwell", "amplitude": 2.0, "frequency": 0.5, "dwell": 1.0, "start": 1.0})
    expected = [0.0, 2.0, 0.0, -2.0, -2.0, -2.0, 0.0]
    assert [angle(t) for t in (0.5, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)] == pytest.approx(expected, abs=1e-9)


def test_profiles_of_ramp_and_step():
    ramp = make_profile({"kind": "ramp", "rate": -0.1, "limit": 0.3, "start": 1.0})
    assert [ramp(t) for t in (0.5, 2.0, 9.0)] == pytest.approx([0.0, -0.1, -0.3])
    step = make_profile({"kind": "step", "amplitude": 0.4, "start": 1.0, "rise": 0.2})
    assert [step(t) for t in (1.0, 1.1, 3.0)] == pytest.approx([0.0, 0.2, 0.4])
    with pytest.raises(ConfigError, match="did you mean 'ramp'"):
        make_profile({"kind": "ramps"})
    with pytest.raises(ConfigError, match="amplitude"):
        make_profile({"kind": "step"})


@pytest.mark.parametrize(
    "data",
    [
        {"kind": "step", "amplitude": -0.0312, "start": 1.0, "rise": 0.15},
        {"kind": "step", "amplitude": 0.1},
        {"kind": "ramp", "rate": -0.1, "limit": 0.3, "start": 0.7},
        {"kind": "sine_with_dwell", "amplitude": 0.03, "frequency": 0.7, "dwell": 0.5, "start": 0.3},
    ],
)
def test_a_table_of_a_profile_has_its_bits(data):
    times = np.arange(700) * 0.01
    assert tabulate(data, times).tolist() == [make_profile(data)(time) for time in times.tolist()]


def test_random_steering_has_the_asked_effective_value_and_the_same_seed_the_same_signal():
    data = {"kind": "random", "amplitude": 0.1, "first": 0.2, "last": 2.0, "length": 500.0}
    time = np.arange(0.0, 500.0, 0.05)
    angle = np.array([make_profile(data)(t) for t in time[:1]] + [0.0])
    wave = make_profile(data)
    values = np.array([wave(t) for t in time])
    assert np.sqrt(np.mean(values**2)) == pytest.approx(0.1 / math.sqrt(2.0), rel=0.05)
    assert values[0] == angle[0]
    assert make_profile(data | {"seed": 1})(1.0) != wave(1.0)


def test_random_steering_does_not_jump():
    """Its sines have phases by chance: begun at once, they would jump by 13 mrad in a sample, with 13 rad/s."""
    wave = make_profile({"kind": "random", "amplitude": 0.015, "first": 0.1, "last": 3.0, "length": 20.0, "start": 1.0})
    values = np.array([wave(t) for t in np.arange(0.0, 22.0, 1e-3)])
    assert values[0] == values[-1] == 0.0
    assert np.abs(np.diff(values)).max() / 1e-3 < 0.4  # the Bolt's steering runs with 0.5 rad/s


def test_a_circle_closes_and_an_eight_turns_right_first():
    line = circle(radius=10.0, turn=1.0, laps=1.0)
    assert (line.x[-1], line.y[-1]) == pytest.approx((0.0, 0.0), abs=0.3)
    assert line.y.max() == pytest.approx(20.0, abs=0.01)
    index, s, offset = project_line(line.table, 0.0, 20.5, -1)
    assert offset == pytest.approx(-0.5, abs=0.01)
    assert line_at(line.table, s)[1] == pytest.approx(0.1)
    assert index > 0
    figure = eight(radius=9.125, laps=1)
    assert (figure.y.min(), figure.y.max()) == pytest.approx((-18.25, 18.25), abs=0.01)
    assert figure.y[len(figure.y) // 4] < -1.0


def test_a_planned_line_keeps_the_body_off_the_cones():
    sections = [Section(0.0, 15.0, -1.1, 1.1), Section(45.0, 70.0, 3.5, 5.9), Section(95.0, 125.0, -1.1, 1.45)]
    body = Body(-0.8, 3.4, 0.88)
    line = within(
        sections=[list(s) for s in sections], rear=-0.8, front=3.4, half_width=0.88, margin=0.1, start=-30.0, end=150.0
    )
    room = clearance(line.x, line.y, line.yaw, body, sections)
    assert room.min() > 0.05
    assert np.abs(line.curvature).max() * (80.0 / 3.6) ** 2 < 7.0  # a car can
    with pytest.raises(ConfigError, match="no path through"):
        make_line(
            {"kind": "within", "sections": [[0.0, 10.0, 0.0, 1.0]], "rear": -1.0, "front": 3.0, "half_width": 0.8,
             "margin": 0.1, "start": -20.0, "end": 30.0}
        )  # fmt: skip


def test_clearance_is_that_of_the_worst_corner():
    """A body turned by 0.1 rad in the middle of a lane of 3 m: half_width cos + front sin."""
    room = clearance(
        np.array([5.0]), np.array([0.0]), np.array([0.1]), Body(-1.0, 3.0, 0.9), [Section(0.0, 20.0, -1.5, 1.5)]
    )
    assert room[0] == pytest.approx(1.5 - (0.9 * math.cos(0.1) + 3.0 * math.sin(0.1)))
    assert math.isinf(clearance(np.zeros(1), np.zeros(1), np.zeros(1), Body(-1, 3, 1), [Section(50, 60, 0, 1)])[0])


def test_clearance_of_a_short_section_does_not_depend_on_where_the_samples_lie():
    """A body that slides along y = x / 4 + 2 over a cone's 0.3 m, sampled every 0.4 m: the front right corner."""
    section, body, yaw = Section(-0.15, 0.15, 0.0, math.inf), Body(-1.0, 3.0, 0.9), 0.1
    rooms = []
    for phase in np.linspace(0.0, 0.4, 9):
        x = np.arange(-8.0, 8.0, 0.4) + phase
        rooms.append(clearance(x, 0.25 * x + 2.0, np.full_like(x, yaw), body, [section])[0])
    # The front right corner reaches the section first and lowest: it is at x = -0.15 when the axle is at `axle`.
    axle = -0.15 - 3.0 * math.cos(yaw) - 0.9 * math.sin(yaw)
    lowest = 0.25 * axle + 2.0 + 3.0 * math.sin(yaw) - 0.9 * math.cos(yaw)
    assert rooms == pytest.approx([lowest] * len(rooms), abs=0.005)


def test_rows_run_along_straight_lines():
    rows = make_rows([(0.0, 1.0), (2.0, 3.0), (2.0, 0.0)], 1, "test")
    assert [rows.at(t)[0] for t in (-1.0, 1.0, 2.0, 5.0)] == pytest.approx([1.0, 2.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match="the times must not decrease"):
        make_rows([(1.0, 1.0), (0.0, 1.0)], 1, "test")
    with pytest.raises(ConfigError, match="a time and 3 numbers"):
        make_rows([(1.0, 1.0)], 3, "test")


def test_a_small_vehicle_has_the_same_froude_number_by_default():
    car, small = StepSteerSpec(), scaled(StepSteerSpec(), 0.25)
    assert isinstance(small, StepSteerSpec)
    assert small.speed == pytest.approx(0.5 * car.speed)
    assert small.rise == pytest.approx(0.5 * car.rise)
    assert small.lateral == car.lateral
    given = scaled(StepSteerSpec(speed=7.0), 0.25)
    assert isinstance(given, StepSteerSpec)
    assert given.speed == 7.0
    braking = scaled(BrakingSpec(), 0.25)
    assert isinstance(braking, BrakingSpec)
    assert braking.others == pytest.approx(tuple(0.5 * item for item in BrakingSpec().others))


@pytest.mark.parametrize("step", [0.01, 0.005, 0.001])
def test_the_time_of_a_wheel_in_the_air_does_not_depend_on_the_samples(step):
    """A load of 1000 - 3000 sin(2 π t) N is below zero for (1 - 2 asin(1 / 3) / π) / 2 s of each second."""
    time = np.arange(0.0, 3.0, step)
    air = time_in_air(np.maximum(1000.0 - 3000.0 * np.sin(2.0 * math.pi * time), 0.0)) * step
    assert air == pytest.approx(3.0 * (0.5 - math.asin(1.0 / 3.0) / math.pi), rel=1e-3)
