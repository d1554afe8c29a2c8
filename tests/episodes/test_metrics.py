import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.envs import make_worlds
from armctl.episodes.metrics import jerks, largest_and_rms, path_length, range_use, smoothness
from armctl.episodes.record import TIME_COLUMNS
from armctl.policies import make_policy
from armctl.rollout import evaluate
from armctl.rollout.loop import rollouts


def minimum_jerk(samples, amplitude=1.0):
    """From rest to rest (Flash and Hogan 1985), along a diagonal."""
    time = np.linspace(0, 1, samples)
    return amplitude * np.outer(10 * time**3 - 15 * time**4 + 6 * time**5, np.ones(3) / math.sqrt(3))


def test_smoothest_motion_has_its_textbook_jerk():
    # integral of jerk^2 = 720 A^2 / T^5, peak speed = 15/8 A / T: 720 / (15/8)^2 = 204.8 without dimension.
    assert smoothness(minimum_jerk(4000), 1 / 3999) == pytest.approx(-math.log(204.8), abs=5e-3)


@given(st.floats(0.01, 100), st.floats(0.01, 10))
def test_smoothness_minds_neither_size_nor_duration(amplitude, period):
    assert smoothness(minimum_jerk(30, amplitude), period) == pytest.approx(smoothness(minimum_jerk(30), 1.0))


def test_trembling_is_less_smooth_and_rest_has_no_smoothness():
    path = minimum_jerk(50)
    trembling = path + 0.01 * (-1.0) ** np.arange(50)[:, None]
    assert smoothness(trembling, 0.04) < smoothness(path, 0.04) - 3
    assert math.isnan(smoothness(np.zeros((10, 3)), 0.04))
    assert math.isnan(smoothness(path[:3], 0.04))


def test_path_length_and_range_use():
    assert path_length(np.array([[0, 0, 0], [3, 4, 0], [3, 4, 2.0]])) == 7
    assert range_use(np.array([[0.0, 1.0], [0.5, 1.5]]), np.array([-1.0, 0.0]), np.array([1.0, 2.0])) == 0.5


def test_jerk_of_a_cubic_is_constant_and_of_the_smoothest_motion_as_in_the_textbook():
    times = np.linspace(0, 1, 501)[:, None]
    positions, speeds = 2 * times**3, 6 * times**2  # jerk 12
    for samples, order in ((positions, 3), (speeds, 2)):
        assert largest_and_rms(jerks(samples, order, 0.002)) == pytest.approx((12, 12), rel=1e-4)
    path = jerks(minimum_jerk(2001), 3, 1 / 2000)
    assert largest_and_rms(np.linalg.norm(path, axis=1)) == pytest.approx((60, math.sqrt(720)), rel=1e-2)
    assert largest_and_rms(np.zeros((0, 3))) == (0.0, 0.0)


@pytest.fixture(scope="module")
def played():
    return evaluate("random", "armctl/ArmReach-v0", episodes=2, lower_bound_steps=False)


def test_metrics_of_an_arm_are_those_of_its_motion(played):
    env = gymnasium.make("armctl/ArmReach-v0")
    policy: Any = make_policy("random", env)
    observation, _ = env.reset(seed=0, options={"episode": 1})
    policy.reset(np.zeros(1, dtype=np.int32))
    task, data = env.get_wrapper_attr("task"), []
    finished, limits, energy = False, env.get_wrapper_attr("task").arm.description.limits, 0.0
    middle, half, away = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2, []
    places, contacts, all_speeds = [task.motion().position[0]], 0, [np.zeros(6)] * 2
    while not finished:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation[None])[0])
        speeds, torques = task.motion().joints[:, :, 0]
        assert task.motion().path[-1, 0] == pytest.approx(task.motion().position[0])
        all_speeds.extend(speeds)
        assert speeds[-1] == pytest.approx(task.arm.joint_velocities[0])
        energy += 0.008 * np.abs(speeds * torques).sum()
        places.append(task.motion().position[0])
        away.append(np.abs(task.arm.joint_positions[0] - middle) / half)
        contacts += int(task.motion().contact[0])
        data.append((np.abs(speeds / limits.velocity).max(), np.abs(torques / limits.effort).max()))
        finished = terminated or truncated
    row = played.iloc[1]
    assert (row.speed_use, row.torque_use) == pytest.approx(np.max(data, axis=0))
    assert row.torque_use <= 1 + 1e-9
    assert row.energy == pytest.approx(energy)
    assert row.path_length == pytest.approx(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    assert row.range_use == pytest.approx(np.max(away))
    assert row.contacts == contacts > 0
    jerk = np.diff(all_speeds, n=2, axis=0) / 0.008**2
    assert (row.joint_jerk_max, row.joint_jerk_rms) == pytest.approx((np.abs(jerk).max(), np.sqrt((jerk**2).mean())))
    assert row.smoothness == pytest.approx(smoothness(np.array(places), 0.04))


def test_a_robot_that_stands_does_nothing():
    def still(env):
        policy: Any = make_policy("random", env)
        policy.act = lambda observations: observations[:, 3:9]
        return policy

    row = evaluate(still, episodes=1, lower_bound_steps=False).iloc[0]
    assert row.path_length < 0.005
    assert row.energy < 0.5
    assert row.contacts == 0


def test_an_episode_that_ends_by_a_collision_has_one_contact_and_no_clearance():
    arm = evaluate("random", "armctl/ArmReachObstacles-v0", episodes=2, lower_bound_steps=False)
    collided = arm[arm.outcome == "collided"]
    assert len(collided)
    assert (collided.contacts == 1).all()
    assert (collided.clearance < 0.03).all()
    options = {"resolution": (4, 4)}
    rover = evaluate("bridge_ompl", "armctl/BridgeCross-v0", episodes=1, env_options=options).iloc[0]
    assert rover.contacts == 0
    assert 0.05 < rover.clearance < 0.5
    assert 17 < rover.path_length < 25
    assert rover.joint_jerk_max > rover.joint_jerk_rms > 0
    assert math.isnan(rover.tip_jerk_max)
    assert math.isnan(rover.range_use)


def late(env):
    import time

    policy: Any = make_policy("random", env)
    act = policy.act
    policy.act = lambda observations: time.sleep(0.041) or act(observations)
    return policy


def test_missed_deadlines_are_counted():
    row = evaluate(late, episodes=1, env_options={"max_episode_steps": 3}, lower_bound_steps=False).iloc[0]
    assert row.missed_deadlines == 2  # of three: the first is cold, and told apart
    assert row.first_call_ms > 41
    assert row.decision_ms_max >= row.decision_ms_p99 >= row.decision_ms_p50 > 41


def test_solver_failures_are_those_of_the_world_and_episode():
    env = make_worlds("armctl/ArmReach-v0", 2, {"max_episode_steps": 4})
    policy: Any = make_policy("random", env)
    policy.failures = np.array([5, 7])
    act = policy.act

    def failing_in_odd_episodes(observations):
        policy.failures = policy.failures + env.episodes % 2
        return act(observations)

    policy.act = failing_in_odd_episodes
    results = {result.episode: result for result in rollouts(policy, env, range(5), 0)}
    assert [results[k].metrics.solver_failures for k in range(5)] == [0, 4, 0, 4, 0]
    env.close()


@pytest.mark.parametrize(
    ("policy", "env", "options"),
    [
        ("reach_ppo", "armctl/ArmReach-v0", {}),
        pytest.param(
            "bridge_ompl",
            "armctl/BridgeCrossMoving-v0",
            {"deck_length": 12.0, "blocks": 2, "walkers": 2, "resolution": (4, 4)},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_number_of_worlds_changes_no_metric(policy, env, options):
    runs = [
        evaluate(policy, env, episodes=5, worlds=worlds, env_options=options, lower_bound_steps=False).drop(
            columns=list(TIME_COLUMNS)
        )
        for worlds in (1, 3)
    ]
    assert runs[0].equals(runs[1])


def test_the_stop_at_a_target_is_no_jerk():
    """A world stands still from the tick on in which the target is reached, at whatever acceleration."""
    row = evaluate("reach_ik", episodes=5, worlds=5, lower_bound_steps=False)
    assert row.success.all()
    assert (row.joint_jerk_rms < 1.5 * 15 / 0.008).all()  # the drives' acceleration, changed within a tick
    assert (row.tip_jerk_max > row.tip_jerk_rms).all()
