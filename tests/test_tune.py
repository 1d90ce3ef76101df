"""Tuning from start to finish: short studies here, those of the acceptance marked slow."""

import json
from pathlib import Path
from typing import Any

import pytest

from mirdrake.core.errors import RunError
from mirdrake.tuning.result import load_result
from mirdrake.tuning.tune import tune
from tests.tuning_rigs import short_study

STUDIES = Path(__file__).parents[1] / "studies"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return tune(short_study(), out=tmp_path_factory.mktemp("tune") / "bolt")


def test_a_result_has_what_was_agreed(study: Any) -> None:
    data = study.data
    assert data["loop"]["gains"]["kp"] == {"unit": "N m s/rad", "path": "wheel_speed.kp"}
    assert data["loop"]["settings"]["wheel_speed.kind"] == "pid"
    kinds = {one["kind"] for one in data["candidates"]}
    assert {"baseline", "rule", "shaped"} <= kinds
    assert data["candidates"][0]["gains"] == {"kp": 100.0, "ki": 0.01, "kd": 10.0}
    for name in ("responses", "trials", "frequency", "map"):
        assert len(study.table(name)) > 0
    assert {model["name"] for model in data["models"]} == {"step test", "relay", "frequency response"}


def test_the_identified_gain_is_that_of_the_mass(study: Any) -> None:
    model = next(one for one in study.data["models"] if one["name"] == "frequency response")
    values = {name: pair[0] for name, pair in model["parameters"].items()}
    slope = values["gain"] / values.get("time_constant", 1.0)
    assert slope == pytest.approx(2.0 / (1616.0 * 0.3012**2), rel=0.06)
    assert 0.05 < values["delay"] < 0.08


def test_the_best_beats_the_baseline_by_half(study: Any) -> None:
    best, baseline = study.candidate(), study.candidate("baseline")
    assert best["feasible"]
    assert best["figures"]["iae"] < 0.5 * baseline["figures"]["iae"]


def test_a_finished_study_is_not_done_again(study: Any) -> None:
    before = (study.folder / "tuning.json").stat().st_mtime_ns
    again = tune(short_study(), out=study.folder)
    assert again.data == study.data
    assert (study.folder / "tuning.json").stat().st_mtime_ns == before


def test_another_study_does_not_take_its_folder(study: Any) -> None:
    with pytest.raises(RunError, match="not of this very study"):
        tune(short_study(seed=1), out=study.folder)


def test_a_result_is_valid_json(study: Any) -> None:
    text = (study.folder / "tuning.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    assert json.loads(text) == load_result(study.folder).data


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bolt_speed", "unior_steering"])
def test_acceptance(name: str, tmp_path: Path) -> None:
    result = tune(STUDIES / f"{name}.yaml", out=tmp_path / name, workers=2)
    assert [row for row in result.data["acceptance"] if not row["met"]] == []
