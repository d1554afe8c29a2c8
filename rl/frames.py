"""Frame stacking: a network without recurrence that sees earlier observations beside the present one.

While it learns, its worlds show the stack. The exported agent keeps the earlier observations in its memory.
"""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.agents import INPUT, inputs
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.rl.encoding import EncodedVectorEnv, Encoder
from armctl.rl.training import Count, TrainingOptions
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import View

PAST, BEGUN = "past_", "begun"
"""Names of an agent's memory: of each array's earlier values, before its own name; and whether there are any."""


@options
class FrameOptions(TrainingOptions):
    """Options of learners whose networks may see earlier observations too."""

    frames: Count = 1
    """Observations that the network sees at once: the present one, and earlier ones."""
    frame_gap: Count = 1
    """Control steps from one of these observations to the next."""

    def __post_init__(self) -> None:
        if self.frame_gap > 1 and self.frames == 1:
            raise ConfigurationError("frame_gap is the time between frames, of which there is one: set frames too")


class History(Encoder):
    """Prepared observations (n, ...) of the last control steps, stacked to (n, frames, ...), the present one last.

    Before an episode's first observation, there was always that same one. `memory` is what has to be remembered for
    this. Raises `ConfigurationError` for observations other than arrays of 32-bit floats.
    """

    def __init__(self, view: View, observed: gymnasium.Space[Any], frames: int = 1, gap: int = 1) -> None:
        super().__init__()
        self.prepare, self.frames, self.gap = view.preparation(observed), frames, gap
        parts, length = inputs(view.prepared(observed)), (frames - 1) * gap
        for name, space in parts.items():
            if space.dtype != np.float32:
                raise ConfigurationError(
                    f"frames are stacked of 32-bit floats, and the observation {name!r} has {space.dtype}"
                )
        sizes = {name: space.shape or () for name, space in parts.items()}
        self.memory = {}
        if length:
            self.memory = {PAST + name: (length, *size) for name, size in sizes.items()} | {BEGUN: (1,)}
        self.names = list(sizes)
        self.space = _unbounded({name: (frames, *size) for name, size in sizes.items()})

    def elsewhere(self, view: View, observed: gymnasium.Space[Any]) -> "History":
        """The same of other observations, which are prepared alike."""
        return History(view, observed, self.frames, self.gap)

    def features(self, view: View) -> dict[str, Any]:
        """Arguments of a policy of Stable-Baselines3 for a view's features of stacks."""
        return {"features_extractor_class": FrameFeatures, "features_extractor_kwargs": {"view": view}}

    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[Any, ...]:
        """The stack, an array or several by name, and the next memory."""
        prepared = self.prepare(observation)
        parts = prepared if isinstance(prepared, dict) else {INPUT: prepared}
        stack, after = {}, []
        for i, name in enumerate(self.names):
            now = parts[name][:, None]
            if memory:
                begun = memory[-1].reshape(-1, *[1] * (now.dim() - 1)) > 0
                now = torch.cat((torch.where(begun, memory[i], now), now), dim=1)
                after.append(now[:, 1:])
            stack[name] = now[:, :: self.gap]
        if memory:
            after.append(torch.ones_like(memory[-1]))
        return stack if isinstance(prepared, dict) else stack[INPUT], *after


class FrameFeatures(BaseFeaturesExtractor):
    """A view's features of each frame of a stack, one behind the other."""

    def __init__(self, observation_space: gymnasium.Space[Any], view: View) -> None:
        stacks = {name: space.shape or () for name, space in inputs(observation_space).items()}
        features = view.features(_unbounded({name: size[1:] for name, size in stacks.items()}), **view.features_options)
        frames = next(iter(stacks.values()))[0]
        super().__init__(observation_space, frames * features.features_dim)
        self.features = features

    def forward(self, observations: Any) -> torch.Tensor:
        """Features (n, frames * k) of stacks (n, frames, ...)."""
        each = (
            {name: _each(stack) for name, stack in observations.items()}
            if isinstance(observations, dict)
            else _each(observations)
        )
        return self.features(each).reshape(-1, self.features_dim)


def shown_worlds(
    worlds: Any, view: View, options: FrameOptions, kind: Callable[..., EncodedVectorEnv] | None = None
) -> StableBaselinesVectorEnv:
    """Worlds as a learner with these options is shown them: of a `kind`, or without stacks where there is no need."""
    if kind is None and options.frames == 1 and view.prepare is None:
        return StableBaselinesVectorEnv(worlds, view.action_scale)
    encoder = History(view, worlds.single_observation_space, options.frames, options.frame_gap)
    return (kind or EncodedVectorEnv)(encoder, worlds, view.action_scale)


def _each(stacks: torch.Tensor) -> torch.Tensor:
    """All frames (n * frames, ...) of stacks (n, frames, ...)."""
    return stacks.reshape(-1, *stacks.shape[2:])


def _unbounded(sizes: Mapping[str, tuple[int, ...]]) -> gymnasium.Space[Any]:
    boxes: dict[str, gymnasium.Space[Any]] = {
        name: gymnasium.spaces.Box(-np.inf, np.inf, size, np.float32) for name, size in sizes.items()
    }
    return boxes[INPUT] if list(boxes) == [INPUT] else gymnasium.spaces.Dict(boxes)
