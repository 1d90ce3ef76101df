"""Actors that are full vehicles: their drivers follow the motion of the behaviour, and others see the vehicles."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mirdrake.actors.crew import check_path
from mirdrake.core.errors import ConfigError
from mirdrake.editor.actors import actors_of
from mirdrake.editor.picture import _actors
from mirdrake.runs.logs import load_run
from mirdrake.suites import collect_cases
from mirdrake.suites.worker import run_case
from mirdrake.worlds import load_world
from mirdrake.worlds.lock import lock_text
from tests.actor_rigs import STRAIGHT, simulation, world_file

LEAD: dict[str, Any] = {
    "actor": "bolt", "name": "lead", "body": "full", "on_track": {"track": "main", "s": 40}, "speed": 12,
    "behaviour": "idm",
}  # fmt: skip
SCENARIO = {"lead": [{"at": 0.5, "change_lane": "left in 3 s"}, {"at": 4, "stop": {"rate": 4}}]}


def test_a_full_vehicle_follows_the_steps_of_its_scenario(tmp_path: Path) -> None:
    follower = LEAD | {"actor": "sedan", "name": "follower", "body": "ghost", "speed": 10}
    follower["on_track"] = {"track": "main", "s": 10, "lane": "left"}
    drive = simulation(world_file(tmp_path, actors=[LEAD, follower], scenario=SCENARIO))
    run = drive.run(duration=14.0, folder=tmp_path / "run")
    time, x, y = run.signals.index.to_numpy(), run["lead.x"].to_numpy(), run["lead.y"].to_numpy()

    # The lanes are 3.5 m apart; the change is complete at its time, and the stop has its rate from the speed before.
    assert y[0] == pytest.approx(-1.75, abs=1e-6)
    assert y[time > 3.8] == pytest.approx(1.75, abs=0.1)
    speed = np.interp(4.0, time, run["lead.vx"])
    assert 11.0 < speed < 12.0
    assert x[-1] == pytest.approx(np.interp(4.0, time, x) + speed**2 / (2.0 * 4.0), abs=0.2)
    assert np.interp(5.0, time, run["lead.vx"]) == pytest.approx(speed - 4.0, abs=0.2)
    assert run["lead.vx"].iloc[-1] == pytest.approx(0.0, abs=0.01)

    # An actor behind it keeps the standstill gap to the vehicle, not to the motion that the vehicle follows.
    (actor,) = drive.assembly.parts.world.actors
    rear = -float(drive._volumes["lead"].outline[:, 0].min())
    gap = x[-1] - rear - float(run.actors["follower.x"].iloc[-1]) - actor.front
    assert gap == pytest.approx(float(run.actors["follower.gap"].iloc[-1]), abs=0.01)  # of a step before
    assert gap == pytest.approx(2.0, abs=0.5)

    # It is a vehicle of the run, and an actor of its world.
    stored = load_run(tmp_path / "run").scene()
    assert list(stored.vehicles) == ["ego", "lead"]
    assert [full.name for full in stored.world.full_actors] == ["lead"]


def test_a_full_vehicle_waits_for_its_start_and_keeps_its_path(tmp_path: Path) -> None:
    turn = LEAD | {"path": [[30, -30], [30, 0], [80, 0]], "radius": 8, "speed": 5, "behaviour": "follow"}
    turn |= {"starts": {"at": 1.0}}
    del turn["on_track"]
    drive = simulation(world_file(tmp_path, actors=[turn], tracks=None))
    run = drive.run(duration=11.5)
    time, x, y = run.signals.index.to_numpy(), run["lead.x"].to_numpy(), run["lead.y"].to_numpy()
    assert np.abs(y[time < 1.0] + 30.0).max() < 0.02
    # The arc about (38, -8) between the straights.
    on_arc = (x < 38.0) & (y > -8.0)
    assert on_arc.sum() > 50
    assert np.hypot(x - 38.0, y + 8.0)[on_arc] == pytest.approx(8.0, abs=0.2)
    assert np.abs(y[x > 42.0]).max() < 0.2


@pytest.mark.slow
def test_requirements_know_the_gap_to_a_full_vehicle(tmp_path: Path) -> None:
    test = {
        "name": "follows", "start": "go", "behaviour": {"kind": "traffic", "track": "main", "speed": 12},
        "duration": 9, "expect": ["never collision", "always gap to lead > 1 m"],
    }  # fmt: skip
    world = {
        "mirdrake": "world/1", "name": "w", "tracks": {"main": {"segments": [{"line": 400}], "width": 4}},
        "ground": {"size": [900, 200]}, "start": {"go": {"on_track": {"track": "main", "s": 10}, "speed": 12}},
        "actors": [LEAD], "scenario": {"lead": [{"at": 1, "stop": {"rate": 3}}]}, "tests": [test],
    }  # fmt: skip

    def result(driver: Any) -> Any:
        path = tmp_path / f"{driver['kind']}.yaml"
        path.write_text(yaml.safe_dump(world | {"tests": [test | {"behaviour": driver}]}, sort_keys=False))
        (case,) = collect_cases([path])
        return run_case(case)

    good = result({"kind": "traffic", "track": "main", "speed": 12})
    assert good.verdict == "pass", good.reason
    assert result({"kind": "constant", "speed": 12}).verdict == "fail"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"behaviour": "walk"}, "walk is a behaviour of pedestrians; a full vehicle has follow, idm or idm_mobil"),
        ({"color": "red"}, "color has no effect on a full vehicle, which has its own colours; remove it"),
        ({"name": "ego"}, "'ego' is the name of a vehicle of the diagram; rename the actor"),
        ({"actor": "sedan"}, "unknown vehicle 'sedan'"),
    ],
)
def test_faults_of_full_vehicles_have_one_line(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    entry = {key: value for key, value in (LEAD | changes).items() if value is not None}
    with pytest.raises(ConfigError, match=r"actors.yaml:\d+: ") as caught:
        simulation(world_file(tmp_path, actors=[entry]))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_full_vehicle_needs_bends_that_it_can_drive(tmp_path: Path) -> None:
    turn = {key: value for key, value in LEAD.items() if key != "on_track"} | {"path": [[0, 9], [20, 9], [20, 40]]}
    world = load_world(str(world_file(tmp_path, actors=[turn])))
    (actor,) = world.full_actors
    check_path(actor, world, 5.0)
    with pytest.raises(ConfigError, match=r"actors.yaml:\d+: actors.0.path: bends of 5.4 m radius; .* is 6.00 m"):
        check_path(actor, world, 6.0)


def test_a_diagram_cannot_drive_an_actor(tmp_path: Path) -> None:
    control = {"ego": {"kind": "constant", "speed": 0}, "lead": {"kind": "constant", "speed": 0}}
    with pytest.raises(ConfigError, match="'lead' is an actor of the world, which moves by its behaviour"):
        simulation(world_file(tmp_path, actors=[LEAD]), control=control)


def test_lock_files_contain_full_vehicles(tmp_path: Path) -> None:
    text = lock_text(load_world(str(world_file(tmp_path, actors=[LEAD], scenario=SCENARIO))))
    assert '"bolt"' in text or "model: bolt" in text
    assert "full_actors" in text
    assert "full_actors" not in lock_text(load_world(str(world_file(tmp_path, tracks=STRAIGHT))))


def test_the_editor_draws_a_full_vehicle_and_its_place(tmp_path: Path) -> None:
    world = load_world(str(world_file(tmp_path, actors=[LEAD], scenario=SCENARIO)))
    (drawn,) = _actors(world)
    assert drawn["key"] == "actors/0"
    assert (drawn["x"], drawn["y"]) == pytest.approx((40.0, -1.75))
    assert [actor.name for actor in actors_of(world, 0)] == ["lead"]
