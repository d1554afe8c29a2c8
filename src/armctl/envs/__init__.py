"""Environments: tasks as Gymnasium environments, and those of others.

`gym.make_vec` steps n worlds of a task at once, and `gym.make` is its n = 1 view.
"""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.envs.episodes import EpisodeVectorEnv
    from armctl.envs.find import RETURN_BOUNDS, check_from_file, find_spec, full_id
    from armctl.envs.interface import (
        INTERFACES,
        CurrentEpisode,
        Interface,
        MapInterface,
        ModelInterface,
        interface_of,
        interface_values,
    )
    from armctl.envs.make import make_worlds, task_of
    from armctl.envs.observations import batch_of_one, one_of
    from armctl.envs.outcomes import ERROR, UNSTABLE
    from armctl.envs.policy_seed import PolicyStreams, chosen_policy_seed, new_policy_seed
    from armctl.envs.sees import SEES, Sees, privilege_in_words
    from armctl.envs.single import TaskEnv
    from armctl.envs.third_party import ThirdPartyVectorEnv, episode_seed
    from armctl.envs.vector import Observer, TaskVectorEnv

__all__ = [
    "ERROR", "INTERFACES", "RETURN_BOUNDS", "SEES", "UNSTABLE", "CurrentEpisode", "EpisodeVectorEnv", "Interface",
    "MapInterface", "ModelInterface", "Observer", "PolicyStreams", "Sees", "TaskEnv", "TaskVectorEnv",
    "ThirdPartyVectorEnv", "batch_of_one", "check_from_file", "chosen_policy_seed", "episode_seed", "find_spec",
    "full_id", "interface_of", "interface_values", "make_worlds", "new_policy_seed", "one_of", "privilege_in_words",
    "task_of",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)
