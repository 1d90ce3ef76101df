"""Velocity command with its watchdog, scheduled drivers, and their file formats."""

import math

import numpy as np
import pytest
from pydantic import Field
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.controllers import (
    CommandLimits,
    CommandSchedule,
    CommandState,
    ConstantCommand,
    ConstantSpec,
    DeadMan,
    DriverSpec,
    DrivingLimits,
    PathGains,
    PathTrackingSpec,
    Schedule,
    ScheduleSpec,
    command_step,
)
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import Schema, parse_yaml
from mirdrake.gym.testing import assert_follows, drive


def after(time, *, speed=4.0, steering=0.1, stamp=0.0, state=None, limits=None):
    state = state or CommandState()
    _, result = command_step(state, speed, steering, stamp=stamp, time=time, limits=limits or CommandLimits())
    return result


def test_a_fresh_message_passes():
    assert after(0.05) == ((4.0, 0.1), True)


def test_a_message_is_good_for_exactly_0_2_s():
    assert after(0.2).setpoint.speed == 4.0
    assert after(1.2, stamp=1.0).setpoint.speed == 4.0  # 1.2 - 1.0 is 0.19999999999999996
    assert after(0.7, stamp=0.5).setpoint.speed == 4.0  # 0.7 - 0.5 is 0.19999999999999996
    assert after(0.3, stamp=0.1).setpoint.speed == 4.0  # 0.3 - 0.1 is 0.19999999999999998
    assert after(0.9, stamp=0.7).setpoint.speed == 4.0  # 0.9 - 0.7 is 0.20000000000000007


def test_a_message_older_than_0_2_s_commands_zero_speed_and_holds_the_steering():
    assert after(0.2 + 1e-6) == ((0.0, 0.1), False)


def test_before_the_first_message_the_command_is_zero():
    assert after(0.0, speed=3.0, stamp=-math.inf) == ((0.0, 0.0), False)
    assert after(0.0, speed=3.0, stamp=math.nan) == ((0.0, 0.0), False)


def test_driving_goes_on_when_messages_resume():
    state, result = command_step(CommandState(), 4.0, 0.1, stamp=0.0, time=1.0)
    assert not result.alive
    _, result = command_step(state, 3.0, 0.2, stamp=1.02, time=1.02)
    assert result == ((3.0, 0.2), True)


@pytest.mark.parametrize(
    "nonsense",
    [
        {"speed": math.nan, "steering": 0.0, "stamp": 0.1},
        {"speed": 1.0, "steering": math.inf, "stamp": 0.1},
        {"speed": 1.0, "steering": 0.0, "stamp": 9.0},  # from the future: it would disarm the dead-man
        {"speed": 1.0, "steering": 0.0, "stamp": -0.1},  # older than the last one
    ],
)
def test_nonsense_is_no_message_and_the_last_good_one_ages(nonsense):
    state = CommandState(4.0, 0.1, 0.0)
    _, result = command_step(state, **nonsense, time=0.15)
    assert result == ((4.0, 0.1), True)
    _, result = command_step(state, **nonsense, time=0.25)
    assert result == ((0.0, 0.1), False)


def test_speed_and_steering_are_limited():
    limits = CommandLimits(minimum_speed=0.0, maximum_speed=11.0, steering=0.5)
    assert after(0.0, speed=20.0, steering=-2.0, limits=limits).setpoint == (11.0, -0.5)
    assert after(0.0, speed=-1.0, limits=limits).setpoint.speed == 0.0


def test_limits_that_are_invalid_are_rejected():
    with pytest.raises(ConfigError, match="CommandLimits: minimum_speed must be <= 0"):
        CommandLimits(minimum_speed=1.0)
    with pytest.raises(ConfigError, match="CommandLimits: timeout must be > 0"):
        CommandLimits(timeout=0.0)


# --- systems -------------------------------------------------------------------------------------------------------


def test_a_driver_without_messages_from_0_stops_the_vehicle_after_0_2_s():
    silent = {"command": [5.0, 0.3, 0.0]}  # its stamp stays at 0
    gate = drive(DeadMan(period=0.01), inputs=silent, duration=0.3, period=0.005)
    alive = (gate.index < 0.2025).astype(float)
    assert_follows(gate["speed"], 5.0 * alive, atol=1e-12)
    assert_follows(gate["steering"], 0.3, atol=1e-12)


def test_a_scheduled_driver_stamps_its_messages_which_keeps_the_gate_open():
    builder = DiagramBuilder()
    driver = builder.AddSystem(CommandSchedule(Schedule([(0.0, 0.0, 0.0), (2.0, 4.0, 0.2)]), period=0.05))
    gate = builder.AddSystem(DeadMan(period=0.01))
    builder.Connect(driver.command, gate.command)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.005)
    context = gate.GetMyContextFromRoot(simulator.get_context())
    # At t = 1.00 the gate reads the message sent at 1.00, with 4 m/s x 1/2.
    outputs = gate.speed, gate.steering
    np.testing.assert_allclose([port.Eval(context).item() for port in outputs], [2.0, 0.1], atol=1e-12)
    simulator.AdvanceTo(5.0)
    np.testing.assert_allclose([port.Eval(context).item() for port in outputs], [4.0, 0.2], atol=1e-12)


def test_constant_command_is_there_at_time_zero():
    driver = ConstantCommand(3.0, -0.1)
    simulator = Simulator(driver)
    simulator.Initialize()
    np.testing.assert_array_equal(driver.command.Eval(simulator.get_context()), [3.0, -0.1, 0.0])
    assert [signal.unit for signal in signals_of(driver.command) or ()] == ["m/s", "rad", "s"]


def test_schedule_is_linear_between_rows_and_constant_outside():
    schedule = Schedule([(1.0, 0.0, 0.0), (3.0, 4.0, -0.2)])
    assert schedule.at(0.0) == (0.0, 0.0)
    assert schedule.at(1.5) == (1.0, -0.05)
    assert schedule.at(3.0) == (4.0, -0.2)
    assert schedule.at(9.0) == (4.0, -0.2)


def test_held_schedule_changes_at_its_rows():
    schedule = Schedule([(0.0, 1.0, 0.0), (1.0, 2.0, 0.1)], interpolation="hold")
    assert schedule.at(0.999) == (1.0, 0.0)
    assert schedule.at(1.0) == (2.0, 0.1)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "schedule: at least one row (time, speed, steering) is needed, got none"),
        ([(0.0, 1.0)], "schedule row 1: time, speed and steering are expected, got (0.0, 1.0)"),
        ([(0.0, 1.0, 0.0), (0.0, 2.0, 0.0)], "schedule row 2: time must be > 0 and finite [s], got 0 s"),
        ([(0.0, math.nan, 0.0)], "schedule row 1: speed must be finite [m/s], got nan m/s"),
    ],
)
def test_schedules_that_are_invalid_are_rejected(rows, message):
    with pytest.raises(ConfigError) as caught:
        Schedule(rows)
    assert str(caught.value) == message


# --- file formats --------------------------------------------------------------------------------------------------


class Drivers(Schema):
    control: dict[str, DriverSpec] = Field(default_factory=dict)


def load(text):
    return parse_yaml(text, Drivers, name="d.yaml").control


def test_every_kind_loads_with_units():
    control = load(
        """
control:
  ego: {kind: path_tracking, track: main, speed: 18 km/h}
  other: {kind: constant, speed: 3, steering: 10 deg}
  third: {kind: schedule, interpolation: hold, rows: [{time: 0}, {time: 500 ms, speed: 2 m/s, steering: 0.1}]}
"""
    )
    assert control["ego"].speed == pytest.approx(5.0)
    assert control["other"].steering == pytest.approx(math.radians(10.0))
    assert control["third"].make_system().schedule.at(0.6) == (2.0, 0.1)
    assert isinstance(control["other"].make_system(), ConstantCommand)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            "{kind: path_trackin}",
            "d.yaml:1: control.ego.kind: unknown kind 'path_trackin'; did you mean 'path_tracking'?",
        ),
        ("{kind: path_tracking, sped: 4}", "d.yaml:1: control.ego.sped: unknown field; did you mean 'speed'?"),
        ("{kind: path_tracking, speed: -1}", "d.yaml:1: control.ego.speed: -1 is not allowed"),
        ("{kind: constant, steering: 95 deg}", "d.yaml:1: control.ego.steering: '95 deg' is not allowed"),
        ("{kind: schedule, rows: []}", "d.yaml:1: control.ego.rows: has 0 items; at least 1"),
        (
            "{kind: schedule, rows: [{time: 1}, {time: 1}]}",
            "d.yaml:1: control.ego: rows.1.time must be later than the row before (1 s), got 1 s",
        ),
    ],
)
def test_faults_name_file_line_and_key(entry, message):
    with pytest.raises(ConfigError) as caught:
        load(f"control: {{ego: {entry}}}")
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("schema", [PathTrackingSpec, ConstantSpec, ScheduleSpec])
def test_every_field_documents_its_meaning_and_unit(schema):
    for name, field in schema.model_fields.items():
        assert "[" in (field.description or ""), name


def test_defaults_of_the_file_and_of_python_are_the_same():
    spec = PathTrackingSpec(kind="path_tracking")
    assert spec.gains() == PathGains(spec.speed)
    assert spec.limits() == DrivingLimits()
