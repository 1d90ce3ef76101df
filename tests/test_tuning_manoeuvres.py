"""Gains that are better in the mean of a test are not accepted if a manoeuvre gets worse."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.tuning.designs import Design
from mirdrake.tuning.identify import identify_loop
from mirdrake.tuning.loops.base import NOMINAL, Course, Evaluation, LoopModel, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.manoeuvres import (
    HOLD,
    MOST_OVER_PRESENT,
    OVER_PRESENT,
    Manoeuvre,
    largest_ratio,
    make_manoeuvres,
    manoeuvre_costs,
    plant_costs,
    slopes_of,
)
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.loops.speed import SETTLING, SLOWEST_SPEED
from mirdrake.tuning.models import TransferFunction
from mirdrake.tuning.scenarios import InManoeuvres
from mirdrake.tuning.spec import make_tuning
from mirdrake.tuning.stages import Stages

INERTIA, DRAG, SLOPE, TOP = 2.0, 1.5, 0.6, 5.4
GAINS = {"kp": 20.0, "ki": 10.0, "kd": 3.0}


@pytest.fixture(scope="module")
def loop() -> LoopSpec:
    """An inertia without dead time, with the feed-forward of its slope."""
    spec = make_loop_spec(make_tuning({"vehicle": "bolt", "loop": "speed"}))
    model = LoopModel(
        {"main": TransferFunction((1.0 / INERTIA,), (1.0, 0.0), 0.0)},
        start=TOP - 1.0, rise=SLOPE, fall=SLOPE, feedforward=INERTIA, drag=DRAG,
    )  # fmt: skip
    course = Course(step=1.0, step_time=0.5, load=-2.0, load_time=20.0, duration=40.0, speed=TOP - 1.0)
    return replace(spec, model=model, period=1e-3, filter_time=0.01, delay=0.0, course=course)


def costs_of(spec: LoopSpec, gains: dict[str, float], *, at_samples: bool = False) -> dict[str, float]:
    names = [f"{name} {part}" for part in range(3) for name in ("launch", "stop")]
    # Of each manoeuvre: both parts against the held set-point, then both at the samples.
    costs = np.reshape(manoeuvre_costs(made(spec, spec, [0.0]), gains), (-1, 2, 2))[:, int(at_samples)]
    return dict(zip(["step", "load", *names], costs.ravel(), strict=True))


def made(spec: LoopSpec, own: LoopSpec, delays: list[float]) -> tuple[Manoeuvre, ...]:
    return make_manoeuvres(spec, own, delays, LOOP_KINDS["speed"].at_slopes)


@pytest.mark.parametrize("kd", [0.0, 3.0])
@pytest.mark.parametrize(("at_samples", "periods"), [(False, 0.5), (True, 1.0)])
def test_the_derivative_brakes_on_a_slope_by_its_gain_times_the_slope(
    loop: LoopSpec, kd: float, periods: float, *, at_samples: bool
) -> None:
    """Error of (J + kd) s² + kp s + ki, overdamped, to a step D of the torque: D (exp(-p t) - exp(-q t)) / (J (q - p)).

    The steps are those that the feed-forward lacks: the drag F and kd a at the launch, less kd a at the end of a slope.
    Therefore a launch costs about (F + 2 kd a) / ki, and a stop 2 kd a / ki.
    """
    inertia, slope_time = INERTIA + kd, (1.0 - SLOWEST_SPEED) * TOP / SLOPE
    q, p = -np.roots([inertia, GAINS["kp"], GAINS["ki"]])
    stop = slope_time + SETTLING + HOLD
    braking = kd * SLOPE
    steps = {0.0: DRAG + braking, slope_time: -braking, stop: -braking, stop + slope_time: braking}
    t = np.arange(0.0, stop + slope_time + SETTLING + HOLD, 1e-3)
    error = np.zeros(len(t))
    for time, step in steps.items():
        past = np.maximum(t - time, 0.0)
        error += step * (np.exp(-p * past) - np.exp(-q * past)) / (inertia * (q - p))
    # The set-point is held for a period: it is a period old at the samples, and half a period on average.
    slopes = [np.clip(t - begin, 0.0, slope_time) for begin in (0.0, stop)]
    error -= periods * 1e-3 * SLOPE * (np.gradient(slopes[0], t) - np.gradient(slopes[1], t))
    launch, back = (float(np.sum(np.abs(error[part])) * 1e-3) for part in (t < stop, t >= stop))

    costs = costs_of(loop, GAINS | {"kd": kd}, at_samples=at_samples)
    assert launch == pytest.approx((DRAG + 2.0 * braking) / GAINS["ki"], rel=0.05)
    assert costs["launch 0"] == pytest.approx(launch, rel=0.005)
    assert costs["stop 0"] == pytest.approx(back, rel=0.005, abs=1e-3)
    assert costs["load"] == pytest.approx(2.0 / GAINS["ki"], rel=0.01)


def test_manoeuvres_have_the_slopes_of_study_and_vehicle_and_their_geometric_mean(loop: LoopSpec) -> None:
    own = LOOP_KINDS["speed"].at_slopes(loop, 2.4, 5.4)
    found = made(loop, own, [-0.01, 0.05])
    models = [manoeuvre.spec.model for manoeuvre in found]
    assert [model.rise for model in models if model] == pytest.approx([0.6, 0.6, 1.2, 2.4] * 2)
    assert [model.fall for model in models if model] == pytest.approx([0.6, 0.6, 1.8, 5.4] * 2)
    slopes = [slopes_of(manoeuvre.spec) for manoeuvre in found[1:4]]
    assert np.array(slopes) == pytest.approx(np.array([(0.6, 0.6), (1.2, 1.8), (2.4, 5.4)]))
    assert [manoeuvre.conditions.delay for manoeuvre in found] == [-0.01] * 4 + [0.05] * 4
    # From a low speed to the largest one of the test of the study.
    low = SLOWEST_SPEED * TOP
    assert {(one.spec.course.speed, one.spec.course.step) for one in found[1:4]} == {(low, TOP - low)}


def test_a_servo_is_driven_on_the_plant_and_pid_gains_have_the_same_costs_there_as_on_the_model() -> None:
    """Launch, stop and step of the Bolt. Its PID gains stand for a servo, as they have both costs."""
    loop = identify_loop(plant_bench(make_loop_spec(make_tuning({"vehicle": "bolt", "loop": "speed"})))).loop
    own = LOOP_KINDS["speed"].at_own_slopes(loop)
    assert own is not None
    found = made(loop, own, [loop.delay])
    gains = {"kp": 100.0, "ki": 60.0, "kd": 0.0}  # the wheels do not slide
    model = manoeuvre_costs(found, gains)
    plant = plant_costs(found, lambda spec: LoopEvaluator(spec, keep=True)(gains))
    # The last part brakes close to the limit of the grip, where the wheels slip; the reduced model has no slip.
    on_plant, on_model = np.reshape(plant, (-1, 2)), np.reshape(model, (-1, 2))
    assert on_plant[:-1, 0] == pytest.approx(on_model[:-1, 0], rel=0.1)
    assert on_plant[:-2, 1] == pytest.approx(on_model[:-2, 1], rel=0.1)
    assert on_plant[-2, 1] > on_model[-2, 1]
    servo = plant_costs(found, lambda spec: LoopEvaluator(spec, keep=True)({}))
    assert 0.0 < max(servo) < math.inf
    assert len(servo) == 4 * len(found)


def test_manoeuvres_that_the_present_gains_cannot_drive_do_not_count() -> None:
    assert largest_ratio([1.0, 3.0, 9.0], [2.0, 2.0, math.inf]) == 1.5
    assert largest_ratio([1.0, math.inf], [2.0, 2.0]) == math.inf
    assert largest_ratio([1.0], [math.inf]) == 0.0


def test_costs_below_a_hundredth_of_the_largest_are_negligible() -> None:
    assert largest_ratio([1.0, 1e-3], [2.0, 1e-6]) == 1.0
    assert largest_ratio([1.0, 0.04], [2.0, 1e-6]) == pytest.approx(2.0)


@pytest.mark.parametrize(("kd", "fidelity"), [(0.0, "plant"), (3.0, "reduced")])
def test_gains_that_are_worse_in_a_manoeuvre_are_not_tested_on_the_plant(
    loop: LoopSpec, kd: float, fidelity: str
) -> None:
    driven: list[str] = []

    def evaluate(gains: Any, conditions: Any = NOMINAL, fidelity: Any = "plant") -> Evaluation:
        driven.append(fidelity)
        return Evaluation("ok", {"iae": 1.0})

    found = made(loop, loop, [0.0])
    present = manoeuvre_costs(found, GAINS | {"kd": 1.0})
    result = InManoeuvres(evaluate, found, present)(GAINS | {"kd": kd})
    assert driven == [fidelity]
    assert (result.figures[OVER_PRESENT] > MOST_OVER_PRESENT) == (fidelity == "reduced")


def test_the_present_gains_limit_every_manoeuvre_of_a_candidate(loop: LoopSpec, tmp_path: Path) -> None:
    """A servo limits them only if it is the baseline."""
    study = {"vehicle": "bolt", "loop": "speed", "constraints": {"iae": 2.0}, "robustness": {"runs": 0}}
    present = GAINS | {"kd": 1.0}
    for given, baseline, limited in (({}, "published", False), ({}, "present", True), (present, "published", True)):
        spec = make_tuning(study | {"baseline": baseline})
        stages = Stages(spec, replace(loop, present=given), tmp_path, "", None, 0, lambda *_: None)
        assert (OVER_PRESENT in stages.constraints) == limited
    for gains, ratio in (({}, 1.0), (present, 1.0)):
        trial = stages.candidate(Design("one", "rule", gains), Evaluation("ok", {"iae": 1.0})).trial
        assert trial.figures[OVER_PRESENT] == ratio
    # Fewer resistances and steps, but a worse launch.
    trial = stages.candidate(Design("one", "rule", GAINS | {"kd": 3.0}), Evaluation("ok", {"iae": 0.5})).trial
    assert trial.figures[OVER_PRESENT] > MOST_OVER_PRESENT
    assert not trial.feasible
