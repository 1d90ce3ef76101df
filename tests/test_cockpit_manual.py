"""ManualInput to commands: speeds, steering, reversing, and the watchdog, without a simulation."""

import math
from typing import Any

import pytest

from mirdrake.viewer.cockpit.manual import (
    LATERAL,
    LEAD,
    ManualCommand,
    ManualInput,
    ManualLimits,
    command_step,
    steering_at,
    stop_step,
)
from mirdrake.viewer.cockpit.watchdog import InputWatchdog

LIMITS = ManualLimits(forward=30.0, backward=4.0, acceleration=3.0, braking=6.0, steering=0.5, wheelbase=2.6)
PERIOD = 0.02


def drive(state: ManualCommand, manual: ManualInput, seconds: float, *, measured: float | None = None) -> ManualCommand:
    """Return the state after a time of constant input; the vehicle follows at once, or has the given speed."""
    for _ in range(round(seconds / PERIOD)):
        speed = state.speed if measured is None else measured
        state = command_step(state, manual, measured=speed, period=PERIOD, limits=LIMITS)
    return state


def test_a_pressed_throttle_gives_the_acceleration_times_the_time():
    assert drive(ManualCommand(), ManualInput(throttle=1.0), 2.0).speed == pytest.approx(3.0 * 2.0)
    assert drive(ManualCommand(), ManualInput(throttle=0.5), 2.0).speed == pytest.approx(0.5 * 3.0 * 2.0)


def test_commands_stay_within_the_limits():
    assert drive(ManualCommand(), ManualInput(throttle=1.0), 60.0).speed == LIMITS.forward
    assert drive(ManualCommand(), ManualInput(brake=1.0), 60.0).speed == -LIMITS.backward
    assert drive(ManualCommand(), ManualInput(speed=1e3), 60.0).speed == LIMITS.forward


def test_without_pedal_input_the_vehicle_coasts_to_standstill():
    state = drive(ManualCommand(speed=7.0), ManualInput(), 5.0)
    assert state.speed == pytest.approx(7.0 - 0.7 * 5.0)
    assert drive(state, ManualInput(), 30.0).speed == 0.0


def test_the_brake_stops_and_only_a_second_press_reverses():
    state = drive(ManualCommand(speed=6.0), ManualInput(brake=1.0), 0.5)
    assert state.speed == pytest.approx(6.0 - 6.0 * 0.5)
    state = drive(state, ManualInput(brake=1.0), 3.0)
    assert state.speed == 0.0
    state = drive(state, ManualInput(), 0.1)
    state = drive(state, ManualInput(brake=1.0), 0.5)
    assert state.speed == pytest.approx(-3.0 * 0.5)
    assert drive(state, ManualInput(throttle=1.0), 0.1).speed == pytest.approx(-1.5 + 6.0 * 0.1)  # it brakes


def test_stop_wants_zero_at_once_and_a_slider_its_speed():
    assert drive(ManualCommand(speed=20.0), ManualInput(throttle=1.0, stop=True), PERIOD).speed == 0.0
    assert drive(ManualCommand(), ManualInput(speed=5.0), 1.0).speed == pytest.approx(3.0)
    assert drive(ManualCommand(), ManualInput(speed=5.0), 9.0).speed == 5.0
    assert drive(ManualCommand(speed=9.0), ManualInput(speed=5.0), 9.0).speed == 5.0


def test_before_a_wall_the_set_point_stays_near_the_actual_speed():
    assert drive(ManualCommand(), ManualInput(throttle=1.0), 30.0, measured=0.0).speed == LEAD


def test_steering_by_key_needs_its_time_and_comes_back_twice_as_fast():
    rate = LIMITS.steering / LIMITS.turning_time
    part = drive(ManualCommand(), ManualInput(steer=1.0), 0.26)
    assert part.steering == pytest.approx(0.26 * rate)
    full = drive(part, ManualInput(steer=1.0), 2.0)
    assert full.steering == LIMITS.steering
    back = drive(full, ManualInput(), 0.1)
    assert back.steering == pytest.approx(LIMITS.steering - 2.0 * 0.1 * rate)
    assert drive(back, ManualInput(), 1.0).steering == 0.0


@pytest.mark.parametrize("speed", [8.0, 15.0, 30.0])
def test_keys_and_stick_steer_no_more_than_a_vehicle_can_follow(speed):
    angle = drive(ManualCommand(speed=speed), ManualInput(steer=-1.0, throttle=0.01), 5.0, measured=speed).steering
    assert angle == pytest.approx(-steering_at(speed, LIMITS))
    lateral = speed**2 * math.tan(-angle) / LIMITS.wheelbase  # of an ideal bicycle
    assert lateral <= LATERAL * (1.0 + 1e-9)
    assert (
        drive(ManualCommand(speed=speed), ManualInput(steering=-0.4), 5.0, measured=speed).steering == -0.4
    )  # a slider may


def test_without_a_driver_the_vehicle_brakes_to_standstill_and_holds_the_steering():
    state = ManualCommand(speed=12.0, steering=0.2)
    for _ in range(round(1.0 / PERIOD)):
        state = stop_step(state, period=PERIOD, limits=LIMITS)
    assert state.speed == pytest.approx(12.0 - 6.0)
    assert state.steering == 0.2
    for _ in range(200):
        state = stop_step(state, period=PERIOD, limits=LIMITS)
    assert state.speed == 0.0


# --- who drives ---------------------------------------------------------------------------------------------------


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def watchdog(clock: Clock) -> InputWatchdog:
    return InputWatchdog(clock=clock, timeout=1.0)


PRESSED: dict[str, Any] = {"throttle": 1.0, "active": True}
IDLE: dict[str, Any] = {"throttle": 0.0, "active": False}


def test_no_page_drives_before_the_first_message(watchdog):
    assert watchdog.read() is None
    assert not watchdog.lost


def test_a_page_without_messages_is_lost_and_regains_control_by_a_key(watchdog, clock):
    watchdog.report("a", PRESSED)
    assert watchdog.read() == ManualInput(throttle=1.0)
    clock.now = 0.9
    assert watchdog.read() == ManualInput(throttle=1.0)
    clock.now = 1.1
    assert watchdog.read() is None
    assert watchdog.lost
    watchdog.report("a", IDLE)  # back, but nobody has pressed anything
    assert watchdog.read() is None
    watchdog.report("a", PRESSED)
    assert watchdog.read() == ManualInput(throttle=1.0)
    assert not watchdog.lost


def test_a_late_message_counts_as_lost_input_even_without_a_reading(watchdog, clock):
    watchdog.report("a", PRESSED)
    clock.now = 5.0
    watchdog.report("a", IDLE)
    assert watchdog.lost


def test_a_hidden_page_is_as_silent_as_a_closed_one(watchdog, clock):
    watchdog.report("a", PRESSED)
    for _ in range(12):
        clock.now += 0.1
        watchdog.report("a", PRESSED | {"hidden": True, "active": False})
    assert watchdog.read() is None


def test_one_page_drives_and_another_takes_over_only_by_pressing_something(watchdog, clock):
    watchdog.report("a", PRESSED)
    watchdog.report("b", IDLE)
    assert watchdog.read() == ManualInput(throttle=1.0)
    watchdog.report("b", {"brake": 0.5, "active": True})
    assert watchdog.read() == ManualInput(brake=0.5)
    watchdog.report("a", IDLE | {"throttle": 1.0})
    assert watchdog.read() == ManualInput(brake=0.5)


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, "full", None, True, [1], {}])
def test_nonsense_counts_as_nothing_pressed(watchdog, nonsense):
    watchdog.report("a", {"throttle": nonsense, "steer": nonsense, "stop": "no", "active": True})
    assert watchdog.read() == ManualInput()


def test_numbers_out_of_range_are_cut(watchdog):
    watchdog.report("a", {"throttle": 9.0, "steer": -3.0, "active": True})
    assert watchdog.read() == ManualInput(throttle=1.0, steer=-1.0)
