"""Monte Carlo over conditions, and gain scheduling over speed."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import beta

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.tuning.robustness import MonteCarlo, draw_conditions, failure_rate, quantiles_of, run_monte_carlo
from mirdrake.vehicles.joint_control import GainTable
from tests.tuning_rigs import TextbookLoop

RANGES = {"mass": (0.8, 1.2), "friction": (0.3, 1.0), "delay": (0.0, 0.1), "noise": (0.0, 0.01)}
CANDIDATES = {"calm": {"kp": 1.0, "ki": 1.0}, "hot": {"kp": 6.5, "ki": 4.0}}
LOOP = TextbookLoop()


# --- the draws ---


def test_every_run_has_the_same_conditions_whatever_else_is_drawn() -> None:
    whole = draw_conditions(RANGES, runs=50, seed=3)
    assert draw_conditions(RANGES, runs=7, seed=3) == whole[:7]
    mass = draw_conditions({"mass": RANGES["mass"]}, runs=50, seed=3)
    assert [draw.mass for draw in mass] == [draw.mass for draw in whole]
    assert [draw.seed for draw in mass] == [draw.seed for draw in whole]
    assert mass[0].friction is None
    assert draw_conditions(RANGES, runs=7, seed=4) != whole[:7]
    assert len({draw.seed for draw in whole}) == 50
    assert all(0.8 <= draw.mass <= 1.2 and 0.3 <= (draw.friction or 0.0) <= 1.0 for draw in whole)
    draws = np.array([[draw.mass, draw.friction, draw.delay] for draw in draw_conditions(
        RANGES, runs=2000, seed=0)])  # fmt: skip
    assert np.abs(np.corrcoef(draws.T) - np.eye(3)).max() < 0.07
    assert draws.mean(axis=0) == pytest.approx([1.0, 0.65, 0.05], rel=0.03)


def test_candidates_meet_the_same_conditions_whatever_runs_them() -> None:
    robustness = run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=12, seed=1)
    drawn = [*RANGES, "seed"]
    calm, hot = (robustness.table[robustness.table["candidate"] == name] for name in CANDIDATES)
    assert calm[drawn].to_numpy().tolist() == hot[drawn].to_numpy().tolist()
    assert run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=12, seed=1, workers=1).table.equals(robustness.table)
    alone = run_monte_carlo(LOOP, {"hot": CANDIDATES["hot"]}, RANGES, runs=12, seed=1)
    assert alone.table["iae"].fillna(-1).tolist() == hot["iae"].fillna(-1).tolist()


def test_a_journal_is_continued_with_more_runs_and_candidates(tmp_path: Path) -> None:
    count, store = tmp_path / "count", tmp_path / "journal.jsonl"
    loop = TextbookLoop(count=str(count))

    def stop(done: int, total: int, left: float) -> None:
        if done == 9:
            raise KeyboardInterrupt

    stopped = run_monte_carlo(loop, CANDIDATES, RANGES, runs=6, store=store, progress=stop)
    assert not stopped.complete
    assert len(stopped.table) == 8
    more = run_monte_carlo(loop, CANDIDATES, RANGES, runs=10, store=store)
    assert count.stat().st_size == 20
    assert more.table.equals(run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=10).table)
    with pytest.raises(RunError, match="has other gains for trial calm 0"):
        run_monte_carlo(loop, {"calm": {"kp": 2.0}}, RANGES, runs=2, store=store)
    with pytest.raises(RunError, match="begun for another purpose"):
        run_monte_carlo(loop, CANDIDATES, RANGES, runs=2, seed=5, store=store)


def test_runs_that_have_been_made_already_are_not_made_again(tmp_path: Path) -> None:
    count = tmp_path / "count"
    draws = draw_conditions(RANGES, runs=10, seed=0)
    known = {"calm": {draws[run]: LOOP(CANDIDATES["calm"], draws[run]) for run in (2, 7)}}
    outcome = run_monte_carlo(TextbookLoop(count=str(count)), CANDIDATES, RANGES, runs=10, known=known)
    assert count.stat().st_size == 2 * 10 - 2
    assert outcome.table.equals(run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=10).table)


# --- the statistics ---


def test_cautious_gains_stay_stable_in_runs_that_aggressive_ones_fail() -> None:
    robustness = run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=100, seed=2)
    calm, hot = robustness.failures("calm"), robustness.failures("hot")
    assert calm.failures == 0
    assert calm.high == pytest.approx(1.0 - 0.025 ** (1.0 / 100.0))  # the closed form for no failure
    # Unstable where the delay is too long for gain and lag: known for each draw.
    conditions = draw_conditions(RANGES, runs=100, seed=2)
    assert hot.failures == sum(LOOP(CANDIDATES["hot"], draw).status == "unstable" for draw in conditions)
    assert 0.02 < hot.low < hot.rate < hot.high < 1.0
    rows = robustness.table[robustness.table["candidate"] == "calm"]
    spread = robustness.quantiles("calm", "iae")
    assert spread.worst == rows["iae"].max()
    assert (rows["iae"] <= spread.p95).sum() == 95
    assert (rows["iae"] <= spread.median).sum() == 50
    assert robustness.quantiles("hot", "iae").worst == math.inf
    summary = robustness.summary({})
    assert summary.candidates["hot"].figures["iae"].worst == math.inf
    assert summary.ranges == RANGES
    with pytest.raises(ConfigError, match="no candidate 'clam'; did you mean 'calm'"):
        robustness.failures("clam")
    with pytest.raises(ConfigError, match="no figure 'iea'"):
        robustness.quantiles("calm", "iea")


def test_a_run_that_is_not_stable_costs_more_than_any_other() -> None:
    """Ratios 2, 0 (the other failed), inf (it failed itself) and 4; both failed: none."""
    rows = [
        {"candidate": name, "run": run, "fidelity": "plant", "seed": 0, "iae": value, "reason": ""}
        | {"status": "unstable" if math.isnan(value) else "ok"}
        for name, values in {"a": [2.0, 1.0, math.nan, 4.0, math.nan], "b": [1.0, math.nan, 1.0, 1.0, math.nan]}.items()
        for run, value in enumerate(values)
    ]
    columns = ["candidate", "run", "fidelity", "seed", "iae", "status", "reason"]
    runs = MonteCarlo(pd.DataFrame(rows, columns=columns), {}, 5, 0)
    assert runs.ratios("a", "b", {"iae": 1.0}).tolist() == [2.0, 0.0, math.inf, 4.0]
    assert runs.median_ratio("a", "b", {"iae": 1.0}) == 3.0


@pytest.mark.parametrize(("failures", "runs"), [(0, 30), (1, 30), (7, 100), (30, 30)])
def test_the_interval_of_a_rate_is_that_of_clopper_and_pearson(failures: int, runs: int) -> None:
    interval = failure_rate(failures, runs)
    low = beta.ppf(0.025, failures, runs - failures + 1) if failures else 0.0
    high = beta.ppf(0.975, failures + 1, runs - failures) if failures < runs else 1.0
    assert interval.low == pytest.approx(low)
    assert interval.high == pytest.approx(high)


def test_statistics_go_from_good_to_bad() -> None:
    values, ok = np.arange(1.0, 21.0), np.ones(20, dtype=bool)
    spread = quantiles_of("iae", values, ok)
    assert (spread.median, spread.p95, spread.worst) == (10.0, 19.0, 20.0)
    spread = quantiles_of("gain_margin", values, ok)
    assert (spread.median, spread.p95, spread.worst) == (11.0, 2.0, 1.0)
    spread = quantiles_of("steady_error", -values, ok)
    assert spread.worst == 20.0
    all_but_one = np.arange(20) != 3
    assert quantiles_of("iae", values, all_but_one).worst == math.inf
    assert quantiles_of("iae", values, all_but_one).p95 == 20.0
    assert quantiles_of("disk_margin", values, all_but_one).worst == -math.inf


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"masss": (0.8, 1.2)}, "robustness.masss: no such condition; did you mean 'mass'"),
        ({"mass": (1.2, 0.8)}, "robustness.mass: the range from 1.2 to 0.8 is empty"),
        ({"friction": (0.0, 1.0)}, "robustness.friction: 0 is not allowed; it must be above 0"),
        ({"delay": (-0.1, 0.1)}, "robustness.delay: -0.1 is not allowed; it must be 0 or more"),
    ],
)
def test_faulty_ranges_are_rejected(ranges: dict[str, tuple[float, float]], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run_monte_carlo(LOOP, CANDIDATES, ranges, runs=2)
    assert message in str(caught.value)


def test_a_monte_carlo_without_candidates_or_runs_is_rejected() -> None:
    with pytest.raises(ConfigError, match="candidates: none is given"):
        run_monte_carlo(LOOP, {}, RANGES)
    with pytest.raises(ConfigError, match="runs: 0 is not allowed"):
        run_monte_carlo(LOOP, CANDIDATES, RANGES, runs=0)


# --- gain scheduling ---


def test_a_table_is_interpolated_between_its_speeds_and_held_beyond() -> None:
    table = GainTable((5.0, 15.0, 25.0), {"kp": (1.0, 2.0, 6.0), "ki": (1.0, 0.0, 0.0)})
    assert table.at(0.0) == table.at(5.0) == {"kp": 1.0, "ki": 1.0}
    assert table.at(10.0) == {"kp": 1.5, "ki": 0.5}
    assert table.at(25.0) == table.at(99.0) == {"kp": 6.0, "ki": 0.0}
    assert table.between(1) == [10.0, 20.0]
    assert table.between(4)[:2] == [7.0, 9.0]
    with pytest.raises(ConfigError, match=r"schedule.speeds: must increase, got 5, 5"):
        GainTable((5.0, 5.0), {})
    with pytest.raises(ConfigError, match=r"schedule.kp: 2 values are needed, got 1"):
        GainTable((5.0, 6.0), {"kp": (1.0,)})
