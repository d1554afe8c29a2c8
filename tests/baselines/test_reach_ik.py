import math
from typing import Any

import numpy as np
import pinocchio
import pytest

from armctl.baselines.reach_ik import REPLAN_STEPS
from armctl.disturbances import ARM
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, Ik
from armctl.kinematics.room import DIRECTIONS
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
        "reach_ik", episodes=sized(30, 60), seed=0, worlds=30, env_options=options, lower_bound_steps=False
    )
    assert results.success.mean() >= success


@pytest.mark.one_case
@pytest.mark.parametrize("prepared", [True, False])
@pytest.mark.parametrize(
    ("env", "options"),
    [
        ("armctl/ArmReachObstacles-v0", {}), ("armctl/ArmReachMoving-v0", {}), (REACH, {"control": "velocity"}),
        (REACH, {"observation": "full"}), ("armctl/ArmReachMoving-v0", {"observation": "full"}),
        ("armctl/ArmPose-v0", {"control": "velocity"}), ("armctl/ArmPose-v0", {"observation": "full"}),
    ],
)  # fmt: skip
def test_it_plays_every_task_that_it_is_made_for(env, options, prepared):
    results = evaluate(
        f"reach_ik:prepared={str(prepared).lower()}",
        env, episodes=3, seed=1, worlds=3, env_options=options, lower_bound_steps=False,
    )  # fmt: skip
    assert not (results.outcome == "error").any()
    assert results.success.sum() >= 2 or "Obstacles" in env  # it ignores boxes


@pytest.mark.slow
def test_it_wins_most_of_what_weak_motors_can_hold():
    """With 20 kg, a third of the targets have no posture in which the motors could hold the arm, near or at them.

    Of the others, it reaches nine in ten; momentum brings it to some of the rest.
    """
    episodes, load, tolerance = 100, 20.0, 0.05
    worlds = make_worlds(REACH, episodes)
    observations, _ = worlds.reset(seed=[300] * episodes, options={"episode": np.arange(episodes)})
    model = ArmModel("ur5")
    places = observations[:, None, 9:12] + 0.9 * tolerance * np.vstack((np.zeros(3), DIRECTIONS))
    holdable = np.array([any(can_hold(model, Ik(model), place, load) for place in sphere) for sphere in places])
    results = evaluate(
        "reach_ik", episodes=episodes, seed=300, worlds=25, env_options={"disturbances": {"payload": load}},
        lower_bound_steps=False,
    )  # fmt: skip
    assert 0.6 < holdable.mean() < 0.75
    assert results.success[holdable].mean() > 0.88
    assert results.success[~holdable].mean() < 0.6


def can_hold(model, ik, place, load):
    """Return True if a collision-free posture at a place (3,) needs no more torque than the motors have, at rest."""
    for q in ik.free_configurations(place):
        weight = pinocchio.computeGeneralizedGravity(model.pinocchio, model.pinocchio.createData(), q)
        if (np.abs(weight + load * 9.81 * model.jacobian(q)[2]) <= model.limits.effort).all():
            return True
    return False
