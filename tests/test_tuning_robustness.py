"""Monte Carlo over conditions, and gain scheduling over speed."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scipy.stats import beta

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.pid import PidGains, PidState, pid_step
from mirdrake.tuning.robustness import draw_conditions, failure_rate, monte_carlo, read_ranges, spread_of
from mirdrake.tuning.schedule import GainTable, ScheduledPid, check_schedule, tune_schedule
from tests.tuning_rigs import TextbookLoop

RANGES = {"mass": [0.8, 1.2], "friction": [0.3, 1.0], "delay": [0.0, 0.1], "noise": [0.0, 0.01]}
CANDIDATES = {"calm": {"kp": 1.0, "ki": 1.0}, "hot": {"kp": 6.5, "ki": 4.0}}
LOOP = TextbookLoop()


# --- the draws ---


def test_every_run_has_the_same_conditions_whatever_else_is_drawn() -> None:
    whole = draw_conditions(read_ranges(RANGES), runs=50, seed=3)
    assert draw_conditions(read_ranges(RANGES), runs=7, seed=3) == whole[:7]
    mass = draw_conditions(read_ranges({"mass": RANGES["mass"]}), runs=50, seed=3)
    assert [given.mass for given in mass] == [given.mass for given in whole]
    assert [given.seed for given in mass] == [given.seed for given in whole]
    assert mass[0].friction is None
    assert draw_conditions(read_ranges(RANGES), runs=7, seed=4) != whole[:7]
    assert len({given.seed for given in whole}) == 50
    assert all(0.8 <= given.mass <= 1.2 and 0.3 <= (given.friction or 0.0) <= 1.0 for given in whole)
    draws = np.array([[given.mass, given.friction, given.delay] for given in draw_conditions(
        read_ranges(RANGES), runs=2000, seed=0)])  # fmt: skip
    assert np.abs(np.corrcoef(draws.T) - np.eye(3)).max() < 0.07
    assert draws.mean(axis=0) == pytest.approx([1.0, 0.65, 0.05], rel=0.03)


def test_candidates_meet_the_same_conditions_whatever_runs_them() -> None:
    found = monte_carlo(LOOP, CANDIDATES, RANGES, runs=12, seed=1)
    drawn = [*RANGES, "seed"]
    calm, hot = (found.table[found.table["candidate"] == name] for name in CANDIDATES)
    assert calm[drawn].to_numpy().tolist() == hot[drawn].to_numpy().tolist()
    assert monte_carlo(LOOP, CANDIDATES, RANGES, runs=12, seed=1, workers=1).table.equals(found.table)
    alone = monte_carlo(LOOP, {"hot": CANDIDATES["hot"]}, RANGES, runs=12, seed=1)
    assert alone.table["iae"].fillna(-1).tolist() == hot["iae"].fillna(-1).tolist()


def test_a_journal_goes_on_with_more_runs_and_candidates(tmp_path: Path) -> None:
    count, store = tmp_path / "count", tmp_path / "journal.jsonl"
    loop = TextbookLoop(count=str(count))

    def stop(done: int, total: int, left: float) -> None:
        if done == 9:
            raise KeyboardInterrupt

    stopped = monte_carlo(loop, CANDIDATES, RANGES, runs=6, store=store, progress=stop)
    assert not stopped.complete
    assert len(stopped.table) == 8
    more = monte_carlo(loop, CANDIDATES, RANGES, runs=10, store=store)
    assert count.stat().st_size == 20
    assert more.table.equals(monte_carlo(LOOP, CANDIDATES, RANGES, runs=10).table)
    with pytest.raises(RunError, match="has other gains for trial calm 0"):
        monte_carlo(loop, {"calm": {"kp": 2.0}}, RANGES, runs=2, store=store)
    with pytest.raises(RunError, match="begun for another purpose"):
        monte_carlo(loop, CANDIDATES, RANGES, runs=2, seed=5, store=store)


# --- the statistics ---


def test_a_calm_loop_stays_stable_where_a_hot_one_does_not() -> None:
    found = monte_carlo(LOOP, CANDIDATES, RANGES, runs=100, seed=2)
    calm, hot = found.failures("calm"), found.failures("hot")
    assert calm.failures == 0
    assert calm.high == pytest.approx(1.0 - 0.025 ** (1.0 / 100.0))  # the closed form for no failure
    # Unstable where the delay is too long for gain and lag: known for each draw.
    conditions = draw_conditions(read_ranges(RANGES), runs=100, seed=2)
    assert hot.failures == sum(LOOP(CANDIDATES["hot"], given).status == "unstable" for given in conditions)
    assert 0.02 < hot.low < hot.rate < hot.high < 1.0
    rows = found.table[found.table["candidate"] == "calm"]
    spread = found.spread("calm", "iae")
    assert spread.worst == rows["iae"].max()
    assert (rows["iae"] <= spread.p95).sum() == 95
    assert (rows["iae"] <= spread.median).sum() == 50
    assert found.spread("hot", "iae").worst == math.inf
    data = found.data()
    assert data["candidates"]["hot"]["figures"]["iae"]["worst"] is None
    assert data["ranges"]["mass"] == {"low": 0.8, "high": 1.2, "scale": "linear"}
    with pytest.raises(ConfigError, match="no candidate is called 'clam'; did you mean 'calm'"):
        found.failures("clam")
    with pytest.raises(ConfigError, match="no figure is called 'iea'"):
        found.spread("calm", "iea")


@pytest.mark.parametrize(("failures", "runs"), [(0, 30), (1, 30), (7, 100), (30, 30)])
def test_the_interval_of_a_rate_is_that_of_clopper_and_pearson(failures: int, runs: int) -> None:
    found = failure_rate(failures, runs)
    low = beta.ppf(0.025, failures, runs - failures + 1) if failures else 0.0
    high = beta.ppf(0.975, failures + 1, runs - failures) if failures < runs else 1.0
    assert found.low == pytest.approx(low)
    assert found.high == pytest.approx(high)


def test_statistics_go_from_good_to_bad() -> None:
    values, ok = np.arange(1.0, 21.0), np.ones(20, dtype=bool)
    spread = spread_of("iae", values, ok)
    assert (spread.median, spread.p95, spread.worst) == (10.0, 19.0, 20.0)
    spread = spread_of("gain_margin", values, ok)
    assert (spread.median, spread.p95, spread.worst) == (11.0, 2.0, 1.0)
    spread = spread_of("steady_error", -values, ok)
    assert spread.worst == 20.0
    one = np.arange(20) != 3
    assert spread_of("iae", values, one).worst == math.inf
    assert spread_of("iae", values, one).p95 == 20.0
    assert spread_of("disk_margin", values, one).worst == -math.inf


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"masss": [0.8, 1.2]}, "robustness.masss: no such condition; did you mean 'mass'"),
        ({"mass": [1.2, 0.8]}, "range of mass: the range from 1.2 to 0.8 is empty"),
        ({"friction": [0.0, 1.0]}, "robustness.friction: 0 is not allowed; it must be above 0"),
        ({"delay": [-0.1, 0.1]}, "robustness.delay: -0.1 is not allowed; it must be 0 or more"),
        ({"mass": [1.0]}, "robustness.mass: two numbers are needed, low and high, got 1"),
    ],
)
def test_faulty_ranges_are_refused(ranges: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        monte_carlo(LOOP, CANDIDATES, ranges, runs=2)
    assert message in str(caught.value)


def test_nothing_to_try_is_refused() -> None:
    with pytest.raises(ConfigError, match="candidates: none is given"):
        monte_carlo(LOOP, {}, RANGES)
    with pytest.raises(ConfigError, match="runs: 0 is not allowed"):
        monte_carlo(LOOP, CANDIDATES, RANGES, runs=0)


# --- gain scheduling ---

SPACE = {"kp": {"low": 0.3, "high": 60.0, "scale": "log"}, "ki": {"low": 0.1, "high": 30.0, "scale": "log"}}
JUDGED: dict[str, Any] = {"cost": {"iae": 1.0}, "constraints": {"ms": 1.6}}


def faster(speed: float, **more: Any) -> TextbookLoop:
    """A loop with a lag that grows with speed, as that of a motor of constant power does."""
    return TextbookLoop(time_constant=0.2 * speed, **more)


def test_a_table_is_straight_between_its_speeds_and_held_beyond() -> None:
    table = GainTable((5.0, 15.0, 25.0), {"kp": (1.0, 2.0, 6.0), "ki": (1.0, 0.0, 0.0)})
    assert table.at(0.0) == table.at(5.0) == {"kp": 1.0, "ki": 1.0}
    assert table.at(10.0) == {"kp": 1.5, "ki": 0.5}
    assert table.at(25.0) == table.at(99.0) == {"kp": 6.0, "ki": 0.0}
    assert table.between(1) == [10.0, 20.0]
    assert table.between(4)[:2] == [7.0, 9.0]
    with pytest.raises(ConfigError, match=r"schedule.speeds: must rise, got 5, 5"):
        GainTable((5.0, 5.0), {})
    with pytest.raises(ConfigError, match=r"schedule.kp: 2 values are needed, got 1"):
        GainTable((5.0, 6.0), {"kp": (1.0,)})


def test_a_schedule_beats_constant_gains_and_holds_between_its_points(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    table = tune_schedule(faster, SPACE, [5.0, 15.0, 25.0], trials=60, seed=1, store=tmp_path, **JUDGED)
    kp = table.gains["kp"]
    assert kp[0] < kp[1] < kp[2]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["speed-15.jsonl", "speed-25.jsonl", "speed-5.jsonl"]
    counted = partial(faster, count=str(tmp_path / "count"))
    again = tune_schedule(counted, SPACE, [5.0, 15.0, 25.0], trials=60, seed=1, store=tmp_path, **JUDGED)
    assert again == table
    assert not (tmp_path / "count").exists()

    checked = check_schedule(faster, table, others={"of 5 m/s": table.at(5.0), "of 25 m/s": table.at(25.0)}, **JUDGED)
    assert checked["speed"].unique().tolist() == [5.0, 10.0, 15.0, 20.0, 25.0]
    rows = {name: part.set_index("speed") for name, part in checked.groupby("gains")}
    scheduled = rows["scheduled"]
    assert scheduled["where"].tolist() == ["tuned", "between", "tuned", "between", "tuned"]
    assert scheduled["feasible"].all()
    assert scheduled["cost"][25.0] < 0.6 * rows["of 5 m/s"]["cost"][25.0]
    assert not rows["of 25 m/s"]["feasible"][5.0]
    both = check_schedule(faster, table, workers=1, **JUDGED)
    assert both["cost"].tolist() == scheduled["cost"].tolist()


def test_a_speed_without_a_solution_is_told() -> None:
    with pytest.raises(RunError, match="no candidate meets the constraints at 15 m/s"):
        tune_schedule(
            lambda speed: TextbookLoop(dead_time=0.2 if speed < 10.0 else 3.0),
            {"kp": {"values": [2.0]}, "ki": {"values": [2.0]}},
            [5.0, 15.0],
            method="grid",
            trials=1,
            **JUDGED,
        )


def test_a_scheduled_pid_takes_the_gains_of_its_table() -> None:
    builder = DiagramBuilder()
    pid = builder.AddSystem(ScheduledPid([5.0, 15.0], [1.0, 3.0], [0.5, 0.1], period=0.1, maximum=9.0))
    sources = {name: builder.AddSystem(ConstantVectorSource([v])) for name, v in (("r", 2.0), ("y", 0.5), ("v", 10.0))}
    for name, port in (("r", pid.reference), ("y", pid.measurement), ("v", pid.schedule)):
        builder.Connect(sources[name].get_output_port(), port)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = pid.GetMyContextFromRoot(simulator.get_context())
    simulator.AdvanceTo(0.95)
    state, control = PidState(), math.nan
    for _ in range(10):
        state, control = pid_step(state, 2.0, 0.5, gains=PidGains(2.0, 0.3), period=0.1)
    assert pid.control.Eval(context).item() == pytest.approx(control, rel=1e-12)
    source = sources["v"].get_mutable_source_value(sources["v"].GetMyMutableContextFromRoot(simulator.get_context()))
    source.SetFromVector([15.0])
    simulator.AdvanceTo(1.05)
    assert pid.control.Eval(context).item() == pytest.approx(control + 0.3 * 0.1 * 1.5)  # no jump from 2 to 3
    assert pid.get_gains(context) == PidGains(3.0, 0.1)
