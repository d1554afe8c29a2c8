"""What learners see of their worlds: what an encoder, which does not learn, makes of observations and of a memory.

While an agent learns, its worlds show that. The exported agent has the encoder in its graph.
"""

from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import numpy as np
import torch

from armctl.envs import one_of
from armctl.envs.observations import stacked
from armctl.rl.actor import Actor, blank, tensors
from armctl.rl.training import Training
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import View


class Encoder(torch.nn.Module, ABC):
    """What a learner's worlds make of observations (n, ...) and a memory, before the network that learns."""

    memory: dict[str, tuple[int, ...]]
    """Shapes of what has to be remembered, by name; empty if nothing has."""
    space: gymnasium.Space[Any]
    """Of what it makes of one observation."""

    @abstractmethod
    def elsewhere(self, view: View, observed: gymnasium.Space[Any]) -> "Encoder":
        """The same of other observations, which are prepared alike."""

    @abstractmethod
    def features(self, view: View) -> dict[str, Any]:
        """Arguments of a policy of Stable-Baselines3 for features of what it makes."""

    @abstractmethod
    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[Any, ...]:
        """What it makes of observations, an array or several by name, and the next memory."""


class Encoded(torch.nn.Module):
    """A network of what an encoder makes, as a network of observations and memory."""

    def __init__(self, encoder: Encoder, network: torch.nn.Module) -> None:
        super().__init__()
        self.encoder, self.network = encoder, network

    def forward(self, observation: Any, *memory: torch.Tensor) -> Any:
        """Actions (n, ...) in [-1, 1], and the next memory if there is one."""
        encoded, *after = self.encoder(observation, *memory)
        return (self.network(encoded), *after) if memory else self.network(encoded)


class EncodedVectorEnv(StableBaselinesVectorEnv):
    """Worlds that show what an encoder makes of their observations."""

    def __init__(self, encoder: Encoder, *args: Any) -> None:
        super().__init__(*args)
        self.encoder, self.observation_space = encoder, encoder.space
        self._memory = blank(encoder.memory, self.num_envs)

    def reset(self) -> Any:
        """Start new episodes in all worlds."""
        self._memory = blank(self.encoder.memory, self.num_envs)
        return self._encoded(super().reset())

    def step_wait(self) -> Any:
        """Step all worlds."""
        observations, rewards, done, infos = super().step_wait()
        if (ended := np.flatnonzero(done)).size:
            last = stacked([infos[i]["terminal_observation"] for i in ended])
            with torch.no_grad():
                final = _arrays(self.encoder(tensors(last), *(part[ended] for part in self._memory))[0])
            for k, i in enumerate(ended):
                infos[i]["terminal_observation"] = one_of(final, k)
            # in place, it would change the stacks that the learner has been shown, which share their memory
            self._memory = [part.index_fill(0, torch.as_tensor(ended), 0.0) for part in self._memory]
        return self._encoded(observations), rewards, done, infos

    def _encoded(self, observations: Any) -> Any:
        with torch.no_grad():
            shown, *self._memory = self.encoder(tensors(observations), *self._memory)
        return _arrays(shown)


def features_of(venv: StableBaselinesVectorEnv, view: View) -> dict[str, Any]:
    """Arguments of a policy of Stable-Baselines3 for the features of what worlds show."""
    if isinstance(venv, EncodedVectorEnv):
        return venv.encoder.features(view)
    return {"features_extractor_class": view.features, "features_extractor_kwargs": view.features_options}


def actor_in(venv: StableBaselinesVectorEnv, network: torch.nn.Module, training: Training) -> Actor:
    """An actor for a training's held-out worlds, with a network of what its own worlds show, prepared alike."""
    view, observed = training.view, training.held_out.single_observation_space
    if isinstance(venv, EncodedVectorEnv):
        encoder = venv.encoder.elsewhere(view, observed)
        return Actor(Encoded(encoder, network), view.action_scale, observed, encoder.memory)
    return Actor(network, view.action_scale, observed)


def _arrays(values: Any) -> Any:
    """As NumPy arrays: one, or several by name."""
    return {name: part.numpy() for name, part in values.items()} if isinstance(values, dict) else values.numpy()
