"""Gains that are better in the mean of a test are not accepted if a manoeuvre gets worse."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.tuning.designs import Design
from mirdrake.tuning.loops.base import NOMINAL, Course, Evaluation, LoopModel, LoopSpec
from mirdrake.tuning.loops.manoeuvres import (
    HOLD,
    MOST_OVER_PRESENT,
    OVER_PRESENT,
    largest_ratio,
    make_manoeuvres,
    manoeuvre_costs,
)
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.models import TransferFunction
from mirdrake.tuning.scenarios import InManoeuvres
from mirdrake.tuning.spec import make_tuning
from mirdrake.tuning.stages import Stages

INERTIA, DRAG, SLOPE, TOP = 2.0, 1.5, 0.5, 4.0
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


def costs_of(spec: LoopSpec, gains: dict[str, float]) -> dict[str, float]:
    names = [f"{name} {part}" for part in range(3) for name in ("launch", "stop")]
    return dict(zip(["step", "load", *names], manoeuvre_costs(make_manoeuvres(spec, spec, [0.0]), gains), strict=True))


@pytest.mark.parametrize("kd", [0.0, 3.0])
def test_the_derivative_brakes_on_a_slope_by_its_gain_times_the_slope(loop: LoopSpec, kd: float) -> None:
    """Error of (J + kd) s² + kp s + ki, overdamped, to a step D of the torque: D (exp(-p t) - exp(-q t)) / (J (q - p)).

    The steps are those that the feed-forward lacks: the drag F and kd a at the launch, less kd a at the end of a slope.
    Therefore a launch costs about (F + 2 kd a) / ki, and a stop 2 kd a / ki.
    """
    inertia, slope_time = INERTIA + kd, TOP / SLOPE
    q, p = -np.roots([inertia, GAINS["kp"], GAINS["ki"]])
    stop = slope_time + HOLD
    braking = kd * SLOPE
    steps = {0.0: DRAG + braking, slope_time: -braking, stop: -braking, stop + slope_time: braking}
    t = np.arange(0.0, stop + slope_time + HOLD, 1e-3)
    error = np.zeros(len(t))
    for time, step in steps.items():
        past = np.maximum(t - time, 0.0)
        error += step * (np.exp(-p * past) - np.exp(-q * past)) / (inertia * (q - p))
    launch, back = (float(np.sum(np.abs(error[part])) * 1e-3) for part in (t < stop, t >= stop))

    costs = costs_of(loop, GAINS | {"kd": kd})
    assert launch == pytest.approx((DRAG + 2.0 * braking) / GAINS["ki"], rel=0.05)
    assert costs["launch 0"] == pytest.approx(launch, rel=0.01)
    assert costs["stop 0"] == pytest.approx(back, rel=0.01, abs=1e-3)
    assert costs["load"] == pytest.approx(2.0 / GAINS["ki"], rel=0.01)


def test_manoeuvres_have_the_slopes_of_study_and_vehicle_and_their_geometric_mean(loop: LoopSpec) -> None:
    assert loop.model is not None
    own = replace(loop, model=replace(loop.model, rise=2.0, fall=4.5))
    made = make_manoeuvres(loop, own, [-0.01, 0.05])
    models = [manoeuvre.spec.model for manoeuvre in made]
    assert [model.rise for model in models if model] == pytest.approx([0.5, 0.5, 1.0, 2.0] * 2)
    assert [model.fall for model in models if model] == pytest.approx([0.5, 0.5, 1.5, 4.5] * 2)
    assert [manoeuvre.conditions.delay for manoeuvre in made] == [-0.01] * 4 + [0.05] * 4
    # From standstill to the largest speed of the test of the study.
    assert {(one.spec.course.speed, one.spec.course.step) for one in made[1:4]} == {(0.0, TOP)}


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

    made = make_manoeuvres(loop, loop, [0.0])
    present = manoeuvre_costs(made, GAINS | {"kd": 1.0})
    result = InManoeuvres(evaluate, made, present)(GAINS | {"kd": kd})
    assert driven == [fidelity]
    assert (result.figures[OVER_PRESENT] > MOST_OVER_PRESENT) == (fidelity == "reduced")


def test_the_present_gains_limit_every_manoeuvre_of_a_candidate(loop: LoopSpec, tmp_path: Path) -> None:
    """A servo has no model: without gains to compare with, there is no limit."""
    spec = make_tuning({"vehicle": "bolt", "loop": "speed", "constraints": {"iae": 2.0}, "robustness": {"runs": 0}})
    present = GAINS | {"kd": 1.0}
    for given, limited in (({}, False), (present, True)):
        stages = Stages(spec, replace(loop, present=given), tmp_path, "", None, 0, lambda *_: None)
        assert (OVER_PRESENT in stages.constraints) == limited
    for gains, ratio in (({}, 1.0), (present, 1.0)):
        trial = stages.candidate(Design("one", "rule", gains), Evaluation("ok", {"iae": 1.0})).trial
        assert trial.figures[OVER_PRESENT] == ratio
    # Fewer resistances and steps, but a worse launch.
    trial = stages.candidate(Design("one", "rule", GAINS | {"kd": 3.0}), Evaluation("ok", {"iae": 0.5})).trial
    assert trial.figures[OVER_PRESENT] > MOST_OVER_PRESENT
    assert not trial.feasible
