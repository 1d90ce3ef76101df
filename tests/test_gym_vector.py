"""The vector environment: names and bounds of the single one, the loop of the batch, resets, the speed."""

import time

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import mirdrake.gym
from mirdrake.batched import Batch, BatchControl
from mirdrake.batched.lane import SIGNALS
from mirdrake.core.errors import ConfigError
from mirdrake.gym.vector_env import VectorDriveEnv
from mirdrake.single_track import estimate_parameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.vehicles import load_vehicle

OBSERVED = [f"ego.{name}" for name in SIGNALS] + ["ego.curvature_ahead.10"]


@pytest.fixture(scope="module")
def env():
    created = gymnasium.make_vec("mirdrake/Drive-v0", num_envs=16, start="anywhere_on_track", duration=4.0)
    assert isinstance(created, VectorDriveEnv)
    return created


@pytest.fixture(scope="module")
def single():
    return mirdrake.gym.DriveEnv(observe=OBSERVED)


def actions(env, speed, steering):
    """Return actions for a speed [m/s] and steering angles [rad]."""
    low, high = env.action_bounds.T
    values = np.column_stack([np.full(env.num_envs, speed), np.broadcast_to(steering, env.num_envs)])
    return (2.0 * (values - low) / (high - low) - 1.0).astype(np.float32)


def test_it_has_the_names_and_spaces_of_the_single_environment(env):
    single = gymnasium.make("mirdrake/Drive-v0").unwrapped
    assert isinstance(single, mirdrake.gym.DriveEnv)
    assert env.observation_names == single.observation_names
    assert env.action_names == single.action_names
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.observation_space.shape == (16, len(single.observation_names))
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def test_steps_are_within_the_spaces_and_repeat_with_the_seed(env):
    rows = []
    for _ in range(2):
        observation, info = env.reset(seed=3)
        env.action_space.seed(3)
        history = [observation]
        for _ in range(60):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation)
            assert reward.shape == terminated.shape == truncated.shape == (16,)
            assert terminated.dtype == truncated.dtype == np.bool_
            assert np.isfinite(reward).all()
            history.append(observation.copy())
        assert info["time"].shape == (16,)
        rows.append(np.array(history))
    assert rows[0].tolist() == rows[1].tolist()
    assert env.reset(seed=4)[0].tolist() != rows[0][0].tolist()


class OneCar(gymnasium.Env):
    """The only car of a vector environment, for Gymnasium's checker, which takes single environments."""

    def __init__(self):
        self.env = gymnasium.make_vec("mirdrake/Drive-v0", num_envs=1, start="anywhere_on_track", duration=4.0)
        self.observation_space, self.action_space = self.env.single_observation_space, self.env.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observations, info = self.env.reset(seed=seed, options=options)
        return observations[0], info

    def step(self, action):
        observations, rewards, terminated, truncated, info = self.env.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info


@pytest.mark.filterwarnings("error")
def test_a_car_passes_the_checker_of_gymnasium_without_a_warning():
    check_env(OneCar(), skip_render_check=True)


def test_an_ended_episode_starts_again_in_the_next_step(env):
    env.reset(seed=0)
    straight = actions(env, 8.0, 0.5)  # off the road after some steps
    ended = np.zeros(16, dtype=bool)
    restarts = 0
    for _ in range(45):
        observation, reward, terminated, truncated, info = env.step(straight)
        again = ended
        assert (reward[again] == 0.0).all()
        assert (info["time"][again] == 0.0).all()
        assert not (terminated | truncated)[again].any()
        # The table of the centre line has constant curvature over 0.1 m.
        assert (np.abs(observation[again, env.observation_names.index("ego.lateral_error")]) < 1e-5).all()
        restarts += int(again.sum())
        ended = terminated | truncated
    assert restarts > 16


def test_a_reset_forgets_episodes_that_had_ended(env):
    env.reset(seed=0)
    while not env._ended.any():
        env.step(actions(env, 8.0, 0.5))
    env.reset(seed=0)
    _, reward, _, _, info = env.step(actions(env, 8.0, 0.0))
    assert (info["time"] == env.period).all()
    assert (reward > 0.0).all()


def test_a_restart_leaves_the_signals_of_the_other_cars():
    """Two cars that drive alike, one restarted by hand: the signals of the other one equal those without a restart."""
    seen = []
    for restarts in (False, True):
        env = VectorDriveEnv(2, observe=OBSERVED, ends=())
        env.reset()
        for k in range(6):
            env._ended[1] = restarts and k == 5
            observation, *_ = env.step(actions(env, 6.0, 0.05))
        seen.append(observation[0].tolist())
        assert observation[0, OBSERVED.index("ego.speed_trim")] != 0.0
    assert seen[0] == seen[1]
    assert (observation[1] != observation[0]).any()


def test_it_drives_as_the_control_unit_of_the_batch():
    env = VectorDriveEnv(3, observe=OBSERVED, parameters={"mass": [1500.0, 1600.0, 1800.0]}, ends=())
    env.reset(seed=0)
    vehicle = load_vehicle("bolt")
    parameters, track_start = estimate_parameters(vehicle), env.cars.state.copy()
    cars = Batch(
        parameters,
        Variant("brush", actuators=True),
        columns={"mass": [1500.0, 1600.0, 1800.0]},
        step=env.cars.step_time,
    )
    cars.state[:] = track_start
    control = BatchControl(cars, vehicle)
    commands = np.column_stack([np.repeat([4.0, 6.0], 100), np.repeat([0.05, -0.08], 100)])
    run = control.run(commands)
    for k in range(40):
        speed, steering = commands[5 * k]
        observation, *_ = env.step(actions(env, speed, steering))
        if 5 * (k + 1) < run.values.shape[1]:
            for name, signal in (("vx", "vx"), ("wz", "yaw_rate"), ("x", "x"), ("y", "y")):
                theirs = observation[:, OBSERVED.index(f"ego.{name}")]
                assert theirs == pytest.approx(run[signal][:, 5 * (k + 1)], abs=2e-5)  # float32 of x and y


def test_places_on_the_track_are_those_of_the_single_environment(single):
    """At random places beside the centre line, the observations equal those of the full vehicle's environment."""
    env = VectorDriveEnv(1, observe=OBSERVED)
    track = env._track
    rng = np.random.default_rng(1)
    for s in rng.uniform(0.0, track.length, 5):
        x, y, yaw = (float(value) for value in track.pose(float(s)))
        aside, turn = rng.uniform(-1.0, 1.0), rng.uniform(-0.2, 0.2)
        pose = (x - aside * np.sin(yaw), y + aside * np.cos(yaw), yaw + turn, 5.0)
        theirs, _ = single.reset(options={"start": {"ego": pose}})
        env.reset()
        env.cars.reset(x=pose[0], y=pose[1], yaw=pose[2], vx=pose[3])
        env._progress[:] = s
        env._advance(0, np.ones(1, dtype=bool))
        ours = env._observations()[0]
        for name in ("lateral_error", "heading_error", "progress", "wheels_on_road", "vx", "yaw"):
            index = OBSERVED.index(f"ego.{name}")
            assert ours[index] == pytest.approx(theirs[index], abs=1e-3), name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "money"}, "unknown reward 'money'"),
        ({"ends": ["collision"]}, "unknown end 'collision'"),
        ({"start": "here"}, "unknown start 'here'"),
        ({"observe": ["ego.wheel_speed.front_left"]}, "no signal 'ego.wheel_speed.front_left'"),
        ({"rate": 30.0}, "not a multiple of the control period of 0.02 s"),
    ],
)
def test_errors_name_the_faulty_value(options, message):
    with pytest.raises(ConfigError, match=message):
        VectorDriveEnv(2, **options)


@pytest.mark.slow
def test_the_rate_per_core():
    env = VectorDriveEnv(4096, start="anywhere_on_track", control_period=0.025)
    observation, _ = env.reset(seed=0)
    rates = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(20):
            steering = np.clip(2.6 * observation[:, 6] - 0.15 * observation[:, 3] - 0.8 * observation[:, 4], -0.5, 0.5)
            observation, *_ = env.step(actions(env, 5.0, steering))
        rates.append(20 * 4096 / (time.process_time() - began))
    assert max(rates) >= 3.0e5
