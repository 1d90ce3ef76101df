"""Studies: rows do not depend on the scheduler or on crashes; context parameters; faults of a study file."""

import gc
import json
import math
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.cli import main
from mirdrake.core.compiled import announce_compilation, compilation_time
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError
from mirdrake.execution.job import run_job
from mirdrake.execution.workers import WorkerLostError
from mirdrake.runs.simulation import Simulation
from mirdrake.studies import Workers, find_context_parameters, load_results, load_study, make_study, run_study
from mirdrake.studies import run as study_run
from mirdrake.studies.folder import JOURNAL_FILE, RESULTS_FILE, read_rows
from mirdrake.studies.plan import make_plan
from mirdrake.studies.sampling import sample

DIAGRAM = {
    "world": "empty",
    "vehicles": {"ego": {"model": "bolt", "speed": 3.0}},
    "control": {"ego": {"kind": "constant", "speed": 5.0}},
    "plant": {"contact": "point", "time_step": 0.01},
}


def study(**changes: Any) -> dict[str, Any]:
    """Return a small study of eight short runs: context parameters and a path of the diagram."""
    return {
        "diagram": DIAGRAM,
        "parameters": {
            "ego.speed.kp": {"low": 0.3, "high": 3.0, "scale": "log"},
            "ego.mass_scale": {"low": 0.8, "high": 1.2},
            "road.friction": {"low": 0.3, "high": 1.0},
            "control.ego.speed": {"values": [5.0, "36 km/h"]},
        },
        "sampling": {"kind": "sobol", "runs": 8},
        "metrics": ["ego.distance_m", "ego.max_speed_mps", "simulated_s"],
        "duration": 0.3,
        "seed": 4,
    } | changes


def write_metrics(folder: Path, text: str) -> str:
    """Return a module of metrics in a folder; its name, which no other test uses."""
    name = f"metrics_{folder.name.replace('-', '_')}"
    (folder / f"{name}.py").write_text(textwrap.dedent(text), encoding="utf-8")
    return name


# --- the same rows, whatever runs them ---


def test_rows_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    results = {count: run_study(study(), out=tmp_path / str(count), workers=count) for count in (0, 1, 2)}
    assert results[0].counts == {"ok": 8, "unstable": 0, "failed": 0}
    assert results[0].table["ego.distance_m"].nunique() > 4
    files = {(tmp_path / str(count) / RESULTS_FILE).read_bytes() for count in results}
    assert len(files) == 1
    assert load_results(tmp_path / "1").arrow.equals(results[2].arrow)
    assert results[0].table.attrs["units"]["ego.mass_scale"] == "1"
    assert not (tmp_path / "2" / JOURNAL_FILE).exists()


def test_a_foreign_executor_gives_the_same_rows() -> None:
    with ThreadPoolExecutor(2) as threads:
        assert run_study(study(), executor=threads).arrow.equals(run_study(study(), workers=0).arrow)


_DASK = """
import json, sys
from distributed import Client, LocalCluster
from mirdrake.studies import run_study
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster:
        with Client(cluster) as client:
            run_study(json.loads(sys.argv[1]), out=sys.argv[2], executor=client.get_executor())
"""


@pytest.mark.slow
def test_two_dask_workers_on_loopback_give_the_same_rows(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    (tmp_path / "cluster.py").write_text(_DASK, encoding="utf-8")  # by itself: Dask changes os.environ
    command = [sys.executable, str(tmp_path / "cluster.py"), json.dumps(study()), str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    subprocess.run(command, check=True, timeout=300, env=environment, cwd=tmp_path)
    assert load_results(tmp_path / "out").arrow.equals(run_study(study(), workers=0).arrow)


def test_a_run_does_not_know_the_runs_before_it() -> None:
    plan = make_plan(make_study(study()))
    alone = run_job(plan.job(5))
    for index in (2, 7, 0):
        run_job(plan.job(index))
    assert run_job(plan.job(5)) == alone


# --- what is not well ---


def test_an_unstable_candidate_is_a_result() -> None:
    amplifier = {"wave": {"kind": "sine", "frequency": 1.0}, "amplifier": {"kind": "gain", "gain": 1e300}}
    connect = [["wave.y0", "amplifier.u"], ["amplifier.y", "ego.speed_reference"]]
    study_data = study(
        diagram={**DIAGRAM, "systems": amplifier, "connect": connect},
        parameters={"systems.wave.amplitude": {"values": [1e-300, 1e300]}},
        sampling={"kind": "list"},
    )
    table = run_study(study_data, workers=0).table
    assert table["status"].tolist() == ["ok", "unstable"]
    assert table["reason"][1].startswith("diverged: ")
    assert table["ego.distance_m"].isna().tolist() == [False, True]


def test_a_metric_that_raises_fails_its_run_only(tmp_path: Path) -> None:
    name = write_metrics(
        tmp_path,
        """
        def errors(run):
            wanted = run.spec["control"]["ego"]["speed"]
            if wanted > 8.0:
                raise ValueError("too fast")
            error = wanted - run["ego.vx"]
            return {"iae": float(abs(error).sum() * 0.02), "last": float(error.iloc[-1]), "text": "x"}
        """,
    )
    metrics = [f"{name}:errors.iae", f"{name}:errors.last"]
    result = run_study(study(metrics=metrics, folder=str(tmp_path)), workers=0)
    slow = result.table[result.table["control.ego.speed"] == 5.0]
    fast = result.table[result.table["control.ego.speed"] == 10.0]
    assert set(slow["status"]) == {"ok"}
    assert (slow[metrics[0]] > 0.2).all()
    assert set(fast["reason"]) == {f"metric {name}:errors: ValueError: too fast"}
    assert fast[metrics[0]].isna().all()
    result = run_study(study(metrics=[f"{name}:errors.itea"], folder=str(tmp_path)), workers=0)
    assert "does not return 'itea'; allowed: iae, last, text" in " ".join(result.table["reason"])


def test_a_worker_that_crashes_costs_its_run_only(tmp_path: Path) -> None:
    name = write_metrics(
        tmp_path,
        """
        import os, signal

        def speed(run):
            if run.spec["control"]["ego"]["speed"] == 6.0:
                os.kill(os.getpid(), signal.SIGSEGV)
            if run.spec["control"]["ego"]["speed"] == 7.0:
                os._exit(3)
            return run["ego.vx"].iloc[-1]
        """,
    )
    speeds = {"control.ego.speed": {"values": [5.0, 6.0, 7.0, 8.0]}}
    study_data = study(parameters=speeds, sampling={"kind": "list"}, metrics=[f"{name}:speed"], folder=str(tmp_path))
    table = run_study(study_data, workers=1).table
    assert table["status"].tolist() == ["ok", "failed", "failed", "ok"]
    assert "ended by SIGSEGV" in table["reason"][1]
    assert "exit code 3" in table["reason"][2]


@pytest.mark.slow
def test_a_run_that_hangs_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_run, "GRACE", 20.0)
    name = write_metrics(
        tmp_path,
        """
        import time

        def stuck(run):
            while run.spec["control"]["ego"]["speed"] == 6.0:
                time.sleep(0.1)
            return 1.0
        """,
    )
    speeds = {"control.ego.speed": {"values": [5.0, 6.0, 7.0]}}
    study_data = study(parameters=speeds, sampling={"kind": "list"}, metrics=[f"{name}:stuck"], folder=str(tmp_path))
    table = run_study(study_data | {"time_limit": 5.0}, workers=2).table
    assert table["status"].tolist() == ["ok", "failed", "ok"]
    assert f"no end after 25 s of wall time; it was in stuck of {tmp_path}" in table["reason"][1]


def test_a_simulation_that_takes_too_long_is_ended() -> None:
    table = run_study(study(time_limit=1e-9), workers=0).table
    assert set(table["reason"]) == {"no end after 1e-09 s of wall time"}


def test_workers_survive_failing_jobs() -> None:
    workers = Workers(1, limit=2.0)
    try:
        crash, hang, rejected, fine = (
            workers.submit(os.abort),
            workers.submit(time.sleep, 60.0),
            workers.submit(lambda: 0),
            workers.submit(abs, -3),
        )
        with pytest.raises(WorkerLostError, match="ended by SIGABRT"):
            crash.result(timeout=300)
        with pytest.raises(WorkerLostError, match="no end after 2 s"):
            hang.result(timeout=300)
        assert rejected.exception(timeout=300) is not None
        assert fine.result(timeout=300) == 3
    finally:
        workers.shutdown(cancel_futures=True)


def test_a_call_may_take_any_time() -> None:
    """As each shard of a single-track study may."""
    workers = Workers(1, limit=math.inf)
    try:
        assert workers.submit(abs, -3).result(timeout=300) == 3
        with pytest.raises(WorkerLostError, match="ended by SIGABRT"):
            workers.submit(os.abort).result(timeout=300)
    finally:
        workers.shutdown(cancel_futures=True)


def _leak() -> int:
    """Gain more memory than a worker may; the number of its process."""
    from mirdrake.execution import workers

    workers._leaked = bytearray(b"1") * (workers.MEMORY_GROWTH + 2**20)  # type: ignore[attr-defined]
    return os.getpid()


def test_a_worker_that_has_gained_much_memory_is_replaced() -> None:
    workers = Workers(1, limit=60.0)
    try:
        calls = (os.getpid, _leak, os.getpid)
        first, second, third = (workers.submit(call).result(timeout=300) for call in calls)
        assert first == second != third
    finally:
        workers.shutdown(cancel_futures=True)


def test_a_worker_has_the_present_environment_and_a_time_limit_per_call(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIRDRAKE_PATH", "changed after the server of the workers has started")
    workers = Workers(
        1, limit=lambda *study_data: float(study_data[0]) if study_data and study_data[0] == 1.0 else 60.0
    )
    try:
        assert workers.submit(os.getenv, "MIRDRAKE_PATH").result(timeout=300) == os.environ["MIRDRAKE_PATH"]
        with pytest.raises(WorkerLostError, match="no end after 1 s") as caught:
            workers.submit(_sleep, 1.0).result(timeout=300)
        assert caught.value.seconds >= 1.0
    finally:
        workers.shutdown(cancel_futures=True)


def _sleep(_: float) -> None:
    time.sleep(60.0)


def _compile(seconds: float) -> int:
    """Compile for a time, as the first call of a new installation does; then 0.2 s of work."""
    from numba.core import event

    from mirdrake.core.compiled import compiled

    compiled(_sleep, parts=())  # listens from now on
    before = compilation_time()
    for _ in range(2):
        with event.trigger_event("numba:compile", data={}), event.trigger_event("numba:compile", data={}):
            time.sleep(0.5 * seconds)
    assert compilation_time() - before == pytest.approx(seconds, abs=0.2)
    time.sleep(0.2)
    return os.getpid()


def test_compilation_is_no_part_of_the_time_limit_and_is_announced(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    announce_compilation.cache_clear()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    workers = Workers(1, limit=lambda seconds=1.0: 2.0 if seconds else 300.0)
    try:
        workers.submit(_compile, 0.0).result(timeout=300)  # imports
        assert workers.submit(_compile, 2.5).result(timeout=300) > 0
        # Work after a compilation has the limit of any other.
        with pytest.raises(WorkerLostError, match="no end after 2 s") as caught:
            workers.submit(_compile_and_hang).result(timeout=300)
        assert 2.0 <= caught.value.seconds < 2.9
    finally:
        workers.shutdown(cancel_futures=True)
    assert capsys.readouterr().err.count("compiling the equations") == 1


def _compile_and_hang() -> None:
    _compile(1.0)
    time.sleep(60.0)


# --- killed and resumed ---

_SCRIPT = """
import sys, json
from mirdrake.studies import run_study
run_study(json.load(open(sys.argv[1])), out=sys.argv[2], workers=2, resume=True)
"""


def _kill(study_file: Path, out: Path, *, after: float) -> None:
    """Run a study in a separate process, and kill it `after` seconds after it has written rows."""
    command = [sys.executable, "-c", _SCRIPT, str(study_file), str(out)]
    before = len(read_rows(out))
    with subprocess.Popen(command, cwd=Path(__file__).parents[1]) as process:
        while len(read_rows(out)) <= before:
            assert process.poll() is None, "the study ended before it could be killed"
            time.sleep(0.01)
        time.sleep(after)
        process.send_signal(signal.SIGKILL)


def _check(tmp_path: Path, study_data: dict[str, Any], kills: list[float]) -> list[int]:
    """Kill and resume a study repeatedly, compare it with an uninterrupted one; return the rows after each kill."""
    (tmp_path / "study.json").write_text(json.dumps(study_data), encoding="utf-8")
    out, counts = tmp_path / "killed", []
    for after in kills:
        _kill(tmp_path / "study.json", out, after=after)
        counts.append(len(read_rows(out)))
    resumed = run_study(study_data, out=out, workers=0, resume=True)
    undisturbed = run_study(study_data, out=tmp_path / "whole", workers=0)
    assert resumed.complete
    assert resumed.arrow.equals(undisturbed.arrow)
    assert (out / RESULTS_FILE).read_bytes() == (tmp_path / "whole" / RESULTS_FILE).read_bytes()
    return counts


@pytest.mark.slow
def test_a_killed_study_resumes_with_the_same_rows(tmp_path: Path) -> None:
    (count,) = _check(tmp_path, study(sampling={"kind": "latin_hypercube", "runs": 80}), [0.05])
    assert 0 < count < 80


@pytest.mark.slow
def test_a_study_killed_five_times_ends_with_the_same_rows(tmp_path: Path) -> None:
    chance = random.Random(7)
    study_data = study(sampling={"kind": "random", "runs": 400}, duration=0.2)
    counts = _check(tmp_path, study_data, [chance.uniform(0.0, 0.8) for _ in range(5)])
    assert counts == sorted(set(counts))
    assert 0 < counts[-1] < 400


def test_a_folder_takes_one_study_only(tmp_path: Path) -> None:
    few = study(sampling={"kind": "sobol", "runs": 2})
    run_study(few, out=tmp_path, workers=0)
    with pytest.raises(RunError, match="is not empty"):
        run_study(few, out=tmp_path, workers=0)
    with pytest.raises(RunError, match="begun with another study"):
        run_study(few | {"seed": 5}, out=tmp_path, resume=True, workers=0)
    before = (tmp_path / RESULTS_FILE).stat().st_mtime_ns
    assert run_study(few | {"time_limit": 9.0}, out=tmp_path, resume=True, workers=2).complete
    assert (tmp_path / RESULTS_FILE).stat().st_mtime_ns == before
    with pytest.raises(ConfigError, match="not the folder of a study"):
        load_results(tmp_path / "nothing")


def test_rows_of_a_folder_survive_between_all_steps_of_writing(tmp_path: Path) -> None:
    study_data = study(sampling={"kind": "sobol", "runs": 2})
    whole = run_study(study_data, out=tmp_path, workers=0).arrow
    rows = read_rows(tmp_path)
    journal = tmp_path / JOURNAL_FILE
    assert not journal.exists()
    journal.write_text(json.dumps(rows["0"] | {"run": "0"}) + "\n")  # killed before the journal was removed
    assert load_results(tmp_path).arrow.equals(whole)

    (tmp_path / RESULTS_FILE).unlink()
    journal.write_text(journal.read_text() + '{"run": "1", "sta')  # killed while a row was written
    assert list(read_rows(tmp_path)) == ["0"]
    assert load_results(tmp_path).arrow.equals(whole[:1])
    assert run_study(study_data, out=tmp_path, resume=True, workers=0).arrow.equals(whole)
    assert not journal.exists()


# --- context parameters ---


def test_context_parameters_change_the_context_and_nothing_else() -> None:
    assembly = assemble(make_spec(DIAGRAM))
    parts = assembly.parts
    parameters = find_context_parameters({"ego": parts.vehicles["ego"].vehicle}, parts.world)
    plant, instance = parts.plant, parts.vehicles["ego"].instance
    context, other = assembly.make_context(), assembly.make_context()
    mass = plant.CalcTotalMass(plant.GetMyContextFromRoot(context), [instance])
    values = {"ego.mass_scale": 1.2, "road.friction": 0.4, "ego.speed.ki": 7.0}
    for name, value in values.items():
        parameters[name].apply(assembly, context, value)
    assert plant.CalcTotalMass(plant.GetMyContextFromRoot(context), [instance]) == pytest.approx(1.2 * mass)
    assert plant.CalcTotalMass(plant.GetMyContextFromRoot(other), [instance]) == pytest.approx(mass)
    control = assembly.diagram.GetSubsystemByName("ego.control")
    assert control.GetMyContextFromRoot(context).get_numeric_parameter(0).value()[1] == 7.0
    tyres = assembly.tyres["ego"]
    for root, expected in ((context, 0.4), (other, parts.world.road_mu)):
        assert tyres.friction(tyres.GetMyContextFromRoot(root)) == pytest.approx([expected] * 4)


def test_half_the_friction_doubles_the_braking_distance() -> None:
    braking = DIAGRAM | {"vehicles": {"ego": {"model": "bolt", "speed": 10.0}}}
    grip = {"road.friction": {"values": [0.15, 0.3]}}
    study_data = study(
        diagram=braking, overrides={"control.ego.speed": 0.0}, parameters=grip, sampling={"kind": "list"}
    )
    table = run_study(study_data | {"duration": 9.0, "metrics": ["ego.distance_m"]}, workers=0).table
    distances = table["ego.distance_m"].to_numpy()
    assert distances[0] / distances[1] == pytest.approx(2.0, rel=0.15)


# --- sampling ---


def test_sampling_methods() -> None:
    two = {"ego.speed.kp": {"low": 1.0, "high": 100.0, "scale": "log", "count": 3}, "ego.speed.ki": {"values": [1, 2]}}
    grid = sample(make_study(study(parameters=two, sampling={"kind": "grid"})))
    assert grid == [(pytest.approx(kp), ki) for kp in (1.0, 10.0, 100.0) for ki in (1, 2)]
    for kind in ("random", "latin_hypercube", "sobol"):
        drawn = make_study(study(parameters=two, sampling={"kind": kind, "runs": 50}))
        rows = sample(drawn)
        assert rows == sample(drawn)
        assert rows != sample(make_study(study(parameters=two, sampling={"kind": kind, "runs": 50}, seed=5)))
        assert all(1.0 <= kp <= 100.0 and ki in (1, 2) for kp, ki in rows)
        assert 15 <= sum(kp < 10.0 for kp, _ in rows) <= 35
    spread = make_study(study(parameters=two, sampling={"kind": "latin_hypercube", "runs": 20}))
    cells = np.floor([10.0 * np.log10(kp) for kp, _ in sample(spread)])
    assert sorted(cells) == list(range(20))


# --- faults of a study file ---

_FILE = """\
mirdrake: study/1
diagram:
  world: empty
  vehicles: {ego: {model: bolt}}
  control: {ego: {kind: constant, speed: 5}}
parameters:
  ego.speed.kp: {low: 0.5, high: 5, count: 2}
metrics: [ego.distance_m]
duration: 1 s
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "ego.speed.kp",
            "ego.speed.kpp",
            "study.yaml:7: parameters.ego.speed.kpp: neither a context parameter nor a path of the diag",
        ),
        ("ego.speed.kp", "ego.steering.kp", "study.yaml:7: parameters.ego.steering.kp: neither a context parameter"),
        (
            "ego.speed.kp",
            "control.ego.sped",
            "study.yaml:7: parameters.control.ego.sped: control.ego.sped: unknown field",
        ),
        ("ego.speed.kp", "connect.3.x", "study.yaml:7: parameters.connect.3.x: a list of 0 has no item '3'"),
        ("ego.speed.kp", "duration", "study.yaml:7: parameters.duration: cannot differ"),
        (
            "ego.speed.kp: {low: 0.5",
            "ego.mass_scale: {low: 0",
            "study.yaml:7: parameters.ego.mass_scale: 0 is not allowed",
        ),
        ("high: 5", "high: 0.5", "study.yaml:7: parameters.ego.speed.kp: the range from 0.5 to 0.5 is empty"),
        ("low: 0.5", "low: 0, scale: log", "study.yaml:7: parameters.ego.speed.kp: a range on a log scale"),
        ("high: 5, ", "", "study.yaml:7: parameters.ego.speed.kp: a range needs low and high; high is missing"),
        (
            "low: 0.5, high: 5, count: 2",
            "",
            "study.yaml:7: parameters.ego.speed.kp: needs either values, or low and high",
        ),
        ("low: 0.5, high: 5, count: 2", "values: []", "study.yaml:7: parameters.ego.speed.kp.values: has 0 items"),
        (
            "low: 0.5, high: 5, count: 2",
            "values: [1, much]",
            "study.yaml:7: parameters.ego.speed.kp: 'much' is not a num",
        ),
        (", count: 2", "", "study.yaml:7: parameters.ego.speed.kp: a grid needs a count, or values"),
        ("[ego.distance_m]", "[ego.distanc]", "study.yaml:8: metrics.0: neither a figure"),
        ("[ego.distance_m]", "[nowhere_at_all:f]", "study.yaml:8: metrics.0: module 'nowhere_at_all' cannot be import"),
        ("[ego.distance_m]", "['math:sine']", "study.yaml:8: metrics.0: no function 'sine' in math; did you mean"),
        ("[ego.distance_m]", "[status]", "study.yaml:8: metrics.0: 'status' is already a column"),
        ("speed: 5}", "sped: 5}", "study.yaml:5: diagram.control.ego.sped: unknown field"),
        ("duration: 1 s", "sampling: {kind: halton, runs: 3}", "study.yaml:9: sampling.kind: unknown kind 'halton'"),
        ("duration: 1 s", "duration: 0 s", "study.yaml:9: duration: '0 s' is not allowed"),
        (
            "duration: 1 s",
            "overrides: {plant.contakt: point}",
            "study.yaml:9: overrides.plant.contakt: plant.contakt: unknown field",
        ),
    ],
)
def test_a_faulty_study_is_rejected_with_its_line(
    old: str, new: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _FILE.count(old) == 1
    Path("study.yaml").write_text(_FILE.replace(old, new), encoding="utf-8")
    with pytest.raises(MirdrakeError) as caught:
        run_study("study.yaml", out="out", workers=0)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)
    assert not Path("out").exists()


_UNDRIVEN = """\
world: empty
vehicles: {ego: {model: bolt}}
"""


def test_a_loop_that_is_not_connected_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("car.yaml").write_text(_UNDRIVEN, encoding="utf-8")
    Path("study.yaml").write_text(
        "diagram: car.yaml\nparameters: {ego.speed.kp: {values: [1]}}\nmetrics: [ego.distance_m]\n", encoding="utf-8"
    )
    with pytest.raises(MirdrakeError) as caught:
        run_study("study.yaml", out="out", workers=0)
    assert str(caught.value).startswith("car.yaml:1: control: 'ego' has no driver (open inputs: ego.speed_reference")
    block = "systems: {half: {kind: gain, gain: 0.5}}\ncontrol: {ego: {kind: constant, speed: 5}}\n"
    Path("car.yaml").write_text(_UNDRIVEN + block, encoding="utf-8")
    with pytest.raises(MirdrakeError) as caught:
        run_study("study.yaml", out="out", workers=0)
    assert str(caught.value).startswith("car.yaml:3: systems.half: input 'half.u' is not connected")
    assert not Path("out").exists()


def test_the_figures_of_a_run_can_be_metrics() -> None:
    run = Simulation(assemble(make_spec(DIAGRAM))).run(duration=0.1)
    figures = run.summary["vehicles"]["ego"].items()
    known = [f"ego.{name}" for name, value in figures if isinstance(value, int | float)]
    result = run_study(study(metrics=[*known, "simulated_s"], sampling={"kind": "sobol", "runs": 1}), workers=0)
    assert result.counts["ok"] == 1


# --- the command ---


def test_the_command_runs_resumes_and_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gains.yaml").write_text(_FILE.replace("duration: 1 s", "duration: 0.1 s"), encoding="utf-8")
    assert main(["study", "gains.yaml", "--workers", "0"]) == 0
    output = capsys.readouterr().out
    assert "2 of 2 runs: 2 ok" in output
    assert "ego.distance_m" in output
    assert "runs/gains/" in output
    before = Path("runs/gains", RESULTS_FILE).read_bytes()
    assert main(["study", "gains.yaml", "--workers", "0", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert Path("runs/gains", RESULTS_FILE).read_bytes() == before
    assert main(["study", "gains.yaml", "--workers", "0", "--set", "seed=1"]) == 2
    assert "begun with another study" in capsys.readouterr().err
    assert main(["study", "nowhere.yaml"]) == 2
    assert capsys.readouterr().err.startswith("error: no study at 'nowhere.yaml'")
    assert main(["study", "gains.yaml", "--workers", "1", "--scheduler", "tcp://x:1"]) == 2


def test_a_scheduler_that_is_not_there_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    (tmp_path / "gains.yaml").write_text(_FILE, encoding="utf-8")
    assert main(["study", str(tmp_path / "gains.yaml"), "--scheduler", "nonsense://x"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: --scheduler nonsense://x: no Dask scheduler answers")
    assert len(error.splitlines()) == 1


def test_ctrl_c_keeps_the_runs_that_are_done(tmp_path: Path) -> None:
    few = study(sampling={"kind": "sobol", "runs": 4}, duration=0.1)

    def stop(done: int, total: int, row: dict[str, Any]) -> None:
        if done == 2:
            raise KeyboardInterrupt

    stopped = run_study(few, out=tmp_path / "out", workers=0, progress=stop)
    assert not stopped.complete
    assert load_results(tmp_path / "out").arrow.num_rows == 2
    resumed = run_study(few, out=tmp_path / "out", workers=0, resume=True)
    assert resumed.arrow.equals(run_study(few, workers=0).arrow)


def test_a_study_file_finds_its_diagram_and_name(tmp_path: Path) -> None:
    lines = _FILE.splitlines()
    (tmp_path / "car.yaml").write_text("\n".join(line[2:] for line in lines[2:5]) + "\n", encoding="utf-8")
    text = "\n".join([lines[0], "diagram: car.yaml", *lines[5:]])
    (tmp_path / "gains.yaml").write_text(text, encoding="utf-8")
    spec = load_study(tmp_path / "gains.yaml")
    assert spec.name == "gains"
    assert make_plan(spec).diagram["vehicles"]["ego"]["model"] == "bolt"


# --- cost ---


@pytest.mark.slow
def test_memory_and_time_of_a_run_do_not_grow(tmp_path: Path) -> None:
    page = os.sysconf("SC_PAGE_SIZE")
    sizes, times = [], []

    def look(done: int, total: int, row: dict[str, Any]) -> None:
        times.append(time.process_time())
        if done % 50 == 0:
            gc.collect()
            sizes.append(int(Path("/proc/self/statm").read_text().split()[1]) * page / 1e6)

    parameters = {name: study()["parameters"][name] for name in ("ego.speed.kp", "ego.mass_scale", "road.friction")}
    study_data = study(parameters=parameters, sampling={"kind": "sobol", "runs": 200})
    run_study(study_data, out=tmp_path / "out", workers=0, progress=look)
    assert sizes[-1] - sizes[0] < 5.0, sizes
    each = np.diff(times)
    assert np.median(each[-50:]) < 1.3 * np.median(each[20:70])
