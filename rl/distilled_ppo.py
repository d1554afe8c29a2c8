"""An agent that remembers, as `distil` trains it, and which PPO improves.

Imitation ends where the student does not see what its teacher sees; rewards say what to do there. What the agent makes
of what it sees, and what it remembers of it, stays as it is: PPO learns the layers from there to the actions. So
nothing flows back through time, and the learner is plain PPO. As in `armctl.rl.cloned_ppo`, the critic is fitted first,
and a penalty holds the actor to its start.
"""

from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import AgentCard, OnnxPolicy
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.policies import make_policy
from armctl.rl.anchored_ppo import AnchoredPpo, AnchoredPpoOptions, improve
from armctl.rl.asymmetric import AsymmetricVectorEnv
from armctl.rl.encoding import EncodedVectorEnv, Encoder
from armctl.rl.recurrent import MEMORY, RecurrentNetwork
from armctl.rl.training import Count, Training
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import Features, View
from armctl.training.learners import Callback, Recipe


@options
class DistilledPpoOptions(AnchoredPpoOptions):
    """Options of PPO, whose network has the sizes of the agent from which it starts."""

    steps: Count = 1_000_000
    hidden_units: Count = 192
    layers: Count = 1
    """Between the memory and the actions."""
    features: Features = "invariant"
    activation: Literal["elu", "relu"] = "relu"
    evaluation_every: Count = 100_000


def train(
    recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True, on_evaluation: Callback = None
) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.training.Training`, also for the errors raised."""
    options = recipe.read_options(DistilledPpoOptions)
    if options.frames > 1:
        raise ConfigurationError("distilled_ppo starts from an agent that remembers: leave the option frames out")
    training = Training(recipe, options, out, seed, resume, on_evaluation)
    sizes, weights = network_of(recipe, training)

    def show() -> StableBaselinesVectorEnv:
        worlds, view = training.worlds, training.view
        recollection = Recollection(sizes, weights, view, worlds.single_observation_space)
        kind = AsymmetricVectorEnv if options.privileged_critic else EncodedVectorEnv
        return kind(recollection, worlds, view.action_scale)

    def start(model: AnchoredPpo) -> None:
        head = model.env.encoder.network.head
        model.policy.mlp_extractor.policy_net.load_state_dict(head[:-1].state_dict())
        model.policy.action_net.load_state_dict(head[-1].state_dict())

    return improve(training, options, show, start, progress)


def network_of(recipe: Recipe, training: Training) -> tuple[dict[str, int], dict[str, torch.Tensor]]:
    """The sizes and weights of the teacher's network, by name.

    Raises `ConfigurationError` if the recipe's teacher is no agent with a memory, or has a network of other sizes.
    """
    if recipe.teacher is None:
        raise ConfigurationError("distilled_ppo starts from an agent: name it, --teacher AGENT")
    teacher = make_policy(recipe.teacher, training.held_out)
    if not isinstance(teacher, OnnxPolicy) or list(teacher.card.memory) != [MEMORY]:
        raise ConfigurationError(
            f"distilled_ppo starts from an agent that remembers, as distil trains it, and {recipe.teacher} is none"
        )
    for name in ("hidden_units", "layers", "features", "relative"):
        theirs, ours = teacher.card.learner_options.get(name), getattr(training.options, name)
        if theirs != ours:
            raise ConfigurationError(
                f"{recipe.teacher} was trained with {name} {theirs!r}: set that option, not {ours!r}"
            )
    card, options = teacher.card, training.options
    (memory_units,), actions = card.memory[MEMORY], card.action_shape[0]
    sizes = {"hidden_units": options.hidden_units, "layers": options.layers}
    weights = {name: torch.tensor(numbers) for name, numbers in teacher.numbers.items()}
    return {**sizes, "memory_units": memory_units, "actions": actions}, weights


class Recollection(Encoder):
    """What an agent makes of an observation and what it remembers, one number (n, k) beside the other."""

    def __init__(
        self, sizes: dict[str, int], weights: dict[str, torch.Tensor], view: View, observed: gymnasium.Space[Any]
    ) -> None:
        super().__init__()
        self._made = sizes, weights
        self.network = RecurrentNetwork(view.extractor(observed), **sizes)
        self.network.requires_grad_(False)
        for name, parameter in self.network.named_parameters():
            theirs = weights.get(f"network.{name}")
            if theirs is None or theirs.shape != parameter.shape:
                raise ConfigurationError(
                    f"distilled_ppo starts from an agent as distil trains it, with weights network.{name} of shape "
                    f"{tuple(parameter.shape)}: this one has none"
                )
            parameter.copy_(theirs)
        self.memory = self.network.memory
        self.space = gymnasium.spaces.Box(-np.inf, np.inf, (sizes["hidden_units"] + sizes["memory_units"],), np.float32)

    def elsewhere(self, view: View, observed: gymnasium.Space[Any]) -> "Recollection":
        """The same of other observations, which are prepared alike."""
        return Recollection(*self._made, view, observed)

    def features(self, view: View) -> dict[str, Any]:
        """Arguments of a policy of Stable-Baselines3."""
        return {"features_extractor_class": FlattenExtractor, "features_extractor_kwargs": {}}

    def forward(self, observation: Any, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What PPO sees, and the next memory."""
        return self.network.recall(observation, hidden)
