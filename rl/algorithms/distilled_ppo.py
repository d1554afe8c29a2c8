"""An agent that remembers, as `distil` trains it, and which PPO improves.

Imitation ends where the student does not see what its teacher sees; rewards say what to do there. What the agent makes
of what it sees, and what it remembers of it, stays as it is: PPO learns the layers from there to the actions. So
nothing flows back through time, and the learner is plain PPO. As in `cloned_ppo`, the critic is fitted first, and a
penalty holds the actor to its start.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import AgentCard, OnnxPolicy
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, options
from armctl.policies import make_policy
from armctl.rl.algorithms.anchored_ppo import AnchoredPpo, AnchoredPpoOptions, improve
from armctl.rl.algorithms.asymmetric import AsymmetricVectorEnv
from armctl.rl.networks.encoder import Encoder
from armctl.rl.networks.recurrent import MEMORY, RecurrentNetwork, copy_weights
from armctl.rl.networks.view import View
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training
from armctl.rl.run.vector import EncodedVectorEnv, StableBaselinesVectorEnv


@options
class DistilledPpoOptions(AnchoredPpoOptions):
    """Options of PPO, whose network has the sizes of the agent from which it starts."""

    hidden_units: Count = 192
    layers: Count = 1
    """Layers between the memory and the actions."""
    evaluation_every: Count = 100_000


@learner(DistilledPpoOptions)
def train(training: Training, options: DistilledPpoOptions) -> AgentCard:
    """Improve by PPO what an agent makes of its memory."""
    if options.frames > 1:
        raise ConfigurationError("distilled_ppo starts from an agent that remembers: leave the option frames out")
    sizes, weights = network_of(training)

    def make_vec_env() -> StableBaselinesVectorEnv:
        envs, view = training.envs, training.view
        encoder = FrozenRecurrentEncoder(sizes, weights, view, envs.single_observation_space)
        kind = AsymmetricVectorEnv if options.privileged_critic else EncodedVectorEnv
        return kind(encoder, envs, view)

    def start(model: AnchoredPpo) -> None:
        head = model.env.encoder.network.head
        model.policy.mlp_extractor.policy_net.load_state_dict(head[:-1].state_dict())
        model.policy.action_net.load_state_dict(head[-1].state_dict())

    return improve(training, options, make_vec_env, start)


def network_of(training: Training) -> tuple[dict[str, int], dict[str, torch.Tensor]]:
    """Return the sizes and weights of the network of the agent to start from; raises what `start_of` raises."""
    card, weights = start_of(training, "distilled_ppo", memory=[MEMORY])
    sizes = {"hidden_units": training.options.hidden_units, "layers": training.options.layers}
    (memory_units,), actions = card.memory[MEMORY], card.action_shape[0]
    return {**sizes, "memory_units": memory_units, "actions": actions}, weights


def start_of(training: Training, learner: str, memory: list[str]) -> tuple[AgentCard, dict[str, torch.Tensor]]:
    """Return the card and the weights, by name, of the recipe's teacher, from which a learner starts.

    Raises `ConfigurationError` if it is no agent with this memory, or has a network of other sizes than the options.
    """
    name = training.recipe.teacher
    if name is None:
        raise ConfigurationError(f"{learner} starts from an agent: name it, --teacher AGENT")
    teacher = make_policy(name, training.held_out)
    if not isinstance(teacher, OnnxPolicy) or list(teacher.card.memory) != memory:
        kind = "that remembers, as distil trains it" if memory else "without a memory, as bc trains it"
        raise ConfigurationError(f"{learner} starts from an agent {kind}, and {name} is none")
    for option in ("hidden_units", "layers", "features", "relative"):
        of_teacher, requested = teacher.card.learner_options.get(option), getattr(training.options, option)
        if of_teacher != requested:
            raise ConfigurationError(
                f"{name} was trained with {option} {of_teacher!r}: set that option, not {requested!r}"
            )
    return teacher.card, {key: torch.tensor(numbers) for key, numbers in teacher.numbers.items()}


class FrozenRecurrentEncoder(Encoder):
    """An agent's recurrent network, which stays as it is: from observations to what its head sees (n, k)."""

    def __init__(
        self,
        sizes: dict[str, int],
        weights: dict[str, torch.Tensor],
        view: View,
        observation_space: gymnasium.Space[Any],
    ) -> None:
        super().__init__()
        self._sizes, self._weights = sizes, weights
        self.network = RecurrentNetwork(view.extractor(observation_space), **sizes)
        self.network.requires_grad_(False)
        copy_weights(self.network, weights)
        self.memory = self.network.memory
        self.space = gymnasium.spaces.Box(-np.inf, np.inf, (sizes["hidden_units"] + sizes["memory_units"],), np.float32)

    def rebuilt_for(self, view: View, observation_space: gymnasium.Space[Any]) -> "FrozenRecurrentEncoder":
        """Return the same for other observations, which are prepared alike."""
        return FrozenRecurrentEncoder(self._sizes, self._weights, view, observation_space)

    def features(self, view: View) -> dict[str, Any]:
        """Return the arguments of a policy of Stable-Baselines3."""
        return {"features_extractor_class": FlattenExtractor, "features_extractor_kwargs": {}}

    def forward(self, observation: Any, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what PPO sees, and the next memory."""
        return self.network.recall(observation, hidden)
