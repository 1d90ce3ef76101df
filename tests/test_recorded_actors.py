"""Recorded actors: motion from a CSV file, or from the run of another world."""

import math
from pathlib import Path

import numpy as np
import pytest

from mirdrake.actors.crew import make_crew, start_states
from mirdrake.core.errors import ConfigError
from mirdrake.runs.logs import load_run
from mirdrake.worlds import load_world
from mirdrake.worlds.lock import lock_text, used_files
from tests.actor_rigs import simulation, world_file
from tests.test_traffic_acceptance import DT, states_over

TURN = "\n".join(
    [
        "time,x,y,yaw",
        *(f"{5 + 0.5 * k},{10 * math.sin(0.1 * k)},{10 - 10 * math.cos(0.1 * k)},{0.1 * k}" for k in range(41)),
    ]
)
"""20 s on a circle with a radius of 10 m, at 2 m/s; the first time is 5 s."""


def test_a_recorded_actor_is_where_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "turn.csv").write_text(TURN)
    actor = {"actor": "pedestrian", "name": "walker", "recorded": {"file": "turn.csv", "begin": 5}}
    world = load_world(str(world_file(tmp_path, actors=[actor])))
    states = states_over(world, 22.0)
    for time in (0.0, 3.0, 7.24, 19.98):
        state = states[round(time / DT)][0]
        angle = 0.2 * time
        # Chords of 1 m are at most 1²/8/10 m = 1.25 cm inside of the circle.
        assert math.hypot(state["x"] - 10 * math.sin(angle), state["y"] - 10 + 10 * math.cos(angle)) < 0.013
        assert state["yaw"] == pytest.approx(angle, abs=1e-9)
        if time > 0.0:
            assert state["v"] == pytest.approx(2.0, rel=1e-3)
            assert math.hypot(state["vx"], state["vy"]) == pytest.approx(2.0, rel=1e-3)
            assert state["wz"] == pytest.approx(0.2, rel=1e-6)
    # After its last sample it stands.
    assert states[-1][0]["v"] == 0.0
    assert states[-1][0]["yaw"] == pytest.approx(4.0)
    assert world.paths["path/walker"].length == pytest.approx(40.0, rel=1e-3)


def test_the_middle_of_a_recorded_car_is_ahead_of_its_frame(tmp_path: Path) -> None:
    (tmp_path / "stands.csv").write_text("t_s,x_m,y_m,yaw_rad,speed_m_s\n0,4,3,1.5707963,0\n9,4,3,1.5707963,0\n")
    actor = {"actor": "sedan", "name": "car", "recorded": {"file": "stands.csv", "point": "middle"}}
    world = load_world(str(world_file(tmp_path, actors=[actor])))
    lanes, _, _ = make_crew(world, {}, 0)
    (state,) = start_states(world, lanes)
    assert [float(state[key]) for key in ("x", "y")] == pytest.approx([4.0, 3.0 - world.actors[0].rear_axle], abs=1e-6)


def test_a_run_replays_the_actors_of_another_one(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    cars = [{"actor": "sedan", "name": "lead", "on_track": {"track": "main", "s": 20}, "speed": 12, "behaviour": "idm"}]
    scenario = {"lead": [{"at": 1, "stop": {"rate": 4}}]}
    first = simulation(world_file(tmp_path / "first", actors=cars, scenario=scenario)).run(
        duration=3.0, folder=tmp_path / "run"
    )
    actor = {"actor": "sedan", "name": "copy", "recorded": {"file": "run/actors.parquet", "of": "lead"}}
    path = world_file(tmp_path, actors=[actor])
    again = simulation(path).run(duration=3.0, folder=tmp_path / "again")
    for key in ("x", "y", "yaw"):
        assert np.abs(again.actors[f"copy.{key}"] - first.actors[f"lead.{key}"]).max() < 0.002
    # The run folder has the samples: it is read without the file.
    for file in (tmp_path / "run").iterdir():
        file.unlink() if file.is_file() else None
    assert load_run(tmp_path / "again").scene().world.actors[0].spec.recorded is not None


def test_a_recording_is_part_of_the_world_and_its_faults_have_one_line(tmp_path: Path) -> None:
    (tmp_path / "turn.csv").write_text(TURN)
    actor = {"actor": "pedestrian", "name": "walker", "recorded": "turn.csv"}
    world = load_world(str(world_file(tmp_path, actors=[actor])))
    assert tmp_path / "turn.csv" in used_files(world).values()
    before = lock_text(world)
    (tmp_path / "turn.csv").write_text(TURN.replace("time,x,y,yaw", "time,y,x,yaw"))
    assert lock_text(load_world(str(world_file(tmp_path, actors=[actor])))) != before
    for recorded, message in (
        ("gone.csv", "gone.csv: no such file"),
        ({"file": "turn.csv", "of": "lead"}, "has no column 'lead.x_m'"),
    ):
        with pytest.raises(ConfigError, match=message):
            load_world(str(world_file(tmp_path, actors=[actor | {"recorded": recorded}])))
    with pytest.raises(ConfigError, match="speed has no effect on a recorded motion"):
        load_world(str(world_file(tmp_path, actors=[actor | {"speed": 3}])))
    with pytest.raises(ConfigError, match="'walker' is recorded"):
        load_world(str(world_file(tmp_path, actors=[actor], scenario={"walker": [{"at": 1, "stop": {}}]})))
