"""Tasks as Gymnasium environments: `gym.make_vec` steps n worlds at once, `gym.make` is its n = 1 view."""

from armctl.envs.make import find_spec, make_worlds, task_of
from armctl.envs.observations import batch_of_one, one_of
from armctl.envs.single import TaskEnv
from armctl.envs.vector import Observer, TaskVectorEnv

__all__ = ["Observer", "TaskEnv", "TaskVectorEnv", "batch_of_one", "find_spec", "make_worlds", "one_of", "task_of"]
