"""Actors on a network obey the right of way of its junctions."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.actors.crew import make_crew, start_states
from mirdrake.actors.step import TimeStep
from mirdrake.worlds import World, make_world
from mirdrake.worlds.clearance import clearance_between
from tests.opendrive_maps import crossing, signal

DT = 0.02  # [s]


def world_of(folder: Path, cars: dict[str, tuple[str, float]], **options: Any) -> World:
    """Return a crossing with cars by name: lane, station [m]; all at 8 m/s."""
    (folder / "map.xodr").write_text(crossing(**options), encoding="utf-8")
    actors = [
        {"actor": "sedan", "name": name, "on_lane": {"lane": lane, "s": s}, "speed": 8, "behaviour": "idm"}
        for name, (lane, s) in cars.items()
    ]
    data = {"mirdrake": "world/1", "network": {"xodr": "map.xodr"}, "actors": actors}
    return make_world(data, path=folder / "world.yaml")


def drive(world: World, duration: float) -> tuple[dict[str, float], float]:
    """Return when each car has its middle past the junction, and the smallest distance of two cars [m]."""
    lanes, crew, _ = make_crew(world, {}, 0)
    step, now = TimeStep(lanes, crew), start_states(world, lanes)
    names, numbers = [actor.name for actor in world.actors], {name: k for k, name in enumerate(world.lanes)}
    inner = {numbers[name] for junction in world.network.junctions.values() for name in junction.lanes}  # type: ignore[union-attr]
    left: dict[str, float] = {}
    entered: set[str] = set()
    poses: list[Any] = []
    for k in range(round(duration / DT)):
        after = np.empty_like(now)
        step(now, np.empty((0, 5)), k * DT, DT, after)
        now = after
        poses.append(np.column_stack([now[key] for key in ("x", "y", "yaw")]))
        for name, lane in zip(names, now["lane"], strict=True):
            if int(lane) in inner:
                entered.add(name)
            elif name in entered:
                left.setdefault(name, k * DT)
    volume, places = world.actors[0].volume, np.array(poses)
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    return left, min(float(clearance_between(volume, places[:, i], volume, places[:, j]).min()) for i, j in pairs)


@pytest.mark.parametrize("ahead", [-6.0, -2.0, 0.0, 3.0])
def test_a_car_gives_way_to_one_from_its_right(ahead: float, tmp_path: Path) -> None:
    alone, _ = drive(world_of(tmp_path, {"east": ("180.0.1", 10), "north": ("270.0.1", 0)}), 0.1)
    assert not alone
    cars = {"east": ("180.0.1", 10.0 + ahead), "north": ("270.0.1", 10.0)}
    left, distance = drive(world_of(tmp_path, cars), 25.0)
    # The one from the south has priority and drives through at nearly its speed; the other one waits for it.
    assert left["north"] < (40.0 + 20.0) / 8.0 + 1.5
    assert left["east"] > left["north"] + 1.0
    assert distance > 0.5


def test_a_car_passes_a_crossing_without_others(tmp_path: Path) -> None:
    left, _ = drive(world_of(tmp_path, {"east": ("180.0.1", 10.0), "late": ("270.0.1", 0.0)}), 25.0)
    assert set(left) == {"east", "late"}
    first, _ = drive(world_of(tmp_path, {"east": ("180.0.1", 40.0), "late": ("90.0.1", 0.0)}), 15.0)
    # One from the left has to wait: no effect on this one.
    assert first["east"] == pytest.approx((10.0 + 20.0) / 8.0, abs=0.7)


def test_signs_decide_before_the_side(tmp_path: Path) -> None:
    signs = {270: signal("s", 0.5, "205"), 90: signal("n", 0.5, "205")}
    cars = {"east": ("180.0.1", 10.0), "north": ("270.0.1", 10.0)}
    left, distance = drive(world_of(tmp_path, cars, signals=signs), 25.0)
    assert left["north"] > left["east"] + 1.0
    assert distance > 0.5


def test_dense_traffic_on_two_roads_does_not_overlap(tmp_path: Path) -> None:
    cars = {f"e{k}": ("180.0.1", 1.0 + 9.0 * k) for k in range(5)} | {
        f"n{k}": ("270.0.1", 3.0 + 9.0 * k) for k in range(5)
    }
    left, distance = drive(world_of(tmp_path, cars), 60.0)
    assert len(left) == 10
    assert distance > 0.3
    assert math.isfinite(distance)


def test_the_first_to_enter_drives_where_nobody_has_priority(tmp_path: Path) -> None:
    signs = {d: signal(f"stop{d}", 0.5, "206") for d in (0, 90, 180, 270)}
    for first, second in (("180.0.1", "270.0.1"), ("270.0.1", "180.0.1")):
        world = world_of(tmp_path, {"first": (first, 14.0), "second": (second, 4.0)}, signals=signs)
        assert world.network is not None
        assert world.network.junctions["J"].rule == "all_way_stop"
        left, distance = drive(world, 20.0)
        assert left["first"] < left["second"]
        assert distance > 0.3
