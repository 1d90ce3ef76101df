"""Actors on a network obey the right of way of its junctions."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.actors.crew import make_crew, start_states
from mirdrake.actors.step import TimeStep
from mirdrake.core.paths import find
from mirdrake.worlds import World, load_world, make_world
from mirdrake.worlds.clearance import clearance_between
from tests.opendrive_maps import crossing, signal

DT = 0.02  # [s]
ARMS = (0, 90, 180, 270)  # [deg]
STOPS = {direction: signal(f"stop{direction}", 0.5, "206") for direction in ARMS}
LONGEST = 80.0  # [s] in which eight cars pass, each after the one before it


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
    claims = step.claims()
    names, numbers = [actor.name for actor in world.actors], {name: k for k, name in enumerate(world.lanes)}
    inner = {numbers[name] for junction in world.network.junctions.values() for name in junction.lanes}  # type: ignore[union-attr]
    left: dict[str, float] = {}
    entered: set[str] = set()
    poses: list[Any] = []
    for k in range(round(duration / DT)):
        after = np.empty_like(now)
        step(now, np.empty((0, 5)), k * DT, DT, after, claims)
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


def test_the_first_to_stop_drives_at_an_all_way_stop(tmp_path: Path) -> None:
    for first, second in (("180.0.1", "270.0.1"), ("270.0.1", "180.0.1")):
        world = world_of(tmp_path, {"first": (first, 14.0), "second": (second, 4.0)}, signals=STOPS)
        assert world.network is not None
        assert world.network.junctions["J"].rule == "all_way_stop"
        left, distance = drive(world, 45.0)
        assert left["first"] < left["second"]
        assert distance > 0.3
        # The line is 0.5 m before the junction.
        way = next(way for way in world.ways if way.lane == "180_straight.0.-1")
        assert [way.s, way.length] == pytest.approx([-0.5, 20.5])
        assert way.stops


@pytest.mark.slow
def test_one_that_yields_to_endless_traffic_passes_after_its_patience(tmp_path: Path) -> None:
    signs = {270: signal("s", 0.5, "205"), 90: signal("n", 0.5, "205")}
    cars = {f"east_{k}": ("180.0.1", 1.0 + 16.0 * k) for k in range(3)} | {"north": ("270.0.1", 20.0)}
    world = world_of(tmp_path, cars, signals=signs)
    lanes, crew, _ = make_crew(world, {}, 0)
    step, now = TimeStep(lanes, crew), start_states(world, lanes)
    claims, names = step.claims(), list(world.lanes)
    arrives, leaves = names.index("180.0.1"), names.index("0.0.-1")
    passed, hardest, poses = math.nan, 0.0, []
    for k in range(round(60.0 / DT)):
        after = np.empty_like(now)
        step(now, np.empty((0, 5)), k * DT, DT, after, claims)
        now = after
        # A car that has left comes again as soon as there is room, so that the queue never ends.
        for row in now[:3]:
            last = min((float(other["s"]) for other in now[:3] if other["lane"] == arrives), default=50.0)
            if row["lane"] == leaves and row["s"] > 5.0 and last > 17.0:
                row["lane"], row["s"], row["v"] = arrives, 1.0, min(8.0, float(row["v"]))
        hardest = min(hardest, float(now["a"][:3].min()))
        poses.append(np.column_stack([now[key] for key in ("x", "y", "yaw")]))
        if k * DT == 30.0:
            # It waits since it came. For the 180 s to end 5 s later, its request is made older.
            assert math.isnan(passed)
            assert 0.0 <= claims["since"][3] < 10.0
            claims["since"][3] = 30.0 - 175.0
        if math.isnan(passed) and names[int(now["lane"][3])].startswith("270_"):
            passed = k * DT
    # Those pass first who had reserved their ways before; the next ones brake comfortably.
    assert 35.0 < passed < 50.0
    assert hardest > -3.5
    volume, places = world.actors[0].volume, np.array(poses)
    for other in range(3):
        assert float(clearance_between(volume, places[:, 3], volume, places[:, other]).min()) > 0.5


# --- draws of junctions ---------------------------------------------------------------------------------------------


def draw(folder: Path, seed: int, kind: str, cars: tuple[int, int] = (0, 2)) -> World:
    """Return a crossing of four arms with cars on random ways through it.

    Args:
        folder: for its map.
        seed: of the draw.
        kind: stop: an all-way stop; equal: right before left.
        cars: least and largest number per arm; one per arm all come at the same time.
    """
    rng = np.random.default_rng(seed)
    (folder / "map.xodr").write_text(crossing(signals=STOPS if kind == "stop" else {}), encoding="utf-8")
    tracks: dict[str, Any] = {}
    actors = []
    for arm in ARMS:
        for k in range(rng.integers(cars[0], cars[1] + 1)):
            to = int(rng.choice([other for other in ARMS if other != arm]))
            name = f"way_{arm}_{to}"
            tracks[name] = {"route": {"from": f"{arm}.0.1@1", "to": f"{to}.0.-1@48"}}
            s, speed = (
                (15.0, 8.0) if cars == (1, 1) else (18.0 - 16.0 * k + rng.uniform(0.0, 7.0), rng.uniform(5.0, 12.0))
            )
            place = {"track": name, "s": float(s)}
            car = {"actor": "sedan", "name": f"car_{arm}_{k}", "on_track": place, "speed": float(speed)}
            actors.append(car | {"behaviour": "idm"})
    data = {"mirdrake": "world/1", "network": {"xodr": "map.xodr"}, "tracks": tracks, "actors": actors}
    return make_world(data, path=folder / "world.yaml")


def town(folder: Path, seed: int, count: int = 24) -> World:
    """Return the world `town` with cars on random ways through its crossing and its roundabout.

    Args:
        folder: of the world.
        seed: of the draw; with an odd one, the lights of the crossing are on.
        count: number of cars.
    """
    rng, network = np.random.default_rng(seed), load_world("town").network
    assert network is not None
    arms = [lane for lane in network.driving() if lane.junction is None and lane.length > 25.0]
    begins, ends = [one.id for one in arms if not one.predecessors], [one.id for one in arms if not one.successors]
    tracks: dict[str, Any] = {}
    actors: list[dict[str, Any]] = []
    taken: list[tuple[str, float]] = []
    while len(actors) < count:
        begin, end = str(rng.choice(begins)), str(rng.choice(ends))
        s = float(rng.uniform(2.0, network.lanes[begin].length - 15.0))
        if any(lane == begin and abs(at - s) < 9.0 for lane, at in taken):
            continue
        taken.append((begin, s))
        name = f"way_{begins.index(begin)}_{ends.index(end)}"
        tracks[name] = {"route": {"from": f"{begin}@1", "to": f"{end}@{network.lanes[end].length - 1.0:.1f}"}}
        car = {"actor": "sedan", "name": f"car_{len(actors):02d}", "on_track": {"track": name, "s": s}}
        actors.append(car | {"speed": float(rng.uniform(6.0, 11.0)), "behaviour": "idm"})
    cycle = {"green": 12, "amber": 3, "red": 17}
    lights = {
        name: {"programme": cycle, "offset": 0.0 if {"east", "west"} & set(name.split("_")) else 16.0}
        for name, signal in network.signals.items()
        if signal.kind == "lights" and seed % 2
    }
    data = {"mirdrake": "world/1", "network": {"xodr": str(find("worlds", "town").parent / "maps" / "town.xodr")}}
    return make_world(data | {"tracks": tracks, "actors": actors, "signals": lights}, path=folder / "world.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_crossing_with_lights_and_a_roundabout_become_empty(seed: int, tmp_path: Path) -> None:
    # Cars in a small roundabout would wait for one another in a circle if each junction were reserved by itself.
    time, distance, states = pass_all(town(tmp_path, seed), longest=200.0)
    assert time < 200.0
    assert distance > 0.3
    assert len(states[-1]) == 24


def pass_all(world: World, longest: float = LONGEST) -> tuple[float, float, list[Any]]:
    """Return when the last car is behind all junctions [s], the smallest distance of two cars [m], and all states."""
    lanes, crew, _ = make_crew(world, {}, 0)
    step, now = TimeStep(lanes, crew), start_states(world, lanes)
    claims, states = step.claims(), [now]
    rows, begins = crew.ways.rows, crew.ways.begins
    last = rows[begins[now["lane"].astype(int) + 1] - 1]  # of each car's lane
    while (now["s"] - crew.shape[:, 1] <= last["s"] + last["length"]).any() and len(states) * DT < longest:
        after = np.empty_like(now)
        step(now, np.empty((0, 5)), (len(states) - 1) * DT, DT, after, claims)
        now = after
        states.append(now)
    poses = np.array([np.column_stack([one[key] for key in ("x", "y", "yaw")]) for one in states[::5]])
    distance = math.inf
    for i, j in itertools.combinations(range(len(now)), 2):
        # Exact distances only where the circles around both come near to each other.
        near = np.hypot(*(poses[:, i, :2] - poses[:, j, :2]).T) < 9.0
        if near.any():
            volume = world.actors[0].volume
            distance = min(distance, float(clearance_between(volume, poses[near, i], volume, poses[near, j]).min()))
    return len(states) * DT, distance, states


@pytest.mark.parametrize("kind", ["stop", "equal"])
@pytest.mark.parametrize("cars", [(1, 1), (0, 2)])
@pytest.mark.parametrize(
    "seeds",
    [range(2), pytest.param(range(2, 60), marks=pytest.mark.slow)],
    ids=["few", "many"],
)
def test_everybody_passes_without_overlap(kind: str, cars: tuple[int, int], seeds: range, tmp_path: Path) -> None:
    for seed in seeds:
        time, distance, _ = pass_all(draw(tmp_path, seed, kind, cars))
        assert time < LONGEST, seed
        assert distance > 0.3, seed


def test_the_order_of_equal_ones_is_that_of_their_names(tmp_path: Path) -> None:
    # All go straight on and arrive at the same instant: each has one from its right. The first name opens the circle.
    (tmp_path / "map.xodr").write_text(crossing(), encoding="utf-8")
    tracks = {f"way_{a}": {"route": {"from": f"{a}.0.1@1", "to": f"{(a + 180) % 360}.0.-1@48"}} for a in ARMS}

    def order(names: dict[int, str], *, reverse: bool = False) -> tuple[list[str], bytes]:
        actors = [
            {
                "actor": "sedan",
                "name": names[a],
                "on_track": {"track": f"way_{a}", "s": 15},
                "speed": 8,
                "behaviour": "idm",
            }
            for a in ARMS
        ]
        data = {"mirdrake": "world/1", "network": {"xodr": "map.xodr"}, "tracks": tracks}
        world = make_world(data | {"actors": actors[::-1] if reverse else actors}, path=tmp_path / "world.yaml")
        time, distance, states = pass_all(world)
        assert time < LONGEST
        assert distance > 0.3
        ends = {
            actor.name: next(k for k, one in enumerate(states) if one["s"][i] > 69.0)
            for i, actor in enumerate(world.actors)
        }
        return sorted(ends, key=ends.__getitem__), b"".join(one.tobytes() for one in states)

    first, same = order({0: "a", 90: "b", 180: "c", 270: "d"})
    assert first[0] == "a"
    assert order({0: "a", 90: "b", 180: "c", 270: "d"}, reverse=True) == (first, same)
    assert order({0: "d", 90: "a", 180: "b", 270: "c"})[0][0] == "a"
