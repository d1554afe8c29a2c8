"""Policies behind the safety filter: they touch much less, and actions far from everything stay as they are."""

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.control.arm_filter import ArmFilter
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kernels import braking
from armctl.kernels.edges import measure_all
from armctl.kinematics import ArmModel, ArmShapes
from armctl.policies import make_policy
from armctl.policies.names import check_policy_name
from armctl.robot_description import load_arm
from armctl.scene import NO_BOXES, Boxes
from armctl.study import compare, sweep

REACH, OBSTACLES = "armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0"
BRIDGE, MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
TICKS, TICK = 5, 0.008


@functools.cache
def shapes():
    return ArmShapes(ArmModel(load_arm("ur5")))


def test_one_command_after_another_keeps_the_margin():
    """The drives alone, by a reference of their law, for random commands held for a while."""

    @settings(max_examples=15, deadline=None)
    @given(st.integers(0, 2**32 - 1), st.booleans())
    def check(seed, to_positions):
        rng, limits, home = np.random.default_rng(seed), shapes().model.limits, load_arm("ur5").home
        boxes = Boxes(rng.uniform((0.3, -0.6, 0.1), (0.7, 0.6, 0.8), (3, 3)), np.full((3, 3), 0.08), np.zeros(3))
        arm_filter = ArmFilter(shapes(), boxes, home, to_positions=to_positions, margin=0.01, period=TICKS * TICK)
        scene = arm_filter._arm.scene
        least, apart = np.minimum(0.01, arm_filter._arm.caps), np.empty(len(scene.pairs))
        measure_all(scene, home, apart)
        if (apart < 0.02).any():
            return
        q, speed, span = home.copy(), np.zeros(6), limits.upper if to_positions else limits.velocity
        for step in range(30):
            if step % 6 == 0:
                proposal = rng.uniform(-span, span)
            command = arm_filter(q, speed, q, proposal)
            for _ in range(TICKS):
                aim = np.array([
                    np.sign(c - p) * braking_speed(abs(c - p)) if to_positions else c
                    for c, p in zip(command, q, strict=True)
                ])  # fmt: skip
                change = limits.acceleration * TICK
                speed = np.clip(
                    aim, np.maximum(speed - change, -limits.velocity), np.minimum(speed + change, limits.velocity)
                )
                q = q + speed * TICK
                measure_all(scene, q, apart)
                assert (apart >= least - 1e-9).all()

    check()


def braking_speed(distance, acceleration=15.0):
    """Highest speed for a tick from which a joint stops at a distance, braking at a constant rate, by search."""
    best = 0.0
    for further in range(200):
        speed = (distance / TICK + acceleration * TICK * further * (further + 1) / 2) / (further + 1)
        if acceleration * TICK * further <= speed + 1e-12:
            best = speed
    return best


def test_drives_stop_where_the_braking_command_says():
    arm = ArmFilter(shapes(), NO_BOXES, load_arm("ur5").home, to_positions=True, margin=0.01, period=0.04)._arm
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, speed, goal = rng.uniform(-1, 1, 6), rng.uniform(-3, 3, 6), np.empty(6)
        braking.brake_commands(arm, q, speed, goal)
        position, velocity = q.copy(), speed.copy()
        while np.abs(velocity).max() > 0:
            velocity = np.sign(velocity) * np.maximum(np.abs(velocity) - 15.0 * TICK, 0.0)
            position += velocity * TICK
        np.testing.assert_allclose(goal, position, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "control"),
    [(REACH, "position"), (REACH, "relative"), (OBSTACLES, "position"), (OBSTACLES, "delta"), (OBSTACLES, "velocity")],
)
def test_random_actions_of_an_arm_touch_ten_times_less(env, control):
    options: Any = {"env_options": {"control": control}, "worlds": 20, "policy_seed": 1}
    episodes = compare(["filtered(random)", "random"], env, episodes=20, seed=300, **options)
    safe, random = (sum(one.metrics.contacts for one in played) for played in episodes.results.by_policy().values())
    assert 10 * safe <= random
    assert random > 0


@pytest.mark.slow
@pytest.mark.parametrize("env", [BRIDGE, MOVING])
def test_random_actions_of_a_rover_touch_nothing(env):
    episodes = compare(["filtered(random)", "random"], env, episodes=20, seed=301, worlds=20, policy_seed=1)
    safe, random = episodes.results.by_policy().values()
    assert {one.outcome for one in safe} == {"timeout"}
    assert sum(one.outcome in ("collided", "fell") for one in random) >= 10


@pytest.mark.slow
def test_a_sweep_under_a_disturbance():
    """Noise is on what a policy observes, not on what the filter sees: it still touches ten times less."""
    policies = ["filtered(obstacles_plan_bc)", "obstacles_plan_bc"]
    swept = sweep(policies, OBSTACLES, disturbances={"noise": [0.05]}, episodes=20, seed=300, worlds=20)
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
