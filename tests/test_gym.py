"""The Gymnasium environment: its contract, its physics and its errors for wrong names."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from mirdrake.core.errors import ConfigError  # noqa: E402
from mirdrake.gym import ID, DriveEnv, Moment  # noqa: E402
from mirdrake.gym.testing import drive  # noqa: E402

PLAIN: dict[str, Any] = {
    "world": "skidpad",
    "vehicles": {"ego": {"model": "bolt", "start": "left"}},
    "plant": {"contact": "point", "time_step": 0.01},
    "duration": 20.0,
}


@pytest.fixture(scope="module")
def env() -> DriveEnv:
    return DriveEnv(PLAIN)


def act(env: DriveEnv, **values: float) -> np.ndarray:
    """Return an action from SI values by the last word of its name."""
    low, high = env.action_bounds.T
    si = np.array([values[name.rpartition(".")[2]] for name in env.action_names])
    action: np.ndarray = (2.0 * (si - low) / (high - low) - 1.0).astype(np.float32)
    return action


def test_the_registered_environment_passes_the_checker_without_a_warning():
    env = gymnasium.make(ID, diagram=PLAIN)
    check_env(env.unwrapped)
    env.close()


def test_the_module_can_be_named_in_the_id():
    assert gymnasium.make(f"mirdrake.gym:{ID}", diagram=PLAIN).spec.id == ID


def test_ranges_are_those_of_the_vehicle(env):
    assert env.action_names == ["ego.speed_reference", "ego.steering_reference"]
    assert env.action_bounds[0] == pytest.approx([0.0, 50.0])
    # bicycle angle at which the inner wheel is at its limit: cot d = cot d_in + kingpin track / (2 wheelbase)
    geometry = env.assembly.parts.vehicles["ego"].vehicle.geometry
    limit = math.atan(
        1.0 / (1.0 / math.tan(geometry.steering_limit) + geometry.kingpin_track / 2.0 / geometry.wheelbase)
    )
    assert env.action_bounds[1] == pytest.approx([-limit, limit])
    assert env.observation_names[:2] == ["ego.vx", "ego.wz"]
    assert dict(zip(env.observation_names, env.observation_units, strict=True))["ego.curvature_ahead.10"] == "1/m"


def test_a_vehicle_does_what_it_does_without_the_environment(env):
    env.reset(seed=0)
    values = []
    for _ in range(20):
        observation, *_ = env.step(act(env, speed_reference=4.0, steering_reference=0.2))
        values.append(observation[:2])
    plain = drive(
        PLAIN,
        inputs={"ego.speed_reference": 4.0, "ego.steering_reference": 0.2},
        duration=2.0,
        outputs=["ego.vx", "ego.wz"],
        period=0.1,
    )
    np.testing.assert_allclose(values[10:], plain.iloc[11:], atol=5e-3)  # its first step knows no command


def test_progress_adds_up_to_the_distance_along_the_track(env):
    # the left circle of the skidpad has a radius of 9.125 m and is driven at 3 m/s on its centre line
    track = env.assembly.parts.world.tracks["left"]
    s = 10.0
    x, y, yaw = track.pose_at(s)
    observation, _ = env.reset(options={"start": {"ego": (x, y, yaw, 3.0)}}, seed=0)
    names = env.observation_names
    assert observation[names.index("ego.lateral_error")] == pytest.approx(0.0, abs=1e-4)
    assert observation[names.index("ego.curvature_ahead.20")] == pytest.approx(1.0 / 9.125, abs=1e-4)
    angle = math.atan(2.6 / 9.125)
    progress = 0.0
    for _ in range(20):
        observation, reward, terminated, truncated, _ = env.step(
            act(env, speed_reference=3.0, steering_reference=angle)
        )
        progress += reward
        assert not terminated
        assert not truncated
    assert progress == pytest.approx(3.0 * 2.0, abs=0.12)
    assert env.readings.find("ego.progress")[0].read(env._context) - s == pytest.approx(progress, abs=0.15)


def test_nothing_is_built_again_and_no_python_runs_from_step_to_step(env):
    diagram, simulator = env.assembly.diagram, env._simulator
    first, _ = env.reset(seed=3)
    trace = [env.step(act(env, speed_reference=5.0, steering_reference=0.1))[0] for _ in range(3)]
    again, _ = env.reset(seed=3)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(
        trace, [env.step(act(env, speed_reference=5.0, steering_reference=0.1))[0] for _ in range(3)]
    )
    assert env.assembly.diagram is diagram
    assert env._simulator is simulator
    assert env._friction.varies == (simulator.get_monitor() is not None)
    assert DriveEnv(PLAIN | {"world": "empty", "vehicles": {"ego": {"model": "bolt"}}})._simulator.get_monitor() is None


def test_seeds_choose_the_start():
    env = DriveEnv(PLAIN, start="anywhere_on_track", observe=["ego.x", "ego.y", "ego.lateral_error"])
    places = [env.reset(seed=seed)[0] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(places[0], places[1])
    assert np.hypot(*(places[0] - places[2])[:2]) > 0.1
    assert [pose[2] for pose in places] == pytest.approx([0.0] * 3, abs=1e-4)


def test_leaving_the_road_ends_the_episode(env):
    env.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, truncated, info = env.step(act(env, speed_reference=8.0, steering_reference=0.0))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["ended_by"] == "off_road"
    assert math.isfinite(reward)
    assert env.readings.find("ego.wheels_on_road")[0].read(env._context) < 3.0


def test_hitting_a_wall_ends_the_episode(tmp_path: Path):
    world = tmp_path / "wall.yaml"
    world.write_text(
        "mirdrake: world/1\nname: wall\nprops: [{box: [1, 8, 2], at: [12, 0]}]\nstart: {here: {at: [0, 0]}}\n",
        encoding="utf-8",
    )
    env = DriveEnv(PLAIN | {"world": str(world), "vehicles": {"ego": {"model": "bolt", "speed": 5}}})
    env.reset(seed=0)
    ended: dict[str, Any] = {}
    while not ended.get("ended_by"):
        *_, truncated, ended = env.step(act(env, speed_reference=5.0, steering_reference=0.0))
        assert not truncated
    assert ended["ended_by"] == "collision"
    # its front is 3.385 m ahead of the rear axle: 1.62 s at 5 m/s, counted every 0.1 s and seen at the end of a step
    assert 1.62 <= ended["time"] < 1.85


def test_time_truncates_and_does_not_terminate():
    env = DriveEnv(PLAIN, duration=0.3)
    env.reset(seed=0)
    results = [env.step(act(env, speed_reference=0.0, steering_reference=0.0))[2:4] for _ in range(3)]
    assert results == [(False, False), (False, False), (False, True)]


MODULE = """
import math

def nothing(moment):
    return math.nan

def fast(moment):
    return moment["ego.vx"] - moment.action["ego.speed_reference"]

def late(moment):
    return moment.time > 0.25

def breaks(assembly, rng):
    from mirdrake.worlds import Start
    return {"ego": Start(float(rng.uniform(1.0, 2.0)), 0.0, 0.5)}
"""


def test_user_functions_are_named_by_module_and_name(tmp_path: Path, monkeypatch):
    (tmp_path / "gym_functions_of_mine.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    env = DriveEnv(
        PLAIN,
        reward="gym_functions_of_mine:fast",
        ends=["gym_functions_of_mine:late"],
        start="gym_functions_of_mine:breaks",
        observe=["ego.x", "ego.yaw"],
    )
    observation, _ = env.reset(seed=4)
    assert 1.0 <= observation[0] <= 2.0
    assert observation[1] == pytest.approx(0.5)
    _, reward, *_ = env.step(act(env, speed_reference=10.0, steering_reference=0.0))
    assert reward == pytest.approx(-10.0, abs=0.5)
    env.step(act(env, speed_reference=10.0, steering_reference=0.0))
    assert (
        env.step(act(env, speed_reference=10.0, steering_reference=0.0))[4]["ended_by"] == "gym_functions_of_mine:late"
    )

    env = DriveEnv(PLAIN, reward="gym_functions_of_mine:nothing", ends=[])
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(env.action_space.sample())
    assert (reward, terminated, info["bad_reward"]) == (0.0, False, True)


def test_an_action_that_is_not_finite_is_the_middle_of_its_range(env):
    env.reset(seed=0)
    observation, reward, *_ = env.step(np.array([np.nan, np.inf], dtype=np.float32))
    assert np.isfinite(observation).all()
    assert math.isfinite(reward)


def test_pedals_are_actions_of_a_vehicle_that_has_them():
    spec = PLAIN | {"world": "empty", "vehicles": {"ego": {"model": "bolt@handling"}}, "plant": {"contact": "point"}}
    env = DriveEnv(
        spec,
        act=["ego.pedals_reference.throttle", "ego.pedals_reference.brake", "ego.steering_reference"],
        observe=["ego.vx"],
        ends=[],
    )
    env.reset(seed=0)
    for _ in range(20):
        fast, *_ = env.step(act(env, throttle=0.5, brake=0.0, steering_reference=0.0))
    for _ in range(20):
        slow, *_ = env.step(act(env, throttle=0.0, brake=0.5, steering_reference=0.0))
    assert fast[0] > 3.0
    assert slow[0] < 0.2


def test_sensors_and_blocks_are_observed_and_other_drivers_keep_driving():
    spec = {
        "world": "skidpad",
        "vehicles": {
            "other": {"model": "bolt", "start": {"x": -9.125, "y": -9.125, "yaw": "90 deg"}},
            "ego": {"model": "bolt", "start": "left"},
        },
        "control": {
            "other": {"kind": "path_tracking", "track": "right", "speed": 3},
            "ego": {"kind": "constant", "speed": 9},
        },
        "sensors": {"ego": ["imu"]},
        "systems": {"bias": {"kind": "constant", "value": [0.25]}},
        "plant": {"contact": "point", "time_step": 0.01},
    }
    env = DriveEnv(spec, vehicle="ego", observe=["ego.vx", "ego.imu", "bias.y", "other.vx"], ends=[])
    assert env.observation_names[1:7] == [f"ego.imu.{name}" for name in ("fx", "fy", "fz", "wx", "wy", "wz")]
    env.reset(seed=0)
    for _ in range(25):
        observation, *_ = env.step(act(env, speed_reference=2.0, steering_reference=0.0))
    observed = dict(zip(env.observation_names, observation, strict=True))
    assert observed["ego.vx"] == pytest.approx(2.0, abs=0.05)  # and not 9
    assert observed["ego.imu.fz"] == pytest.approx(9.81, abs=0.5)
    assert observed["bias.y"] == pytest.approx(0.25)
    assert observed["other.vx"] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicle": "egon"}, "no vehicle 'egon' in the diagram; did you mean 'ego'"),
        ({"observe": ["ego.vxx"]}, "the diagram has no signal 'ego.vxx'; did you mean 'ego.vx'"),
        ({"observe": ["ego.curvature_ahead.far"]}, "'far' is not a distance in m"),
        ({"observe": []}, "observe: is empty"),
        ({"act": ["ego.sped_reference"]}, "'ego.sped_reference'"),
        ({"act": ["egon.speed_reference"]}, "is not an input of the diagram; did you mean 'ego.speed_reference'"),
        ({"act": ["ego.speed_reference"] * 2}, "is named twice"),
        ({"bounds": {"ego.vx": (3.0, 1.0)}}, "bounds of 'ego.vx': low 3 must be below high 1"),
        ({"bounds": {"ego.vx": 3.0}}, "are not two numbers"),
        ({"rate": 0.0}, "rate 0.0 Hz is not allowed"),
        ({"rate": 2.0}, "the watchdog of ego stops it after 0.2 s without a command; set a rate of 5 Hz or more"),
        ({"reward": "progres"}, "unknown reward 'progres'; did you mean 'progress'"),
        ({"reward": "math:nothing_there"}, "no function 'nothing_there' in math"),
        ({"reward": "no_such_module_here:x"}, "module 'no_such_module_here' cannot be imported"),
        ({"ends": [3]}, "end: 3 is not a function"),
        ({"start": "everywhere"}, "unknown start 'everywhere'; allowed: anywhere_on_track, or give module:name"),
    ],
)
def test_wrong_names_and_ranges_are_errors_of_one_line(options, message):
    with pytest.raises(ConfigError) as caught:
        DriveEnv(PLAIN, **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_moment_reads_signals_that_are_not_observed():
    observed: list[tuple[float, float]] = []

    def reward(moment: Moment) -> float:
        observed.append((moment["ego.wheel_speed.rear_left"], moment["ego.vx"]))
        return 1.0

    env = DriveEnv(PLAIN, reward=reward, observe=["ego.vx"], ends=[])
    env.reset(seed=0)
    for _ in range(25):
        assert env.step(act(env, speed_reference=3.0, steering_reference=0.0))[1] == 1.0
    radius = env.assembly.parts.vehicles["ego"].vehicle.geometry.rear_wheel_radius
    assert observed[-1][0] * radius == pytest.approx(observed[-1][1], rel=0.1)  # it still accelerates
    assert observed[-1][1] > 2.5
