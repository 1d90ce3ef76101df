"""Lane keeping at a constant speed, as an environment for Stable-Baselines3."""

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

import mirdrake.gym

SPEED, RATE, LIMIT = 8.0, 25.0, 0.35  # m/s, Hz, rad

OBSERVED = {  # signals and their usual sizes
    "ego.lateral_error": 1.0,
    "ego.heading_error": 0.2,
    "ego.wz": 0.5,
    "ego.steering_setpoint": 0.3,
    "ego.curvature": 0.06,
    "ego.curvature_ahead.4": 0.06,
    "ego.curvature_ahead.8": 0.06,
    "ego.curvature_ahead.16": 0.06,
}
SIZES = np.array(list(OBSERVED.values()), dtype=np.float32)


def diagram(model, seed):
    """Return the diagram of a car on a random track."""
    world = {"name": "random_track", "seed": seed, "params": {"min_radius": 15}}
    vehicle = {"model": model, "start": "line", "speed": SPEED}
    return {"world": world, "vehicles": {"ego": vehicle}, "plant": {"contact": "point"}, "duration": 60.0}


def scaled_action(env, steering):
    """Return actions for a constant speed and steering from -1 to 1 times LIMIT."""
    bounds = env.unwrapped.action_bounds
    speed = np.full(len(steering), 2.0 * SPEED / bounds[0, 1] - 1.0)
    return np.column_stack([speed, LIMIT / bounds[1, 1] * np.clip(steering, -1.0, 1.0)]).astype(np.float32)


class LaneKeeping(VecEnv):
    """Many single-track models; the action is the steering.

    The reward is the centred progress, reduced for changes of the steering. After the end of an episode mirdrake uses
    the next step for the reset; its reward is 0.
    """

    def __init__(self, cars):
        options = {"observe": list(OBSERVED), "reward": "centred_progress", "start": "anywhere_on_track", "rate": RATE}
        self.env = gymnasium.make_vec(mirdrake.gym.ID, num_envs=cars, diagram=diagram("bolt", 1), **options)
        box = gymnasium.spaces.Box
        super().__init__(cars, box(-10.0, 10.0, (len(OBSERVED),), np.float32), box(-1.0, 1.0, (1,), np.float32))

    def reset(self):
        self.last = np.zeros(self.num_envs)
        return self.env.reset(seed=0)[0] / SIZES

    def step_async(self, actions):
        self.steering = actions[:, 0]

    def step_wait(self):
        seen, reward, terminated, truncated, _ = self.env.step(scaled_action(self.env, self.steering))
        reward = reward * RATE / SPEED - 0.2 * np.abs(self.steering - self.last)
        done = terminated | truncated
        self.last = np.where(done, 0.0, self.steering)
        return seen / SIZES, reward.astype(np.float32), done, [{} for _ in range(self.num_envs)]

    def close(self):
        self.env.close()

    # Stable-Baselines3 asks for these; the cars have no attributes or methods of their own.

    def get_attr(self, name, indices=None):  # noqa: ARG002
        return [getattr(self, name, None)] * self.num_envs

    def set_attr(self, name, value, indices=None):  # noqa: ARG002
        setattr(self, name, value)

    def env_method(self, name, *arguments, indices=None, **options):  # noqa: ARG002
        return [getattr(self, name)(*arguments, **options)] * self.num_envs

    def env_is_wrapped(self, wrapper, indices=None):  # noqa: ARG002
        return [False] * self.num_envs


def drive_lap(policy, model, seed):
    """Return lateral error [m] and number of wheels on the road of a lap on the full plant, for each step.

    Args:
        policy: a policy of Stable-Baselines3.
        model: vehicle.
        seed: seed of the track.
    """
    watched = ["ego.progress", "ego.wheels_on_road"]
    options = {"diagram": diagram(model, seed), "observe": [*OBSERVED, *watched], "rate": RATE}
    env = gymnasium.make(mirdrake.gym.ID, **options)
    seen, _ = env.reset(seed=0)
    rows, ended = [seen], False
    while not ended:
        steering, _ = policy.predict(seen[: len(OBSERVED)] / SIZES, deterministic=True)
        seen, _, terminated, truncated, _ = env.step(scaled_action(env, steering)[0])
        rows.append(seen)
        ended = terminated or truncated or (len(rows) > 100 and rows[-2][-2] > 350.0 and seen[-2] < 50.0)
    lap = np.array(rows)
    return lap[:, 0], lap[:, -1]
