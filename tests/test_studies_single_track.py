"""Studies of the single-track model: agreement with the plant, shards, resumption, faults of a study file."""

import pickle
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.studies import load_results, make_study, run_study, single_track
from mirdrake.studies.folder import RESULTS_FILE, SHARDS, ShardStore, make_schema
from mirdrake.studies.plan import make_plan

DIAGRAM = {
    "world": "test_track",
    "vehicles": {"ego": {"model": "bolt", "start": "line", "speed": 5.0}},
    "control": {"ego": {"kind": "path_tracking", "track": "main", "speed": 5.0}},
    "plant": {"contact": "point", "time_step": 0.01},
}


def study(**changes: Any) -> dict[str, Any]:
    """Return a study of the single-track model with four runs."""
    return {
        "diagram": DIAGRAM,
        "model": "single_track",
        "parameters": {"ego.speed.kp": {"values": [0.5, 2.0]}, "ego.mass_scale": {"values": [0.8, 1.2]}},
        "metrics": ["ego.distance_m", "ego.max_speed_mps", "simulated_s"],
        "duration": 2.0,
    } | changes


@pytest.mark.parametrize("model", ["bolt", "bolt@handling"])
def test_the_single_track_model_drives_as_far_as_the_plant(model: str) -> None:
    """Servos on the wheels, and pedals."""
    diagram = DIAGRAM | {"vehicles": {"ego": {"model": model, "start": "line", "speed": 5.0}}}
    changes = {"parameters": {"control.ego.speed": {"values": [5.0, 8.0]}}, "diagram": diagram}
    reduced, plant = (run_study(study(**changes, model=kind), workers=0) for kind in ("single_track", "plant"))
    assert reduced.model == "single_track"
    assert reduced.table["ego.distance_m"].to_numpy() == pytest.approx(plant.table["ego.distance_m"], rel=0.005)
    assert reduced.table["ego.max_speed_mps"].to_numpy() == pytest.approx(plant.table["ego.max_speed_mps"], rel=0.01)
    assert reduced.table["ego.distance_m"][1] > reduced.table["ego.distance_m"][0]


def test_rows_do_not_depend_on_shards_and_a_stopped_study_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run_study(study(), workers=0)
    assert whole.counts == {"ok": 4, "unstable": 0, "failed": 0}
    assert len(set(whole.table["ego.distance_m"])) == 4
    monkeypatch.setattr(single_track, "LARGEST", 3)
    first = single_track.run_shard

    def stop_after_one(shard: single_track.BatchShard) -> Any:
        if shard.number:
            raise KeyboardInterrupt
        return first(shard)

    monkeypatch.setattr("mirdrake.studies.run.run_shard", stop_after_one)
    part = run_study(study(), out=tmp_path / "out", workers=0)
    assert (part.complete, part.arrow.num_rows) == (False, 3)
    assert load_results(tmp_path / "out").arrow.equals(part.arrow)
    monkeypatch.setattr("mirdrake.studies.run.run_shard", first)
    result = run_study(study(), out=tmp_path / "out", workers=0, resume=True)
    assert result.arrow.equals(whole.arrow)
    assert load_results(tmp_path / "out").arrow.equals(whole.arrow)
    assert (tmp_path / "out" / RESULTS_FILE).is_file()
    assert not (tmp_path / "out" / SHARDS).exists()


class SynchronousDask(Executor):
    """Makes each call a task of Dask's synchronous scheduler, through pickle as on another computer."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run the task at once."""
        from dask.delayed import delayed

        done: Future[Any] = Future()
        function, arguments = pickle.loads(pickle.dumps((fn, args)))
        task = delayed(function, pure=False)(*arguments, **kwargs)
        done.set_result(pickle.loads(pickle.dumps(task.compute(scheduler="synchronous"))))
        return done


def test_shards_as_tasks_of_dask_give_the_same_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dask")
    monkeypatch.setattr(single_track, "LARGEST", 3)
    files: list[list[str]] = []

    def look(done: int, total: int, row: Any) -> None:
        files.append(sorted(file.name for file in (tmp_path / "out" / SHARDS).iterdir()))

    result = run_study(study(), out=tmp_path / "out", executor=SynchronousDask(), progress=look)
    assert result.arrow.equals(run_study(study(), workers=0).arrow)
    # A Parquet file for each shard, until the table of the whole study replaces them.
    assert [len(names) for names in files] == [1, 2]
    assert all(name.endswith(".parquet") for names in files for name in names)
    assert not (tmp_path / "out" / SHARDS).exists()


def test_a_run_ends_after_its_laps() -> None:
    diagram = DIAGRAM | {"laps": 0.005}
    result = run_study(study(diagram=diagram, metrics=["ego.laps"]), workers=0)
    assert (result.table["simulated"] < 1.5).all()
    assert result.table["ego.laps"].to_numpy() == pytest.approx(0.005, abs=2e-4)


def test_constant_commands_and_schedules() -> None:
    constant = DIAGRAM | {"control": {"ego": {"kind": "constant", "speed": 3.0}}}
    result = run_study(study(diagram=constant, parameters={"control.ego.speed": {"values": [3.0, 7.0]}}), workers=0)
    assert result.table["ego.distance_m"][0] < 10.0 < result.table["ego.distance_m"][1]
    rows = [{"time": 0.0, "speed": 5.0}, {"time": 1.0, "speed": 6.0}]
    schedule = DIAGRAM | {"control": {"ego": {"kind": "schedule", "rows": rows}}}
    result = run_study(study(diagram=schedule), workers=0)
    assert (result.table["ego.max_speed_mps"] > 5.4).all()


def test_a_value_out_of_range_fails_the_runs_of_its_shard() -> None:
    plan = make_plan(make_study(study()))
    (shard,) = single_track.make_shards(plan)
    outcomes = single_track.run_shard(replace(shard, first=7, columns={"ego.mass_scale": [-1.0, 1.0]}, duration=1.0))
    assert [(outcome.index, outcome.status) for outcome in outcomes] == [(7, "failed"), (8, "failed")]
    assert "mass" in outcomes[0].reason


def test_the_table_of_shards_is_in_the_order_of_the_runs() -> None:
    store = ShardStore(None, make_schema({}, ["a"]))
    for number in (1, 0):
        store.add(number, [{"run": number, "status": "ok", "reason": "", "simulated": 1.0, "a": float(number)}])
    assert store.table()["run"].to_pylist() == [0, 1]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"diagram": DIAGRAM | {"control": {"ego": {"kind": "straight_and_avoid"}}}}, "model: .*path_tracking"),
        ({"metrics": ["ego.off_road_s"]}, "metrics.0: not a metric of the single-track model"),
        ({"parameters": {"plant.time_step": {"values": [0.01, 0.02]}}}, "parameters.plant.time_step: .*cannot vary"),
    ],
)
def test_faults_of_a_study_name_their_place(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        run_study(study(**changes), workers=0)


@pytest.mark.slow
def test_ten_thousand_candidates_take_seconds() -> None:
    gains = {"ego.speed.kp": {"low": 0.3, "high": 3.0}, "ego.mass_scale": {"low": 0.8, "high": 1.2}}
    changes = {"parameters": gains, "sampling": {"kind": "sobol", "runs": 10_000}, "duration": 10.0}
    run_study(study(), workers=0)  # machine code
    began = time.process_time()
    result = run_study(study(**changes), workers=0)
    assert result.counts["ok"] == 10_000
    assert np.isfinite(result.table["ego.distance_m"]).all()
    assert time.process_time() - began < 60.0
