"""Demonstrations of a teacher or a dataset, as examples to learn from."""

import functools
import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from armctl.core.arrays import map_arrays
from armctl.core.console import printable
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Share, options
from armctl.datasets.demonstrations import Demonstration, demonstrate
from armctl.datasets.minari import read_demonstrations
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.policies import Policy, make_policy
from armctl.policies.state_observing import StateObservingAgent, state_observing_env
from armctl.policies.trainings import card_of
from armctl.rl.networks.actor import tensors
from armctl.rl.networks.view import Features
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.training import Training
from armctl.tasks import ReachMovingTask, ReachTask
from armctl.training.learners import Recipe

ACHIEVED = {"target_position": "end_effector_position", "target_axes": "end_effector_axes"}
"""Parts of an observation that tell the target, and those that tell where the end-effector is."""
LOOK_BACK = 10
"""Control steps before an example from which hindsight takes its targets, at most."""


@options
class CloningOptions(TrainingOptions):
    """Options that all learners from demonstrations share."""

    family = "BC"
    steps: Count = 12_000
    """Number of gradient steps."""
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
        parts = [episode.observations for episode in self.episodes]
        self._observations = map_arrays(lambda *arrays: np.concatenate(arrays), *parts)

    def actions_of(self, samples: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the actions (size, k) at these samples."""
        return self._actions[samples]

    @functools.cached_property
    def _slices(self) -> dict[str, slice]:
        return slices_of_parts(self.task)

    def draw(self, rng: np.random.Generator, size: int) -> tuple[Any, torch.Tensor]:
        """Return a random batch of observations and actions (size, ...).

        Some are relabelled in hindsight (Ding et al., Goal-conditioned imitation learning, NeurIPS 2019): the target
        becomes the end-effector's position, or pose, at another time of the episode, the action the joint positions at
        that time.
        """
        samples = rng.integers(len(self._rows), size=size)
        rows, actions = self._rows[samples], self.actions_of(samples)
        observations = map_arrays(lambda values: values[rows], self._observations)
        if self.hindsight and not isinstance(observations, dict):
            other = rng.random(size) < self.hindsight
            first = np.maximum(self._begins[samples], rows - LOOK_BACK)
            achieved = self._observations[rng.integers(first, self._ends[samples] + 1)]
            parts = self._slices
            for goal, place in ACHIEVED.items():
                if goal in parts:
                    observations[other, parts[goal]] = achieved[other, parts[place]]
            actions[other] = achieved[other, parts["joint_positions"]]
        return tensors(observations), torch.as_tensor(actions)


def slices_of_parts(task: Any) -> dict[str, slice]:
    """Return the places of the parts of a task's observation, by name."""
    sizes = {name: part.shape[1] for name, part in task.observation_parts().items()}
    ends = itertools.accumulate(sizes.values())
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def examples_for(training: Training, options: CloningOptions) -> Examples:
    """Return an empty set of examples; with hindsight if the task allows it."""
    task = training.held_out.task
    at_rest = isinstance(task, ReachTask) and not isinstance(task, ReachMovingTask)
    positions = at_rest and task.interface["control"] == "position"
    positions = positions and {"end_effector_position", "target_position"} <= task.observation_parts().keys()
    return Examples(task, options.hindsight if positions else 0.0)


class Teacher:
    """The policy to learn from, in worlds of its own; the training's seed determines its random numbers.

    Raises `ConfigurationError` for a recipe without a teacher.
    """

    def __init__(self, training: Training, num_envs: int) -> None:
        recipe, self._shows_bars = training.recipe, training.shows_bars
        self.name = _teacher_of(recipe)
        self.envs = make_worlds(recipe.env, num_envs, recipe.options_in_training)
        try:
            self.policy = make_policy(self.name, self.envs, policy_seed=training.seed)
        except Exception:
            self.envs.close()
            raise

    def show(self, episodes: int, seed: int, **instead: Any) -> list[Demonstration]:
        """Return the teacher's episodes 0 to `episodes` - 1 of a seed, in order; see `demonstrate` for `instead`."""
        pairs = demonstrate(self.policy, self.envs, episodes, seed, self.name, **instead)
        bar = tqdm(pairs, printable(self.name), episodes, leave=False, disable=not self._shows_bars)
        in_order = sorted(bar, key=lambda pair: pair[0].episode)
        return [episode for _, episode in in_order]


class UndisturbedPolicy:
    """A policy that acts on the observations of `env` as they are without disturbances."""

    training_steps = 0

    def __init__(self, policy: Policy, env: TaskVectorEnv) -> None:
        self.sees, self.reset, self._policy, self._task = policy.sees, policy.reset, policy, env.task

    def act(self, observations: Any) -> NDArray[Any]:
        """Return actions (n, ...) for the present observations without disturbances."""
        return self._policy.act(self._task.observe())


def teacher_in(envs: TaskVectorEnv, recipe: Recipe, policy_seed: int) -> Policy:
    """Return the recipe's teacher in these worlds. An agent that was trained to see the state sees theirs.

    `policy_seed` determines its random numbers. No disturbance reaches the observations on which the teacher acts.

    Raises `ConfigurationError` for a recipe without a teacher, or with a prepared one, and what `armctl.make_policy`
    raises.
    """
    teacher = _teacher_of(recipe)
    card = card_of(teacher)
    if card is None or card.sees != "state" or envs.task.state_space is None:
        policy = make_policy(teacher, envs, policy_seed=policy_seed)
        check_labels(teacher, policy)
        return UndisturbedPolicy(policy, envs) if envs.disturbances else policy
    with state_observing_env(envs) as single_env:
        return StateObservingAgent(make_policy(teacher, single_env, policy_seed=policy_seed), envs)


def check_labels(name: str, policy: Policy) -> None:
    """Raise `ConfigurationError` for a teacher that takes the student's commands for its own."""
    if getattr(policy, "prepared", False):
        raise ConfigurationError(
            f"{name} identifies the robot by its own commands, but the student's are executed: take "
            f"{name.partition(':')[0]}:prepared=false as its teacher"
        )


def _teacher_of(recipe: Recipe) -> str:
    if recipe.teacher is None:
        raise ConfigurationError(f"{recipe.learner} learns from a policy: name it, --teacher POLICY")
    return recipe.teacher


def demonstrations(training: Training, options: CloningOptions, dataset: str | None) -> list[Demonstration]:
    """Return the successful episodes of a dataset, or of the teacher. Raises `ConfigurationError` if there are none."""
    episodes = recorded_episodes(training, options, dataset)
    successes = [episode for episode in episodes if episode.success]
    if not successes:
        source = dataset or training.recipe.teacher
        raise ConfigurationError(
            f"none of {len(episodes)} episodes of {source} was a success: there is nothing to learn from"
        )
    return successes


def recorded_episodes(training: Training, options: CloningOptions, dataset: str | None) -> list[Demonstration]:
    """Return all episodes of a dataset, or of the teacher."""
    if dataset is None:
        teacher = Teacher(training, min(options.worlds, options.demonstrations))
        try:
            episodes = teacher.show(options.demonstrations, training.first_seed())
        finally:
            teacher.envs.close()
    else:
        episodes = read_demonstrations(dataset, training.held_out)
    if training.newest_checkpoint() is None:  # a resumed training is shown the same episodes again
        steps = sum(map(len, episodes))
        training.meter.add(decisions=steps, teacher_queries=steps)
    return episodes
