"""Behaviour cloning, and PPO from there on: the clone is the policy that PPO begins with.

The critic learns alone at first. An untrained one would tell the actor nothing but to unlearn (see Zhu et al., 2019,
and Uchendu et al., Jump-start reinforcement learning, 2023, for the effect).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from stable_baselines3 import PPO

from armctl.agents import AgentCard
from armctl.learners import Recipe
from armctl.rl.cloning import CloningOptions, demonstrations, examples_for, fit
from armctl.rl.learning import learn
from armctl.rl.ppo import PpoOptions, actor_of, new_model
from armctl.rl.training import Count, Positive, Training, read_options
from armctl.rl.vector import StableBaselinesVectorEnv


@dataclass(frozen=True)
class ClonedPpoOptions(PpoOptions, CloningOptions):
    """Options of the learner: PPO's, whose steps are decisions, and those of the cloning before."""

    steps: Count = 1_000_000
    worlds: Count = 256
    batch_size: Count = 2048
    evaluation_every: Count = 50_000
    activation: Literal["elu", "relu"] = "relu"
    cloning_steps: Count = 6_000
    """Gradient steps of the cloning."""
    cloning_rate: Positive = 1e-3
    cloning_batch_size: Count = 256
    critic_steps: Count = 50_000
    """Decisions during which the critic learns alone."""
    learning_rate: Positive = 3e-4
    initial_log_std: Annotated[float, Field(allow_inf_nan=False)] = -2.0
    dataset: str | None = None
    """Minari dataset to clone from, instead of asking the teacher."""


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`; see `armctl.rl.training.Training`, also for the errors raised."""
    options = read_options(ClonedPpoOptions, recipe)
    with Training(recipe, options, out, seed, resume) as training:
        venv = StableBaselinesVectorEnv(
            training.worlds, training.view.action_scale, options.reward_scale, recipe.reward_weights
        )
        newest = training.newest_checkpoint()
        if newest is not None:
            model = PPO.load(newest, venv, "cpu")
        else:
            model = new_model(venv, training.view, options, seed)
            clone(training, model, options, progress)
            warm_up(training, model, min(options.critic_steps, options.steps), progress)
        return learn(training, model, actor_of(model, training.view), progress)


def clone(training: Training, model: PPO, options: ClonedPpoOptions, progress: bool) -> None:
    """Fit the model's actor to the demonstrations, and judge it."""
    examples, actor = examples_for(training, options), actor_of(model, training.view)
    examples.add(demonstrations(training, options, options.dataset, progress))
    for _ in fit(
        actor, examples, options.cloning_steps, np.random.default_rng(training.seed),
        batch_size=options.cloning_batch_size, learning_rate=options.cloning_rate, progress=progress,
    ):  # fmt: skip
        pass
    training.evaluate(actor, 0)


def warm_up(training: Training, model: PPO, steps: int, progress: bool) -> None:
    """Let the critic learn the value of the clone, which stays as it is."""
    critic = {id(parameter) for part in ("value_net", "mlp_extractor.value_net")
              for parameter in model.policy.get_submodule(part).parameters()}  # fmt: skip
    cloned = [parameter for parameter in model.policy.parameters() if id(parameter) not in critic]
    for parameter in cloned:
        parameter.requires_grad_(False)
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed())
    model.learn(steps, progress_bar=progress)
    for parameter in cloned:
        parameter.requires_grad_(True)
