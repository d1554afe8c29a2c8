"""DAgger (Ross, Gordon and Bagnell, AISTATS 2011): the teacher labels the states that the student visits.

In the first round the teacher acts; then the student acts more and more often. The student learns from all labels so
far.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.files import write_atomically
from armctl.core.options import Count, options
from armctl.datasets.demonstrations import Demonstration
from armctl.policies import Policy
from armctl.rl.algorithms.cloning import fit, new_actor
from armctl.rl.data.demonstrations import CloningOptions, Examples, Teacher, check_labels, examples_for
from armctl.rl.networks.actor import Actor, numpy_arrays, tensors
from armctl.rl.run.disk import torch_bytes
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training

RECORD = "rounds.pt"


@options
class DaggerOptions(CloningOptions):
    """Options of DAgger."""

    family = "DAgger"
    rounds: Count = 10
    mixed_rounds: Count = 3
    """Rounds until the student acts alone. Until then, each action is the teacher's with a probability that decays
    linearly from 1."""
    teacher_memory: bool = True
    """If False, the teacher is reset before each action. A student has no memory: it cannot learn actions that depend
    on more than the present observation."""


class MemorylessTeacher:
    """A policy that is reset before each action."""

    training_steps = 0

    def __init__(self, policy: Policy) -> None:
        self.sees, self._policy, self.reset = policy.sees, policy, policy.reset

    def act(self, observations: Any) -> NDArray[Any]:
        """Return actions (n, ...)."""
        array = next(iter(observations.values())) if isinstance(observations, dict) else observations
        self._policy.reset(np.arange(len(array), dtype=np.int32))
        return self._policy.act(observations)


@learner(DaggerOptions, rewards=False, curriculum=False, explores=False)
def train(training: Training, options: DaggerOptions) -> AgentCard:
    """Let the teacher label what the student visits, and fit the student, round by round."""
    each = options.demonstrations // options.rounds
    if not each or options.steps < options.rounds:
        raise ConfigurationError(f"{options.rounds} rounds need an episode and a gradient step each")
    steps = options.steps // options.rounds
    teacher = Teacher(training, min(options.worlds, each))
    if options.teacher_memory:
        check_labels(teacher.name, teacher.policy)
    else:
        teacher.policy = MemorylessTeacher(teacher.policy)
    with training:
        try:
            actor, examples = new_actor(training, options), examples_for(training, options)
            finished = _load(training, actor, examples)
            for i in range(finished, options.rounds):
                share = max(0.0, 1 - i / options.mixed_rounds)
                rng = np.random.default_rng((training.seed, i))
                mixture = _mixture(actor, share, rng)
                episodes = teacher.show(each, training.first_seed(i), acting=mixture)
                decisions = sum(map(len, episodes))
                training.meter.add(decisions=decisions, teacher_queries=decisions)
                examples.add(episodes)
                for _ in fit(
                    training, actor, examples, steps, rng,
                    batch_size=options.batch_size, learning_rate=options.learning_rate,
                ):  # fmt: skip
                    pass
                _save(training, actor, examples, i + 1, steps)
                training.evaluate(actor, (i + 1) * steps)
        finally:
            teacher.envs.close()
        return training.finish(actor, options.rounds * steps)


def _mixture(actor: Actor, share: float, rng: np.random.Generator) -> Any:
    """Return a function that acts as the teacher with probability `share`, and as the student otherwise."""

    def acting(observations: Any, labels: NDArray[Any]) -> NDArray[Any]:
        chosen = rng.random(len(labels)) < share
        return np.where(chosen[:, None], labels, actor.act(observations))

    return acting


def _save(training: Training, actor: Actor, examples: Examples, rounds: int, steps: int) -> None:
    training.checkpoint(rounds * steps, torch_bytes(actor.state_dict()))
    episodes = [
        {"observations": tensors(episode.observations), "actions": torch.as_tensor(episode.actions)}
        for episode in examples.episodes
    ]
    write_atomically(training.out / RECORD, torch_bytes({"rounds": rounds, "episodes": episodes}))


def _load(training: Training, actor: Actor, examples: Examples) -> int:
    """Load the newest checkpoint, if any, and return the number of finished rounds."""
    newest, record = training.newest_checkpoint(), training.out / RECORD
    if newest is None or not record.exists():
        return 0
    actor.load_state_dict(torch.load(newest, weights_only=True))
    saved = torch.load(record, weights_only=True)
    examples.add([_episode(episode) for episode in saved["episodes"]])
    return int(saved["rounds"])


def _episode(saved: Any) -> Demonstration:
    observations = numpy_arrays(saved["observations"])
    return Demonstration(observations, saved["actions"].numpy(), np.zeros(len(saved["actions"])), False, False)
