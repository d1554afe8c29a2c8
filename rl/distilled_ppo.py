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
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.options import options
from armctl.policies import make_policy
from armctl.rl.anchored_ppo import AnchoredPpo, AnchoredPpoOptions, improve
from armctl.rl.asymmetric import AsymmetricVectorEnv
from armctl.rl.frames import FramesVectorEnv
from armctl.rl.recurrent import MEMORY, RecurrentNetwork
from armctl.rl.training import Count, Training
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import Features, View


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


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.training.Training`, also for the errors raised."""
    options = recipe.read_options(DistilledPpoOptions)
    if options.frames > 1:
        raise ConfigurationError("distilled_ppo starts from an agent that remembers: leave the option frames out")
    training = Training(recipe, options, out, seed, resume)
    weights = weights_of(recipe, training)

    def show() -> StableBaselinesVectorEnv:
        worlds, view = training.worlds, training.view
        recollection = Recollection(weights, options, view, worlds.single_observation_space)
        kind = AsymmetricVectorEnv if options.privileged_critic else FramesVectorEnv
        return kind(recollection, worlds, view.action_scale)

    def start(model: AnchoredPpo) -> None:
        head = model.env.history.network.head
        policy = model.policy
        with torch.no_grad():
            policy.mlp_extractor.policy_net.load_state_dict(head[:-1].state_dict())
            policy.action_net.load_state_dict(head[-1].state_dict())

    return improve(training, options, show, start, progress)


def weights_of(recipe: Recipe, training: Training) -> dict[str, torch.Tensor]:
    """The weights of the recipe's teacher, by name. Raises `ConfigurationError` if it is no agent with a memory."""
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
    return {name: torch.tensor(numbers) for name, numbers in teacher.numbers.items()}


class Recollection(torch.nn.Module):
    """What an agent makes of an observation and what it remembers, one number (n, k) beside the other.

    It takes the place of `armctl.rl.frames.History`.
    """

    def __init__(
        self, weights: dict[str, torch.Tensor], options: DistilledPpoOptions, view: View,
        observed: gymnasium.Space[Any],
    ) -> None:  # fmt: skip
        super().__init__()
        self._made = weights, options
        memory_units, units = weights["network.unit.weight_hh"].shape[1], options.hidden_units
        self.network = RecurrentNetwork(
            view.extractor(observed), hidden_units=units, layers=options.layers, memory_units=memory_units,
            actions=len(weights["scale.span"]),
        )  # fmt: skip
        with torch.no_grad():
            for name, parameter in self.network.named_parameters():
                parameter.copy_(weights[f"network.{name}"])
        self.network.requires_grad_(False)
        self.memory = self.network.memory
        self.space = gymnasium.spaces.Box(-np.inf, np.inf, (units + memory_units,), np.float32)

    def elsewhere(self, view: View, observed: gymnasium.Space[Any]) -> "Recollection":
        """The same of other observations, which are prepared alike."""
        return Recollection(*self._made, view, observed)

    def features(self, view: View) -> dict[str, Any]:
        """Arguments of a policy of Stable-Baselines3."""
        return {"features_extractor_class": FlattenExtractor, "features_extractor_kwargs": {}}

    def forward(self, observation: Any, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What PPO sees, and the next memory."""
        return self.network.recall(observation, hidden)
