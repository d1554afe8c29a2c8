"""Shared by learners from demonstrations: the examples, the network, and fitting the network to the examples."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from tqdm import tqdm

from armctl.agents import AgentCard
from armctl.core.console import printable
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.datasets.demonstrations import Demonstration, demonstrate
from armctl.datasets.minari import read_demonstrations
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.policies import Policy, make_policy
from armctl.policies.state_observing import StateObservingAgent, state_observing_env
from armctl.policies.trainings import card_of
from armctl.rl.actor import Actor, tensors
from armctl.rl.disk import save_torch
from armctl.rl.training import Count, Share, Training, TrainingOptions, bar_fits
from armctl.rl.view import Features
from armctl.tasks import ReachMovingTask, ReachTask
from armctl.tasks.reach import observation_slices
from armctl.training.learners import Recipe

LOOK_BACK = 10
"""Control steps: hindsight takes its targets from at most so long before an example."""
LAST_RATE = 0.02
"""Share of the learning rate that is left at the end of a fit."""


@options
class CloningOptions(TrainingOptions):
    """Options that all learners from demonstrations share."""

    steps: Count = 12_000
    """Gradient steps."""
    worlds: Count = 50
    hidden_units: Count = 256
    layers: Count = 3
    features: Features = "invariant"
    evaluation_every: Count = 3_000
    demonstrations: Count = 500
    """Episodes of the teacher, in total."""
    batch_size: Count = 256
    hindsight: Share = 0.5
    """Share of the examples whose target is moved to another point of their episode; for targets at rest only."""


@dataclass
class Examples:
    """Observations and actions of many episodes, concatenated."""

    task: Any
    hindsight: float
    episodes: list[Demonstration] = field(default_factory=list)

    def add(self, episodes: list[Demonstration]) -> None:
        """Add episodes."""
        self.episodes += episodes
        lengths = np.array([len(episode) for episode in self.episodes])
        begins = np.concatenate(([0], np.cumsum(lengths + 1)[:-1]))
        self._begins, self._ends = np.repeat(begins, lengths), np.repeat(begins + lengths, lengths)
        self._rows = np.concatenate([begin + np.arange(length) for begin, length in zip(begins, lengths, strict=True)])
        self._actions = np.concatenate([episode.actions for episode in self.episodes]).astype(np.float32)
        parts: Any = [episode.observations for episode in self.episodes]
        self._observations: Any = (
            {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            if isinstance(parts[0], dict)
            else np.concatenate(parts)
        )

    def draw(self, rng: np.random.Generator, size: int) -> tuple[Any, torch.Tensor]:
        """A random batch of observations and actions (size, ...).

        Some are relabelled in hindsight (Ding et al., Goal-conditioned imitation learning, NeurIPS 2019): the target
        becomes the end-effector's position at another time of the episode, the action the joint positions at that time.
        """
        drawn = rng.integers(len(self._rows), size=size)
        rows, actions = self._rows[drawn], self._actions[drawn]
        if isinstance(self._observations, dict):
            return tensors({name: part[rows] for name, part in self._observations.items()}), torch.as_tensor(actions)
        observations = self._observations[rows]
        if self.hindsight:
            other = rng.random(size) < self.hindsight
            first = np.maximum(self._begins[drawn], rows - LOOK_BACK)
            then = self._observations[rng.integers(first, self._ends[drawn] + 1)]
            parts = observation_slices(actions.shape[1])
            observations[other, parts["target_position"]] = then[other, parts["end_effector_position"]]
            actions[other] = then[other, parts["joint_positions"]]
        return torch.as_tensor(observations), torch.as_tensor(actions)


def examples_for(training: Training, options: CloningOptions) -> Examples:
    """An empty set of examples; with hindsight if the task allows it."""
    task = training.held_out.task
    at_rest = isinstance(task, ReachTask) and not isinstance(task, ReachMovingTask)
    positions = at_rest and task.interface["control"] == "position"
    return Examples(task, options.hindsight if positions else 0.0)


def check_teaching(recipe: Recipe) -> None:
    """Raise `ConfigurationError` for options that have no meaning without rewards."""
    if recipe.shaping or recipe.reward_weights or any(stage.reward_weights for stage in recipe.curriculum):
        raise ConfigurationError(
            f"{recipe.learner} does not learn from rewards: it takes neither shaping nor reward_weights"
        )


class Teacher:
    """The policy to learn from, in worlds of its own; `policy_seed` determines its random numbers.

    Raises `ConfigurationError` for a recipe without a teacher.
    """

    def __init__(self, recipe: Recipe, worlds: int, policy_seed: int) -> None:
        if recipe.teacher is None:
            raise ConfigurationError(f"{recipe.learner} learns from a policy: name it, --teacher POLICY")
        self.name = recipe.teacher
        self.worlds = make_worlds(recipe.env, worlds, recipe.options_in_training)
        try:
            self.policy = make_policy(self.name, self.worlds, policy_seed=policy_seed)
        except Exception:
            self.worlds.close()
            raise

    def show(self, episodes: int, seed: int, progress: bool, **instead: Any) -> list[Demonstration]:
        """The teacher's episodes 0 to `episodes` - 1 of a seed, in this order; see `demonstrate` for `instead`."""
        shown = demonstrate(self.policy, self.worlds, episodes, seed, self.name, **instead)
        bar = tqdm(shown, printable(self.name), episodes, leave=False, disable=not bar_fits(progress))
        played = sorted(bar, key=lambda pair: pair[0].episode)
        return [episode for _, episode in played]


def teacher_in(worlds: TaskVectorEnv, recipe: Recipe, policy_seed: int) -> Policy:
    """The recipe's teacher in these worlds of its environment. An agent that was trained to see the state sees theirs.

    `policy_seed` determines its random numbers.

    Raises `ConfigurationError` for a recipe without a teacher, and what `armctl.make_policy` raises.
    """
    if recipe.teacher is None:
        raise ConfigurationError(f"{recipe.learner} learns from a policy: name it, --teacher POLICY")
    card = card_of(recipe.teacher)
    if card is None or card.sees != "state" or worlds.task.state_space is None:
        return make_policy(recipe.teacher, worlds, policy_seed=policy_seed)
    with state_observing_env(worlds) as single_env:
        return StateObservingAgent(make_policy(recipe.teacher, single_env, policy_seed=policy_seed), worlds)


def demonstrations(
    training: Training, options: CloningOptions, dataset: str | None, progress: bool
) -> list[Demonstration]:
    """The successful episodes of a dataset, or of the teacher. Raises `ConfigurationError` if there are none."""
    if dataset is None:
        teacher = Teacher(training.recipe, min(options.worlds, options.demonstrations), training.seed)
        try:
            episodes, source = teacher.show(options.demonstrations, training.first_seed(), progress), teacher.name
        finally:
            teacher.worlds.close()
    else:
        episodes, source = read_demonstrations(dataset, training.held_out), dataset
    if training.newest_checkpoint() is None:  # a resumed training is shown the same episodes again
        asked = sum(map(len, episodes))
        training.meter.add(decisions=asked, teacher_queries=asked)
    won = [episode for episode in episodes if episode.success]
    if not won:
        raise ConfigurationError(
            f"none of {len(episodes)} episodes of {source} was a success: there is nothing to learn from"
        )
    return won


def new_actor(training: Training, options: TrainingOptions) -> Actor:
    """An untrained actor."""
    torch.manual_seed(training.seed)
    view, space = training.view, training.held_out.single_observation_space
    features = view.extractor(space)
    sizes = [features.features_dim] + [options.hidden_units] * options.layers
    layers: list[torch.nn.Module] = []
    for fewer, more in itertools.pairwise(sizes):
        layers += [torch.nn.Linear(fewer, more), torch.nn.ReLU()]
    actions = training.held_out.single_action_space.shape[0]
    return Actor(torch.nn.Sequential(features, *layers, torch.nn.Linear(sizes[-1], actions)), view.action_scale, space)


class Drawn(Protocol):
    """Examples to draw from."""

    def draw(self, rng: np.random.Generator, size: int) -> tuple[Any, torch.Tensor]:
        """A random batch of observations and actions (size, ...)."""


def fit_and_export(
    training: Training,
    actor: Actor,
    examples: Drawn,
    batch_size: int,
    progress: bool,
    renew: Callable[[int], None] | None = None,
) -> AgentCard:
    """Fit an actor to the examples from the newest checkpoint on, evaluate it now and then, and export the best.

    `renew` is called with the number of gradient steps that have been taken, at the start and after each.
    """
    options, step = training.options, 0
    if (newest := training.newest_checkpoint()) is not None:
        actor.load_state_dict(torch.load(newest, weights_only=True))
        step = int(newest.stem)
    fitting = fit(
        actor, examples, options.steps, np.random.default_rng((training.seed, step)),
        batch_size=batch_size, learning_rate=options.learning_rate, progress=progress, start=step,
    )  # fmt: skip

    def save() -> None:
        training.checkpoint(step, lambda path: save_torch(actor.state_dict(), path))

    try:
        if renew:
            renew(step)
        for step in fitting:
            training.meter.add(gradient_steps=1)
            if renew:
                renew(step)
            if step % options.evaluation_every == 0:
                save()
                training.evaluate(actor, step)
    finally:
        if step:
            save()
    return training.finish(actor, step)


def fit(
    actor: Actor,
    examples: Drawn,
    steps: int,
    rng: np.random.Generator,
    *,
    batch_size: int,
    learning_rate: float,
    progress: bool,
    start: int = 0,
) -> Iterator[int]:
    """Fit the actor's network by least squares, in the network's unit of actions.

    Yields the number of each gradient step, from `start` + 1 to `steps`. The learning rate decays linearly.
    """
    optimizer = torch.optim.Adam(actor.network.parameters(), learning_rate)
    for step in tqdm(range(start, steps), "fit", leave=False, disable=not bar_fits(progress)):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * max(1 - step / steps, LAST_RATE)
        observations, actions = map(tensors, examples.draw(rng, batch_size))
        wanted = actor.scale.inverse(observations, actions)
        loss = (actor.network(observations) - wanted).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        yield step + 1
