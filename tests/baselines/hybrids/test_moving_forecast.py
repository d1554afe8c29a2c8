import contextlib
from typing import Any

import pytest

from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rollout import evaluate

ENV = "armctl/ArmReachMoving-v0"


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["moving_forecast", "moving_estimated:forecast=1"])
def test_targets_are_held_under_delay_and_noise(policy):
    """Neither parent holds one of them: `reach_ik` and `moving_dagger`."""
    disturbances = {"delay": 8, "noise": 0.02}
    episodes = evaluate(
        policy, ENV, episodes=8, seed=300, worlds=8, env_options={"disturbances": disturbances}, lower_bound_steps=False
    )
    assert episodes.success.sum() >= 6


def test_costs_are_those_of_all_networks():
    with contextlib.closing(make_worlds(ENV, 1)) as worlds:
        names = "moving_dagger", "moving_forecast", "moving_estimated"
        policies: Any = [make_policy(name, worlds) for name in names]
    agent, forecast, both = (policy.training_cost for policy in policies)
    assert both.gradient_steps == agent.total.gradient_steps + forecast.gradient_steps
