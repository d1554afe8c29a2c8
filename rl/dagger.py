"""DAgger (Ross, Gordon and Bagnell, AISTATS 2011): the teacher is asked in the states that the student gets into.

In the first round the teacher acts; then the student does, more and more, and all that the teacher has said is learnt.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import AgentCard
from armctl.datasets.demonstrations import Demonstration
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.policies import Policy
from armctl.rl.actor import Actor, tensors
from armctl.rl.cloning import CloningOptions, Examples, Teacher, check_teaching, examples_for, fit, new_actor
from armctl.rl.training import Count, Training, read_options, write_whole

RECORD = "rounds.pt"


@dataclass(frozen=True)
class DaggerOptions(CloningOptions):
    """Options of the learner."""

    rounds: Count = 10
    mixed_rounds: Count = 3
    """Rounds until the student acts alone; before that, each decision is the teacher's by a chance that falls from 1."""
    teacher_memory: bool = True
    """Without it, the teacher is asked in each state as if an episode began there. A student has no memory: it cannot
    learn what depends on more than what it sees."""


class MemorylessTeacher:
    """A policy that is asked in each state as if an episode began there."""

    training_steps = 0

    def __init__(self, policy: Policy) -> None:
        self.sees, self._policy, self.reset = policy.sees, policy, policy.reset

    def act(self, observations: Any) -> NDArray[Any]:
        """Actions (n, ...)."""
        some = next(iter(observations.values())) if isinstance(observations, dict) else observations
        self._policy.reset(np.arange(len(some), dtype=np.int32))
        return self._policy.act(observations)


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`; see `armctl.rl.training.Training`, also for the errors raised."""
    options = read_options(DaggerOptions, recipe)
    check_teaching(recipe)
    each = options.demonstrations // options.rounds
    if not each or options.steps < options.rounds:
        raise ConfigurationError(f"{options.rounds} rounds need an episode and a gradient step each")
    with Training(recipe, options, out, seed, resume) as training:
        teacher = Teacher(recipe, min(options.worlds, each))
        if not options.teacher_memory:
            teacher.policy = MemorylessTeacher(teacher.policy)
        try:
            actor, examples = new_actor(training, options), examples_for(training, options)
            before = _load(training, actor, examples)
            for i in range(before, options.rounds):
                share = max(0.0, 1 - i / options.mixed_rounds)
                rng = np.random.default_rng((seed, i))
                mixture = _mixture(actor, share, rng)
                examples.add(teacher.show(each, training.first_seed(i), progress, acting=mixture))
                for _ in fit(
                    actor, examples, options.steps // options.rounds, rng,
                    batch_size=options.batch_size, learning_rate=options.learning_rate, progress=progress,
                ):  # fmt: skip
                    pass
                _save(training, actor, examples, i + 1, options.steps // options.rounds)
                training.evaluate(actor, (i + 1) * (options.steps // options.rounds))
        finally:
            teacher.worlds.close()
        return training.finish(actor, options.rounds * (options.steps // options.rounds))


def _mixture(actor: Actor, share: float, rng: np.random.Generator) -> Any:
    """Acts as the teacher with probability `share`, and as the student else."""

    def acting(observations: Any, labels: NDArray[Any]) -> NDArray[Any]:
        chosen = rng.random(len(labels)) < share
        return np.where(chosen[:, None], labels, actor.act(observations))

    return acting


def _save(training: Training, actor: Actor, examples: Examples, rounds: int, steps: int) -> None:
    training.checkpoint(rounds * steps, lambda path: torch.save(actor.state_dict(), path))
    told = [
        {"observations": tensors(episode.observations), "actions": torch.as_tensor(episode.actions)}
        for episode in examples.episodes
    ]
    write_whole(training.out / RECORD, lambda path: torch.save({"rounds": rounds, "episodes": told}, path))


def _load(training: Training, actor: Actor, examples: Examples) -> int:
    """Take up the newest checkpoint, and tell how many rounds there have been."""
    newest, record = training.newest_checkpoint(), training.out / RECORD
    if newest is None or not record.exists():
        return 0
    actor.load_state_dict(torch.load(newest, weights_only=True))
    told = torch.load(record, weights_only=True)
    examples.add([_episode(episode) for episode in told["episodes"]])
    return int(told["rounds"])


def _episode(told: Any) -> Demonstration:
    seen = told["observations"]
    observations = {name: part.numpy() for name, part in seen.items()} if isinstance(seen, dict) else seen.numpy()
    return Demonstration(observations, told["actions"].numpy(), np.zeros(len(told["actions"])), False, False)
