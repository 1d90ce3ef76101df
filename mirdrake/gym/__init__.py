"""A Gymnasium environment on a diagram file, for reinforcement learning (extra `gym`).

::

    import gymnasium
    import mirdrake.gym

    env = gymnasium.make("mirdrake/Drive-v0", diagram="bolt_test_track", rate=10.0)
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

:class:`~mirdrake.gym.env.DriveEnv` documents observations and actions, :mod:`mirdrake.gym.judging` the built-in
rewards, termination conditions and starts, and the arguments of user functions.
"""

from importlib.util import find_spec

from mirdrake.core.errors import MissingDependencyError

if find_spec("gymnasium") is None:
    raise MissingDependencyError("mirdrake.gym needs Gymnasium: pip install 'mirdrake[gym]'")

import gymnasium

from mirdrake.gym.env import DriveEnv
from mirdrake.gym.judging import ENDS, REWARDS, STARTS, Moment

__all__ = ["ENDS", "ID", "REWARDS", "STARTS", "DriveEnv", "Moment"]

ID = "mirdrake/Drive-v0"
"""Id of the environment in Gymnasium's registry."""

if ID not in gymnasium.registry:
    gymnasium.register(
        id=ID, entry_point="mirdrake.gym.env:DriveEnv", vector_entry_point="mirdrake.gym.vector_env:VectorDriveEnv"
    )
