"""Hindsight experience replay (Andrychowicz et al. 2017), by Stable-Baselines3's buffer, in tasks with goals.

An episode that missed its target has brought things to other places: with one of them as the target, it is a success.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from armctl.rl.data.demonstrations import slices_of_parts
from armctl.rl.networks.frames import FrameFeatures
from armctl.rl.networks.view import View
from armctl.rl.run.vector import EncodedVectorEnv
from armctl.tasks import Task
from armctl.tasks.reach.state import STEP_REWARD

ACHIEVED, DESIRED = "achieved_goal", "desired_goal"


def has_goals(task: Task) -> bool:
    """Return whether the task's own class declares goals: success in a subclass of one that does may be another."""
    return "goals" in vars(type(task))


class GoalVectorEnv(EncodedVectorEnv):
    """Worlds with goals: `observation` (n, frames, k), and `achieved_goal` and `desired_goal`, of the state."""

    takes_features = False  # hindsight changes the goals of what it has stored

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        worlds = self.env.unwrapped
        self.task, self.reward_scale = worlds.task, worlds.reward_scale
        self.goals = self.task.goals
        begin = slices_of_parts(self.task)[self.goals.part].start
        self.places = slice(begin, begin + self.goals.size)
        """Places in each frame of the numbers that tell the desired goal."""
        worlds.observers.append(self)
        size = self.goals.desired(self.task.state).shape[1:]
        goal = spaces.Box(-np.inf, np.inf, size, np.float64)
        self.observation_space = spaces.Dict({"observation": self.encoder.space, ACHIEVED: goal, DESIRED: goal})

    def began(self, ids: NDArray[np.int32]) -> None:
        """Take note that worlds `ids` have begun a new episode."""

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Keep the goals of a control step, before ended episodes are replaced."""
        self._last_goals = self._goals_by_name()

    def reset(self) -> Any:
        """Start new episodes in all worlds."""
        return {"observation": super().reset(), **self._goals_by_name()}

    def step_wait(self) -> Any:
        """Step all worlds."""
        observations, rewards, done, infos = super().step_wait()
        for i in np.flatnonzero(done):
            goals = {name: values[i] for name, values in self._last_goals.items()}
            infos[i]["terminal_observation"] = {"observation": infos[i]["terminal_observation"], **goals}
        return {"observation": observations, **self._goals_by_name()}, rewards, done, infos

    @property
    def policy_kwargs(self) -> dict[str, Any]:
        """Arguments of a policy for the features of observations."""
        return {"features_extractor_class": GoalFeatures, "features_extractor_kwargs": {"view": self.view}}

    def show(self, observations: Mapping[str, torch.Tensor]) -> None:
        """Let observations by name show their desired goals in all frames."""
        goals = observations[DESIRED][:, None, : self.goals.size]
        observations["observation"][..., self.places] = goals.to(observations["observation"].dtype)

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> Any:
        """Return the scaled reward (n,) of steps that end at goals `achieved` (n, k) where others are `desired`."""
        reached = self.goals.reached(achieved, desired)
        return self.reward_scale * (STEP_REWARD + self.task.options.goal_reward * reached)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method once, for all worlds."""
        if method_name == "compute_reward":
            return [self.compute_reward(*args[:2])]
        return super().env_method(method_name, *args, indices=indices, **kwargs)

    def _goals_by_name(self) -> dict[str, NDArray[np.float64]]:
        state = self.task.state
        return {ACHIEVED: np.array(self.goals.achieved(state)), DESIRED: np.array(self.goals.desired(state))}


class GoalFeatures(BaseFeaturesExtractor):
    """A view's features of stacks of observations, which show their goals."""

    def __init__(self, observation_space: spaces.Dict, view: View) -> None:
        features = FrameFeatures(observation_space["observation"], view)
        super().__init__(observation_space, features.features_dim)
        self.features = features

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (n, k) of observations by name."""
        return self.features(observations["observation"])


class HindsightBuffer(HerReplayBuffer):
    """A replay buffer in which relabelled transitions end their episode as in the task: by success and by failure.

    Stable-Baselines3's own would bootstrap beyond them.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.infos = np.empty(0)  # unused: a dict for each transition

    def _get_virtual_samples(
        self, batch_indices: NDArray[np.intp], env_indices: NDArray[np.intp], env: Any = None
    ) -> DictReplayBufferSamples:
        samples = super()._get_virtual_samples(batch_indices, env_indices, env)
        worlds: Any = self.env
        worlds.show(samples.observations)
        worlds.show(samples.next_observations)
        at = batch_indices, env_indices
        achieved, desired = (self.next_observations[name][at] for name in (ACHIEVED, DESIRED))
        is_terminal = self.dones[at] > self.timeouts[at]
        failed = self.to_torch(is_terminal & ~worlds.goals.reached(achieved, desired))[:, None]
        reached = samples.rewards > worlds.reward_scale * STEP_REWARD
        rewards = torch.where(failed, self.to_torch(self.rewards[at])[:, None], samples.rewards)
        return samples._replace(rewards=rewards, dones=(failed | reached).float())
