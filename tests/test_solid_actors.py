"""Solid actors: bodies of the plant that follow the motion of the actor and collide with vehicles."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context

from mirdrake.runs.simulation import Simulation
from mirdrake.worlds import load_world
from mirdrake.worlds.lock import lock_text
from tests.actor_rigs import simulation, world_file


def body_states(drive: Simulation, duration: float) -> tuple[Any, Any, Any]:
    """Return times (n), x, y, yaw of the body of a solid actor and their rates (n, 6), and those of the actor."""
    parts = drive.assembly.parts
    traffic: Any = drive.assembly.diagram.GetSubsystemByName("traffic")
    instance = parts.actors.instance
    assert instance is not None
    times, bodies, actors = [], [], []

    def look(context: Context) -> None:
        times.append(context.get_time())
        bodies.append(parts.plant.GetPositionsAndVelocities(parts.plant.GetMyContextFromRoot(context), instance))
        actors.append(traffic.solid_states(traffic.GetMyContextFromRoot(context)))

    drive.run(duration=duration, monitor=look)
    # The first of each step of the plant: multiples of 5 and of 20 ms differ by rounding, and events at both are steps.
    rows = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0.004)
    return np.array(times)[rows], np.array(bodies)[rows], np.array(actors)[rows]


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_the_body_of_a_solid_actor_follows_its_motion(contact: str, tmp_path: Path) -> None:
    # More than a lap of a circle, whose yaw begins again at its end.
    tracks = {
        "main": {"segments": [{"line": 400}]},
        "ring": {"segments": [{"arc": {"radius": 12, "angle": "360 deg"}}], "start": {"at": [0, 60]}, "closed": True},
    }
    car = {"actor": "sedan", "name": "car", "on_track": {"track": "ring", "s": 55}, "speed": 8, "body": "solid"}
    drive = simulation(world_file(tmp_path, tracks=tracks, actors=[car]), plant={"contact": contact})
    _, bodies, actors = body_states(drive, 4.0)
    assert np.ptp(actors[:, 2]) == pytest.approx(4.0 * 8.0 / 12.0, rel=0.02)
    # Outside by the acceleration over the square of the natural frequency, 8²/12/30² = 6 mm, and a step of the plant.
    away = np.hypot(*(bodies - actors)[:, :2].T)
    assert 0.005 < away[-1] < 0.008
    assert away.max() < 0.012
    assert np.abs(bodies - actors)[:, 2].max() < 0.01


def crash(tmp_path: Path, body: str, speed: float = 6.0) -> tuple[Simulation, Any]:
    car = {"actor": "sedan", "name": "parked", "path": [[8, 0], [40, 0]], "speed": 0, "body": body}
    drive = simulation(world_file(tmp_path, tracks=None, actors=[car]), speed=speed)
    return drive, car


def test_a_vehicle_that_hits_a_solid_actor_pushes_it_and_is_slowed_down(tmp_path: Path) -> None:
    (tmp_path / "ghost").mkdir()
    ghost, _ = crash(tmp_path / "ghost", "ghost")
    run = ghost.run(duration=1.5)
    assert run["ego.vx"].iloc[-1] == pytest.approx(6.0, abs=0.1)
    solid, _ = crash(tmp_path, "solid")
    run = solid.run(duration=1.5)
    (hit,) = run.summary["vehicles"]["ego"]["collisions"]
    assert hit["with"] == "parked"
    assert hit["difference_mps"] == pytest.approx(6.0, abs=0.3)
    assert run["ego.vx"].min() < 4.5
    # The contact is one with the actor, not with the ground.
    assert all("the ground" not in event["text"] for event in run.events)

    # Momentum in the first 60 ms of the impact: what the car loses the actor gains, but for its brakes.
    times, bodies, _ = body_states(solid, 1.5)
    plant = solid.assembly.parts.plant
    mass = plant.CalcTotalMass(plant.CreateDefaultContext(), [solid.assembly.parts.vehicles["ego"].instance])
    (actor,) = solid.assembly.parts.world.actors
    begin = float(times[np.argmax(bodies[:, 3] > 1e-3)]) - 0.01
    speeds = [float(np.interp(begin + late, run.signals.index, run["ego.vx"])) for late in (0.0, 0.06)]
    gained = float(np.interp(begin + 0.06, times, bodies[:, 3])) * actor.prop.mass
    lost = (speeds[0] - speeds[1]) * mass
    outside = (0.9 * 9.81 * mass + 8.0 * actor.prop.mass) * 0.06  # tyres of the car, brakes of the actor
    assert gained > 3.0 * outside
    assert abs(lost - gained) < outside


def test_the_body_of_a_solid_actor_climbs_a_grade_and_is_hit_there(tmp_path: Path) -> None:
    """10 %, from 2 m above the lowest ground: the body is at the height of the road, and a vehicle hits it."""
    grade = {"size": [200, 200], "relief": [{"plane": {"grade": 0.1, "height": "2 m"}}]}
    car = {"actor": "sedan", "name": "car", "path": [[12, 0], [60, 0]], "speed": 1, "body": "solid"}
    drive = simulation(world_file(tmp_path, tracks=None, ground=grade, actors=[car]), speed=8.0)
    run = drive.run(duration=2.2)
    (hit,) = run.summary["vehicles"]["ego"]["collisions"]
    assert hit["with"] == "car"
    _, bodies, _ = body_states(drive, 2.2)
    assert bodies.shape[1] == 8
    early = bodies[:100]  # before the impact
    assert early[:, 2] == pytest.approx(2.0 + 0.1 * early[:, 0], abs=5e-3)
    assert bodies[-1, 4] > 1.5  # pushed uphill


@pytest.mark.slow
def test_the_force_of_a_solid_actor_is_that_of_its_hardest_braking(tmp_path: Path) -> None:
    drive, _ = crash(tmp_path, "solid", speed=3.0)
    times, bodies, actors = body_states(drive, 5.5)
    away = bodies[:, 0] - actors[:, 0]
    assert away.max() > 0.8
    # Pushed away it comes back, at no more than 8 m/s² of its own.
    assert away[-1] < 0.7 * away.max()
    back = slice(int(away.argmax()), None)
    assert (np.diff(bodies[back, 3]) / np.diff(times[back])).min() > -8.1


def test_lock_files_have_no_key_for_the_default(tmp_path: Path) -> None:
    texts = []
    for body in ({}, {"body": "ghost"}, {"body": "solid"}):
        car = {"actor": "sedan", "name": "car", "path": [[14, 0], [40, 0]], **body}
        texts.append(lock_text(load_world(str(world_file(tmp_path, actors=[car])))))
    assert texts[0] == texts[1]
    assert "body: solid" not in texts[0]
    assert "body: solid" in texts[2]
