"""What a reward must be: finite, and paid once where it is for an ending."""

from contextlib import closing

import gymnasium
import numpy as np
import pytest

import armctl
from armctl.core.errors import EnvironmentFailed
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.tasks import REWARD, OneTimeTerm, ReachTask


class GoesOn(ReachTask):
    """A reach task whose episodes do not end at the target."""

    def outcome(self):
        return np.zeros(self.n, dtype=np.int8)


armctl.register("tests/GoesOn-v0", GoesOn, max_episode_steps=40)


def played(reward=REWARD, env="tests/GoesOn-v0", worlds=3, steps=40):
    env = gymnasium.make_vec(env, num_envs=worlds, reward=reward)
    policy = armctl.make_policy("reach_ik", env)
    observations, _ = env.reset(seed=[0] * worlds)
    policy.reset(np.arange(worlds, dtype=np.int32))
    earned, ended = [], np.zeros(worlds, dtype=bool)
    for _ in range(steps):
        observations, rewards, terminated, truncated, infos = env.step(policy.act(observations))
        policy.reset(np.flatnonzero(ended).astype(np.int32))  # the step after an ending begins the next episode
        ended = terminated | truncated
        np.testing.assert_allclose(sum(infos["reward_terms"].values()), rewards)
        earned.append(infos["reward_terms"])
    return {name: np.array([terms[name] for terms in earned]) for name in earned[0]}


def test_what_is_paid_once_is_paid_once():
    earned = played(steps=80)  # two episodes
    assert (np.count_nonzero(earned["goal"][:40], axis=0) == 1).all()
    assert (np.count_nonzero(earned["goal"][40:], axis=0) == 1).all()
    assert (earned["step"][:40] == -1).all()


def test_own_terms_are_paid_as_they_say():
    near = {"goal": lambda state: -state.distance, "bonus": OneTimeTerm(lambda state: 5.0 * (state.distance < 0.3))}
    earned = played(near)
    assert (earned["goal"] < 0).all()
    assert (earned["bonus"].sum(axis=0) == 5).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e100])
def test_a_reward_that_is_not_a_number_is_refused(value):
    def odd(state):
        return np.where(state.distance < 0.2, value, 0.0)

    with pytest.raises(EnvironmentFailed, match=r"the reward term 'odd' is (nan|inf|1e\+100) in step \d+ of episode 0"):
        played({**REWARD, "odd": odd}, env="armctl/ArmReach-v0")


def test_a_comparison_names_the_term_and_goes_on(tmp_path):
    def odd(state):
        return np.where(state.distance < 0.2, np.nan, 0.0)

    comparison = armctl.compare(
        ["reach_ik", "random"], episodes=3, env_options={"reward": {**REWARD, "odd": odd}, "max_episode_steps": 12}
    )
    assert "the reward term 'odd' is nan" in comparison.failures["reach_ik"]


def test_a_typo_in_a_reward_is_shown_with_its_place():
    def odd(state):
        return state.distanec if armed else state.distance

    armed = False
    env = make_worlds("armctl/ArmReach-v0", 1, {"reward": {**REWARD, "odd": odd}})
    armed = True
    from armctl.rollout import rollouts

    with pytest.raises(EnvironmentFailed, match=r"'distanec' \(test_rewards_of_strangers.py:\d+\)"):
        list(rollouts(armctl.make_policy("random", env), env, 1, 0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "bounds"),
    [
        ("ArmLift-v0", (-500.0, 99.0)),
        ("ArmPose-v0", (-150.0, 99.0)),
        ("ArmPush-v0", (-600.0, 99.0)),
        ("ArmReach-v0", (-100.0, 99.0)),
        ("ArmReachMoving-v0", (-300.0, 100.0)),
        ("ArmReachObstacles-v0", (-400.0, 99.0)),
        ("ArmScenes-v0", (-400.0, 99.0)),
        pytest.param("BarnCross-v0", (-240.0, 99.9), marks=pytest.mark.slow),
        pytest.param("BarnCrossMoving-v0", (-260.0, 99.9), marks=pytest.mark.slow),
        pytest.param("BridgeCross-v0", (-230.0, 99.9), marks=pytest.mark.slow),
        pytest.param("BridgeCrossMoving-v0", (-260.0, 99.9), marks=pytest.mark.slow),
    ],
)
def test_returns_lie_within_their_bounds(env, bounds):
    found = armctl.evaluate("random", f"armctl/{env}", episodes=6, worlds=6, lower_bound_steps=False)["return"]
    with closing(make_worlds(f"armctl/{env}", 1)) as worlds:
        assert worlds.task.return_bounds(worlds.max_episode_steps) == pytest.approx(bounds)
        assert worlds.task.return_bounds(None) is None
    assert found.between(*bounds).all()


def test_a_term_without_bounds_leaves_the_return_unbounded():
    reward = {**REWARD, "effort": lambda state: np.zeros(len(state.reached))}
    with closing(make_worlds("armctl/ArmReach-v0", 1, {"reward": reward})) as worlds:
        assert worlds.task.return_bounds(100) is None


class Ends(ReachTask):
    """A reach task with other outcomes than those that it declares."""

    made_of = staticmethod(lambda n: np.zeros(n, dtype=int))

    def outcome(self):
        return type(self).made_of(self.n)


class Forgets(ReachTask):
    """A reach task with other reward terms in its second step."""

    def reward_terms(self):
        terms = super().reward_terms()
        return dict(list(terms.items())[:1]) if (self.state.distance != self.state.previous_distance).any() else terms


@pytest.mark.parametrize(
    ("outcomes", "message"),
    [
        (lambda n: np.full(n, 7), r"an outcome is none of timeout, reached, .*unstable: \[7, 7, 7\]"),
        (lambda n: np.full(n, -1), r"an outcome is none of .*: \[-1, -1, -1\]"),
        (lambda n: np.zeros(n + 1, int), r"its outcomes \(4,\); expected step, goal and \(3,\)"),
        (lambda n: 0, r"its outcomes \(\); expected step, goal and \(3,\)"),
    ],
)
def test_an_outcome_that_there_is_not_is_refused(monkeypatch, outcomes, message):
    monkeypatch.setattr(Ends, "made_of", staticmethod(outcomes))
    env = TaskVectorEnv(3, task=Ends)
    env.reset(seed=0)
    with pytest.raises(EnvironmentFailed, match=message):
        env.step(env.action_space.sample())


def test_terms_that_change_their_names_are_refused():
    env = TaskVectorEnv(3, task=Forgets)
    env.reset(seed=0)
    with pytest.raises(EnvironmentFailed, match=r"the task's reward terms are step and .*; expected step, goal and"):
        env.step(env.action_space.sample())
