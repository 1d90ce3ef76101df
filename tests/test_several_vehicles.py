"""Several vehicles in one diagram: each with its own name, start and controllers, all in one contact problem."""

from typing import Any

import numpy as np
import pytest

from mirdrake.diagram import assemble, load_diagram
from mirdrake.errors import ConfigError, WorldError
from mirdrake.simulation import Simulation

TWO: dict[str, Any] = {
    "world": "empty",
    "vehicles": {
        "first": {"model": "bolt", "start": {"x": 0, "y": 0}},
        "second": {"model": "bolt", "start": {"x": 0, "y": 5, "yaw": "90 deg"}, "arguments": {"drive": "rear"}},
    },
    "control": {
        "first": {"kind": "constant", "speed": 3},
        "second": {"kind": "constant", "speed": 2, "steering": 0.2},
    },
    "plant": {"contact": "point"},
}


def test_two_cars_drive_their_own_ways():
    run = Simulation(assemble(TWO)).run(duration=4.0)
    first, second = run.summary["vehicles"]["first"], run.summary["vehicles"]["second"]
    assert first["distance_m"] > second["distance_m"] > 5.0
    # The first keeps its heading, the second one turns at v tan(delta)/L from its heading of 90 degrees.
    assert abs(run["first.yaw"].iloc[-1]) < 1e-3
    rate = 2.0 * np.tan(0.2) / 2.601
    assert run["second.wz"].iloc[-50:].mean() == pytest.approx(rate, rel=0.005)


def test_a_car_drives_the_same_whether_or_not_another_one_is_there():
    alone = {**TWO, "vehicles": {"first": TWO["vehicles"]["first"]}, "control": {"first": TWO["control"]["first"]}}
    both, one = (Simulation(assemble(spec)).run(duration=2.0) for spec in (TWO, alone))
    np.testing.assert_allclose(both["first.x"], one["first.x"], atol=1e-4)


def test_a_car_that_runs_into_a_parked_one_pushes_it_and_says_so():
    spec = {
        "world": "empty",
        "vehicles": {
            "ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": 3},
            "other": {"model": "bolt", "start": {"x": 7, "y": 0}},
        },
        "control": {"ego": {"kind": "constant", "speed": 3}, "other": {"kind": "constant", "speed": 0}},
        "plant": {"contact": "point"},
    }
    run = Simulation(assemble(spec)).run(duration=2.0)
    assert run["other.x"].iloc[-1] > 7.01
    assert run["other_contacts"].max() > 0
    assert run["ego.x"].iloc[-1] < run["other.x"].iloc[-1] - 3.5  # bumper to bumper, not inside one another


def test_starts_by_place_must_be_in_the_world_and_apart():
    with pytest.raises(WorldError, match=r"vehicles\.first\.start: start outside the world: \(9000, 0\) m"):
        assemble({**TWO, "vehicles": {**TWO["vehicles"], "first": {"model": "bolt", "start": {"x": 9000}}}})
    with pytest.raises(ConfigError, match=r"vehicles\.second\.start: 'second' starts where 'first' stands"):
        assemble({**TWO, "vehicles": {name: {"model": "bolt"} for name in ("first", "second")}})


def test_the_bundled_two_cars_keep_to_their_circles():
    run = Simulation(assemble(load_diagram("two_cars"))).run(duration=12.0)
    for name, turn in (("left", 1.0), ("right", -1.0)):
        assert run[f"{name}.lateral_error"].abs().max() < 0.1
        assert run[f"{name}.wz"].iloc[-100:].mean() == pytest.approx(turn * 5.0 / 9.125, rel=0.02)
