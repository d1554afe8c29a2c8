"""What a network observes of a task and how it acts in it: `Task.learner_view` as torch modules."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.vector.utils import create_empty_array
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.rl.actor import tensors
from armctl.rl.features import features_by_name, preparation_by_name

Features = Literal["none", "plain", "invariant", "model"]


@dataclass(frozen=True)
class View:
    """Feature extractor and action scaling of a network."""

    action_scale: torch.nn.Module
    """Maps observations and the network's actions in [-1, 1] to the environment's actions."""
    features: type[BaseFeaturesExtractor]
    """Of prepared observations."""
    features_options: Mapping[str, Any] = field(default_factory=dict)
    prepare: Callable[[gymnasium.Space[Any]], torch.nn.Module] | None = None
    """Made with the observation space, it maps observations to smaller ones; None: they stay as they are."""
    state_features: Callable[[gymnasium.Space[Any]], BaseFeaturesExtractor] | None = None
    """Made with the space of states, it extracts their features, for a critic that sees them, whatever `features` the
    actor has; None: their numbers are shares of their bounds."""

    def preparation(self, observed: gymnasium.Space[Any]) -> torch.nn.Module:
        """From observations to prepared ones."""
        return torch.nn.Identity() if self.prepare is None else self.prepare(observed)

    def prepared(self, observed: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
        """The space of prepared observations."""
        if self.prepare is None:
            return observed
        with torch.no_grad():
            example = self.prepare(observed)(tensors(create_empty_array(observed, n=1)))
        if isinstance(example, dict):
            return gymnasium.spaces.Dict({name: _space_of(values) for name, values in example.items()})
        return _space_of(example)

    def extractor(self, observed: gymnasium.Space[Any]) -> BaseFeaturesExtractor:
        """The feature extractor of observations that are not prepared yet."""
        features = self.features(self.prepared(observed), **self.features_options)
        return features if self.prepare is None else _PreparedFirst(observed, self.prepare(observed), features)


class _PreparedFirst(BaseFeaturesExtractor):
    def __init__(
        self, observation_space: gymnasium.Space[Any], prepare: torch.nn.Module, features: BaseFeaturesExtractor
    ) -> None:
        super().__init__(observation_space, features.features_dim)
        self.prepare, self.features = prepare, features

    def forward(self, observations: Any) -> torch.Tensor:
        return self.features(self.prepare(observations))


def view_of(worlds: TaskVectorEnv, *, features: Features = "plain", relative: bool = True) -> View:
    """The view of a task.

    `features`: `none` for the bare observation, `plain` for the task's features, `invariant` for features that are
    invariant under the task's symmetries, if it has any, `model` for those that know the robot's geometry. `relative`:
    actions are relative to a part of the observation, if the task allows it.

    Raises `ConfigurationError` for an observation or features that learners of this task cannot use.
    """
    declared = worlds.task.learner_view
    chosen = {
        "none": None,
        "plain": declared.features,
        "invariant": declared.invariant_features or declared.features,
        "model": declared.model_features,
    }[features]
    if features == "model" and chosen is None:
        raise ConfigurationError("this task has no features that know the robot's geometry: choose others")
    extractor = features_by_name(chosen.name if chosen else None, worlds.single_observation_space)
    prepare = None
    if chosen and chosen.prepare:
        prepare = functools.partial(preparation_by_name(chosen.prepare), **chosen.prepare_options)
    if worlds.normalized:
        unit = np.ones(worlds.single_action_space.shape)
        scale = ActionScale(-unit, unit)
    elif relative and declared.relative_to is not None:
        largest = np.full(worlds.single_action_space.shape, declared.largest_move)
        scale = ActionScale(-largest, largest, declared.relative_to)
    else:
        scale = ActionScale(*worlds.task.action_range)
    state_features = None
    if (states := declared.state_features) is not None:
        state_features = functools.partial(features_by_name(states.name, worlds.task.state_space), **states.options)
    return View(scale, extractor, dict(chosen.options) if chosen else {}, prepare, state_features)


def _space_of(values: torch.Tensor) -> gymnasium.spaces.Box:
    array = values.numpy()
    return gymnasium.spaces.Box(-np.inf, np.inf, array.shape[1:], array.dtype.type)


class ActionScale(torch.nn.Module):
    """Maps the network's actions in [-1, 1] to the environment's, between `low` and `high` (k,).

    With `relative_to`, that part of the observation is added.
    """

    def __init__(self, low: NDArray[Any], high: NDArray[Any], relative_to: slice | None = None) -> None:
        super().__init__()
        self.relative_to = relative_to
        self.register_buffer("middle", torch.as_tensor((low + high) / 2, dtype=torch.float32))
        self.register_buffer("span", torch.as_tensor((high - low) / 2, dtype=torch.float32))

    def forward(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Environment actions (n, k)."""
        scaled = self.middle + self.span * actions.clamp(-1, 1)
        return scaled if self.relative_to is None else observations[:, self.relative_to] + scaled

    def inverse(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """The network's actions (n, k), clamped to [-1, 1], for actions of the environment."""
        scaled = actions if self.relative_to is None else actions - observations[:, self.relative_to]
        return ((scaled - self.middle) / self.span).clamp(-1, 1)
