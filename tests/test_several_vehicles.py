"""Several vehicles in one diagram: each with its name, start and controllers, all in one contact problem."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble, load_diagram
from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.requirements import observe
from mirdrake.runs.incidents import Incident
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world

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


def test_two_cars_drive_separate_paths():
    run = Simulation(assemble(TWO)).run(duration=4.0)
    first, second = run.summary["vehicles"]["first"], run.summary["vehicles"]["second"]
    assert first["distance_m"] > second["distance_m"] > 5.0
    # The first keeps its heading, the second one turns at v tan(delta)/L from its heading of 90 degrees.
    assert abs(run["first.yaw"].iloc[-1]) < 1e-3
    rate = 2.0 * np.tan(0.2) / 2.601
    assert run["second.wz"].iloc[-50:].mean() == pytest.approx(rate, rel=0.005)


def test_a_car_drives_the_same_whether_or_not_another_one_is_there():
    alone = {**TWO, "vehicles": {"first": TWO["vehicles"]["first"]}, "control": {"first": TWO["control"]["first"]}}
    both, single = (Simulation(assemble(spec)).run(duration=2.0) for spec in (TWO, alone))
    np.testing.assert_allclose(both["first.x"], single["first.x"], atol=1e-4)


def test_a_car_that_hits_a_parked_one_pushes_it_and_reports_the_collision():
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
    with pytest.raises(ConfigError, match=r"vehicles\.second\.start: 'second' starts at the place of 'first'"):
        assemble({**TWO, "vehicles": {name: {"model": "bolt"} for name in ("first", "second")}})


def test_the_bundled_two_cars_keep_to_their_circles():
    run = Simulation(assemble(load_diagram("two_cars"))).run(duration=12.0)
    for name, turn in (("left", 1.0), ("right", -1.0)):
        assert run[f"{name}.lateral_error"].abs().max() < 0.1
        assert run[f"{name}.wz"].iloc[-100:].mean() == pytest.approx(turn * 5.0 / 9.125, rel=0.02)


# --- what vehicles see of one another, and what is reported at once -------------------------------------------------


def parked_ahead(behaviour: dict[str, Any], *, y: float = 0.3, yaw: float = 0.4, model: str = "mkz") -> dict[str, Any]:
    return {
        "world": "empty",
        "vehicles": {
            "ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": 8},
            "other": {"model": model, "start": {"x": 25, "y": y, "yaw": yaw}, "parked": True},
        },
        "control": {"ego": behaviour, "other": {"kind": "constant", "speed": 0}},
        "plant": {"contact": "point"},
    }


@pytest.mark.parametrize("kind", ["straight_and_avoid", "obstacle_stopper", "drive_to_nearest_and_stop"])
def test_a_behaviour_sees_a_parked_car(kind: str):
    run = Simulation(assemble(parked_ahead({"kind": kind, "speed": 8}))).run(duration=4.0)
    assert run["other_contacts"].max() == 0
    assert run.summary["vehicles"]["ego"]["collisions"] == []
    assert np.hypot(run["ego.x"].iloc[-1], run["ego.y"].iloc[-1]) > 10.0


def test_a_collision_is_reported_at_once_with_its_time_and_speed():
    reported: list[Incident] = []
    spec = parked_ahead({"kind": "blind", "speed": 8}, y=0.0, yaw=0.0, model="bolt")
    run = Simulation(assemble(spec)).run(duration=4.0, report=reported.append)
    (hit,) = run.summary["vehicles"]["ego"]["collisions"]
    assert hit["with"] == "other"
    assert hit["time"] == pytest.approx((25.0 - 4.166) / 8.0, abs=0.15)
    assert hit["speed_mps"] == pytest.approx(8.0, abs=0.5)
    assert [event.text for event in reported if event.vehicle == "ego"] == [
        entry["text"] for entry in run.events if entry["kind"] == "collision" and entry["text"].startswith("ego")
    ]
    others = {name: load_vehicle("bolt") for name in ("ego", "other")}
    observation = observe(run, load_world("empty"), "ego", others["ego"], others=others)
    assert observation.events["collision"].truth.any()
    assert observation.signals["clearance"][0] == pytest.approx(25.0 - 4.166, abs=0.01)


WALLS = """
mirdrake: world/1
name: walls
ground: {surface: asphalt, size: [60, 40]}
props: [{box: [1, 4, 2], name: wall, at: [10, 0]}]
start: {a: {at: [0, 0]}}
"""


@pytest.mark.parametrize(
    ("vehicle", "kind", "text"),
    [
        ({"start": {"x": 9, "y": 0}}, "start", "ego: starts in 'wall', "),
        ({"start": {"x": 29, "y": 0}}, "start", "ego: starts beyond the ground"),
        ({"start": {"x": 0, "y": 9}, "speed": 90}, "start", "ego: starts at 90 m/s; its top speed is 42.0 m/s"),
        ({"start": {"x": 0, "y": 9}, "speed": -90}, "start", "ego: starts at -90 m/s; its top speed backwards"),
        ({"start": {"x": 0, "y": 9}, "speed": 3, "parked": True}, "start", "although it is parked"),
        ({"start": {"x": 20, "y": 9}, "speed": 8}, "ground", "ego: left the world's ground at (30"),
        ({"start": {"x": 0, "y": 0}, "speed": 8}, "collision", "ego: collision with 'wall' at 8."),
    ],
)
def test_notable_occurrences_are_recorded_as_events(vehicle: dict[str, Any], kind: str, text: str, tmp_path: Path):
    (tmp_path / "walls.yaml").write_text(WALLS)
    spec = {
        "world": str(tmp_path / "walls.yaml"),
        "vehicles": {"ego": {"model": "bolt", **vehicle}},
        "control": {"ego": {"kind": "constant", "speed": 8}},
        "plant": {"contact": "point"},
    }
    run = Simulation(assemble(spec)).run(duration=1.5)
    assert [entry for entry in run.events if entry["kind"] == kind and text in entry["text"]]


def test_a_sound_start_has_no_incident():
    run = Simulation(assemble(TWO)).run(duration=0.2)
    assert not [entry for entry in run.events if entry["kind"] in {"start", "collision", "ground"}]
