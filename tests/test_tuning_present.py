"""The present controllers of a vehicle are the baseline, and a loop that is not tuned keeps its gains."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from mirdrake.cli import main
from mirdrake.tuning.check import baseline_gains
from mirdrake.tuning.loops.base import Conditions, Evaluation, LoopModel, LoopSpec, OuterLoop
from mirdrake.tuning.loops.evaluate import LoopEvaluator
from mirdrake.tuning.loops.reduced import find_loop_margins, loop_plants, run_reduced
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.models import TransferFunction
from mirdrake.tuning.scenarios import drawn_ranges
from mirdrake.tuning.spec import TuningSpec, make_tuning
from mirdrake.tuning.stages import Stages


def study(**changes: Any) -> TuningSpec:
    return make_tuning({"vehicle": "bolt", "loop": "speed", "test": {"duration": 4.0, "step": 1.0}, **changes})


@pytest.fixture(scope="module")
def loop() -> LoopSpec:
    return make_loop_spec(study())


def test_the_speed_loop_of_the_vehicle_is_not_written(loop: LoopSpec) -> None:
    assert {path.partition(".")[0] for path in loop.settings} == {"wheel_speed"}
    assert loop.present_kind == "servo"
    assert loop.present == {}


def test_the_present_control_is_driven_as_it_is_in_the_file(loop: LoopSpec) -> None:
    """The speed loop of the Bolt, kp 1 and ki 1, follows a ramp of 0.6 m/s² with an error of some cm/s."""
    assert baseline_gains(study(), loop) == {}
    present = loop.as_present()
    control = present.diagram["vehicles"]["ego"]["control"]
    assert set(control) == {"dead_man", "speed"}
    assert set(control["speed"]) == {"max_acceleration", "max_deceleration"}
    result = LoopEvaluator(loop)({})
    assert result.status == "ok"
    assert 0.01 < result.figures["iae"] < 0.5


def test_runs_in_which_the_present_control_is_unstable_do_not_reject_a_candidate(
    loop: LoopSpec, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The present control fails in run 2, the candidate in runs 2 and 4."""
    spec = study(robustness={"runs": 6})
    stages = Stages(spec, loop, tmp_path, "key", None, 0, lambda *_: None)
    calls: list[object] = []

    def evaluate(_: LoopEvaluator, gains: object, draw: Conditions, fidelity: str = "plant") -> Evaluation:
        calls.append(gains)
        return Evaluation("unstable" if draw == stages.draws[2] else "ok")

    monkeypatch.setattr(LoopEvaluator, "__call__", evaluate)
    table = pd.DataFrame({"run": [1, 2, 4], "status": ["ok", "unstable", "unstable"]})
    assert stages.unstable_runs(table) == [4]
    assert stages.unstable_runs(table) == [4]
    assert calls == [{}, {}]  # each draw once, with the present control
    assert not stages.is_unstable_now(Conditions(delay=0.1234))
    # Other gains to compare with are not those of the vehicle.
    published = replace(stages, spec=study(robustness={"runs": 6}, baseline="published"), unstable_now={})
    assert published.unstable_runs(table) == [2, 4]


def test_delays_of_the_monte_carlo_are_up_to_twice_the_nominal_one(loop: LoopSpec) -> None:
    assert drawn_ranges(study(test={"delay": 0.03}), loop)["delay"] == (0.0, 0.06)
    assert drawn_ranges(study(robustness={"delay": [0.01, 0.2]}), loop)["delay"] == (0.01, 0.2)


def test_a_speed_loop_around_the_wheels_adds_to_the_loop_gain(loop: LoopSpec) -> None:
    """Of an integrator b / s with dead time L, the gain margin is π / (2 L kp b); kp 1 around it halves that."""
    integrator = TransferFunction((2.0,), (1.0, 0.0), 0.1)
    bare = make_loop(loop, LoopModel({"main": integrator}))
    around = make_loop(loop, LoopModel({"main": integrator}, outer=OuterLoop(1.0, 0.0, 10.0)))
    gains = {"kp": 1.0, "ki": 0.0, "kd": 0.0}
    margins = [find_loop_margins(loop, gains)["gain_margin"] for loop in (bare, around)]
    assert margins[0] / margins[1] == pytest.approx(2.0, rel=1e-3)
    assert loop_plants(around)["main"].static_gain == float("inf")
    fast, slow = (run_reduced(loop, gains).figures["iae"] for loop in (around, bare))
    assert fast == pytest.approx(0.5 * slow, rel=0.1)


def make_loop(loop: LoopSpec, model: LoopModel) -> LoopSpec:
    course = replace(loop.course, load=0.0, duration=12.0, load_time=12.0)
    return replace(loop, model=replace(model, rise=0.6, fall=0.6), filter_time=0.0, course=course)


def test_the_reduced_model_has_the_speed_loop_around_the_wheels() -> None:
    """The Bolt: torque of two wheels to wheel speed by its mass, a drag of 28 N m, and its speed loop of kp 1, ki 1.

    The plant also corrects its rolling radius with that loop. The models have 1.6 and 4.5 times its IAE.
    """
    mass, radius = 1616.0, 0.3012
    spec = make_loop_spec(study(test={"duration": 4.0}))
    model = LoopModel(
        {"main": TransferFunction((2.0 / (mass * radius**2),), (1.0, 0.006), 0.06)},
        scale=1.0 / radius, start=spec.course.speed, rise=0.6, fall=0.6, feedforward=mass * radius / 2,
        weight=mass * 9.80665 * radius / 2, drag=28.0, limit=1269.0, outer=OuterLoop(1.0, 1.0, 2.0),
    )  # fmt: skip
    gains = {"kp": 250.0, "ki": 100.0, "kd": 20.0}
    evaluate = LoopEvaluator(replace(spec, model=model))
    without = LoopEvaluator(replace(spec, model=replace(model, outer=None)))
    plant = evaluate(gains).figures["iae"]
    assert evaluate(gains, fidelity="reduced").figures["iae"] < 2.0 * plant
    assert without(gains, fidelity="reduced").figures["iae"] > 3.0 * plant


def test_the_default_limit_of_the_overshoot_has_what_a_late_feed_forward_causes(loop: LoopSpec, tmp_path: Path) -> None:
    """0.6 m/s² for 0.1 s are 0.06 m/s: 6 % of a step of 1 m/s."""
    model = LoopModel({"main": TransferFunction((1.0,), (1.0, 0.0), 0.1)}, rise=0.6, feedforward=200.0)
    late = replace(loop, model=model)
    for given, limit in (({}, 11.0), ({"constraints": {"overshoot_percent": 5.0}}, 5.0)):
        stages = Stages(study(**given), late, tmp_path, "", None, 0, lambda *_: None)
        assert stages.constraints["overshoot_percent"] == pytest.approx(limit)


@pytest.mark.slow
def test_a_study_in_which_nothing_is_better_keeps_the_present_gains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A servo without delay, as stiff as that of the Bolt's steering, is better than any PID behind 50 ms."""
    text = "mirdrake: tuning/1\nvehicle: bolt\nloop: steering\ntest: {duration: 4}\nsearch: {trials: 6, confirm: 1}\n"
    (tmp_path / "study.yaml").write_text(f"{text}constraints: {{overshoot_percent: 60}}\nrobustness: {{runs: 0}}\n")
    out = tmp_path / "out"
    assert main(["tune", str(tmp_path / "study.yaml"), "--workers", "0", "--out", str(out)]) == 1
    assert "nothing is better than the present gains" in capsys.readouterr().out.splitlines()[0]
    assert main(["tune", "apply", str(out), "--dry-run"]) == 2
    assert "does not meet 1 of 4 criteria" in capsys.readouterr().err
