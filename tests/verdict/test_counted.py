"""Which episodes count: feasible ones, up to the first that was not finished."""

import math
from dataclasses import replace

import pytest

from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable
from armctl.stats.robustness import change_between
from armctl.verdict.scores import by_learner
from armctl.verdict.summary import counted_results, counted_rows, summarise

from ..made_up_comparison import UNTRAINED_POLICY, facts_of
from ..made_up_episodes import played

LOST = 7
"""The episode that was not finished: those after it ended earlier because they were shorter."""


def results(feasible=lambda episode: True):
    """Twelve episodes of a, and of b all but `LOST`; b's later ones are all won, as those that end early are."""
    whole = [replace(one, feasible=feasible(one.episode), success=one.policy == "b" and one.episode > LOST)
             for one in played(12, ("a", "b"))]  # fmt: skip
    return [one for one in whole if (one.policy, one.episode) != ("b", LOST)]


def counted_in(found):
    """Which episodes count, by both implementations."""
    by_table, infeasible = counted_results(EpisodeTable(found))
    from_table = {name: its.column("episode").tolist() for name, its in by_table.items()}
    rows = counted_rows(EpisodeTable(found))
    assert from_table == {name: its.episode.tolist() for name, its in rows.groupby("policy")}
    return from_table, infeasible


def test_episodes_after_an_unfinished_one_do_not_count():
    assert counted_in(results()) == ({"a": [*range(12)], "b": [*range(LOST)]}, 0)
    known = facts_of(
        policies=dict.fromkeys("ab", UNTRAINED_POLICY), planned=12, return_bounds=(-30.0, 1.0), time_limit=30
    )
    policies, (pair,) = summarise(EpisodeTable(results()), known)
    assert [(one.episodes, one.success.value) for one in policies] == [(12, 0.0), (LOST, 0.0)]
    assert (pair.episodes, pair.only_b) == (LOST, 0)


def test_an_unfinished_first_episode_leaves_nothing():
    later = [one for one in results() if one.policy == "a" or one.episode > 0]
    assert counted_in([one for one in later if one.policy == "a"])[0] == {"a": [*range(12)]}
    by_table, _ = counted_results(EpisodeTable(later))
    assert len(by_table["b"]) == 0
    assert list(by_learner(by_table, ["a", "b"], {})) == ["a"]


@pytest.mark.parametrize("episode", [3, 9])
def test_an_infeasible_episode_counts_for_nobody_and_does_not_break_the_rest(episode):
    """Also where only one of the policies has finished it."""
    found, infeasible = counted_in(results(lambda one: one != episode))
    assert infeasible == 1
    assert found["a"] == [k for k in range(12) if k != episode]
    assert found["b"] == [k for k in range(LOST) if k != episode]


def test_a_group_counts_what_all_its_trainings_have_finished():
    by_table, _ = counted_results(EpisodeTable(results()))
    group = by_learner(by_table, ["a", "b"], {"g[*]": ["a", "b"]})["g[*]"]
    assert [its.column("episode").tolist() for its in group.values()] == [[*range(LOST)]] * 2


def test_an_episode_with_an_error_has_the_least_return():
    whole = [replace(one, feasible=True) for one in played(12)]
    failed = [replace(one, outcome=ERROR, total_reward=99.0) if one.episode in (2, 5) else one for one in whole]
    rows = counted_rows(EpisodeTable(failed))
    assert rows.episode[rows["return"] == -math.inf].tolist() == [2, 5]
    p, change = change_between(counted_rows(EpisodeTable(whole)), rows, "return")
    assert change == pytest.approx(-2 / 12)
    assert p > 0.05
