"""Views of tasks: what a network observes and how it acts, `Task.learner_view` as torch modules."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.vector.utils import create_empty_array
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor

from armctl.agents import inputs
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.rl.networks.actor import tensors
from armctl.rl.networks.features import features_by_name, preparation_by_name
from armctl.rl.networks.layers import padded

Features = Literal["none", "plain", "invariant", "model", "robust"]
BARE = CombinedExtractor, FlattenExtractor
"""Feature extractors that pass the observation on."""
MISSING = {"model": "that know the robot's geometry", "robust": "that sensor noise hardly changes"}
"""Descriptions of features that a task may lack."""


@dataclass(frozen=True)
class View:
    """Feature extractor and action scaling of a network."""

    action_scale: torch.nn.Module
    """Map from observations and the network's actions in [-1, 1] to the environment's actions."""
    features: type[BaseFeaturesExtractor]
    """Feature extractor of prepared observations."""
    features_options: Mapping[str, Any] = field(default_factory=dict)
    prepare: Callable[[gymnasium.Space[Any]], torch.nn.Module] | None = None
    """Map of observations to smaller ones, made with their space; None: they stay as they are."""
    state_features: Callable[[gymnasium.Space[Any]], BaseFeaturesExtractor] | None = None
    """Feature extractor of states, made with their space, for a critic that sees them; None: their numbers are shares
    of their bounds."""

    def preparation(self, observation_space: gymnasium.Space[Any]) -> torch.nn.Module:
        """Return the map from observations to prepared ones."""
        return torch.nn.Identity() if self.prepare is None else self.prepare(observation_space)

    def prepared(self, observation_space: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
        """Return the space of prepared observations."""
        if self.prepare is None:
            return observation_space
        with torch.no_grad():
            example = self.prepare(observation_space)(tensors(create_empty_array(observation_space, n=1)))
        if isinstance(example, dict):
            return gymnasium.spaces.Dict({name: _space_of(values) for name, values in example.items()})
        return _space_of(example)

    def has_fixed_features(self, observation_space: gymnasium.Space[Any]) -> bool:
        """Return whether there are features without weights, of 32-bit floats, so that they need computing once."""
        parts = inputs(self.prepared(observation_space)).values()
        extractor = self.extractor(observation_space)
        has_weights = any(True for _ in extractor.parameters())
        return not has_weights and self.features not in BARE and all(part.dtype == np.float32 for part in parts)

    def extractor(self, observation_space: gymnasium.Space[Any]) -> BaseFeaturesExtractor:
        """Return the feature extractor of observations that are not prepared yet."""
        features = self.features(self.prepared(observation_space), **self.features_options)
        if self.prepare is None:
            return features
        return _PreparedFirst(observation_space, self.prepare(observation_space), features)


class _PreparedFirst(BaseFeaturesExtractor):
    def __init__(
        self, observation_space: gymnasium.Space[Any], prepare: torch.nn.Module, features: BaseFeaturesExtractor
    ) -> None:
        super().__init__(observation_space, features.features_dim)
        self.prepare, self.features = prepare, features
        self.image_size = getattr(features, "image_size", 0)

    def forward(self, observations: Any) -> torch.Tensor:
        return self.features(self.prepare(observations))


def view_of(env: TaskVectorEnv, *, features: Features = "plain", relative: bool = True) -> View:
    """Return the view of a task.

    `features`: `none` for the bare observation, `plain` for the task's features, `invariant` for features that are
    invariant under the task's symmetries, if it has any, `model` for those that know the robot's geometry, `robust` for
    those that sensor noise hardly changes. `relative`: actions are relative to a part of the observation, if the task
    allows it.

    Raises `ConfigurationError` for an observation or features that learners of this task cannot use.
    """
    declared = env.task.learner_view
    chosen = {
        "none": None,
        "plain": declared.features,
        "invariant": declared.invariant_features or declared.features,
        "model": declared.model_features,
        "robust": declared.robust_features,
    }[features]
    if features in MISSING and chosen is None:
        raise ConfigurationError(f"this task has no features {MISSING[features]}: choose others")
    extractor = features_by_name(chosen.name if chosen else None, env.single_observation_space)
    prepare = None
    if chosen and chosen.prepare:
        prepare = functools.partial(preparation_by_name(chosen.prepare), **chosen.prepare_options)
    if env.normalized:
        unit = np.ones(env.single_action_space.shape)
        scale = ActionScale(-unit, unit)
    elif relative and declared.relative_to is not None:
        low, high = (np.array(bound) for bound in env.task.action_range)
        count = declared.relative_to.stop - declared.relative_to.start
        low[:count], high[:count] = -declared.largest_move, declared.largest_move
        scale = ActionScale(low, high, declared.relative_to)
    else:
        scale = ActionScale(*env.task.action_range)
    state_features = None
    if (states := declared.state_features) is not None:
        state_features = functools.partial(features_by_name(states.name, env.task.state_space), **states.options)
    return View(scale, extractor, dict(chosen.options) if chosen else {}, prepare, state_features)


def _space_of(values: torch.Tensor) -> gymnasium.spaces.Box:
    array = values.numpy()
    return gymnasium.spaces.Box(-np.inf, np.inf, array.shape[1:], array.dtype.type)


class ActionScale(torch.nn.Module):
    """Maps the network's actions in [-1, 1] to the environment's, between `low` and `high` (k,).

    With `relative_to`, that part of the observation is added to the first actions, which are as many.
    """

    def __init__(self, low: NDArray[Any], high: NDArray[Any], relative_to: slice | None = None) -> None:
        super().__init__()
        self.relative_to = relative_to
        self.register_buffer("middle", torch.as_tensor((low + high) / 2, dtype=torch.float32))
        self.register_buffer("span", torch.as_tensor((high - low) / 2, dtype=torch.float32))

    def forward(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return environment actions (n, k)."""
        scaled = self.middle + self.span * actions.clamp(-1, 1)
        return scaled if self.relative_to is None else self._origins(observations) + scaled

    def inverse(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the network's actions (n, k), clamped to [-1, 1], for actions of the environment."""
        scaled = actions if self.relative_to is None else actions - self._origins(observations)
        return ((scaled - self.middle) / self.span).clamp(-1, 1)

    def _origins(self, observations: Any) -> torch.Tensor:
        return padded(observations[:, self.relative_to], len(self.span))


class Unscaled(torch.nn.Module):
    """The network's actions are the environment's, as they are."""

    def forward(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return environment actions (n, k)."""
        return actions

    def inverse(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the network's actions (n, k)."""
        return actions
