"""Goal-conditioned observations of `armctl/ArmReach-v0`."""

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD

REACH = ("armctl/ArmReach-v0", "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0")


def vector(env, n=3, **options):
    return gymnasium.make_vec(env, num_envs=n, threads=1, **options)


class TestGoals:
    """Goal-conditioned observation of `armctl/ArmReach-v0`."""

    @pytest.fixture
    def worlds(self):
        made = vector(REACH[0], 64, goal=True, tolerance=0.2, max_episode_steps=30, autoreset_mode="same_step")
        made.reset(seed=0)
        return made

    def steps(self, worlds, count=60):
        """What each step ended with, before any autoreset."""
        rng = np.random.default_rng(0)
        for _ in range(count):
            seen, rewards, terminated, truncated, infos = worlds.step(rng.uniform(-np.pi, np.pi, (64, 6)))
            yield infos.get("final_obs", seen), rewards, terminated, truncated

    def test_the_reward_is_a_function_of_what_is_observed(self, worlds):
        reached = 0
        for seen, rewards, terminated, _ in self.steps(worlds):
            goals = seen["achieved_goal"], seen["desired_goal"]
            np.testing.assert_array_equal(worlds.compute_reward(*goals, {}), rewards)
            np.testing.assert_array_equal(worlds.compute_terminated(*goals, {}), terminated)
            assert not worlds.compute_truncated(*goals, {}).any()
            reached += terminated.sum()
        assert reached > 10

    def test_one_goal_or_many(self, worlds):
        at, goals = np.zeros(3), np.array([[0.1, 0, 0], [0, 0.3, 0]])
        assert worlds.compute_reward(at, goals[0], {}) == STEP_REWARD + GOAL_REWARD
        assert worlds.compute_reward(np.tile(at, (2, 1)), goals, [{}, {}]).tolist() == [99.0, -1.0]
        assert vector(REACH[0], goal=True, reward_scale=0.1).compute_reward(at, goals[1], {}) == -0.1

    def test_with_another_goal_reward_too(self):
        made = vector(REACH[0], 64, goal=True, tolerance=0.3, goal_reward=1.0, autoreset_mode="same_step")
        made.reset(seed=0)
        for seen, rewards, terminated, _ in self.steps(made, 20):
            np.testing.assert_array_equal(made.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}), rewards)
            np.testing.assert_array_equal(rewards, terminated - 1.0)
        assert made.task.return_bounds(100) == (-100.0, 0.0)

    @pytest.mark.parametrize("name", ["paper", "features", "full"])
    def test_the_rest_of_the_observation_does_not_know_the_goal(self, name):
        made = vector(REACH[0], 2, goal=True, observation=name)
        seen, _ = made.reset(seed=[1, 2])
        assert (seen["desired_goal"][0] != seen["desired_goal"][1]).any()
        np.testing.assert_array_equal(seen["observation"][0], seen["observation"][1])

    def test_only_with_goals_there_is_compute_reward(self):
        assert not hasattr(gymnasium.make(REACH[0]).unwrapped, "compute_reward")
        assert gymnasium.make(REACH[0], goal=True).get_wrapper_attr("compute_reward")(np.zeros(3), np.ones(3), {}) == -1

    @pytest.mark.parametrize("env", REACH[1:])
    def test_other_tasks_say_that_they_have_none(self, env):
        with pytest.raises(ConfigurationError, match="ArmReach-v0"):
            vector(env, goal=True)
