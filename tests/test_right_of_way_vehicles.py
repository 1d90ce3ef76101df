"""Full vehicles with the driver `traffic` obey the right of way of junctions, among themselves and with actors."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram import assemble
from mirdrake.runs.simulation import Simulation
from tests.opendrive_maps import crossing
from tests.test_right_of_way import STOPS

JUNCTION = 10.0  # [m] from its middle to its edges


def simulation(
    folder: Path, vehicles: dict[str, tuple[int, int]], actors: dict[str, tuple[int, int]], **options: Any
) -> Simulation:
    """Return a simulation of vehicles and actors by name, each from one arm of a crossing to another one, at 8 m/s."""
    (folder / "map.xodr").write_text(crossing(**options), encoding="utf-8")
    ways = {
        f"way_{a}": {"route": {"from": f"{a}.0.1@1", "to": f"{b}.0.-1@48"}}
        for a, b in [*vehicles.values(), *actors.values()]
    }
    world = {
        "mirdrake": "world/1", "network": {"xodr": "map.xodr"}, "tracks": ways,
        "start": {name: {"on_track": {"track": f"way_{a}", "s": 15}, "speed": 8} for name, (a, _) in vehicles.items()},
        "actors": [
            {"actor": "sedan", "name": name, "on_track": {"track": f"way_{a}", "s": 15}, "speed": 8, "behaviour": "idm"}
            for name, (a, _) in actors.items()
        ],
    }  # fmt: skip
    (folder / "world.yaml").write_text(yaml.safe_dump(world), encoding="utf-8")
    spec = {
        "world": str(folder / "world.yaml"),
        "vehicles": {name: {"model": "bolt", "start": name} for name in vehicles},
        "control": {name: {"kind": "traffic", "track": f"way_{a}", "speed": 8} for name, (a, _) in vehicles.items()},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    }
    return Simulation(assemble(spec))


def times_inside(time: Any, x: Any, y: Any) -> tuple[float, float]:
    """Return when a car is in the junction: from the first to the last time [s]."""
    inside = time[np.maximum(np.abs(x), np.abs(y)) < JUNCTION]
    return float(inside[0]), float(inside[-1])


def test_a_vehicle_gives_way_to_an_actor_from_its_right(tmp_path: Path) -> None:
    run = simulation(tmp_path, {"ego": (180, 0)}, {"right": (270, 90)}).run(duration=12.0)
    time = run.signals.index.to_numpy()
    entered, _ = times_inside(time, run["ego.x"].to_numpy(), run["ego.y"].to_numpy())
    # The actor has priority and passes at its speed; the vehicle waits until its rear has left the conflict.
    actors = run.actors
    assert actors["right.speed"][actors["right.y"] < JUNCTION].min() > 7.0
    left = float(actors.index.to_numpy()[np.argmax(actors["right.y"].to_numpy() > 4.0)])
    assert left - 1.0 < entered < left + 3.0
    assert run["ego.x"].iloc[-1] > JUNCTION
    assert not run.summary["vehicles"]["ego"]["collisions"]


@pytest.mark.slow
def test_an_actor_gives_way_to_a_vehicle_from_its_right(tmp_path: Path) -> None:
    run = simulation(tmp_path, {"ego": (270, 90)}, {"left": (180, 0)}).run(duration=12.0)
    time = run.signals.index.to_numpy()
    _, left = times_inside(time, run["ego.x"].to_numpy(), run["ego.y"].to_numpy())
    entered, _ = times_inside(
        run.actors.index.to_numpy(), *(run.actors[f"left.{key}"].to_numpy() for key in ("x", "y"))
    )
    assert run["ego.vx"][time < left].min() > 7.0
    assert entered > left - 2.0
    assert not run.summary["vehicles"]["ego"]["collisions"]


@pytest.mark.slow
@pytest.mark.parametrize("signals", [{}, STOPS], ids=["equal", "stop"])
def test_four_vehicles_that_arrive_at_the_same_time_pass_one_after_another(
    signals: dict[int, str], tmp_path: Path
) -> None:
    ways = {"a": (0, 180), "b": (90, 270), "c": (180, 0), "d": (270, 90)}
    run = simulation(tmp_path, ways, {}, signals=signals).run(duration=60.0)
    time = run.signals.index.to_numpy()
    inside = {name: times_inside(time, run[f"{name}.x"].to_numpy(), run[f"{name}.y"].to_numpy()) for name in ways}
    assert min(inside, key=lambda name: inside[name][0]) == "a"
    assert max(last for _, last in inside.values()) < 55.0
    for name in ways:
        assert not run.summary["vehicles"][name]["collisions"]
        assert max(abs(run[f"{name}.x"].iloc[-1]), abs(run[f"{name}.y"].iloc[-1])) > 2.0 * JUNCTION
        # Before an all-way stop each has stopped.
        before = time < inside[name][0]
        assert not signals or run[f"{name}.vx"][before].min() < 0.15
