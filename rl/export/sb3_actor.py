"""A model of Stable-Baselines3 as a torch module from the environment's observations to its actions.

It acts as `model.predict(observation, deterministic=True)` does, and normalises the observations before that.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
from stable_baselines3.common.vec_env import VecNormalize, VecTransposeImage

from armctl.agents import INPUT, inputs
from armctl.core.errors import AgentFileError
from armctl.rl.networks.onnx_graph import observation_of, write_graph

HIDDEN, CELL = "lstm_hidden", "lstm_cell"


class Sb3Actor(torch.nn.Module):
    """The deterministic actions of a model, for observations as the environment gives them.

    Raises `AgentFileError` if the model was trained with other observations or actions than the environment's.
    """

    def __init__(
        self,
        model: BaseAlgorithm,
        observation_space: gymnasium.Space[Any],
        action_space: gymnasium.Space[Any],
        normalisation: VecNormalize | None,
    ) -> None:
        super().__init__()
        if model.action_space != action_space:
            raise _trained_with("actions", model.action_space, action_space)
        self.policy, self.inputs = model.policy, inputs(observation_space)
        expected = inputs(model.observation_space)
        if set(expected) != set(self.inputs):
            raise _trained_with("observations", model.observation_space, observation_space)
        statistics = _statistics(normalisation, self.inputs)
        self.prepare = torch.nn.ModuleList(
            _preparation(expected[name], space, normalisation, statistics.get(name), name)
            for name, space in self.inputs.items()
        )
        self.limit = ActionLimits(action_space, model.policy.squash_output)
        self.memory: dict[str, list[int]] = {}
        if hasattr(model.policy, "lstm_actor"):
            layers, _, units = model.policy.lstm_hidden_state_shape
            self.memory = {HIDDEN: [layers, units], CELL: [layers, units]}

    def forward(self, *arrays: torch.Tensor) -> Any:
        """Return actions (n, ...), and the new memory if there is one, for the observation's arrays and the memory."""
        prepared = [prepare(array) for prepare, array in zip(self.prepare, arrays, strict=False)]
        observation = observation_of(self.inputs, prepared)
        if not self.memory:
            return self.limit(self.policy._predict(observation, deterministic=True))
        actions, *memory = self._recall(observation, *arrays[len(prepared) :])
        return self.limit(actions), *memory

    def _recall(self, observation: Any, hidden: torch.Tensor, cell: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Make one step of the LSTM. States are (n, layers, units), which torch has as (layers, n, units)."""
        policy = self.policy
        features = BasePolicy.extract_features(policy, observation, policy.pi_features_extractor)
        state = (hidden.transpose(0, 1).contiguous(), cell.transpose(0, 1).contiguous())
        output, (hidden, cell) = policy.lstm_actor(features[None], state)
        latent = policy.mlp_extractor.forward_actor(output[0])
        actions = policy._get_action_dist_from_latent(latent).get_actions(deterministic=True)
        return actions, hidden.transpose(0, 1), cell.transpose(0, 1)

    def export(self, path: Path) -> None:
        """Write it as an ONNX graph: inputs are observations and memory, outputs the action and the new memory."""
        with _unvalidated_distributions():
            write_graph(self, self.inputs, self.memory, path)


class Normalised(torch.nn.Module):
    """Observations as `VecNormalize` shows them to a model: (x - mean) / std, clipped."""

    def __init__(self, normalisation: VecNormalize, statistics: Any) -> None:
        super().__init__()
        self.largest = normalisation.clip_obs
        self.register_buffer("mean", torch.as_tensor(statistics.mean))
        self.register_buffer("std", torch.as_tensor(np.sqrt(statistics.var + normalisation.epsilon)))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return normalised values, in double precision as NumPy computes them."""
        return ((values.double() - self.mean) / self.std).clamp(-self.largest, self.largest).float()


class ChannelsFirst(torch.nn.Module):
    """Images (n, height, width, channels) as torch expects them, which `VecTransposeImage` does in a training."""

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return images (n, channels, height, width)."""
        return images.permute(0, 3, 1, 2)


class ActionLimits(torch.nn.Module):
    """A policy's output as an action of the space: scaled from [-1, 1] if it is squashed, otherwise clipped."""

    def __init__(self, space: gymnasium.Space[Any], squashed: bool) -> None:
        super().__init__()
        self.shape, self.squashed = space.shape or (), squashed
        self.bounded = isinstance(space, spaces.Box)
        if isinstance(space, spaces.Box):
            self.register_buffer("low", torch.as_tensor(space.low))
            self.register_buffer("high", torch.as_tensor(space.high))

    def forward(self, output: torch.Tensor) -> torch.Tensor:
        """Return actions (n, ...)."""
        actions = output.reshape(output.shape[0], *self.shape)
        if not self.bounded:
            return actions
        if self.squashed:
            return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)
        return torch.clamp(actions, self.low, self.high)


def _statistics(normalisation: VecNormalize | None, observed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the statistics of each observation array that is normalised."""
    if normalisation is None or not normalisation.norm_obs:
        return {}
    by_name = normalisation.obs_rms if isinstance(normalisation.obs_rms, dict) else {INPUT: normalisation.obs_rms}
    for name, statistics in by_name.items():
        shape = observed[name].shape if name in observed else None
        if shape != statistics.mean.shape:
            raise AgentFileError(
                f"the statistics are of {name} with shape {statistics.mean.shape}; "
                f"in this environment, {f'its shape is {shape}' if shape is not None else 'there is none'}"
            )
    return by_name


def _preparation(
    expected: gymnasium.Space[Any],
    space: gymnasium.Space[Any],
    normalisation: VecNormalize | None,
    statistics: Any,
    name: str,
) -> torch.nn.Module:
    """Return the map from the environment's array to the one that the model was trained with."""
    first = [] if statistics is None else [Normalised(normalisation, statistics)]
    image = is_image_space(space)
    if expected == space or (first and image and expected.shape == space.shape):
        return torch.nn.Sequential(*first)
    if image and not is_image_space_channels_first(space) and expected == VecTransposeImage.transpose_space(space):
        return torch.nn.Sequential(*first, ChannelsFirst())
    raise _trained_with(name if name == INPUT else f"observation {name}", expected, space)


def _trained_with(name: str, expected: Any, actual: Any) -> AgentFileError:
    texts = (" ".join(str(space).split()) for space in (expected, actual))
    return AgentFileError(
        "the model was trained with {} {}, but here: {}. Name its environment and options, --env and --set; an "
        "environment that was wrapped is registered as one of its own".format(name, *texts)
    )


@contextmanager
def _unvalidated_distributions() -> Iterator[None]:
    """Leave out the checks of values which torch's distributions make: they have no place in a graph."""
    distribution = torch.distributions.Distribution
    previous = distribution._validate_args
    distribution.set_default_validate_args(False)
    try:
        yield
    finally:
        distribution.set_default_validate_args(previous)
