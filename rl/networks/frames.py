"""Frame stacking: a network without recurrence that sees earlier observations beside the present one.

While it learns, its worlds show the stack (`armctl.rl.run.vector`). The exported agent keeps the earlier observations
in its memory.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor

from armctl.agents import INPUT, inputs
from armctl.core.arrays import map_arrays
from armctl.core.errors import ConfigurationError
from armctl.rl.networks.encoder import Encoder
from armctl.rl.networks.view import View

PAST, HAS_PAST = "past_", "begun"
"""Names of an agent's memory: of each array's earlier values, before its own name; and whether there are any."""


class History(Encoder):
    """Prepared observations (n, ...) of the last control steps, stacked to (n, frames, ...), the present one last.

    Before an episode's first observation, there was always that same one. `memory` is what has to be remembered for
    this. Raises `ConfigurationError` for observations other than arrays of 32-bit floats.
    """

    def __init__(self, view: View, observation_space: gymnasium.Space[Any], frames: int = 1, gap: int = 1) -> None:
        super().__init__()
        self.prepare, self.frames, self.gap = view.preparation(observation_space), frames, gap
        parts, length = inputs(view.prepared(observation_space)), (frames - 1) * gap
        for name, space in parts.items():
            if space.dtype != np.float32:
                raise ConfigurationError(
                    f"frames are stacked of 32-bit floats, and the observation {name!r} has {space.dtype}"
                )
        sizes = {name: space.shape or () for name, space in parts.items()}
        self.memory = {}
        if length:
            self.memory = {PAST + name: (length, *size) for name, size in sizes.items()} | {HAS_PAST: (1,)}
        self.names = list(sizes)
        self.space = _unbounded({name: (frames, *size) for name, size in sizes.items()})

    def rebuilt_for(self, view: View, observation_space: gymnasium.Space[Any]) -> "History":
        """Return the same for other observations, which are prepared alike."""
        return type(self)(view, observation_space, self.frames, self.gap)

    def features(self, view: View) -> dict[str, Any]:
        """Return the arguments of a policy of Stable-Baselines3 for a view's features of stacks."""
        return {"features_extractor_class": FrameFeatures, "features_extractor_kwargs": {"view": view}}

    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[Any, ...]:
        """Return the stack, an array or several by name, and the next memory."""
        prepared = self.prepare(observation)
        parts = prepared if isinstance(prepared, dict) else {INPUT: prepared}
        stack, next_memory = {}, []
        for i, name in enumerate(self.names):
            frames = parts[name][:, None]
            if memory:
                has_past = memory[-1].reshape(-1, *[1] * (frames.dim() - 1)) > 0
                frames = torch.cat((torch.where(has_past, memory[i], frames), frames), dim=1)
                next_memory.append(frames[:, 1:])
            stack[name] = frames[:, :: self.gap]
        if memory:
            next_memory.append(torch.ones_like(memory[-1]))
        return stack if isinstance(prepared, dict) else stack[INPUT], *next_memory


class FeatureHistory(History):
    """A view's features of such stacks, (n, k), for features that do not learn.

    The learner gets each of them once, and does not compute it again in every epoch.
    """

    def __init__(self, view: View, observation_space: gymnasium.Space[Any], frames: int = 1, gap: int = 1) -> None:
        super().__init__(view, observation_space, frames, gap)
        self.frame_features = FrameFeatures(self.space, view)
        self.space = _unbounded({INPUT: (self.frame_features.features_dim,)})

    def features(self, view: View) -> dict[str, Any]:
        """Return the arguments of a policy of Stable-Baselines3."""
        return {"features_extractor_class": FlattenExtractor, "features_extractor_kwargs": {}}

    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[Any, ...]:
        """Return the features, and the next memory."""
        stack, *next_memory = super().forward(observation, *memory)
        return self.frame_features(stack), *next_memory


class FrameFeatures(BaseFeaturesExtractor):
    """A view's features of each frame of a stack, one behind the other."""

    def __init__(self, observation_space: gymnasium.Space[Any], view: View) -> None:
        stacks = {name: space.shape or () for name, space in inputs(observation_space).items()}
        features = view.features(_unbounded({name: size[1:] for name, size in stacks.items()}), **view.features_options)
        frames = next(iter(stacks.values()))[0]
        super().__init__(observation_space, frames * features.features_dim)
        self.features = features

    def forward(self, observations: Any) -> torch.Tensor:
        """Return features (n, frames * k) of stacks (n, frames, ...)."""
        return self.features(map_arrays(_unstacked, observations)).reshape(-1, self.features_dim)


def _unstacked(stacks: torch.Tensor) -> torch.Tensor:
    """Return all frames (n * frames, ...) of stacks (n, frames, ...)."""
    return stacks.reshape(-1, *stacks.shape[2:])


def _unbounded(sizes: Mapping[str, tuple[int, ...]]) -> gymnasium.Space[Any]:
    boxes: dict[str, gymnasium.Space[Any]] = {
        name: gymnasium.spaces.Box(-np.inf, np.inf, size, np.float32) for name, size in sizes.items()
    }
    return boxes[INPUT] if list(boxes) == [INPUT] else gymnasium.spaces.Dict(boxes)
