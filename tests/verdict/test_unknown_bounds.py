"""Returns whose bounds nobody knows: nothing is concluded from their means."""

import math

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.episodes.metrics import Metrics
from armctl.episodes.record import EpisodeResult
from armctl.episodes.table import EpisodeTable
from armctl.report.page import _command
from armctl.stats.correction import holm_adjusted
from armctl.stats.difference import Scores, difference_between
from armctl.stats.intervals import Estimate, bounded_mean, median, worst_decile
from armctl.study.results import read_comparison
from armctl.verdict.summary import summarise

from ..made_up_comparison import UNTRAINED_POLICY, facts_of, made_up

EPISODES, RUNS = 60, 30
DISASTERS, COST = 1 / 200, 2000.0
BOUNDS = (-COST - 50.0, 50.0)
BY_MEAN = {"episode_return", "worst_decile"}
"""The figures of a policy that are means of returns."""


def returns(rng, bold):
    """Returns of a careful policy, or of a bold one: 1 more in each episode, and every 200th costs 2,000."""
    earned = rng.normal(0, 3, EPISODES).clip(-40, 40) + bold
    return np.where(rng.random(EPISODES) < DISASTERS * bold, earned - COST, earned)


TRUTH = 1 - DISASTERS * COST
"""Mean of bold's returns: 9 less than that of the careful one's."""


def episodes(name, earned):
    nan = math.nan
    nothing = Metrics(nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, None, 0, None, 0.01, 0.01, 0.01, nan)
    return [
        EpisodeResult(
            name, "mine/Hover-v0", k, 0, "truncated", None, True, float(value), {}, 100, math.nan, math.nan, nothing,
            1, 1, np.array([0.01, 0.01]),
        )
        for k, value in enumerate(earned)
    ]  # fmt: skip


def comparison_of(earned, bounds, time_limit=None):
    played = EpisodeTable(result for name in earned for result in episodes(name, earned[name]))
    policies = dict.fromkeys(earned, UNTRAINED_POLICY)
    known = facts_of(policies=policies, planned=EPISODES, return_bounds=bounds, time_limit=time_limit)
    found, paired = summarise(played, known)
    return made_up("mine/Hover-v0", played, found, paired)


def said_in(comparison):
    parts = comparison.document().parts
    cells = [cell for part in parts if hasattr(part, "rows") for row in part.rows for cell in row]
    return " ".join(
        [*(getattr(part, "text", "") for part in parts), str(comparison.verdict), *(c.small for c in cells)]
    )


@pytest.mark.parametrize("skewed", [True, False])
def test_without_bounds_nothing_is_concluded_from_a_mean(skewed):
    """Of 60 episodes, most samples have no disaster: bold seems to earn 1 more, and truly earns 9 less."""
    rng = np.random.default_rng(0)
    for _ in range(RUNS):
        careful = returns(rng, 0)
        earned = {"careful": careful, "bold": careful + np.where(rng.random(EPISODES) < DISASTERS, -COST, 1.0)}
        if not skewed:
            earned["bold"] = rng.normal(5, 3, EPISODES)
        found = comparison_of(earned, None)
        (pair,) = found.differences
        assert (pair.return_difference.low, pair.return_difference.high, pair.return_p) == (None, None, None)
        for policy in found.policies:
            for name in BY_MEAN:
                estimate = getattr(policy, name)
                assert (estimate.low, estimate.high) == (None, None), name
            assert policy.median_return == median(earned[policy.policy])
            assert policy.median_return.low < policy.median_return.high
        assert " earns " not in said_in(found)
        assert " more return per episode" not in said_in(found)
        assert (
            holm_adjusted(found.differences)[0].higher == pair.superiority.p < 0.05
        )  # the sign test is valid, and stays
        assert "sign test" in str(found.verdict)


def test_with_stated_bounds_intervals_hold_and_the_worse_is_not_told_to_earn_more():
    rng = np.random.default_rng(1)
    misses, wrong, runs = 0, 0, 80
    for _ in range(runs):
        careful, bold = returns(rng, 0), returns(rng, 1)
        mean = bounded_mean(bold, BOUNDS)
        pair = difference_between("bold", "careful", Scores(None, (bold, careful), None, BOUNDS))
        misses += not mean.low <= TRUTH <= mean.high
        misses += not pair.return_difference.low <= TRUTH <= pair.return_difference.high
        wrong += pair.return_difference.low > 0
    assert misses <= 0.05 * 2 * runs
    assert wrong <= 0.025 * runs


@pytest.mark.slow
def test_with_stated_bounds_the_worst_tenth_is_covered():
    rng = np.random.default_rng(2)
    population = np.sort(np.concatenate([returns(rng, 1) for _ in range(20_000)]))
    truth = population[: len(population) // 10].mean()
    found = [worst_decile(returns(rng, 1), BOUNDS) for _ in range(200)]
    assert np.mean([one.low <= truth <= one.high for one in found]) >= 0.95


def test_bounds_decide_whether_a_mean_of_returns_has_an_interval():
    rng = np.random.default_rng(0)
    earned = {"careful": returns(rng, 0), "bold": returns(rng, 1)}
    unknown, known = comparison_of(earned, None), comparison_of(earned, BOUNDS)
    for a, b in zip(unknown.policies, known.policies, strict=True):
        for name in BY_MEAN:
            assert getattr(a, name).value == pytest.approx(getattr(b, name).value)
            assert BOUNDS[0] <= getattr(b, name).low < getattr(b, name).value < getattr(b, name).high <= BOUNDS[1]
        assert b.median_return is None
    assert unknown.document().tables[0].rows[0][1].small == "unknown"
    assert known.document().tables[0].rows[0][1].small != "unknown"
    assert known.differences[0].return_p <= 1


def test_groups_of_trainings_are_no_exception():
    rng = np.random.default_rng(0)
    several, single = np.stack([returns(rng, 1) for _ in range(3)]), returns(rng, 0)[None]
    pair = difference_between("g[*]", "b", Scores(None, (several, single)))
    assert pair.return_difference.value == pytest.approx(several.mean() - single.mean())
    assert (pair.return_difference.low, pair.return_difference.high) == (None, None)
    assert pair.return_p is None
    assert pair.superiority.probability.value > 0.5


@pytest.mark.parametrize("limit", [None, 100])
def test_only_figures_with_true_bounds_have_an_interval(limit):
    """Steps lie between 1 and the time limit. Without one, they may take any number."""
    rng = np.random.default_rng(0)
    (policy,) = comparison_of({"a": returns(rng, 1)}, None, limit).policies
    known = {
        name
        for name, value in {**vars(policy), **policy.metrics}.items()
        if isinstance(value, Estimate) and value.low is not None
    }
    assert known == {"median_return"} | ({"length"} if limit else set())
    if limit:
        assert (policy.length.low, policy.length.high) == (pytest.approx(94, abs=1), 100)  # 100 (1 - 0.025 ** (1 / 60))


def careful(observation):
    return np.zeros(1, dtype=np.float32)


def pendulum(**arguments):
    return armctl.compare(
        {"careful": "random"}, "Pendulum-v1", episodes=3, env_options={"max_episode_steps": 20}, **arguments
    )


PENDULUM = (-20 * 16.3, 0.0)
"""A step costs pi^2 + 0.1 * 8^2 + 0.001 * 2^2 at most."""


def test_stated_bounds_belong_to_the_results(tmp_path):
    whole = pendulum(out=tmp_path, return_bounds=PENDULUM)
    assert PENDULUM[0] <= whole.policies[0].episode_return.low < whole.policies[0].episode_return.high <= PENDULUM[1]
    assert not any("possible returns are unknown" in note for note in whole.notes)
    stored = read_comparison(tmp_path)
    assert stored.env_options["return_bounds"] == PENDULUM
    assert stored.policies == whole.policies
    again = pendulum(out=tmp_path, return_bounds=PENDULUM)
    assert (again.resumed, again.policies[0].episode_return) == (3, whole.policies[0].episode_return)
    with pytest.raises(ResultsError, match="return_bounds"):
        pendulum(out=tmp_path, return_bounds=(-1e6, 0.0))
    assert "--set 'return_bounds=(-326.0, 0.0)'" in _command("compare", stored, "", ["random"])


def test_unknown_bounds_are_said_with_what_to_do():
    assert any("--return-bounds LOW HIGH" in note for note in pendulum().notes)


@pytest.mark.parametrize("worlds", [1, 3])
def test_a_return_outside_the_stated_bounds_is_named(worlds):
    with pytest.raises(ConfigurationError, match=r"episode \d of careful has the return -\d+.*, outside .*\[-1, 0\]"):
        pendulum(return_bounds=(-1, 0), worlds=worlds)


@pytest.mark.parametrize("bounds", [(0, 0), (1, 0), (0, math.inf), (math.nan, 1), (1, 2, 3), "ab", 5, ("a", "b")])
def test_bounds_are_two_numbers_in_order(bounds):
    with pytest.raises(ConfigurationError, match="two finite numbers such as"):
        pendulum(return_bounds=bounds)


def test_a_task_of_ones_own_may_state_them_too():
    found = armctl.compare("random", episodes=2, env_options={"max_episode_steps": 3}, return_bounds=(-1e4, 1e4))
    assert found.policies[0].episode_return.low < -2000
