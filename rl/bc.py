"""Behaviour cloning (Pomerleau 1991): supervised learning of a teacher's actions.

`armctl train reach_bc` runs this. The demonstrations are episodes that the teacher plays, or a Minari dataset.
"""

from pathlib import Path

import numpy as np
import torch

from armctl.agents import AgentCard
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.options import options
from armctl.rl.actor import Actor
from armctl.rl.cloning import CloningOptions, check_teaching, demonstrations, examples_for, fit, new_actor
from armctl.rl.disk import save_torch
from armctl.rl.training import Training


@options
class BcOptions(CloningOptions):
    """Options of behaviour cloning."""

    dataset: str | None = None
    """Minari dataset to learn from, instead of the teacher: a folder (see `armctl collect`), or an id."""


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.training.Training`, also for the errors raised."""
    options = recipe.read_options(BcOptions)
    check_teaching(recipe)
    if recipe.training_options and options.dataset is not None:
        raise ConfigurationError("a dataset shows what it shows: training_options are for a teacher's episodes")
    training = Training(recipe, options, out, seed, resume)
    examples = examples_for(training, options)
    examples.add(demonstrations(training, options, options.dataset, progress))
    with training:
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
                training.meter.add(gradient_steps=1)
                if step % options.evaluation_every == 0:
                    _save(training, actor, step)
                    training.evaluate(actor, step)
        finally:
            if step:
                _save(training, actor, step)
        return training.finish(actor, step)


def _save(training: Training, actor: Actor, step: int) -> None:
    training.checkpoint(step, lambda path: save_torch(actor.state_dict(), path))
