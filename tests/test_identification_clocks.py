"""Which channels are late: the constant of delays that are known up to one."""

from itertools import combinations

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, check_data, load_data
from mirdrake.identification.clocks import Response, Tie, solve_ties
from tests.test_identification_data_lateral import drive

NAMES = ("a", "b", "c", "d", "e")


def ties(late, random=None):
    """Return all differences between channels with these delays [s], with an error of 1 ms."""
    noise = np.zeros(2) if random is None else random.normal(0.0, 1e-3, 200)
    return [
        Tie(first, second, late.get(first, 0.0) - late.get(second, 0.0) + noise[row % len(noise)], 1e-3)
        for row, (first, second) in enumerate(combinations(NAMES[:4], 2))
    ]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("late", [("a",), ("d",), ("a", "b"), ("a", "c"), ("b", "d")])
def test_the_late_channels_are_those_that_were_delayed(seed, late):
    random = np.random.default_rng(seed)
    delay = random.uniform(0.02, 0.3)
    found = solve_ties(ties(dict.fromkeys(late, delay), random), 0.005)
    assert {name for name, value in found.items() if value} == set(late)
    assert [found[name] for name in late] == pytest.approx([delay] * len(late), abs=0.003)


def test_of_three_late_channels_the_fourth_is_early_unless_the_three_are_one_source():
    three = ties({"a": 0.1, "b": 0.1, "c": 0.1})
    assert solve_ties(three, 0.005) == pytest.approx({"a": 0.0, "b": 0.0, "c": 0.0, "d": -0.1})
    one_source = solve_ties(three, 0.005, sources=[{"a", "b", "c"}])
    assert one_source == pytest.approx({"a": 0.1, "b": 0.1, "c": 0.1, "d": 0.0})


def test_the_clock_of_the_data_file_has_no_delay():
    found = solve_ties(ties({"a": 0.1}), 0.005, clock="a")
    assert found == pytest.approx({"a": 0.0, "b": -0.1, "c": -0.1, "d": -0.1})


def test_of_two_late_or_two_early_channels_the_response_stays_behind_the_steering():
    """A yaw rate 0.03 s behind the steering is not 0.1 s late: without the delay it would precede its cause."""
    pair = ties({"a": 0.1, "b": 0.1})
    assert solve_ties(pair, 0.005)["a"] == pytest.approx(0.1)
    found = solve_ties(pair, 0.005, response=Response("a", 0.03, 0.01))
    assert found == pytest.approx({"a": 0.0, "b": 0.0, "c": -0.1, "d": -0.1})


def test_rates_of_clocks_have_either_sign():
    found = solve_ties([Tie("a", "b", -0.1, 1e-3)], 1e-6, one_sided=False, clock="b")
    assert found == pytest.approx({"a": -0.1, "b": 0.0})


def test_a_data_file_states_the_clock(tmp_path):
    log = drive(2, late={"vx": 0.1, "vy": 0.1})
    report = check_data(DataSet((log,), clock="vy"))
    shifted = {key for finding in report.of("delay") if finding.done for key in finding.done.figures}
    assert {"yaw_rate", "lateral_acceleration"} <= shifted
    assert not {"vx", "vy"} & shifted
    (tmp_path / "data.yaml").write_text(
        "mirdrake: data/1\nclock: vz\nchannels:\n  vx: {column: v, unit: m/s}\nlogs: [{file: log.csv}]\n"
    )
    with pytest.raises(ConfigError, match=r"clock: no channel 'vz' is mapped"):
        load_data(tmp_path / "data.yaml")
