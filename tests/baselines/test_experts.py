import gymnasium
import pytest

from armctl.errors import ConfigurationError
from armctl.evaluation import evaluate
from armctl.evaluation.record import TIME_COLUMNS
from armctl.policies import make_policy


@pytest.mark.slow
def test_reach_ik_reaches_every_reachable_target():
    results = evaluate("reach_ik", episodes=1000, seed=0)
    assert results.success.all()
    assert results.length.mean() < 12


@pytest.mark.parametrize("robot", ["ur3", "ur10"])
@pytest.mark.parametrize("control", ["position", "delta", "velocity"])
def test_reach_ik_works_on_other_arms_and_controls(robot, control):
    results = evaluate("reach_ik", episodes=25, seed=1, env_options={"robot": robot, "control": control})
    assert results.success.all()


@pytest.mark.parametrize("robot", ["z1", "panda", "xarm7"])
def test_reach_ik_works_on_arms_that_are_no_ur(robot):
    results = evaluate("reach_ik", episodes=30, seed=2, worlds=10, env_options={"robot": robot})
    assert results.success.mean() >= 0.95


def test_reach_ik_refuses_torque_control():
    with pytest.raises(ConfigurationError, match="joint motions"):
        make_policy("reach_ik", gymnasium.make("armctl/ArmReach-v0", control="torque"))


def test_reach_ik_refuses_another_observation():
    env = gymnasium.make("armctl/ArmReach-v0", observation={"q": lambda state: state.joint_positions})
    with pytest.raises(ConfigurationError, match="reads the observation"):
        make_policy("reach_ik", env)


def test_reach_ik_survives_targets_out_of_reach():
    options = {"target": "box", "target_box": ((1.5, 1.5, 1.5), (2, 2, 2))}
    results = evaluate("reach_ik", episodes=3, env_options=options)
    assert not results.feasible.any()
    assert list(results.outcome) == ["timeout"] * 3


def test_feasible_box_targets_are_reached():
    results = evaluate("reach_ik", episodes=60, seed=3, env_options={"target": "box"})
    assert 15 < results.feasible.sum() < 55
    assert results[results.feasible].success.all()


def test_random_is_the_same_in_every_run_and_seldom_lucky():
    first = evaluate("random", episodes=40, seed=0, worlds=8).drop(columns=list(TIME_COLUMNS))
    again = evaluate("random", episodes=40, seed=0, worlds=3).drop(columns=list(TIME_COLUMNS))
    assert first.equals(again)
    assert first.success.mean() < 0.15


def test_reach_mpc_reaches_and_keeps_all_limits():
    results = evaluate("reach_mpc", episodes=60, seed=4, worlds=20)
    assert results.success.all()
    assert results.optimality_gap.median() < 0.3


def test_reach_mpc_follows_a_moving_target_twice_as_closely_as_reach_ik():
    env = "armctl/ArmReachMoving-v0"
    mpc, ik = (evaluate(policy, env, episodes=20, seed=5, worlds=20) for policy in ("reach_mpc", "reach_ik"))
    assert mpc.success.mean() >= 0.9
    assert mpc.tracking_error.mean() < 0.5 * ik.tracking_error.mean()


@pytest.mark.parametrize("robot", ["ur5", "z1", "xarm7"])
def test_reach_ompl_gets_around_obstacles_without_a_touch(robot):
    env = "armctl/ArmReachObstacles-v0"
    results = evaluate("reach_ompl", env, episodes=25, seed=6, worlds=25, env_options={"robot": robot})
    assert (results.outcome == "reached").mean() >= 0.95
    assert results.feasible.all()


@pytest.mark.parametrize("policy", ["reach_mpc", "reach_ompl"])
def test_position_experts_refuse_other_controls_and_observations(policy):
    env = "armctl/ArmReachObstacles-v0"
    with pytest.raises(ConfigurationError, match="joint positions"):
        make_policy(policy, gymnasium.make(env, control="velocity"))
    with pytest.raises(ConfigurationError, match="reads the observation"):
        make_policy(policy, gymnasium.make(env, observation={"q": lambda state: state.joint_positions}))
    with pytest.raises(ConfigurationError, match=policy):
        make_policy(policy, gymnasium.make("armctl/BridgeCross-v0"))


def test_no_expert_is_sooner_than_possible_by_more_than_a_decision():
    for policy in ("reach_ik", "reach_mpc", "reach_ppo"):
        results = evaluate(policy, episodes=100, seed=7, worlds=50)
        assert (results.length >= results.least_length - 1).all()
    assert evaluate("reach_ik", episodes=100, seed=7, worlds=50).optimality_gap.median() <= 0.1
