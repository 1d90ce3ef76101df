"""Test helpers for user systems, on systems with a known response."""

import re
from math import cos, exp, sin
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    Gain,
    Integrator,
    Saturation,
    ZeroOrderHold,
)

from mirdrake.controllers import DiscretePid, PidGains
from mirdrake.core.errors import ConfigError, DiagramError
from mirdrake.core.signals import declare_vector_input, declare_vector_output, signals
from mirdrake.gym.testing import assert_follows, drive, evaluate
from mirdrake.vehicles import load_vehicle

CIRCLE = signals(("radius", "m"), ("speed", "m/s"))
CAR = {"world": "empty", "vehicles": {"ego": {"model": "bolt", "speed": 3}}, "plant": {"contact": "point"}}


class Turn(LeafSystem):
    """Yaw rate and lateral acceleration on a circle, and its name as an object."""

    def __init__(self) -> None:
        super().__init__()
        self.set_name("turn")
        self.circle = declare_vector_input(self, "circle", CIRCLE)
        outputs = signals(("yaw_rate", "rad/s"), ("acceleration", "m/s^2"))
        declare_vector_output(self, "motion", outputs, self._calc)
        self.DeclareAbstractOutputPort("words", lambda: AbstractValue.Make(""), self._calc_words)
        self.optional = self.DeclareVectorInputPort("grade", 1)
        self.optional_inputs = ("grade",)

    def _calc(self, context: Context, output: BasicVector) -> None:
        radius, speed = self.circle.Eval(context)
        extra = self.optional.Eval(context)[0] if self.optional.HasValue(context) else 0.0
        output.SetFromVector([speed / radius, speed**2 / radius + extra])

    def _calc_words(self, context: Context, output: AbstractValue) -> None:
        output.set_value(f"at {context.get_time():g} s")


# --- systems -------------------------------------------------------------------------------------------------------


def test_the_step_response_of_a_lag_is_its_closed_form():
    response = drive(FirstOrderLowPassFilter(0.5), inputs={"u": 1.0}, duration=3.0)
    assert_follows(response["y"], lambda t: 1.0 - exp(-t / 0.5), atol=1e-7)
    assert response.index[-1] == pytest.approx(3.0)
    assert len(response) == 101


def test_the_integral_of_a_cosine_is_a_sine_from_the_state_that_was_prepared():
    response = drive(
        Integrator(1),
        inputs={"u": lambda t: 2.0 * cos(3.0 * t)},
        duration=2.0,
        prepare=lambda context: context.SetContinuousState([0.25]),
    )
    assert_follows(response["y"], lambda t: 0.25 + 2.0 / 3.0 * sin(3.0 * t), atol=1e-7)


def test_a_system_can_be_driven_again_with_other_values():
    lag = FirstOrderLowPassFilter(0.5)
    first = drive(lag, inputs={"u": 1.0})
    doubled = drive(lag, inputs={"u": lambda t: 2.0})
    assert_follows(doubled["y"], 2.0 * first["y"], atol=1e-7)
    pd.testing.assert_frame_equal(drive(lag, inputs={"u": 1.0}), first, check_exact=True)


def test_a_sampled_system_shows_in_each_row_what_was_there_before_its_update():
    response = drive(DiscreteTimeDelay(0.1, 2, 1), inputs={"u": lambda t: 10.0 * t}, duration=0.5, period=0.1)
    assert response["y"].tolist() == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0, 2.0])


def test_the_first_row_is_the_start_before_any_update():
    response = drive(ZeroOrderHold(0.1, 1), inputs={"u": lambda t: 3.0 + t}, duration=0.3, period=0.1)
    assert response["y"].tolist() == pytest.approx([0.0, 3.0, 3.1, 3.2])
    assert evaluate(ZeroOrderHold(0.1, 1), {"u": 3.0}) == {"y": 0.0}


def test_a_pid_of_ours_integrates_a_constant_error():
    pid = DiscretePid(PidGains(kp=0.0, ki=0.5), period=0.01)
    response = drive(pid, inputs={"reference": 2.0, "measurement": 0.0}, duration=3.0, outputs=["control"], period=0.1)
    assert_follows(response["control"], lambda t: 0.5 * 2.0 * max(t - 0.01, 0.0), atol=1e-9)


def test_tables_are_linear_in_between_and_constant_outside():
    ramp = pd.Series([0.0, 2.0], index=[0.5, 1.5])
    response = drive(Gain(3.0, 1), inputs={"u": ramp}, duration=2.0)
    assert_follows(response["y"], lambda t: 3.0 * min(max(2.0 * (t - 0.5), 0.0), 2.0), atol=1e-12)
    both = drive(Adder(2, 1), inputs={"u0": ([0.0, 1.0], [1.0, 2.0]), "u1": 1.0}, duration=1.0)
    assert_follows(both["sum"], lambda t: 2.0 + t, atol=1e-12)


def test_the_last_sample_is_the_end_also_when_the_period_does_not_divide_it():
    assert drive(Gain(1.0, 1), inputs={"u": 1.0}, duration=1.0, period=0.3).index.tolist() == pytest.approx(
        [0.0, 0.3, 0.6, 0.9]
    )
    assert drive(Gain(1.0, 1), inputs={"u": 1.0}, duration=0.3, period=0.1).index[-1] == pytest.approx(0.3)


def test_ports_and_their_elements_are_named_with_units():
    response = drive(Turn(), inputs={"circle.speed": lambda t: 5.0 + t, "circle.radius": 10.0}, duration=1.0)
    assert list(response) == ["motion.yaw_rate", "motion.acceleration"]
    assert response.attrs["units"] == {"motion.yaw_rate": "rad/s", "motion.acceleration": "m/s^2"}
    assert_follows(response["motion.acceleration"], lambda t: (5.0 + t) ** 2 / 10.0, atol=1e-12)
    only = drive(Turn(), inputs={"circle": [10.0, 5.0]}, outputs=["motion.yaw_rate", "words"], duration=1.0, period=0.5)
    assert only["words"].tolist() == ["at 0 s", "at 0.5 s", "at 1 s"]
    assert only["motion.yaw_rate"].tolist() == [0.5] * 3


def test_one_moment_is_enough_for_a_law_without_memory():
    assert evaluate(Saturation([-1.0], [1.0]), {"u": 3.0}) == {"y": 1.0}
    assert evaluate(Turn(), {"circle": [10.0, 5.0], "grade": 1.0}, outputs=["motion"]) == {
        "motion.yaw_rate": 0.5,
        "motion.acceleration": 3.5,
    }
    assert evaluate(ConstantVectorSource([4.0, 5.0])) == {"y.0": 4.0, "y.1": 5.0}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: drive(Turn(), inputs={"circel": 1.0}), "turn has no input 'circel'; did you mean 'circle'?"),
        (lambda: drive(Turn()), "turn: nothing drives its input 'circle'; give inputs={'circle': ...}"),
        (
            lambda: drive(Turn(), inputs={"circle.speed": 1.0}),
            "nothing drives 'circle.radius'; give them, or the whole",
        ),
        (lambda: drive(Turn(), inputs={"circle.sped": 1.0}), "input 'circle' has no element 'sped'; did you mean 'spe"),
        (lambda: drive(Turn(), inputs={"circle": 1.0}), "input 'circle' has 2 numbers, not a number"),
        (
            lambda: drive(Turn(), inputs={"circle": [1.0, 2.0], "circle.speed": 1.0}),
            "input 'circle' is given as a whole and by element",
        ),
        (
            lambda: drive(Turn(), inputs={"circle": [1.0, 2.0]}, outputs=["motion.yaw"]),
            "turn has no output 'motion.yaw'; did you mean 'motion.yaw_rate'?",
        ),
        (lambda: drive(Gain(1.0, 1), inputs={"u": ([0.0, 0.0], [1.0, 2.0])}), "a table needs increasing times"),
        (lambda: drive(CAR, inputs={"ego.speed": 1.0}), "no open input 'ego.speed'; did you mean"),
        (
            lambda: drive(CAR | {"control": {"ego": {"kind": "constant"}}}, inputs={"ego.speed_reference": 1.0}),
            "'ego.speed_reference' is driven by control.ego of the file",
        ),
    ],
)
def test_errors_of_names_and_sizes_state_what_is_allowed(call, message):
    with pytest.raises(DiagramError, match=re.escape(message)):
        call()


def test_a_system_inside_another_diagram_is_rejected():
    builder, gain = DiagramBuilder(), Gain(1.0, 1)
    builder.AddSystem(gain)
    diagram = builder.Build()
    with pytest.raises(DiagramError, match="is part of another diagram"):
        drive(gain, inputs={"u": 1.0})
    del diagram


@pytest.mark.parametrize("times", [{"duration": -1.0}, {"duration": float("nan")}, {"period": 0.0}])
def test_impossible_times_are_rejected(times: dict[str, Any]):
    with pytest.raises(ConfigError, match="is not allowed"):
        drive(Gain(1.0, 1), inputs={"u": 1.0}, **times)


# --- comparing -----------------------------------------------------------------------------------------------------

RAMP = pd.Series([0.0, 1.0, 2.0, 3.5], index=[0.0, 1.0, 2.0, 3.0], name="x")


def test_a_deviation_is_reported_with_time_and_size():
    message = "x is 3.5 at t = 3 s, expected 3: the difference is 0.5, allowed 0.1; 1 of 4 samples are outside"
    with pytest.raises(AssertionError, match=re.escape(message)):
        assert_follows(RAMP, lambda t: t, atol=0.1)
    assert_follows(RAMP, lambda t: t, atol=0.5)
    assert_follows(RAMP, lambda t: t, atol=0.0, rtol=0.17)


def test_a_sample_that_is_not_finite_never_follows():
    for wrong in (RAMP.where(RAMP < 3.0), RAMP * np.inf):
        with pytest.raises(AssertionError, match="expected"):
            assert_follows(wrong, lambda t: t, atol=1e9)


def test_early_samples_may_be_ignored_but_not_all():
    assert_follows(RAMP, [9.0, 1.0, 2.0, 3.5], atol=1e-12, after=1.0)
    with pytest.raises(AssertionError):
        assert_follows(RAMP, [9.0, 1.0, 2.0, 3.5], atol=1e-12)
    with pytest.raises(ConfigError, match="no samples after 4 s"):
        assert_follows(RAMP, 0.0, atol=1.0, after=4.0)


def test_infinite_tolerances_and_other_lengths_are_rejected():
    for tolerance in (float("inf"), float("nan"), -1.0):
        with pytest.raises(ConfigError, match="tolerances"):
            assert_follows(RAMP, 0.0, atol=tolerance)
    with pytest.raises(ConfigError, match="expected has 3 numbers for 4 samples"):
        assert_follows(RAMP, [0.0, 1.0, 2.0], atol=0.1)


# --- a diagram with a vehicle --------------------------------------------------------------------------------------


def test_a_whole_vehicle_is_driven_by_functions_of_time():
    names = ["ego.vx", "ego.wz", "ego.speed_setpoint"]
    response = drive(
        CAR,
        inputs={"ego.speed_reference": lambda t: 3.0 + t, "ego.steering_reference": lambda t: 0.1 if t > 1.0 else 0.0},
        duration=3.0,
        outputs=names,
        period=0.05,
    )
    assert response.attrs["units"] == dict(zip(names, ("m/s", "rad/s", "m/s"), strict=True))
    assert_follows(response["ego.speed_setpoint"], lambda t: 3.0 + t, atol=0.0201, after=0.05)
    assert_follows(response["ego.vx"], lambda t: 3.0 + t, atol=0.08)
    # v tan(delta) / L of a wheelbase of 2.6 m, the angle reached at the rate of the steering joints
    follows = response["ego.vx"] * np.tan(0.1) / 2.6
    assert_follows(response["ego.wz"], follows, atol=0.004, after=1.5)
    assert response["ego.wz"][:1.0].abs().max() < 1e-3


def test_the_dead_man_of_a_vehicle_can_be_tested_by_a_stamp_that_stops():
    response = drive(
        CAR,
        inputs={
            "ego.speed_reference": 3.0,
            "ego.steering_reference": 0.0,
            "ego.reference_stamp": lambda t: min(t, 0.5),
        },
        duration=1.0,
        outputs=["ego.speed_setpoint"],
        period=0.02,
    )
    assert_follows(response["ego.speed_setpoint"][:0.69], 3.0, atol=1e-4)
    slope = load_vehicle("bolt").control.speed.max_deceleration  # from 0.2 s after the last message on
    assert_follows(response["ego.speed_setpoint"], lambda t: 3.0 - slope * (t - 0.7), atol=0.0401 * slope, after=0.7)


def test_a_file_with_a_driver_is_driven_unchanged_and_repeatably():
    first = drive("bolt_skidpad", duration=0.5, outputs=["ego.vx", "ego.wz"], period=0.1)
    again = drive("bolt_skidpad", duration=0.5, outputs=["ego.vx", "ego.wz"], period=0.1)
    pd.testing.assert_frame_equal(first, again, check_exact=True)
    assert first["ego.vx"].iloc[-1] > 0.3
    with pytest.raises(DiagramError, match=r"has no signal 'ego\.vxx'; did you mean 'ego\.vx'"):
        drive("bolt_skidpad", duration=0.1, outputs=["ego.vxx"])
