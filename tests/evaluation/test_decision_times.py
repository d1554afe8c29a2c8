"""What a decision time is, by a clock that only the policy advances."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from armctl.envs import make_worlds
from armctl.evaluation import compare
from armctl.evaluation.decision_times import TimedPolicy, timing_notes
from armctl.evaluation.rollouts import rollouts
from armctl.report import write_report

OPTIONS = {"max_episode_steps": 3}


class Slow:
    """Holds still. Its resets and decisions take as many ms as they are told to."""

    sees, training_steps = "observation", 0

    def __init__(self, clock, reset_ms, decision_ms):
        self.clock, self.reset_ms, self.decision_ms = clock, reset_ms, iter(decision_ms)

    def reset(self, ids):
        self.clock.now += 1e-3 * self.reset_ms * len(ids)

    def act(self, observations):
        self.clock.now += 1e-3 * next(self.decision_ms)
        return observations[:, 3:9]


def played(policy, worlds, episodes):
    timed = policy if isinstance(policy, TimedPolicy) else TimedPolicy(policy, worlds)
    env = make_worlds("armctl/ArmReach-v0", worlds, OPTIONS)
    found = sorted(
        rollouts(timed, env, episodes, 0, "slow", dict.fromkeys(range(episodes), math.nan)),
        key=lambda result: result.episode,
    )
    env.close()
    return found


def test_planning_at_the_reset_belongs_to_the_first_decision_and_the_very_first_is_told_apart(clock):
    first, second = played(Slow(clock, 30.0, [500, 1, 41, 12, 2, 3]), 1, 2)
    np.testing.assert_allclose(first.decision_ms, [530, 1, 41])
    np.testing.assert_allclose(second.decision_ms, [42, 2, 3])
    assert first.metrics.decision_ms_cold == 530
    assert math.isnan(second.metrics.decision_ms_cold)
    assert (first.metrics.decision_ms_max, second.metrics.decision_ms_max) == (41, 42)
    assert (first.metrics.missed_deadlines, second.metrics.missed_deadlines) == (1, 1)


def test_in_a_batch_everybody_has_a_share_and_no_deadline_is_judged(clock):
    results = played(Slow(clock, 30.0, [100, 10, 10, 20, 10, 10]), 2, 4)
    for result in results[:2]:
        np.testing.assert_allclose(result.decision_ms, [80, 5, 5])
        assert result.metrics.decision_ms_cold == 80
    for result in results[2:]:
        np.testing.assert_allclose(result.decision_ms, [40, 5, 5])
    assert {result.metrics.missed_deadlines for result in results} == {None}
    assert {(result.worlds, result.workers) for result in results} == {(2, 1)}


def test_a_policy_that_has_decided_before_is_warm(clock):
    timed = TimedPolicy(Slow(clock, 0.0, [9, 1, 1, 8, 1, 1]), 1, workers=2)
    (cold,), (warm,) = played(timed, 1, 1), played(timed, 1, 1)
    assert cold.metrics.decision_ms_cold == 9
    assert math.isnan(warm.metrics.decision_ms_cold)
    assert warm.metrics.decision_ms_max == 8
    assert warm.metrics.missed_deadlines is None


def test_times_that_were_taken_otherwise_are_not_mixed(tmp_path):
    arguments = {"env_options": OPTIONS, "out": tmp_path, "seeding": []}
    shares = compare(["random"], episodes=2, worlds=2, **arguments)
    assert shares.notes == [
        "Decision times are shares of a batch of 2 worlds. Only those of one world and one worker are held against "
        "deadlines."
    ]
    assert shares.policies[0].missed_deadlines is None
    assert shares.policies[0].timing == "shares of a batch of 2 worlds"
    mixed = compare(["random"], episodes=3, **arguments)
    assert mixed.episodes.worlds.tolist() == [2, 2, 1]
    assert mixed.notes == [
        "Decision times of random are from 1 of 3 episodes, and are latencies: the others were played with other "
        "--worlds or --workers."
    ]
    (policy,) = mixed.policies
    assert (policy.worlds, policy.workers, policy.timing) == (1, 1, "")
    last = pd.read_csv(tmp_path / "episodes.csv").iloc[-1]
    assert policy.decision_ms_p50 == pytest.approx(last.decision_ms_p50, abs=1e-3)
    assert policy.missed_deadlines == last.missed_deadlines / (last.length - 1)


def test_times_of_different_settings_are_said_not_to_compare(clock):
    (one,) = played(Slow(clock, 0.0, [1, 1, 1]), 1, 1)
    alone, shared, beside = (
        [replace(one, worlds=worlds, workers=workers)] * 3 for worlds, workers in ((1, 1), (40, 1), (1, 3))
    )
    assert timing_notes([("a", alone), ("b", alone)]) == []
    assert timing_notes([("a", alone), ("b", shared), ("c", beside)]) == [
        "Decision times cannot be compared: those of a are latencies; those of b are shares of a batch of 40 worlds; "
        "those of c are taken while up to 2 other workers computed."
    ]
    (said, _) = timing_notes([("a", shared * 2 + alone), ("b", shared)])
    assert said.startswith("Decision times of a are from 3 of 9 episodes, and are latencies")


def test_the_report_says_what_its_times_are_and_how_to_take_them_again(tmp_path):
    compare(["random"], episodes=2, worlds=2, env_options=OPTIONS, out=tmp_path, seeding=[])
    page = write_report(tmp_path, video=False).read_text()
    assert "--episodes 2 --worlds 2" in page
    assert "times are shares of a batch of 2 worlds" in page
    assert "deadline 40 ms" not in page
