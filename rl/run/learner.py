"""Learners: functions of a training, behind the one signature by which armctl calls them all."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.rl.run.training import Training
from armctl.training.learners import Callback, Learner, Recipe


def learner(
    options_type: type[Any],
    *,
    rewards: bool = True,
    curriculum: bool = True,
    explores: bool = True,
    check: Callable[[Recipe, Any], None] = lambda recipe, options: None,
) -> Callable[[Callable[[Training, Any], AgentCard]], Learner]:
    """Make a learner of a function of a training and its options: a decorator.

    Without `rewards`, `curriculum` or `explores`, the learner refuses recipes with shaping or reward weights, with
    later stages, or with a safety filter, since it acts in no worlds of the training. `check` raises an error for a
    recipe and options that do not fit together, before anything is made of them. For all errors that it raises, see
    `armctl.rl.run.training.Training`.
    """

    def decorate(function: Callable[[Training, Any], AgentCard]) -> Learner:
        @functools.wraps(function)
        def train(
            recipe: Recipe,
            *,
            out: Path,
            seed: int,
            resume: bool = False,
            progress: bool = True,
            on_evaluation: Callback = None,
        ) -> AgentCard:
            options = recipe.read_options(options_type)
            if not rewards:
                _check_no_rewards(recipe)
            if recipe.curriculum and not curriculum:
                raise ConfigurationError(
                    f"{recipe.learner} takes no curriculum: ppo, cloned_ppo, distil, distilled_ppo and finetuned_ppo do"
                )
            if recipe.filter is not False and not explores:
                raise ConfigurationError(
                    f"{recipe.learner} does not explore in the training's worlds, and takes no filter: ppo, "
                    "cloned_ppo, distil, distilled_ppo, finetuned_ppo, sac and td_mpc2 do"
                )
            check(recipe, options)
            return function(Training(recipe, options, out, seed, resume, on_evaluation, progress), options)

        return train

    return decorate


def _check_no_rewards(recipe: Recipe) -> None:
    if recipe.shaping or recipe.reward_weights or any(stage.reward_weights for stage in recipe.curriculum):
        raise ConfigurationError(
            f"{recipe.learner} does not learn from rewards of its own: it takes neither shaping nor reward_weights"
        )
