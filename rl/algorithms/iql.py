"""Implicit Q-learning (Kostrikov et al., ICLR 2022): the best of a dataset's episodes, good and bad, without acting.

A value is the upper expectile of what a critic says of the dataset's actions, so that no other action is ever asked
about. The actor clones actions, each weighted by its advantage. Behaviour cloning has no such weights, and clones
successful episodes only.
"""

import copy
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field

from armctl.agents import AgentCard
from armctl.core.arrays import map_arrays
from armctl.core.options import Count, Positive, Share, options
from armctl.datasets.demonstrations import Demonstration
from armctl.rl.algorithms.bc import BcOptions, check_dataset
from armctl.rl.algorithms.cloning import fit_and_export, new_actor
from armctl.rl.data.demonstrations import Examples, recorded_episodes
from armctl.rl.networks.actor import Actor
from armctl.rl.networks.layers import hidden_layers
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training

LARGEST_WEIGHT = 100.0
"""Largest weight of an action in cloning, as in the paper."""


@options
class IqlOptions(BcOptions):
    """Options of implicit Q-learning."""

    family = "IQL"
    steps: Count = 60_000
    evaluation_every: Count = 15_000
    gamma: Share = 0.99
    expectile: Annotated[float, Field(ge=0.5, lt=1)] = 0.8
    """Expectile of the critic's values in a state: 0.5 is their mean, 1 their maximum."""
    temperature: Positive = 3.0
    """Logarithm of an action's weight per unit of its advantage."""
    reward_scale: Positive = 0.1
    tau: Share = 0.01
    """Share by which the critic's target moves in each gradient step."""


class Transitions(Examples):
    """Recorded episodes, whose examples are transitions."""

    def __init__(self, task: Any) -> None:
        super().__init__(task, hindsight=0.0)

    def add(self, episodes: list[Demonstration]) -> None:
        """Add episodes."""
        super().add(episodes)
        self._rewards = np.concatenate([episode.rewards for episode in self.episodes]).astype(np.float32)
        lengths = np.array([len(episode) for episode in self.episodes])
        self._goes_on = np.ones(len(self._rewards), np.float32)
        self._goes_on[np.cumsum(lengths) - 1] = [not episode.terminated for episode in self.episodes]

    def draw(self, rng: np.random.Generator, size: int) -> tuple[Any, Any]:
        """Return observations (size, ...), and what followed: actions, rewards, next observations, and going on."""
        samples = rng.integers(len(self._rows), size=size)
        rows = self._rows[samples]
        return map_arrays(lambda values: values[rows], self._observations), {
            "actions": self.actions_of(samples),
            "rewards": self._rewards[samples],
            "next": map_arrays(lambda values: values[rows + 1], self._observations),
            "goes_on": self._goes_on[samples],
        }


class Critic(torch.nn.Module):
    """Features (n, `size`), and layers from them and from actions, if there are any, to a value."""

    def __init__(self, features: torch.nn.Module, size: int, actions: int, hidden: list[int]) -> None:
        super().__init__()
        self.features = features
        self.layers = torch.nn.Sequential(*hidden_layers([size + actions, *hidden]), torch.nn.Linear(hidden[-1], 1))

    def forward(self, observations: Any, *actions: torch.Tensor) -> torch.Tensor:
        """Return values (n,)."""
        return self.layers(torch.cat((self.features(observations), *actions), dim=1)).squeeze(1)


class IqlActor(Actor):
    """An actor with the critics and the value from which it learns.

    Features without weights are computed once for all networks. The actor's network begins with its features.
    """

    def __init__(self, actor: Actor, training: Training, options: IqlOptions) -> None:
        view, space = training.view, training.held_out.single_observation_space
        super().__init__(actor.network, actor.scale, space)
        actions, hidden = training.held_out.single_action_space.shape[0], [options.hidden_units] * options.layers
        self._options = options
        features = view.extractor(space)
        self._shares = not any(True for _ in features.parameters())
        self.shared = features if self._shares else torch.nn.Identity()

        def critic(actions: int) -> Critic:
            unshared = torch.nn.Identity() if self._shares else view.extractor(space)
            return Critic(unshared, features.features_dim, actions, hidden)

        self.value = critic(0)
        self.critics = torch.nn.ModuleList(critic(actions) for _ in range(2))
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)

    def loss(self, observations: Any, followed: Any) -> torch.Tensor:
        """Return the sum of the losses of value, critics and actor, none of which moves the others' parameters."""
        self._move_targets()
        options, actions = self._options, self.scale.inverse(observations, followed["actions"])
        prepared = self.shared(observations)
        with torch.no_grad():
            best = torch.min(*(target(prepared, actions) for target in self.targets))
            ahead = options.gamma * followed["goes_on"] * self.value(self.shared(followed["next"]))
            returns = options.reward_scale * followed["rewards"] + ahead
        advantages = best - self.value(prepared)
        asymmetry = torch.where(advantages > 0, options.expectile, 1 - options.expectile)
        value_loss = (asymmetry * advantages.square()).mean()
        critic_loss = sum((critic(prepared, actions) - returns).square().mean() for critic in self.critics)
        weights = (options.temperature * advantages.detach()).exp().clamp(max=LARGEST_WEIGHT)
        errors = (self.network[int(self._shares) :](prepared) - actions).square().mean(dim=1)
        return value_loss + critic_loss + (weights * errors).mean()

    @torch.no_grad()
    def _move_targets(self) -> None:
        for target, source in zip(self.targets.parameters(), self.critics.parameters(), strict=True):
            target.lerp_(source, self._options.tau)


@learner(IqlOptions, rewards=False, curriculum=False, explores=False, check=check_dataset)
def train(training: Training, options: IqlOptions) -> AgentCard:
    """Fit value, critics and actor to recorded transitions."""
    examples = Transitions(training.held_out.task)
    examples.add(recorded_episodes(training, options, options.dataset))
    with training:
        actor = IqlActor(new_actor(training, options), training, options)
        return fit_and_export(training, actor, examples, options.batch_size)
