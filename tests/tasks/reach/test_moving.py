import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.kinematics import ArmModel, Workspace
from armctl.policies import make_policy
from armctl.tasks import ReachMovingTask

ENV = "armctl/ArmReachMoving-v0"
PERIOD = 0.04


def hold_still(env):
    return env.task.arm.joint_positions.copy()


def test_observation_ends_with_the_targets_velocity():
    env = TaskVectorEnv(16, task=ReachMovingTask)
    assert env.single_observation_space.shape == (15,)
    before = env.reset(seed=0)[0]
    for _ in range(50):
        observations = env.step(hold_still(env))[0]
        moved = (observations[:, 9:12] - before[:, 9:12]) / PERIOD
        np.testing.assert_allclose(moved, (observations[:, 12:] + before[:, 12:]) / 2, atol=0.01)
        before = observations
    assert np.linalg.norm(observations[:, 12:], axis=1).mean() > 0.1


def test_targets_stay_within_reach_off_floor_and_base(sized):
    env = TaskVectorEnv(20, task=ReachMovingTask)
    env.reset(seed=1)
    workspace = Workspace(ArmModel("ur5"))
    missed, steps = 0, sized(100, 300)
    for _ in range(steps):
        targets = env.step(hold_still(env))[0][:, 9:12]
        assert targets[:, 2].min() >= 0.05 - 0.01
        missed += sum(not workspace.reachable(target, 0.02) for target in targets.astype(float))
    assert missed <= 0.01 * 20 * steps


def test_is_won_by_staying_within_the_tolerance_and_by_nothing_else():
    env = gymnasium.make(ENV, hold_time=1.0)
    policy = make_policy("reach_ik", env)
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        policy.reset(np.zeros(1, dtype=np.int32))
        within, terminated, total = [], False, 0.0
        while not terminated:
            observation, reward, terminated, truncated, info = env.step(policy.act(observation[None])[0])
            within.append(bool(np.linalg.norm(observation[:3] - observation[9:12]) <= 0.05))
            assert reward == info["reward_terms"]["away"] + info["reward_terms"]["goal"]
            assert info["reward_terms"]["away"] == (0.0 if within[-1] else -1.0)
            assert info["is_success"] == terminated == (info["outcome"] == "held")
            total += float(reward)
            assert not truncated
        assert all(within[-25:])
        assert total == 100 - within.count(False)


def test_leaving_the_tolerance_starts_the_clock_anew():
    env = gymnasium.make(ENV, hold_time=0.4, amplitude=0.0)
    task = env.get_wrapper_attr("task")
    env.reset(seed=0)
    home = task.arm.description.home
    there = task.arm.end_effector_positions[0].copy()
    held = []
    for step in range(30):
        task._centres[0] = there + (0.3 if step == 8 else 0.0)
        _, _, terminated, _, _ = env.step(home)
        held.append(terminated)
        if terminated:
            break
    assert held.index(True) == 8 + 10


def test_tracking_error_is_the_mean_distance_since_the_first_touch():
    env = TaskVectorEnv(8, task=ReachMovingTask, max_episode_steps=None)
    observations, infos = env.reset(seed=3)
    assert not infos["tracking"].any()
    np.testing.assert_allclose(infos["tracking_error"], env.task.state.distance)
    policy = make_policy("reach_ik", env)
    policy.reset(np.arange(8, dtype=np.int32))
    distances = []
    for _ in range(80):
        observations, _, _, _, infos = env.step(policy.act(observations))
        distances.append(np.linalg.norm(observations[:, :3] - observations[:, 9:12], axis=1))
    for world, row in enumerate(np.transpose(distances)):
        first = int((row <= 0.05).argmax())
        assert infos["tracking_error"][world] == pytest.approx(row[first + 1 :].mean(), abs=1e-5)


def test_world_i_is_the_single_world_of_seed_plus_i():
    worlds = TaskVectorEnv(3, task=ReachMovingTask)
    together = worlds.reset(seed=5)[0]
    for _ in range(5):
        together = worlds.step(np.zeros((3, 6)))[0]
    for i in range(3):
        env = gymnasium.make(ENV)
        env.reset(seed=5 + i)
        for _ in range(5):
            alone = env.step(np.zeros(6))[0]
        np.testing.assert_array_equal(alone, together[i])


@pytest.mark.parametrize(
    "options", [{"hold_time": 0.0}, {"hold_time": np.nan}, {"amplitude": -1.0}, {"target": "box"}, {"hold_tim": 1.0}]
)
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError):
        gymnasium.make(ENV, **options)
