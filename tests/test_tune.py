"""Tuning end to end: a short study; the shipped studies are marked slow."""

import json
from pathlib import Path
from typing import Any

import pytest

from mirdrake.core.errors import RunError
from mirdrake.tuning.loops.base import Gain
from mirdrake.tuning.result import read_result
from mirdrake.tuning.tune import tune
from tests.tuning_rigs import short_study

STUDIES = Path(__file__).parents[1] / "studies"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return tune(short_study(), out=tmp_path_factory.mktemp("tune") / "bolt")


@pytest.mark.essential
def test_a_result_has_loop_candidates_tables_and_experiments(study: Any) -> None:
    assert study.loop.gains["kp"] == Gain("N m s/rad", "wheel_speed.kp")
    assert study.loop.settings["wheel_speed.kind"] == "pid"
    assert {"baseline", "rule", "shaped"} <= {candidate.kind for candidate in study.candidates}
    assert study.candidates[0].gains == {"kp": 100.0, "ki": 0.01, "kd": 10.0}
    for name in ("responses", "trials", "frequency", "map"):
        assert len(study.table(name)) > 0
    assert [experiment.name for experiment in study.experiments] == ["step_test", "relay", "frequency_response"]
    rejected = [candidate for candidate in study.candidates if not candidate.feasible]
    assert rejected
    assert all(candidate.rejections for candidate in rejected)


def test_the_identified_gain_is_that_of_the_mass(study: Any) -> None:
    values = {name: parameter.value for name, parameter in study.experiments[-1].parameters.items()}
    slope = values["gain"] / values.get("time_constant", 1.0)
    assert slope == pytest.approx(2.0 / (1616.0 * 0.3012**2), rel=0.06)
    assert 0.05 < values["delay"] < 0.08


def test_the_best_has_a_smaller_error_than_the_published_gains(study: Any) -> None:
    best, baseline = study.candidate(), study.candidate("baseline")
    assert best.feasible
    assert best.figures["iae"] < baseline.figures["iae"]


def test_a_finished_study_is_not_run_again(study: Any) -> None:
    before = (study.folder / "tuning.json").stat().st_mtime_ns
    again = tune(short_study(), out=study.folder)
    assert again == study
    assert (study.folder / "tuning.json").stat().st_mtime_ns == before


def test_another_study_cannot_use_its_folder(study: Any) -> None:
    with pytest.raises(RunError, match="does not belong to this study"):
        tune(short_study(seed=1), out=study.folder)


def test_a_result_is_valid_json(study: Any) -> None:
    def fail(name: str) -> None:
        pytest.fail(f"{name} is not valid JSON")

    text = (study.folder / "tuning.json").read_text()
    json.loads(text, parse_constant=fail)
    assert read_result(study.folder) == study


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bolt_speed", "unior_steering"])
def test_acceptance(name: str, tmp_path: Path) -> None:
    result = tune(STUDIES / f"{name}.yaml", out=tmp_path / name, workers=2)
    assert [criterion for criterion in result.acceptance if not criterion.met] == []
