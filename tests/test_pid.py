"""The discrete PID controller."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from mirdrake.controllers import DiscretePid, PidGains, PidLimits, PidState, WheelSpeeds, pid_step
from mirdrake.controllers.ackermann import Ackermann, AxleGeometry
from mirdrake.controllers.cruise import cruise_step, wheel_speed_setpoints
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals, signals_of
from mirdrake.gym.testing import assert_follows, drive
from mirdrake.vehicles.joint_control import WheelPid

H = 0.01


def run_law(gains, references, measurements, *, limits=None, feedforward=0.0):
    state, controls = PidState(), []
    for reference, measurement in zip(references, measurements, strict=True):
        state, control = pid_step(
            state,
            reference,
            measurement,
            gains=gains,
            period=H,
            limits=limits or PidLimits(),
            feedforward=feedforward,
        )
        controls.append(control)
    return np.array(controls), state


def close_loop(gains, *, steps, limits=None, pole=0.95, gain=0.1, reference=1.0):
    """Return first-order plant y+ = pole y + gain u under the controller; returns outputs and controls."""
    y, state, outputs, controls = 0.0, PidState(), [], []
    for _ in range(steps):
        outputs.append(y)
        state, u = pid_step(state, reference, y, gains=gains, period=H, limits=limits or PidLimits())
        controls.append(u)
        y = pole * y + gain * u
    return np.array(outputs), np.array(controls)


def test_integral_of_a_constant_error_of_2_after_3_seconds_with_ki_half_is_3():
    controls, _ = run_law(PidGains(kp=0.0, ki=0.5), [2.0] * 301, [0.0] * 301)
    assert controls[300] == pytest.approx(0.5 * 2.0 * 3.0, abs=1e-12)
    assert controls[0] == 0.0


def test_proportional_part_weighs_the_set_point_with_b_and_not_the_measurement():
    controls, _ = run_law(PidGains(kp=4.0, proportional_weight=0.25), [2.0], [0.3])
    assert controls[0] == pytest.approx(4.0 * (0.25 * 2.0 - 0.3), abs=1e-15)


def test_derivative_of_a_measured_ramp_of_3_per_second_is_minus_kd_times_3_once_the_filter_has_settled():
    time = np.arange(400) * H
    controls, _ = run_law(PidGains(kp=0.0, kd=0.7, filter_time=0.1), [0.0] * 400, 3.0 * time)
    assert controls[-1] == pytest.approx(-0.7 * 3.0, abs=1e-12)
    # Backward difference: after n steps 1 - (Tf/(Tf+h))^n of the way.
    assert controls[5] == pytest.approx(-2.1 * (1.0 - (0.1 / 0.11) ** 5), abs=1e-12)


def test_derivative_without_filter_is_the_backward_difference():
    controls, _ = run_law(PidGains(kp=0.0, kd=2.0), [0.0] * 3, [1.0, 1.5, 1.2])
    np.testing.assert_allclose(controls, [0.0, -2.0 * 0.5 / H, 2.0 * 0.3 / H], atol=1e-11)


def test_a_jump_of_the_set_point_gives_no_derivative_kick_unless_c_is_set():
    references = [0.0, 0.0, 1.0]
    quiet, _ = run_law(PidGains(kp=0.0, kd=1.0, filter_time=0.09), references, [0.0] * 3)
    loud, _ = run_law(PidGains(kp=0.0, kd=1.0, filter_time=0.09, derivative_weight=1.0), references, [0.0] * 3)
    assert quiet[2] == 0.0
    assert loud[2] == pytest.approx(1.0 / (0.09 + H), abs=1e-12)


def test_closed_loop_step_response_equals_the_transfer_function_worked_out_in_the_z_domain():
    kp, ki, kd, tf, b, c = 2.0, 3.0, 0.05, 0.04, 0.6, 0.2
    pole, gain = 0.95, 0.1
    outputs, _ = close_loop(PidGains(kp, ki, kd, tf, b, c), steps=1500, pole=pole, gain=gain)
    # I = ki h/(z-1) (r-y);  D = kd (z-1)/((tf+h) z - tf) (c r - y);  G = gain/(z - pole); common denominator of C:
    integrator, filter_ = np.array([1.0, -1.0]), np.array([tf + H, -tf])
    both = np.polymul(integrator, filter_)
    square = np.polymul(integrator, integrator)

    def numerator(p, i, d):
        return np.polyadd(np.polyadd(p * kp * both, i * ki * H * filter_), d * kd * square)

    feed, back = numerator(b, 1.0, c), numerator(1.0, 1.0, 1.0)
    closed = np.polyadd(np.polymul(both, [1.0, -pole]), gain * back)
    # y = gain feed / closed r as a recursion in z^-1. Before t = 0 the controller holds c r = c, as its filter does.
    order = len(closed) - 1
    top = np.concatenate([np.zeros(len(closed) - len(feed)), gain * feed]) / closed[0]
    bottom = closed / closed[0]
    y = np.zeros(1500 + order)
    r = np.concatenate([np.zeros(order), np.ones(1500)])
    kick = np.concatenate([np.zeros(len(closed) - len(square)), gain * c * kd * square]) / closed[0]
    for n in range(order, 1500 + order):
        # the first step sees c r as if it had always been there: take its derivative kick out
        y[n] = sum((top[k] - kick[k]) * r[n - k] for k in range(order + 1))
        y[n] -= sum(bottom[k] * y[n - k] for k in range(1, order + 1))
    np.testing.assert_allclose(outputs, y[order:], atol=1e-11)
    assert outputs[-1] == pytest.approx(1.0, abs=1e-4)


def test_saturated_start_overshoots_little_with_anti_windup_and_much_without():
    limits = PidLimits(-0.6, 0.6)  # the plant needs 0.5 for an output of 1
    with_tracking, _ = close_loop(PidGains(1.0, 8.0, tracking_time=0.1), steps=1500, limits=limits)
    without, _ = close_loop(PidGains(1.0, 8.0, tracking_time=math.inf), steps=1500, limits=limits)
    assert with_tracking.max() < 1.05
    assert without.max() > 1.15
    assert with_tracking[-1] == pytest.approx(1.0, abs=1e-3)


def test_tracking_time_zero_keeps_the_integral_at_the_limit():
    controls, state = run_law(
        PidGains(1.0, 10.0, tracking_time=0.0), [1.0] * 500, [0.0] * 500, limits=PidLimits(-2.0, 2.0)
    )
    assert controls.max() == 2.0
    # v = u at the limit leaves I = u - P = 1, plus the one step of integration.
    assert state.integral == pytest.approx(1.0 + 10.0 * H, abs=1e-12)


def test_rate_limit_of_5_per_second_takes_0_2_s_for_a_step_of_1():
    controls, _ = run_law(PidGains(1.0), [0.0] + [1.0] * 30, [0.0] * 31, limits=PidLimits(rate=5.0))
    np.testing.assert_allclose(controls[:21], np.arange(21) * 0.05, atol=1e-12)
    assert controls[21] == 1.0


def test_feedforward_counts_before_the_limits():
    controls, _ = run_law(PidGains(1.0), [1.0], [0.0], feedforward=5.0, limits=PidLimits(maximum=4.0))
    assert controls[0] == 4.0


@pytest.mark.parametrize(
    "changed",
    [
        {"kp": 9.0},
        {"ki": 7.0},
        {"kd": 0.9},
        {"filter_time": 0.5},
        {"proportional_weight": 0.1},
        {"derivative_weight": 0.8},
    ],
)
def test_a_change_of_any_gain_does_not_move_the_control(changed):
    before = {"kp": 2.0, "ki": 1.0, "kd": 0.2, "filter_time": 0.05, "proportional_weight": 0.7}
    measurements = np.linspace(0.0, 0.5, 100).tolist()  # rising, so that the derivative part counts
    _, state = run_law(PidGains(**before), [1.0] * 100, measurements)
    _, old = pid_step(state, 1.0, 0.505, gains=PidGains(**before), period=H)
    _, new = pid_step(state, 1.0, 0.505, gains=PidGains(**{**before, **changed}), period=H)
    assert abs(new - old) < 1e-12


def test_new_gains_act_from_the_next_change_of_the_error_on():
    _, state = run_law(PidGains(2.0, 1.0), [1.0] * 10, [0.0] * 10)
    state, first = pid_step(state, 1.0, 0.0, gains=PidGains(5.0, 1.0), period=H)
    _, second = pid_step(state, 1.0, 0.1, gains=PidGains(5.0, 1.0), period=H)
    assert second - first == pytest.approx(-5.0 * 0.1 + 1.0 * H, abs=1e-12)


def test_without_integral_action_a_new_kp_acts_at_once():
    _, state = run_law(PidGains(2.0), [1.0] * 10, [0.0] * 10)
    _, control = pid_step(state, 1.0, 0.0, gains=PidGains(5.0), period=H)
    assert control == 5.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PidGains(math.nan), "PidGains: kp must be finite, got nan"),
        (lambda: PidGains(1.0, filter_time=-1.0), "PidGains: filter_time must be >= 0 and finite [s], got -1 s"),
        (lambda: PidGains(1.0, filter_time=math.nan), "PidGains: filter_time must be >= 0 and finite [s], got nan s"),
        (lambda: PidGains(1.0, tracking_time=-2.0), "PidGains: tracking_time must be >= 0 [s], got -2 s"),
        (lambda: PidLimits(1.0, 0.0), "PidLimits: maximum must be >= 1, got 0"),
        (lambda: PidLimits(rate=0.0), "PidLimits: rate must be > 0, got 0"),
        (lambda: DiscretePid(PidGains(1.0), period=0.0), "DiscretePid: period must be > 0 and finite [s], got 0 s"),
        (
            lambda: DiscretePid(PidGains(1.0), period="x"),  # type: ignore[arg-type]
            "DiscretePid: period must be a number, got 'x'",
        ),
    ],
)
def test_settings_that_are_invalid_are_rejected_in_one_line(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert str(caught.value) == message


# --- the system -------------------------------------------------------------------------------------------------


def make_loop(gains, *, measurement=0.0, reference=1.0):
    builder = DiagramBuilder()
    pid = builder.AddNamedSystem("pid", DiscretePid(gains, period=H, signal_unit="m/s", control_unit="N m"))
    source = builder.AddSystem(ConstantVectorSource([reference]))
    sensor = builder.AddSystem(ConstantVectorSource([measurement]))
    builder.Connect(source.get_output_port(), pid.reference)
    builder.Connect(sensor.get_output_port(), pid.measurement)
    return pid, builder.Build()


def test_system_and_law_give_the_same_control():
    gains = PidGains(2.0, 1.5, 0.1, filter_time=0.02)
    measured = [0.0, 0.1, 0.15, 0.3, 0.2, 0.2]
    expected, _ = run_law(gains, [1.0] * 6, measured)
    held = {"reference": 1.0, "measurement": lambda t: measured[min(int(t / H + 0.01), 5)]}
    control = drive(DiscretePid(gains, period=H), inputs=held, duration=6 * H, period=0.5 * H)["control"]
    assert_follows(control.iloc[1::2], expected, atol=1e-9)  # between two updates


def test_control_is_right_at_time_zero_and_the_first_update_counts_once():
    pid, diagram = make_loop(PidGains(3.0, 10.0))
    simulator = Simulator(diagram)
    simulator.Initialize()
    context = pid.GetMyContextFromRoot(simulator.get_context())
    assert pid.control.Eval(context)[0] == 3.0
    simulator.AdvanceTo(1.0 + 0.5 * H)
    assert pid.control.Eval(context)[0] == pytest.approx(3.0 + 10.0 * 1.0, abs=1e-12)


def test_ports_carry_names_and_units():
    pid = DiscretePid(PidGains(1.0), period=H, signal_unit="rad/s", control_unit="N m", feedforward=True)
    assert [pid.get_input_port(i).get_name() for i in range(3)] == ["reference", "measurement", "feedforward"]
    assert signals_of(pid.measurement) == signals(("measurement", "rad/s"))
    assert signals_of(pid.control) == signals(("control", "N m"))
    assert signals_of(pid.feedforward) == signals(("feedforward", "N m"))


def test_gains_change_in_the_context_without_a_rebuild_and_without_a_bump():
    pid, diagram = make_loop(PidGains(3.0, 1.0))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.5 + 0.5 * H)
    context = pid.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    before = pid.control.Eval(context)[0]
    pid.set_gains(context, PidGains(8.0, 4.0))
    assert pid.get_gains(context) == PidGains(8.0, 4.0)
    simulator.AdvanceTo(0.51 + 0.5 * H)
    # One more step: the integral of step 0.50 was made with the old ki.
    assert pid.control.Eval(context)[0] == pytest.approx(before + 1.0 * H, abs=1e-12)
    simulator.AdvanceTo(0.52 + 0.5 * H)
    assert pid.control.Eval(context)[0] == pytest.approx(before + 1.0 * H + 4.0 * H, abs=1e-12)


def test_two_contexts_of_one_system_do_not_know_of_each_other():
    pid, diagram = make_loop(PidGains(1.0, 1.0))
    first, second = Simulator(diagram), Simulator(diagram, diagram.CreateDefaultContext())
    pid.set_gains(pid.GetMyMutableContextFromRoot(second.get_mutable_context()), PidGains(1.0, 2.0))
    first.AdvanceTo(1.0 + 0.5 * H)
    second.AdvanceTo(0.5 + 0.5 * H)
    first.AdvanceTo(2.0 + 0.5 * H)
    controls = [pid.control.Eval(pid.GetMyContextFromRoot(s.get_context()))[0] for s in (first, second)]
    np.testing.assert_allclose(controls, [1.0 + 2.0, 1.0 + 2.0 * 0.5], atol=1e-12)


def test_the_same_run_twice_gives_the_same_bits():
    pid, diagram = make_loop(PidGains(1.3, 0.7, 0.1, filter_time=0.03))
    results = []
    for _ in range(2):
        simulator = Simulator(diagram, diagram.CreateDefaultContext())
        simulator.AdvanceTo(1.0)
        results.append(pid.control.Eval(pid.GetMyContextFromRoot(simulator.get_context()))[0])
    assert results[0] == results[1]


def test_integral_can_be_set_for_a_warm_start():
    pid, diagram = make_loop(PidGains(1.0, 1.0), measurement=1.0)
    context = diagram.CreateDefaultContext()
    own = pid.GetMyMutableContextFromRoot(context)
    pid.set_integral(own, 5.0)
    simulator = Simulator(diagram, context)
    simulator.AdvanceTo(0.1)
    assert pid.get_integral(own) == 5.0
    assert pid.control.Eval(own)[0] == 5.0


def test_initialising_again_does_not_disturb_a_running_controller():
    pid, diagram = make_loop(PidGains(1.0, 1.0))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.305)
    own = pid.GetMyContextFromRoot(simulator.get_context())
    before = pid.control.Eval(own)[0]
    simulator.Initialize()
    assert pid.control.Eval(own)[0] == before


# --- the speed loop ------------------------------------------------------------------------------------------------


def test_free_rolling_wheels_at_6_m_per_s_with_radius_0_3_turn_at_20_rad_per_s():
    assert wheel_speed_setpoints(6.0, (1.0,) * 4, radii=(0.3, 0.3, 0.4, 0.4)) == pytest.approx((20.0, 20.0, 15.0, 15.0))


def test_speed_trim_takes_out_a_slip_of_5_percent():
    state, speed = PidState(), 0.0
    for _ in range(1500):
        state, trimmed = cruise_step(state, 5.0, speed, period=0.01)
        speed += (0.95 * trimmed - speed) * 0.01 / 0.3  # wheels slip 5 %, the car follows within 0.3 s
    assert speed == pytest.approx(5.0, abs=1e-3)
    assert trimmed == pytest.approx(5.0 / 0.95, abs=1e-2)


def test_a_set_point_of_zero_empties_the_trim():
    state, trimmed = cruise_step(PidState(integral=0.4, started=1.0), 0.0, 0.2, period=0.01)
    assert trimmed == 0.0
    assert state.integral == 0.0


def test_the_block_of_wheel_speeds_gives_those_of_ackermann_steering():
    ratios = Ackermann(AxleGeometry(2.6, 1.5, 1.5, 1.5, 0.6, 0.5)).wheel_speed_ratios(0.2)
    inputs = {"speed": 3.0, "correction": 0.25, "ratios": list(ratios)}
    wheels = drive(WheelSpeeds((0.325,) * 4), inputs=inputs, duration=0.1).iloc[-1].to_numpy()
    radius = 2.6 / math.tan(0.2)
    assert wheels[2] == pytest.approx(10.0 * (radius - 0.75) / radius, rel=1e-12)
    assert wheels[1] == pytest.approx(10.0 * math.hypot(radius + 0.75, 2.6) / radius, rel=1e-12)


def test_the_integral_part_is_limited_to_max_integral():
    # ki h e = 2 · 0.1 · 1 = 0.2 per step: 0.2, 0.4, then 0.5 at its limit; it leaves the limit with the next error
    gains, state, integrals = PidGains(kp=1.0, ki=2.0, max_integral=0.5), PidState(), []
    for error in (1.0, 1.0, 1.0, 1.0, -1.0):
        state, _ = pid_step(state, error, 0.0, gains, 0.1)
        integrals.append(state.integral)
    assert integrals == pytest.approx([0.2, 0.4, 0.5, 0.5, 0.3])


def test_max_integral_of_control_yaml_reaches_the_law():
    control = WheelPid(kind="pid", kp=1.0, ki=2.0, max_integral=0.5)
    assert control.numbers([1.0, 2.0, 0.0]).max_integral == 0.5
    assert WheelPid(kind="pid", kp=1.0).numbers([1.0, 2.0, 0.0]).max_integral == math.inf
