import math
from typing import Any

import numpy as np
import pytest

from armctl.baselines.reach_ik import REPLAN_STEPS
from armctl.disturbances import ARM
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rollout import evaluate
from armctl.tasks.reach import CONTROL_PERIOD

REACH = "armctl/ArmReach-v0"
TINY = 1e-4
"""m: the tolerance of targets that no arm reaches by chance, so that episodes last."""


def steps_between_plans(disturbances, steps=50, tolerance=TINY):
    """For each plan of three episodes: control steps until the next plan or the end, and until the planned arrival."""
    worlds = make_worlds(REACH, 3, options={"disturbances": disturbances, "tolerance": tolerance})
    policy: Any = make_policy("reach_ik", worlds)
    observations, _ = worlds.reset(seed=3)
    policy.reset(np.arange(3, dtype=np.int32))
    plans = [[] for _ in range(3)]
    now, world, find = 0, np.intp(0), policy.controllers[0]._search.find

    def counted(*arguments):
        goal = find(*arguments)
        plans[world].append((now, 0 if goal is None else math.ceil(goal.time / CONTROL_PERIOD)))
        return goal

    policy.controllers[0]._search.find = counted  # all three controllers share one search
    playing = np.ones(3, dtype=bool)
    lengths = np.full(3, steps)
    for now in range(steps):
        actions = np.zeros(worlds.action_space.shape)
        for world in np.flatnonzero(playing):
            actions[world] = policy.controllers[world].act(observations[world])
        observations, _, terminated, truncated, _ = worlds.step(actions)
        lengths[playing & (terminated | truncated)] = now + 1
        playing &= ~(terminated | truncated)
    for made, length in zip(plans, lengths, strict=True):
        begins, arrivals = np.array(made).T
        yield from zip(np.diff(begins, append=length), arrivals, strict=True)


@pytest.mark.one_case
@pytest.mark.parametrize("name", ARM)
@pytest.mark.parametrize("strength", ["neutral", "strongest"])
def test_it_plans_again_by_the_clock_under_every_disturbance(name, strength):
    spec = ARM[name]
    level = spec.neutral if strength == "neutral" else spec.levels[-1]
    waits = list(steps_between_plans({name: level}))
    assert len(waits) > 3 * 2
    assert all(wait <= arrival + REPLAN_STEPS for wait, arrival in waits)


def test_noise_does_not_change_how_often_it_plans():
    quiet, noisy = (len(list(steps_between_plans({"noise": level}))) for level in (0, 0.05))
    assert abs(noisy - quiet) <= 0.3 * quiet


def test_undisturbed_it_plans_once():
    assert len(list(steps_between_plans({}, tolerance=0.05))) == 3


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("disturbances", "success"), [({"noise": 0.02}, 0.99), ({"noise": 0.05}, 0.975), ({"mismatch": 0.2}, 0.9)]
)
def test_it_reaches_with_noisy_readings_and_links_of_other_lengths(disturbances, success, sized):
    options = {"disturbances": disturbances}
    results = evaluate(
        "reach_ik", episodes=sized(30, 200), seed=0, worlds=30, env_options=options, lower_bound_steps=False
    )
    assert results.success.mean() >= success


@pytest.mark.parametrize("prepared", [True, False])
@pytest.mark.parametrize(
    ("env", "options"),
    [
        ("armctl/ArmReachObstacles-v0", {}), ("armctl/ArmReachMoving-v0", {}), (REACH, {"control": "velocity"}),
        (REACH, {"observation": "full"}), ("armctl/ArmReachMoving-v0", {"observation": "full"}),
    ],
)  # fmt: skip
def test_it_plays_every_task_that_it_is_made_for(env, options, prepared):
    results = evaluate(
        f"reach_ik:prepared={str(prepared).lower()}",
        env, episodes=3, seed=1, worlds=3, env_options=options, lower_bound_steps=False,
    )  # fmt: skip
    assert not (results.outcome == "error").any()
    assert results.success.sum() >= 2 or "Obstacles" in env  # it ignores boxes
