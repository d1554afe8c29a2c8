"""Every policy in every environment plays the same episodes in any number of worlds and workers."""

import pandas as pd
import pytest

from armctl.envs import make_worlds, task_of
from armctl.episodes.record import FailedEpisode
from armctl.policies import make_policy
from armctl.rollout import rollouts
from armctl.rollout.decision_times import TimedPolicy
from armctl.study import compare

from ..stores import timeless

LINES_UP = {
    "armctl/ArmLift-v0": ("lift_grasp", "lift_cloned_ppo", "random"),
    "armctl/ArmPose-v0": ("reach_ik", "reach_mpc", "reach_ruckig", "reach_rate", "pose_dagger", "random"),
    "armctl/ArmPush-v0": ("push_line", "push_bc", "random"),
    "armctl/ArmReach-v0": ("reach_ik", "reach_mpc", "reach_ppo", "reach_sac", "reach_bc", "reach_dagger", "random"),
    "armctl/ArmReachMoving-v0": ("reach_ik", "reach_mpc", "moving_forecast", "moving_dagger", "moving_ppo", "random"),
    "armctl/ArmReachObstacles-v0": (
        "reach_ompl",
        "reach_ik",
        "obstacles_plan_bc",
        "obstacles_imagined",
        "random",
    ),
    "armctl/ArmScenes-v0": (
        "reach_ompl",
        "reach_mpc",
        "reach_ik",
        "scenes_imagined",
        "scenes_plan_bc",
        "random",
    ),
    "armctl/BarnCross-v0": ("bridge_ompl", "bridge_dwa", "bridge_distil", "random"),
    "armctl/BarnCrossMoving-v0": ("bridge_mpc", "bridge_orca", "barn_moving_state_ppo", "random"),
    "armctl/BridgeCross-v0": ("bridge_ompl", "bridge_mpc", "bridge_ppo", "bridge_distil", "random"),
    "armctl/BridgeCrossMoving-v0": (
        "bridge_ompl",
        "bridge_mpc",
        "bridge_moving_imagined",
        "bridge_moving_distil",
        "random",
    ),
}
EPISODES = 8
SETTINGS = {"one": (1, 1), "seven": (7, 1), "two workers": (3, 2)}


def rows(env, policies, episodes, worlds, workers):
    played = compare(
        policies, env, episodes=episodes, worlds=worlds, workers=workers, env_options={"max_episode_steps": 25}
    )
    assert not played.failures
    return timeless(played.episodes)


QUICKEST = "armctl/ArmReach-v0"


@pytest.mark.slow
@pytest.mark.parametrize(
    "env", [QUICKEST, *(pytest.param(env, marks=pytest.mark.thorough) for env in LINES_UP if env != QUICKEST)]
)
def test_worlds_and_workers_change_no_episode(env):
    assert set(task_of(env).default_policies) <= set(LINES_UP[env])
    expected = rows(env, LINES_UP[env], EPISODES, EPISODES, 1)
    for worlds, workers in SETTINGS.values():
        pd.testing.assert_frame_equal(rows(env, LINES_UP[env], EPISODES, worlds, workers), expected, check_exact=True)


class Brief:
    """Fails in its third step, where the target is on the left."""

    calls = 0

    def reset(self):
        self.steps = 0

    def act(self, observation):
        Brief.calls += 1
        self.steps += 1
        if self.steps == 3 and observation[10] > 0:
            raise ValueError("enough")
        return observation[3:9]


def test_no_controller_acts_after_its_last_episode():
    played = {}
    for worlds in (1, 3, 7):
        Brief.calls = 0
        episodes = compare([Brief], episodes=7, worlds=worlds, env_options={"max_episode_steps": 9}).episodes
        errors = episodes.outcome == "error"
        assert 0 < errors.sum() < 7
        assert Brief.calls == episodes.length.sum() + errors.sum()
        played[worlds] = timeless(episodes)
        pd.testing.assert_frame_equal(played[worlds], played[1], check_exact=True)


def test_worlds_without_an_episode_stand_still(monkeypatch):
    stepped = []

    def advance(task, ids):
        stepped.append(task.n if ids is None else len(ids))
        original(task, ids)

    original = task_of(QUICKEST).advance
    monkeypatch.setattr(task_of(QUICKEST), "advance", advance)
    worlds = make_worlds(QUICKEST, 5, {"max_episode_steps": 9})
    policy = TimedPolicy(make_policy(Brief, worlds), 5)
    for episodes in (range(2), range(2, 4)):
        stepped.clear()
        Brief.calls = 0
        results = list(rollouts(policy, worlds, episodes, seed=0))
        errors = sum(isinstance(result, FailedEpisode) for result in results)
        assert sum(stepped) == sum(result.length for result in results)
        assert Brief.calls == sum(stepped) + errors + 3  # each of the other controllers has to act once
