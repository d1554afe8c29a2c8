"""Policies behind the safety filter: they touch much less, and actions far from everything stay as they are."""

from typing import Any

import numpy as np
import pytest

from armctl.control.arm_filter import ArmFilter
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kernels import braking
from armctl.kernels.edges import measure_all
from armctl.kinematics import ArmModel, ArmShapes
from armctl.policies import make_policy
from armctl.policies.filtered import SafetyFilter
from armctl.policies.names import check_policy_name
from armctl.policies.robot_filters import ArmFilterOptions, ArmFilters
from armctl.robot_description.joint_profiles import TICK
from armctl.scene import NO_BOXES
from armctl.study import compare, sweep

REACH, OBSTACLES = "armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0"
BRIDGE, MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"


def test_one_command_after_another_keeps_the_margin():
    """Random commands, held for a while, among boxes, in MuJoCo: within 0.5 mm, by which the prediction may be off."""
    n, rng = 6, np.random.default_rng(0)
    worlds = make_worlds(OBSTACLES, n)
    filters = ArmFilters(worlds.task, ArmFilterOptions())
    worlds.reset(seed=300)
    filters.reset(np.arange(n, dtype=np.int32))
    low, high = worlds.task.action_range
    actions, changed = np.zeros((n, 6)), 0
    for step in range(48):
        if step % 6 == 0:
            actions = rng.uniform(low, high, (n, 6))
        states = filters.states()
        safe = [filters.act(i, *values) for i, values in enumerate(zip(actions, states, strict=True))]
        changed += sum(one is not action for one, action in zip(safe, actions, strict=True))
        worlds.step(np.array(safe))
        for i in range(n):
            arm = filters.filters[i].arm
            apart = np.empty(len(arm.scene.pairs))
            measure_all(arm.scene, worlds.task.arm.joint_positions[i], apart)
            assert (apart >= np.minimum(arm.margin, arm.caps) - 5e-4).all()
    assert changed > 0


def test_drives_stop_where_the_braking_command_says():
    shapes = ArmShapes(ArmModel("ur5"))
    arm = ArmFilter(shapes, NO_BOXES, np.ones((2, 6)), to_positions=True, margin=0.01, period=0.04).arm
    limits = shapes.model.limits
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, speed, goal = rng.uniform(-1, 1, 6), rng.uniform(-3, 3, 6), np.empty(6)
        braking.brake_commands(arm, q, speed, goal)
        position, velocity = q.copy(), speed.copy()
        while np.abs(velocity).max() > 0:
            velocity = np.sign(velocity) * np.maximum(np.abs(velocity) - limits.acceleration * TICK, 0.0)
            position += velocity * TICK
        np.testing.assert_allclose(goal, position, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "control"),
    [(REACH, "position"), (REACH, "relative"), (OBSTACLES, "position"), (OBSTACLES, "delta"), (OBSTACLES, "velocity")],
)
def test_random_actions_of_an_arm_touch_nothing(env, control):
    options: Any = {"env_options": {"control": control}, "worlds": 8, "policy_seed": 1}
    episodes = compare(["filtered(random)", "random"], env, episodes=8, seed=300, **options)
    safe, random = (sum(one.metrics.contacts for one in played) for played in episodes.results.by_policy().values())
    assert safe == 0
    assert random > 0


@pytest.mark.slow
@pytest.mark.parametrize("env", [BRIDGE, MOVING])
def test_random_actions_of_a_rover_touch_nothing(env):
    episodes = compare(["filtered(random)", "random"], env, episodes=4, seed=301, worlds=4, policy_seed=1)
    safe, random = episodes.results.by_policy().values()
    assert {one.outcome for one in safe} == {"timeout"}
    assert sum(one.outcome in ("collided", "fell") for one in random) >= 2


@pytest.mark.parametrize(("env", "delay"), [(OBSTACLES, 3), (MOVING, 4)])
def test_delayed_actions_are_judged_where_they_act(env, delay):
    """Random commands show the delay within as many control steps and two; predictions are where the robots get to."""
    n, rng = 4, np.random.default_rng(0)
    worlds = make_worlds(env, n, {"disturbances": {"delay": delay}}, autoreset_mode="disabled")
    safe = SafetyFilter(worlds, "filter", {})
    worlds.reset(seed=300)
    safe.reset(np.arange(n, dtype=np.int32))
    laws: Any = safe._filters
    low, high = worlds.task.action_range
    predictions: list[Any] = []
    for _ in range(delay + 8):
        actions = safe(rng.uniform(low, high, (n, len(low))))
        predictions.append(safe._delays.predict(laws.law(laws.states(), safe._delays.sent[delay]), laws.law))
        worlds.step(np.array(actions))
    assert (safe.delay == delay).all()
    errors = np.abs(predictions[-delay - 1] - laws.states())
    assert errors[:, :2].max() < (1e-9 if env == OBSTACLES else 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("env", "delay"), [(OBSTACLES, 4), (MOVING, 2)])
def test_delayed_random_actions_touch_nothing(env, delay):
    options: Any = {"env_options": {"disturbances": {"delay": delay}}, "worlds": 6, "policy_seed": 1}
    episodes = compare(["filtered(random)"], env, episodes=6, seed=301, **options)
    assert {one.outcome for one in episodes.results} <= {"timeout", "reached"}


@pytest.mark.slow
def test_a_sweep_under_a_disturbance():
    """Noise is on what a policy observes, not on what the filter sees: it still touches ten times less."""
    policies = ["filtered(obstacles_plan_bc)", "obstacles_plan_bc"]
    swept = sweep(policies, OBSTACLES, disturbances={"noise": [0.05]}, episodes=10, seed=300, worlds=10)
    for episodes in swept.comparisons.values():
        safe, plain = (sum(one.metrics.contacts for one in some) for some in episodes.results.by_policy().values())
        assert 10 * safe <= plain
        assert plain > 0


def test_actions_far_from_everything_stay_as_they_are():
    """So that an episode is the same, bit for bit, and no intervention is counted."""
    plain, safe = (
        list(compare(name, REACH, episodes=3, seed=5, worlds=3, policy_seed=1).results)
        for name in ("reach_ppo", "filtered(reach_ppo)")
    )
    assert [one.total_reward for one in plain] == [one.total_reward for one in safe]
    assert [one.metrics.intervention_share for one in safe] == [0.0] * 3
    assert np.isnan([one.metrics.intervention_share for one in plain]).all()


def test_interventions_are_told_of():
    episodes = compare("filtered(random)", OBSTACLES, episodes=2, seed=5, worlds=2, policy_seed=1)
    (policy,) = episodes.policies
    assert 0 < policy.intervention_share < 1
    assert policy.sees == "state"
    assert "safety filter: action changed in" in policy.interventions[0]


def test_it_shows_what_it_and_the_policy_see_and_cost():
    worlds = make_worlds(MOVING, 1, {"observation": "paper"})
    policy: Any = make_policy("filtered(bridge_moving_ppo):margin=0.1", worlds)
    assert (policy.sees, policy.foresight) == ("state", ("pedestrians",))
    assert policy.training_steps > 0


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("filtered(", "filtered\\(POLICY\\)"),
        ("filtered(nobody)", "nobody"),
        ("filtered(reach_pppo)", "reach_ppo"),
        ("filtered(filtered(random))", "one policy"),
        ("filtered(reach_bc[*])", "one policy"),
    ],
)
def test_bad_names(name, reason):
    with pytest.raises(ConfigurationError, match=reason):
        check_policy_name(name)


def test_bad_options_and_tasks():
    with pytest.raises(ConfigurationError, match="margin"):
        make_policy("filtered(random):margn=1", make_worlds(REACH, 1))
    with pytest.raises(ConfigurationError, match="torque"):
        make_policy("filtered(random)", make_worlds(REACH, 1, {"control": "torque"}))
    with pytest.raises(ConfigurationError, match="own tasks"):
        make_policy("filtered(random)", make_worlds("CartPole-v1", 1))
    with pytest.raises(ConfigurationError, match="by name"):
        compare([lambda observation: observation], REACH, episodes=1, filter=True)


def test_all_of_a_line_up():
    comparison = compare(["random", "reach_ik"], REACH, episodes=1, filter=True)
    assert [policy.policy for policy in comparison.policies] == ["filtered(random)", "filtered(reach_ik)"]
