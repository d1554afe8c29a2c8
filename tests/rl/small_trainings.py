"""Small trainings, and a teacher that notes where it was asked."""

from typing import Any

from armctl.policies import make_policy
from armctl.training.learners import load_recipe

JUDGED = {"validation_episodes": 12, "evaluation_episodes": 20}
SHORT = {"max_episode_steps": 25}


def small(name, **options):
    recipe = load_recipe(name)
    return recipe.changed(options=recipe.options | JUDGED | options, env_options=recipe.env_options | SHORT)


def asked(env):
    """reach_ik, which notes where it was asked and how often it was reset."""
    policy: Any = make_policy("reach_ik:prepared=false", env)
    act, reset = policy.act, policy.reset
    policy.seen, policy.resets = [], 0

    def noting(observations):
        policy.seen.append(observations)
        return act(observations)

    def resetting(ids):
        policy.resets += len(ids)
        reset(ids)

    policy.act, policy.reset = noting, resetting
    return policy
