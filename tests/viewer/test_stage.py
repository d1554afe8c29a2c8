import itertools

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.episodes.failures import PolicyFailed
from armctl.viewer.stage import Stage


def played(stage):
    while stage.status.outcome is None:
        stage.step()
    return stage.status


@pytest.mark.parametrize(("policy", "env"), [("reach_ik", "armctl/ArmReach-v0"), ("random", "armctl/BridgeCross-v0")])
def test_an_episode_on_stage_is_the_one_that_is_evaluated(policy, env):
    rows = armctl.evaluate(policy, env, episodes=2, seed=3, lower_bound_steps=False)
    status = played(Stage(policy, env, seed=3, episode=1))
    assert (status.outcome, status.steps) == tuple(rows.loc[1, ["outcome", "length"]])
    assert status.total_reward == pytest.approx(rows.loc[1, "return"])


def test_another_policy_may_come_on_and_one_that_cannot_changes_nothing():
    stage = Stage("reach_ik", "armctl/ArmReach-v0", seed=1)
    first = played(stage)
    stage.step()
    assert stage.status == first
    stage.play("random", 1, 0)
    for _ in range(3):
        stage.step()
    before = stage.status
    for name in ("bridge_ompl", "nobody"):
        with pytest.raises(ConfigurationError):
            stage.play(name, 1, 0)
    assert (stage.status, before.steps) == (before, 3)
    stage.step()
    assert stage.status.steps == 4
    stage.play("reach_ik", 1, 0)
    assert played(stage).total_reward == first.total_reward


def test_contacts_are_told_by_thing_and_part():
    bridge = Stage("random", "armctl/BridgeCross-v0")
    bridge.step()
    assert "front_left_wheel" in bridge.status.contacts["floor"]
    arm = Stage("random", "armctl/ArmReachObstacles-v0", seed=2)
    assert arm.status.contacts == {}
    status = played(arm)
    assert (status.outcome, bool(status.contacts)) == ("collided", True)


def test_who_fails_is_named():
    stage = Stage("random", "armctl/ArmReach-v0", episode=5)
    stage._actor.act = lambda observations: np.full((1, 6), np.nan)
    with pytest.raises(PolicyFailed, match="random failed in episode 5"):
        stage.step()


def reached(stage):
    """Where the end-effector or the rover is, (3,) m."""
    task = stage.task
    return task.arm.end_effector_positions[0].copy() if hasattr(task, "arm") else np.append(task.rover.poses[0, :2], 0)


@pytest.mark.parametrize(
    ("policy", "env", "lines"),
    [
        ("reach_ompl", "armctl/ArmReachObstacles-v0", {"path"}),
        ("reach_mpc", "armctl/ArmReachMoving-v0", {"horizon"}),
        ("bridge_ompl", "armctl/BridgeCross-v0", {"path"}),
        ("bridge_mpc", "armctl/BridgeCrossMoving-v0", {"path", "horizon"}),
    ],
)
def test_plans_lead_from_where_it_is_along_where_it_goes(policy, env, lines):
    stage = Stage(policy, env, seed=2)
    assert stage.plans() == {}
    start = reached(stage)
    stage.step()
    plans = {name: line.copy() for name, line in stage.plans().items()}
    assert set(plans) == lines
    for line in plans.values():
        assert line.shape == (len(line), 3)
        np.testing.assert_allclose(line[0], start, atol=0.06)
    went = []
    for _ in range(5):
        went.append(reached(stage))
        stage.step()
    for line in plans.values():
        dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(line)])
        assert max(np.linalg.norm(dense - place, axis=1).min() for place in went) < 0.2  # pursuit cuts corners
    if "path" in plans:
        far = np.linalg.norm(plans["path"][-1] - stage.task.state.target_position[0]) if "reach" in policy else 0.0
        assert far < 0.05
    stage.play(policy, 2, 1)
    assert stage.plans() == {}


def test_policies_without_plans_show_none():
    for policy in ("reach_ik", "random", "reach_ppo"):
        stage = Stage(policy, "armctl/ArmReach-v0")
        stage.step()
        assert stage.plans() == {}
