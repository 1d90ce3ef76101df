"""Traffic in whole runs: impacts, red lights, streams of random numbers, other vehicles, search."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from mirdrake.actors.crew import make_crew, start_states
from mirdrake.actors.lanes import LaneTable
from mirdrake.actors.occupancy import LINE, OBJECT, OnLane, fill_yield_lines
from mirdrake.actors.step import TimeStep
from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.compiled import records
from mirdrake.suites import collect_cases
from mirdrake.suites.cases import collect_searches
from mirdrake.suites.search import search
from mirdrake.suites.worker import run_case
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import World, load_world, make_world
from mirdrake.worlds.lights import RED
from tests.actor_rigs import simulation, world_file
from tests.test_actor_entries import chain

DT = 0.02  # [s]
BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def states_over(world: World, duration: float) -> list[Any]:
    """Return the states of the actors at all time steps."""
    lanes, crew, _ = make_crew(world, {}, 0)
    step, states = TimeStep(lanes, crew), [start_states(world, lanes)]
    claims = step.claims()
    for k in range(round(duration / DT)):
        after = np.empty_like(states[-1])
        step(states[-1], np.empty((0, 5)), k * DT, DT, after, claims)
        states.append(after)
    return states


class Stopper(NamedTuple):
    """Braking profile of the driver obstacle_stopper."""

    distance: float  # [m]
    deceleration: float  # [m/s²]
    reaction: float  # [s]

    def begins_at(self, speed: float) -> float:
        """Return the gap at which it begins to brake for something at rest [m]."""
        return self.distance + self.reaction * speed + speed**2 / (2.0 * self.deceleration)

    def speed_at(self, gap: float) -> float:
        """Return the largest speed with a gap [m] to the car ahead, m/s; infinite gap: beyond the range of the scan.

        It stops before what it sees, and within its range of 50 m, where a car is noticed up to 50 ms late.
        """

        def stopping_from(rest: float, delay: float) -> float:
            lag = self.deceleration * delay
            return math.sqrt(lag**2 + 2.0 * self.deceleration * max(rest - self.distance, 0.0)) - lag

        seen = stopping_from(gap, self.reaction) if gap < 50.0 else math.inf
        return min(seen, stopping_from(50.0, self.reaction + 0.05))


class Target(NamedTuple):
    """A car ahead: its distance when the run begins [m], its speed [m/s], and its deceleration after 1 s [m/s²]."""

    gap: float
    speed: float
    deceleration: float

    def at(self, time: float) -> tuple[float, float]:
        """Return the distance from the vehicle's place at the start [m], and the speed [m/s]."""
        v, a = self.speed, self.deceleration
        since = min(max(time - 1.0, 0.0), v / a) if a > 0.0 else 0.0
        until = min(time, 1.0) if a > 0.0 else time
        return self.gap + v * (until + since) - 0.5 * a * since**2, v - a * since


class Braking(NamedTuple):
    """Limits of the slope of the speed set-point up and down [m/s²], and how the vehicle follows them."""

    up: float
    down: float
    response: Any  # speed less set-point, 20 ms apart, after the slope has changed by 1 m/s² [m/s]


def measured_braking(folder: Path) -> Braking:
    """Return the braking of the vehicle on its own, from 80 km/h with the largest slope."""
    limits, speed, begin = load_vehicle("bolt").control.speed, 80 / 3.6, 1.0
    rows = [{"time": 0, "speed": speed}, {"time": begin, "speed": speed}, {"time": begin + 1e-3, "speed": 0}]
    drive = simulation(
        world_file(folder, tracks=None), speed=speed, control={"ego": {"kind": "schedule", "rows": rows}}
    )
    run = drive.run(duration=begin + 5.0)
    down = limits.max_deceleration
    # The ramp begins with the first step of the control unit after the command.
    ramp = begin + 0.02
    times = np.arange(0.0, speed / down - 0.5, 0.02)
    found = np.interp(ramp + times, run.signals.index.to_numpy(), run["ego.vx"].to_numpy())
    return Braking(limits.max_acceleration, down, (found - (speed - down * times)) / -down)


def kinematic_impact(speed: float, target: Target, driver: Stopper, braking: Braking) -> tuple[float, float | None]:
    """Return the time of the impact [s] of a point with the driver's speed and the speed difference [m/s].

    Without an impact, the difference is None, and the time is when both are at rest, at most 15 s.

    The driver decides at 20 Hz and sees 50 m far. The control unit follows at 50 Hz, with limited slopes. It reads the
    decision before the present one when both are due. The speed differs from the set-point by the response of the
    vehicle to all changes of the slope.
    """
    dt, v, x, setpoint, acceleration = 0.01, speed, 0.0, speed, 0.0
    command = min(speed, driver.speed_at(target.at(0.0)[0]))  # of the initialisation
    slopes = [0.0]
    for k in range(1500):
        place, other = target.at(k * dt)
        gap = place - x
        if gap < 0.0:
            return k * dt, v - other
        if v < 0.01 and other <= 0.0:
            return k * dt, None
        if k % 2 == 0:
            slopes.append(min(max((command - setpoint) / 0.02, -braking.down), braking.up))
            setpoint += 0.02 * slopes[-1]
            # The newest change is one step old at the end of this step; the response keeps its last value.
            age = np.minimum(np.arange(len(slopes) - 1, 0, -1), len(braking.response) - 1)
            after = max(setpoint + float(np.diff(slopes) @ braking.response[age]), 0.0)
            acceleration = (after - v) / 0.02
        if k % 5 == 0:
            command = min(speed, driver.speed_at(gap))
        x += v * dt + 0.5 * acceleration * dt**2
        v += acceleration * dt
    return 15.0, None


@pytest.mark.slow
@pytest.mark.parametrize("driver", [Stopper(5.0, 3.0, 0.3), Stopper(0.5, 12.0, 0.0)], ids=["usual", "late"])
@pytest.mark.parametrize("speed", [20 / 3.6, 35 / 3.6, 50 / 3.6, 65 / 3.6, 80 / 3.6])
def test_car_to_car_rear_with_the_braking_profile_of_obstacle_stopper_is_as_the_kinematics(
    speed: float, driver: Stopper, tmp_path: Path
) -> None:
    braking = measured_braking(tmp_path)
    if driver.deceleration > braking.down:
        # The reference in closed form, for a vehicle that follows its set-point: braking with the limit begins up to
        # 70 ms late (both periods), and lasts until the impact.
        square, way = speed**2 - 2.0 * braking.down * driver.begins_at(speed), 2.0 * braking.down * speed * 0.07
        exact = braking._replace(response=np.zeros(1))
        _, found = kinematic_impact(speed, Target(60.0, 0.0, 0.0), driver, exact)
        assert found is not None
        assert square <= found**2 <= square + way

    far = min(60.0, 8.0 + 3.0 * speed)
    targets = {
        "stationary": Target(far, 0.0, 0.0),
        "moving": Target(far, 20 / 3.6, 0.0),
        "braking_2": Target(40.0, speed, 2.0),
        "braking_6": Target(40.0, speed, 6.0),
    }
    for name, given in targets.items():
        path = [[given.gap, 0], [given.gap + 600, 0]]
        car = {"actor": "sedan", "name": name, "path": path, "speed": given.speed, "behaviour": "follow"}
        brakes = given.deceleration > 0.0
        scenario = {name: [{"at": 1.0, "stop": {"rate": given.deceleration}}]} if brakes else None
        folder = tmp_path / name
        folder.mkdir()
        world = world_file(folder, actors=[car], scenario=scenario, tracks=None)
        control: dict[str, Any] = {"kind": "obstacle_stopper", "speed": speed} | driver._asdict()
        drive = simulation(world, speed=speed, control={"ego": control})
        front = max(float(x) for x in drive._volumes["ego"].outline[:, 0])
        (actor,) = drive.assembly.parts.world.actors
        end, expected = kinematic_impact(speed, given._replace(gap=given.gap - actor.rear - front), driver, braking)
        run = drive.run(duration=end + 1.0)
        hits = run.summary["vehicles"]["ego"]["collisions"]
        assert bool(hits) == (expected is not None), name
        if expected is not None:
            assert hits[0]["difference_mps"] == pytest.approx(expected, abs=0.3), name
        # A driver that brakes as hard as it believes stops within what it sees, at any speed.
        if name == "stationary" and driver.deceleration < braking.down:
            assert expected is None


@pytest.mark.slow
def test_a_hundred_actors_cost_less_than_a_third_of_the_vehicle_and_a_scan_among_thirty_cars_4_ms() -> None:
    """Processor times without and with actors in turn, so that the load of the machine cancels out."""
    command = [sys.executable, str(BENCHMARKS / "actors.py"), "--pairs", "3", "--scans", "60"]
    one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(BENCHMARKS.parent)}
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | one_thread)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for contact in ("point", "hydroelastic"):
        assert found[f"100_actors_{contact}"]["more_percent"] < 30.0, found
    assert found["lidar_16x900"]["among_30_cars_ms"] < 4.0, found


@pytest.mark.slow
def test_actors_at_lights_never_pass_red_and_stop_before_the_line() -> None:
    light = {"controls": ["main@110"], "programme": {"green": 10, "amber": 3, "red": 17}}
    car = {"actor": "sedan", "on_track": {"track": "main", "s": 10}, "speed": 13.0}
    car["behaviour"] = {"kind": "idm", "standstill": 1.5}  # also the distance of a stop before the line
    tracks = {"main": {"segments": [{"line": 300}]}}
    data = {"mirdrake": "world/1", "tracks": tracks, "signals": {"light": light}, "actors": [car]}
    world = make_world(data)
    lanes, crew, _ = make_crew(world, {}, 0)
    step, stops = TimeStep(lanes, crew), 0
    claims = step.claims()
    for offset in np.random.default_rng(4).uniform(0.0, 30.0, 100):
        crew.programmes[0, 3] = offset
        now = start_states(world, lanes)
        places: list[float] = []
        speeds: list[float] = []
        while now["s"][0] + world.actors[0].front < 110.0:
            after = np.empty_like(now)
            step(now, np.empty((0, 5)), len(places) * DT, DT, after, claims)
            now = after
            places.append(float(now["s"][0]) + world.actors[0].front)
            speeds.append(float(now["v"][0]))
            assert len(places) < 3000
        # The state of the light at the crossing, from its own definition.
        phase = (len(places) * DT + offset) % 30.0
        assert phase < 13.0, offset
        standing = [place for place, speed in zip(places, speeds, strict=True) if speed < 0.05 and place > 60.0]
        if standing:
            stops += 1
            assert -2.0 <= standing[-1] - 110.0 <= 0.0
    assert stops > 20


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_vehicle_at_twenty_lights_never_passes_red_and_stops_within_two_metres(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    lines = [70.0 + 70.0 * i for i in range(20)]
    signals = {
        f"light_{i}": {
            "controls": [f"main@{line}"],
            "programme": {"green": 6, "amber": 3, "red": 8},
            "offset": float(rng.uniform(0.0, 17.0)),
        }
        for i, line in enumerate(lines)
    }
    tracks = {"main": {"segments": [{"line": 1550}], "width": 4}}
    world = world_file(tmp_path, tracks=tracks, signals=signals, ground={"size": [1800, 200]})
    driver = {"kind": "traffic", "track": "main", "speed": 11}
    drive = simulation(world, speed=11.0, start={"x": 5, "y": 0}, control={"ego": driver})
    port = drive.assembly.ports["ego.state"]
    run = drive.run(
        duration=2000.0, until=lambda context: port.Eval(port.get_system().GetMyContextFromRoot(context))[0] > 1410.0
    )
    front = max(float(x) for x in drive._volumes["ego"].outline[:, 0])
    time, x, vx = run.signals.index.to_numpy(), run["ego.x"].to_numpy(), run["ego.vx"].to_numpy()
    stops = 0
    for light in drive.assembly.parts.world.lights.values():
        ((_, line),) = light.lines
        crossed = int(np.argmax(x + front >= line))
        assert x[crossed] + front >= line, light.name
        assert float(light.state(time[crossed])) != RED, light.name
        near = (x + front > line - 20.0) & (x + front < line + 1.0) & (np.abs(vx) < 0.02)
        if near.any():
            stops += 1
            assert -2.0 <= float((x[near] + front - line).max()) <= 0.0, light.name
    assert stops >= 1


def test_random_values_of_an_actor_do_not_depend_on_the_number_of_actors() -> None:
    def car(name: str, s: float) -> dict[str, Any]:
        return {"actor": "sedan | van", "name": name, "on_track": {"track": "main", "s": s}, "speed": "8 .. 20"}

    def values(*actors: dict[str, Any]) -> dict[str, list[float]]:
        tracks = {"main": {"segments": [{"line": 2000}]}}
        data = {"mirdrake": "world/1", "ground": {"size": [5000, 200]}, "tracks": tracks, "actors": list(actors)}
        world = make_world(data)
        last = states_over(world, 5.0)[-1]
        # Without the gap to the others, which is recorded as well.
        return {
            actor.name: [float(last[key][i]) for key in ("x", "v", "desired")] for i, actor in enumerate(world.actors)
        }

    # Alone, with others before and behind it in the list, and in another order.
    few = values(car("b", 100.0), car("d", 300.0))
    more = values(car("a", 500.0), car("d", 300.0), car("c", 700.0), car("b", 100.0))
    assert {name: more[name] for name in few} == few
    assert len({desired for _, _, desired in more.values()}) == 4


def test_a_yield_line_is_closed_for_all_but_the_vehicle_that_closes_it() -> None:
    table: LaneTable = chain(100.0, 100.0)
    lines = np.array([[0.0, 60.0, 1.0, 50.0, 50.0, 3.0, 0.0]])

    def blockers(*middles: float, speed: float = 10.0) -> list[int]:
        objects = np.zeros(10, OBJECT).view(np.recarray)
        for k, middle in enumerate(middles):
            objects[k] = records(OnLane, [OnLane(1, k, middle, 2.0, speed, -1.0, 1.0, -1)])[0]
        count = fill_yield_lines(table, lines, objects, len(middles))
        assert all(objects.owner[len(middles) : count] == LINE)
        return [int(one) for one in objects.blocker[len(middles) : count]]

    # Half of its length and 2 m of clearance belong to each vehicle; it covers 30 m within the gap.
    assert blockers(15.9) == []
    assert blockers(16.1) == [0]
    assert blockers(53.9) == [0]
    assert blockers(54.1) == []
    assert blockers(45.9, speed=0.0) == []
    assert blockers(46.1, speed=0.0) == [0]
    # Two of them: closed for everyone.
    assert blockers(40.0, 30.0, 20.0) == [0, 1]


PLATOON: dict[str, Any] = {
    "mirdrake": "world/1", "name": "platoon",
    "tracks": {"main": {"segments": [{"line": 400}], "width": 4}},
    "ground": {"size": [1000, 200]},
    "start": {
        "behind": {"on_track": {"track": "main", "s": 10}, "speed": 10},
        "ahead": {"on_track": {"track": "main", "s": 40}, "speed": 10},
    },
    "goals": {"half": {"gate": {"track": "main", "s": 110}}},
}  # fmt: skip


@pytest.mark.slow
def test_requirements_on_other_vehicles_decide(tmp_path: Path) -> None:
    def verdict(limit: float) -> Any:
        leader = {
            "start": "ahead", "goal": "half", "behaviour": {"kind": "traffic", "track": "main", "speed": 10},
            "expect": [f"always speed < {limit} m/s", "eventually at goal"],
        }  # fmt: skip
        follower = {
            "name": "follows", "start": "behind", "behaviour": {"kind": "acc", "track": "main", "speed": 12},
            "duration": 9, "expect": ["never collision", "always gap to leader > 5 m"], "others": {"leader": leader},
        }  # fmt: skip
        path = tmp_path / f"platoon_{limit:g}.yaml"
        path.write_text(yaml.safe_dump(PLATOON | {"tests": [follower]}, sort_keys=False))
        (case,) = collect_cases([path])
        return run_case(case)

    good = verdict(12.0)
    assert good.verdict == "pass", good.reason
    assert len(good.findings) == 4
    bad = verdict(5.0)
    assert bad.verdict == "fail"
    assert "speed < 5" in bad.worst.text
    assert bad.worst.margin == pytest.approx(-5.0, abs=0.5)


@pytest.mark.slow
def test_search_finds_the_edge_of_an_actors_start_distance(tmp_path: Path) -> None:
    # Both at 14 m/s; the car ahead brakes with 4 m/s² from 1 s on. After 4 s the gap is smaller by 4/2 3² = 18 m.
    data = {
        "mirdrake": "world/1", "name": "edge", "params": {"gap": 30},
        "tracks": {"main": {"segments": [{"line": 300}], "width": 4}}, "ground": {"size": [800, 200]},
        "start": {"go": {"on_track": {"track": "main", "s": 10}, "speed": 14}},
        "actors": [{"actor": "sedan", "name": "target", "path": [["15 + $gap", 0], [290, 0]], "speed": 14}],
        "scenario": {"target": [{"at": 1, "stop": {"rate": 4}}]},
        "tests": [{
            "name": "blind", "behaviour": {"kind": "constant", "speed": 14}, "duration": 4,
            "expect": ["never collision"],
            "search": {"over": {"gap": [6, 40]}, "budget": 12},
        }],
    }  # fmt: skip
    path = tmp_path / "edge.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    ((case, spec),) = collect_searches(path)
    result = search(case, spec.over, spec.budget)
    assert len(result.tried) == 12
    gaps = {verdict: [float(str(trial.values["gap"])) for trial in result.tried if trial.result.verdict == verdict]
            for verdict in ("pass", "fail")}  # fmt: skip
    # From the front of the vehicle, whose rear axle is at 10 m, to the rear of the car ahead.
    (actor,) = load_world(str(path)).actors
    front = max(float(x) for x in volume_of(load_vehicle("bolt")).outline[:, 0])
    edge = 18.0 - 5.0 + front + actor.rear
    assert max(gaps["fail"]) < edge + 0.3
    assert min(gaps["pass"]) > edge - 0.3
    assert min(gaps["pass"]) - max(gaps["fail"]) < 8.0
    assert result.worst is not None
    assert result.worst.margin < 0.0
