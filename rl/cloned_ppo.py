"""Behaviour cloning, then PPO, which starts from the clone.

At first, only the critic learns: the advantages of an untrained critic would make the actor unlearn what it has cloned
(see Zhu et al., 2019, and Uchendu et al., Jump-start reinforcement learning, 2023, for the effect).
"""

from pathlib import Path
from typing import Literal

import numpy as np
from stable_baselines3 import PPO

from armctl.agents import AgentCard
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.options import options
from armctl.rl.cloning import CloningOptions, Examples, demonstrations, examples_for, fit
from armctl.rl.learning import learn
from armctl.rl.ppo import PpoOptions, actor_of, load_or_make
from armctl.rl.training import Count, Positive, Training, bar_fits
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
    critic_steps: Count = 50_000
    """Environment steps during which only the critic learns."""
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
    model, examples = load_or_make(training, options), examples_for(training, options)
    if new := training.newest_checkpoint() is None:
        examples.add(demonstrations(training, options, options.dataset, progress))
    with training:
        if new:
            clone(training, model, examples, options, progress)
            warm_up(training, model, min(options.critic_steps, options.steps), progress)
        return learn(training, model, actor_of(model, training), progress)


def clone(training: Training, model: PPO, examples: Examples, options: ClonedPpoOptions, progress: bool) -> None:
    """Fit the model's actor to the demonstrations, and evaluate it."""
    actor = actor_of(model, training)
    for _ in fit(
        actor, examples, options.cloning_steps, np.random.default_rng(training.seed),
        batch_size=options.cloning_batch_size, learning_rate=options.cloning_rate, progress=progress,
    ):  # fmt: skip
        training.meter.add(gradient_steps=1)
    training.evaluate(actor, 0)


def warm_up(training: Training, model: PPO, steps: int, progress: bool) -> None:
    """Train the critic on the clone's episodes; the clone stays as it is."""
    critic = {id(parameter) for part in ("value_net", "mlp_extractor.value_net")
              for parameter in model.policy.get_submodule(part).parameters()}  # fmt: skip
    cloned = [parameter for parameter in model.policy.parameters() if id(parameter) not in critic]
    for parameter in cloned:
        parameter.requires_grad_(False)
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed())
    model.learn(steps, progress_bar=bar_fits(progress))
    for parameter in cloned:
        parameter.requires_grad_(True)
