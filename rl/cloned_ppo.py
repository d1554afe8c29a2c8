"""Behaviour cloning, then PPO, which starts from the clone.

The advantages of an untrained critic would make the actor unlearn what it has cloned (see Zhu et al., 2019, and Uchendu
et al., Jump-start reinforcement learning, 2023, for the effect). So the critic is fitted to the clone's episodes first,
and a penalty, which decays, holds the actor to the clone.
"""

import functools
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field

from armctl.agents import AgentCard
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.options import options
from armctl.rl.anchored_ppo import AnchoredPpo
from armctl.rl.cloning import CloningOptions, Examples, demonstrations, examples_for, fit
from armctl.rl.learning import learn
from armctl.rl.ppo import PpoOptions, actor_of, load_or_make, shown
from armctl.rl.training import LOG, Count, Positive, Training
from armctl.rl.vector import StableBaselinesVectorEnv


@options
class ClonedPpoOptions(PpoOptions, CloningOptions):
    """Options of PPO, whose steps are environment steps, and of the cloning before it."""

    steps: Count = 1_000_000
    worlds: Count = 256
    batch_size: Count = 2048
    evaluation_every: Count = 50_000
    activation: Literal["elu", "relu"] = "relu"
    cloning_steps: Count = 6_000
    """Gradient steps of cloning."""
    cloning_rate: Positive = 1e-3
    cloning_batch_size: Count = 256
    critic_steps: Count = 150_000
    """Environment steps after which PPO begins at the latest; until then, only the critic learns."""
    critic_rate: Positive = 1e-3
    """Learning rate of the critic until then."""
    clone_weight: Annotated[float, Field(ge=0)] = 0.1
    """Weight of the penalty on the KL divergence from the clone."""
    clone_decay: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Share of the training over which that weight decays to 0, linearly."""
    learning_rate: Positive = 3e-4
    initial_log_std: float = -2.0
    dataset: str | None = None
    """Minari dataset to clone from, instead of the teacher."""


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.training.Training`, also for the errors raised."""
    options = recipe.read_options(ClonedPpoOptions)
    if options.frames > 1:
        raise ConfigurationError("cloned_ppo clones from single observations: leave the option frames out")
    training = Training(recipe, options, out, seed, resume)
    model, examples = load_or_make(training, options, AnchoredPpo), examples_for(training, options)
    model.anchor_weight, model.anchor_decay = options.clone_weight, options.clone_decay
    if new := training.newest_checkpoint() is None:
        examples.add(demonstrations(training, options, options.dataset, progress))
    with training:
        if new:
            clone(training, model, examples, options, progress)
            fit_critic(training, model, min(options.critic_steps, options.steps), options.critic_rate)
        return learn(training, model, actor_of(model, training), progress, functools.partial(shown, training, options))


def clone(
    training: Training, model: AnchoredPpo, examples: Examples, options: ClonedPpoOptions, progress: bool
) -> None:
    """Fit the model's actor to the demonstrations, hold it to that, and evaluate it."""
    actor = actor_of(model, training)
    for _ in fit(
        actor, examples, options.cloning_steps, np.random.default_rng(training.seed),
        batch_size=options.cloning_batch_size, learning_rate=options.cloning_rate, progress=progress,
    ):  # fmt: skip
        training.meter.add(gradient_steps=1)
    model.drop_anchor()
    training.evaluate(actor, 0)


def fit_critic(training: Training, model: AnchoredPpo, steps: int, learning_rate: float) -> None:
    """Fit the critic on the clone's episodes; the clone stays as it is."""
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed())
    optimizer = torch.optim.Adam(model.critic_parameters(), learning_rate)
    optimizer.register_step_post_hook(lambda *_: training.meter.add(gradient_steps=1))
    for explained in model.fit_critic(steps, optimizer):
        LOG.info("%s steps: the critic explains %.0f%% of returns", f"{model.num_timesteps:,}", 100 * explained)
        training.logger.record("train/explained_variance", explained)
        training.logger.dump(model.num_timesteps)
