"""Behaviour cloning (Pomerleau 1991): supervised learning of what a teacher does.

`armctl train reach_bc` comes here. The teacher plays its own episodes, or a Minari dataset has them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from armctl.agents import AgentCard
from armctl.learners import Recipe
from armctl.rl.actor import Actor
from armctl.rl.cloning import CloningOptions, check_teaching, demonstrations, examples_for, fit, new_actor
from armctl.rl.training import Training, read_options


@dataclass(frozen=True)
class BcOptions(CloningOptions):
    """Options of the learner."""

    dataset: str | None = None
    """Minari dataset to learn from, instead of asking the teacher: a folder (see `armctl collect`), or an id."""


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`; see `armctl.rl.training.Training`, also for the errors raised."""
    options = read_options(BcOptions, recipe)
    check_teaching(recipe)
    with Training(recipe, options, out, seed, resume) as training:
        examples = examples_for(training, options)
        examples.add(demonstrations(training, options, options.dataset, progress))
        actor, step = new_actor(training, options), 0
        if (newest := training.newest_checkpoint()) is not None:
            actor.load_state_dict(torch.load(newest, weights_only=True))
            step = int(newest.stem)
        fitting = fit(
            actor, examples, options.steps, np.random.default_rng((seed, step)),
            batch_size=options.batch_size, learning_rate=options.learning_rate, progress=progress, start=step,
        )  # fmt: skip
        try:
            for step in fitting:
                if step % options.evaluation_every == 0:
                    _save(training, actor, step)
                    training.evaluate(actor, step)
        finally:
            if step:
                _save(training, actor, step)
        return training.finish(actor, step)


def _save(training: Training, actor: Actor, step: int) -> None:
    training.checkpoint(step, lambda path: torch.save(actor.state_dict(), path))
