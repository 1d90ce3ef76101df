"""Search for gains: the same outcome with any number of workers and interruptions; fronts, knees, maps, faults."""

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.studies.fronts import find_knee, pareto_front
from mirdrake.studies.optimise import LARGEST, make_proposer
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.gain_map import map_of_two_gains
from mirdrake.tuning.loops.base import NOMINAL, Evaluation
from mirdrake.tuning.search import search
from tests.tuning_rigs import TextbookLoop

SPACE = {
    "kp": ParameterSpec(low=0.1, high=20.0, scale="log"),
    "ki": ParameterSpec(low=0.05, high=20.0, scale="log"),
}
LOOP = TextbookLoop()
LEARNING = ("tpe", "cma", "nsga2")


def look(evaluate: Any = LOOP, **changes: Any) -> Any:
    """Return a small search."""
    evaluation: dict[str, Any] = {
        "trials": 40,
        "cost": {"iae": 1.0},
        "constraints": {"ms": 1.6},
        "seed": 3,
        "method": "tpe",
    }
    return search(evaluate, SPACE, **(evaluation | changes))


def same(first: Any, second: Any) -> bool:
    """Return whether two searches gave the same bits; nan equals nan."""
    return bool(first.table.equals(second.table)) and first.complete == second.complete


@pytest.fixture(autouse=True)
def _optuna() -> None:
    pytest.importorskip("optuna")


# --- reproducibility ---


@pytest.mark.parametrize("method", [*LEARNING, "latin_hypercube", "sobol", "grid"])
def test_a_search_is_the_same_again(method: str) -> None:
    cost = {"iae": 1.0, "total_variation": 0.01}
    first, again = (look(method=method, cost=cost, trials=36) for _ in range(2))
    assert same(first, again)
    assert len(first.trials) == 36
    assert len({trial.gains["kp"] for trial in first.trials}) >= 6
    if method != "grid":
        assert first.table["kp"].tolist() != look(method=method, cost=cost, trials=36, seed=4).table["kp"].tolist()


def test_the_number_of_workers_does_not_matter() -> None:
    alone = look(trials=24)
    assert same(look(trials=24, workers=1), alone)
    assert same(look(trials=24, workers=2), alone)


_SCRIPT = """
import json, sys
from mirdrake.tuning.search import search
from tests.test_tuning_search import SPACE
from tests.tuning_rigs import TextbookLoop
store, count, more = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
search(TextbookLoop(count=count), SPACE, cost={"iae": 1.0, "ms": 0.0}, seed=3, store=store, **more)
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", LEARNING)
def test_a_search_killed_five_times_ends_as_one_that_was_not(method: str, tmp_path: Path) -> None:
    chance, store, count = random.Random(11), tmp_path / "journal.jsonl", tmp_path / "count"
    more = {"method": method, "trials": 120}
    command = [sys.executable, "-c", _SCRIPT, str(store), str(count), json.dumps(more)]
    size, kills = 0, 5 if method != "tpe" else 2
    for _ in range(kills):
        with subprocess.Popen(command, cwd=Path(__file__).parents[1]) as process:
            target_size = size + chance.randint(3, 14)
            while (count.stat().st_size if count.exists() else 0) < target_size:
                assert process.poll() is None, "the search ended before it could be killed"
                time.sleep(0.001)
            process.send_signal(signal.SIGKILL)
        size = count.stat().st_size
    with store.open("ab") as file:
        file.write(b'{"key": "1')  # half a line
    loop = TextbookLoop(count=str(count))
    options: dict[str, Any] = {"cost": {"iae": 1.0, "ms": 0.0}, "seed": 3, **more}
    resumed = search(loop, SPACE, store=store, **options)
    assert 120 <= count.stat().st_size <= 120 + kills  # at most the one that was going on is made twice
    assert same(resumed, search(LOOP, SPACE, **options))
    before = count.stat().st_size
    assert same(search(loop, SPACE, store=store, **options), resumed)
    assert count.stat().st_size == before


def test_a_journal_belongs_to_one_search(tmp_path: Path) -> None:
    store = tmp_path / "journal.jsonl"
    look(trials=4, store=store, purpose={"loop": "a"})
    with pytest.raises(RunError, match=r"begun for another purpose \(search\)"):
        look(trials=4, store=store, purpose={"loop": "a"}, seed=9)
    with pytest.raises(RunError, match=r"begun for another purpose \(loop\)"):
        look(trials=4, store=store, purpose={"loop": "b"})
    store.write_text("kp,ki\n1,2\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"journal\.jsonl: damaged, cannot be read"):
        look(trials=4, store=store)


def test_ctrl_c_keeps_what_is_done(tmp_path: Path) -> None:
    store = tmp_path / "journal.jsonl"

    def stop(done: int, total: int, left: float) -> None:
        assert left >= 0.0
        if done == 11:
            raise KeyboardInterrupt

    stopped = look(progress=stop, store=store)
    assert not stopped.complete
    assert [trial.number for trial in stopped.trials] == list(range(11))
    assert same(look(store=store), look())


# --- results ---


def _best_pi() -> float:
    """Return the least IAE with Ms at most 1.6, by a simplex from outside the search."""

    def total(x: Any) -> float:
        evaluation = LOOP({"kp": math.exp(x[0]), "ki": math.exp(x[1])})
        if evaluation.status != "ok":
            return 1e3
        return evaluation.figures["iae"] + 100.0 * max(evaluation.figures["ms"] - 1.6, 0.0)

    return float(minimize(total, [0.5, 0.5], method="Nelder-Mead", options={"maxiter": 200}).fun)


@pytest.mark.parametrize(("method", "trials", "within"), [("tpe", 120, 0.05), ("cma", 160, 0.02), ("nsga2", 200, 0.1)])
def test_samplers_approach_the_best_pi(method: str, trials: int, within: float) -> None:
    result = look(method=method, trials=trials)
    assert result.best.figures["ms"] <= 1.6
    assert result.best.cost <= _best_pi() * (1.0 + within)
    random_best = look(method="random", trials=trials).best
    assert result.best.cost < random_best.cost


def test_a_search_begins_with_the_given_candidates() -> None:
    start = [{"kp": 1.0, "ki": 1.0}, {"kp": 0.5, "ki": 0.25}]
    for method in (*LEARNING, "sobol"):
        result = look(method=method, trials=10, start=start)
        assert [trial.gains for trial in result.trials[:2]] == start
        assert len(result.trials) == 10


def test_fixed_gains_are_passed_to_every_candidate() -> None:
    result = search(LOOP, {"kp": SPACE["kp"]}, trials=12, cost={"iae": 1.0}, fixed={"ki": 0.7}, seed=1)
    assert {trial.gains["ki"] for trial in result.trials} == {0.7}
    assert list(result.table.columns[:3]) == ["number", "ki", "kp"]


# --- failures ---


@pytest.mark.parametrize("method", LEARNING)
def test_unstable_candidates_rank_last_and_become_rare(method: str) -> None:
    result = look(method=method, trials=90, constraints={"ms": 1.6, "settling_time": 4.0})
    unstable = [trial for trial in result.trials if trial.status == "unstable"]
    assert unstable
    stable = [trial for trial in result.trials if trial.status == "ok"]
    assert max(trial.violation for trial in stable) < min(trial.violation for trial in unstable) < math.inf
    assert all(trial.cost == math.inf and trial.figures == {} for trial in unstable)
    assert result.best.status == "ok"
    blind = look(method="random", trials=300).table["status"]
    later = result.table["status"][30:]
    assert (later == "unstable").mean() < 0.6 * (blind == "unstable").mean()


@pytest.mark.parametrize("method", LEARNING)
def test_a_sampler_gets_finite_numbers_only(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import optuna

    reported: list[float] = []
    report_trial = optuna.study.Study.tell

    def spy(self: Any, trial: Any, values: Any) -> Any:
        reported.extend(values)
        return report_trial(self, trial, values)

    monkeypatch.setattr(optuna.study.Study, "tell", spy)
    proposer = make_proposer(method, SPACE, trials=40, objectives=1, seed=0, batch=8, start=[])
    for value in (math.nan, math.inf, -math.inf, 1e300, 3.0):
        for violation in (0.0, 1e12):
            proposer.ask(1)
            proposer.tell([value], violation)
    proposer.ask(20)
    assert len(reported) == 10
    assert all(abs(value) <= 1e28 for value in reported)
    assert max(reported) >= LARGEST


def test_a_candidate_that_raises_fails_alone() -> None:
    result = look(TextbookLoop(fault="raise"), method="sobol")
    failed = [trial for trial in result.trials if trial.status == "failed"]
    assert {trial.reason for trial in failed} == {"ValueError: kp is too large"}
    assert all(trial.gains["kp"] > 4.0 for trial in failed)
    assert result.best is not None


def test_a_candidate_that_kills_its_worker_fails_alone() -> None:
    result = look(TextbookLoop(fault="kill"), method="sobol", trials=16, workers=1)
    failed = [trial for trial in result.trials if trial.status == "failed"]
    assert {trial.number for trial in failed} == {t.number for t in result.trials if t.gains["kp"] > 4.0}
    assert {trial.reason for trial in failed} == {"the process was ended by SIGKILL"}
    assert failed
    assert result.best is not None


@pytest.mark.slow
def test_a_candidate_that_hangs_fails_alone() -> None:
    result = look(TextbookLoop(fault="hang"), method="sobol", trials=8, workers=2, limit=3.0)
    failed = [trial for trial in result.trials if trial.status == "failed"]
    assert failed
    assert all(trial.reason.startswith("no end after 3 s of wall time") for trial in failed)


def test_a_candidate_with_a_figure_that_is_not_finite_is_not_the_best() -> None:
    def never_settles(gains: Any, conditions: Any = NOMINAL, fidelity: Any = "plant") -> Evaluation:
        return Evaluation("ok", {"iae": 1.0, "settling_time": math.nan})

    result = look(never_settles, method="sobol", constraints={}, cost={"iae": 1.0, "settling_time": 1.0}, trials=4)
    assert result.best is None
    assert {trial.cost for trial in result.trials} == {math.inf}
    result = look(never_settles, method="sobol", constraints={"settling_time": 2.0}, trials=4)
    assert {trial.violation for trial in result.trials} == {1e9}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "tpee"}, "method: unknown method 'tpee'; did you mean 'tpe'"),
        ({"cost": {"iea": 1.0}}, "cost: no figure 'iea'; did you mean 'iae'"),
        ({"constraints": {"mss": 1.0}}, "constraints: no figure 'mss'; did you mean 'ms'"),
        ({"cost": {"iae": -1.0}}, "cost.iae: -1 is not allowed"),
        ({"cost": {}}, "cost: no figure has a weight"),
        ({"cost": {"gain_margin": 1.0}}, "cost.gain_margin: a larger value is better"),
        ({"trials": 0}, "trials: 0 is not allowed; it must be 1 or more"),
        ({"start": [{"kp": 50.0, "ki": 1.0}]}, "start.0.kp: 50 is outside its range, 0.1 to 20"),
        ({"start": [{"kp": 1.0}]}, "start.0: ki is missing"),
        ({"fixed": {"ki": 1.0}}, "fixed.ki: has a range as well"),
    ],
)
def test_a_faulty_search_is_rejected(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        look(**changes)
    assert str(caught.value).startswith(message)


def test_a_search_without_ranges_is_rejected() -> None:
    with pytest.raises(ConfigError, match="space: no gain has a range"):
        search(LOOP, {}, cost={"iae": 1.0})


# --- fronts and knees ---


def test_the_front_has_all_rows_that_are_not_dominated() -> None:
    values = np.array([[1.0, 5.0], [2.0, 2.0], [5.0, 1.0], [3.0, 3.0], [2.0, 2.0], [1.0, 6.0]])
    assert pareto_front(values) == [0, 1, 2]
    drawn = np.random.default_rng(0).random((120, 3))
    beaten = [(np.all(drawn <= row, axis=1) & np.any(drawn < row, axis=1)).any() for row in drawn]
    assert pareto_front(drawn) == [k for k, lost in enumerate(beaten) if not lost]


def test_the_knee_of_a_quarter_circle_is_in_its_middle() -> None:
    angle = np.linspace(0.0, 0.5 * math.pi, 91)
    circle = np.stack([1.0 - np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    assert angle[find_knee(circle)] == pytest.approx(0.25 * math.pi)
    stretched = circle * [1000.0, 1e-3] + [5.0, -7.0]  # units do not matter
    assert angle[find_knee(stretched)] == pytest.approx(0.25 * math.pi)
    assert find_knee(np.array([[1.0, 2.0]])) == 0


def test_the_front_of_error_and_effort_has_a_knee_between_its_ends() -> None:
    result = look(method="nsga2", trials=150, cost={"iae": 1.0, "total_variation": 0.0})
    front = result.front()
    assert len(front) >= 8
    iae = [trial.figures["iae"] for trial in front]
    effort = [trial.figures["total_variation"] for trial in front]
    assert iae == sorted(iae)
    assert effort == sorted(effort, reverse=True)
    assert result.knee() in front[1:-1]


# --- a map ---


def test_a_map_shows_the_limit_of_stability() -> None:
    ranges = {"kp": ParameterSpec(low=0.5, high=20.0, scale="log", count=24), "ki": ParameterSpec(values=[0.1, 1.0])}
    table = map_of_two_gains(LOOP, ranges, cost={"iae": 1.0})
    assert list(table.columns) == ["kp", "ki", "cost", "ms", "stable", "feasible"]
    assert len(table) == 48
    # First order with dead time L under P: stable up to kp = sqrt(1 + (T w)²), where w L + atan(w T) = π.
    w = np.linspace(5.0, 12.0, 70001)
    ultimate = np.sqrt(1.0 + w[np.argmin(np.abs(0.2 * w + np.arctan(w) - math.pi))] ** 2)
    stable = table[table["ki"] == 0.1].set_index("kp")["stable"]
    assert math.sqrt(stable[stable].index.max() * stable[~stable].index.min()) == pytest.approx(ultimate, rel=0.09)
    assert table[table["stable"]]["ms"].notna().all()
    with pytest.raises(ConfigError, match="a map needs two gains, got 1: kp"):
        map_of_two_gains(LOOP, {"kp": ranges["kp"]}, cost={"iae": 1.0})


def test_no_worker_is_left_running() -> None:
    look(trials=4, workers=2)
    time.sleep(0.2)
    listed = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(os.getpid())], capture_output=True, text=True, check=True
    )
    assert "mirdrake worker" not in listed.stdout
