"""What a decision time is, by a clock that only the policy advances."""

import math
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from armctl.envs import make_worlds
from armctl.episodes.table import EpisodeTable
from armctl.report import write_report
from armctl.rollout.decision_times import Machines, TimedPolicy, comparable_times, timing_notes
from armctl.rollout.loop import rollouts
from armctl.runtime.provenance import Run
from armctl.study import compare
from armctl.study.results import read_comparison

from ..forgery import rewrite
from ..holding_still import HoldsStill
from ..printed import text_of
from ..stores import read_cell

OPTIONS = {"max_episode_steps": 3}


class Slow(HoldsStill):
    """Holds still. Its resets and decisions take as many ms as they are told to."""

    def __init__(self, clock, reset_ms, decision_ms):
        self.clock, self.reset_ms, self.decision_ms = clock, reset_ms, iter(decision_ms)

    def reset(self, ids):
        self.clock.now += 1e-3 * self.reset_ms * len(ids)

    def act(self, observations):
        self.clock.now += 1e-3 * next(self.decision_ms)
        return super().act(observations)


def played(policy, worlds, episodes):
    timed = policy if isinstance(policy, TimedPolicy) else TimedPolicy(policy, worlds)
    env = make_worlds("armctl/ArmReach-v0", worlds, OPTIONS)
    found = sorted(
        rollouts(timed, env, episodes, 0, "slow", dict.fromkeys(range(episodes), math.nan)),
        key=lambda result: result.episode,
    )
    env.close()
    return found


def test_planning_at_the_reset_is_told_apart_and_so_is_the_very_first_decision(clock):
    first, second = played(Slow(clock, 30.0, [500, 1, 41, 12, 2, 3]), 1, 2)
    np.testing.assert_allclose(first.decision_ms, [500, 1, 41])
    np.testing.assert_allclose(second.decision_ms, [12, 2, 3])
    assert (first.reset_ms, second.reset_ms) == (30, 30)
    assert first.metrics.first_call_ms == 500
    assert math.isnan(second.metrics.first_call_ms)
    assert (first.metrics.decision_ms_max, second.metrics.decision_ms_max) == (41, 12)
    assert (first.metrics.missed_deadlines, second.metrics.missed_deadlines) == (1, 1)  # 41 ms; and 30 + 12 ms
    table = EpisodeTable([first, second])
    np.testing.assert_allclose(table.decision_seconds(), [0.572, 0.047])


def test_in_a_batch_everybody_has_a_share_and_no_deadline_is_judged(clock):
    results = played(Slow(clock, 30.0, [100, 10, 10, 20, 10, 10]), 2, 4)
    for result in results[:2]:
        np.testing.assert_allclose(result.decision_ms, [50, 5, 5])
        assert result.metrics.first_call_ms == 50
    for result in results[2:]:
        np.testing.assert_allclose(result.decision_ms, [10, 5, 5])
    assert {result.reset_ms for result in results} == {30}
    assert {result.metrics.missed_deadlines for result in results} == {None}
    assert {(result.worlds, result.workers) for result in results} == {(2, 1)}


class Sleepy:
    """Takes 50 ms to be made, 60 ms at each reset and 1 ms for each decision."""

    def __init__(self):
        time.sleep(0.05)

    def reset(self):
        time.sleep(0.06)

    def act(self, observation):
        time.sleep(0.001)
        return observation[3:9]


@pytest.mark.parametrize(("worlds", "workers"), [(1, 1), (4, 1), pytest.param(2, 2, marks=pytest.mark.slow)])
def test_construction_resets_and_decisions_have_their_own_times_in_any_number_of_worlds(tmp_path, worlds, workers):
    """Episodes as many as worlds, so that each world is reset once, before the first decision of the process."""
    found = compare({"sleepy": Sleepy}, episodes=4, worlds=worlds, workers=workers, env_options=OPTIONS, out=tmp_path)
    assert pd.read_csv(tmp_path / "episodes.csv").reset_ms.between(60, 118).all()
    (sleepy,) = found.policies
    assert 50 <= sleepy.construction_ms < 90
    assert 60 <= sleepy.reset_ms < 118
    assert 1 <= sleepy.decision_ms_p50 < 40
    if worlds == 1:  # elsewhere, each is the first one of its process
        assert 61 <= sleepy.first_decision_ms < 125
        assert sleepy.control_step_ms > 60 / 3  # it has the planning, spread over three decisions each
    assert 0.063 <= sleepy.decision_seconds.value < 0.15
    again = read_comparison(tmp_path).policies[0]
    assert (again.reset_ms, again.construction_ms) == (sleepy.reset_ms, sleepy.construction_ms)
    said = text_of(found)
    assert ("until the first action" in " ".join(said.split())) == (worlds == 1)
    assert "; construction " in said


def test_times_of_another_processor_are_not_pooled(tmp_path):
    """A forged record of another machine's run, which has played most latencies of one policy and none of another."""
    arguments = {"env_options": OPTIONS, "out": tmp_path}
    compare({"one": holds_still, "other": holds_still}, episodes=2, **arguments)
    identity, facts, (played,), episodes = read_cell(tmp_path)
    rewrite(tmp_path, identity, facts, episodes, [replace(played, processor="abacus", cores=1)])
    mixed = compare({"one": holds_still, "other": holds_still}, episodes=5, **arguments)
    last = next(run for run in read_comparison(tmp_path).runs if run.id == mixed.episodes.run.iloc[-1])
    here = f"{last.processor}, {last.cores} cores"
    for name, policy in zip(("one", "other"), mixed.policies, strict=True):
        assert (
            f"Decision times of {name} are from 3 of 5 episodes, and are latencies: the others were played on abacus, "
            f"1 cores, not on {here}."
        ) in mixed.notes
        own = mixed.results[(mixed.results.column("policy") == name) & (mixed.results.column("episode") >= 2)]
        assert [policy.decision_ms_max] == own.warm_times().quantiles((1.0,))
    assert not [note for note in mixed.notes if "cannot be compared" in note]


def test_times_of_policies_on_different_processors_are_said_not_to_compare(clock):
    (one,) = played(Slow(clock, 0.0, [1, 1, 1]), 1, 1)
    here, there = (replace(one, run=run) for run in ("here", "there"))
    runs = [Run(name, "", {}, name, 2, {}, 1, 1) for name in ("here", "there")]
    results = EpisodeTable([*[here] * 3, there, there])
    machines = Machines.of(runs, results)
    assert comparable_times(EpisodeTable([here, there, there]), machines).column("run").tolist() == ["here"]
    assert timing_notes([("a", EpisodeTable([here])), ("b", EpisodeTable([there]))], machines) == [
        "Decision times cannot be compared: those of a are latencies on here, 2 cores; those of b are latencies on "
        "there, 2 cores."
    ]


def holds_still(observation):
    return observation[3:9]


def test_a_policy_that_has_decided_before_is_warm(clock):
    timed = TimedPolicy(Slow(clock, 0.0, [9, 1, 1, 8, 1, 1]), 1, workers=2)
    (cold,), (warm,) = played(timed, 1, 1), played(timed, 1, 1)
    assert cold.metrics.first_call_ms == 9
    assert math.isnan(warm.metrics.first_call_ms)
    assert warm.metrics.decision_ms_max == 8
    assert warm.metrics.missed_deadlines is None


def test_times_that_were_taken_otherwise_are_not_mixed(tmp_path):
    arguments = {"env_options": OPTIONS, "out": tmp_path}
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
    a, b, c, mixed = map(EpisodeTable, (alone, shared, beside, shared * 2 + alone))
    assert timing_notes([("a", a), ("b", a)]) == []
    assert timing_notes([("a", a), ("b", b), ("c", c)]) == [
        "Decision times cannot be compared: those of a are latencies; those of b are shares of a batch of 40 worlds; "
        "those of c are taken while up to 2 other workers computed."
    ]
    (said, _) = timing_notes([("a", mixed), ("b", b)])
    assert said.startswith("Decision times of a are from 3 of 9 episodes, and are latencies")


def test_the_report_says_what_its_times_are_and_how_to_take_them_again(tmp_path):
    compare(["random"], episodes=2, worlds=2, env_options=OPTIONS, out=tmp_path)
    page = write_report(tmp_path, video=False).read_text()
    assert "--episodes 2 --worlds 2" in page
    assert "times are shares of a batch of 2 worlds" in page
    assert "deadline 40 ms" not in page
