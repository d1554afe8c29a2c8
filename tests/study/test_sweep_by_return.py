"""Sweeps whose success is unknown: a drop has the direction of the statistic that is tested."""

import math

import numpy as np
import pandas as pd
import pytest

from armctl.stats.difference import Scores, difference_between
from armctl.stats.robustness import FALSE_DISCOVERY_RATE, Onset, change_between, degradations, robustness_rankings
from armctl.stats.trainings import FEWEST_TRAININGS

EPISODES = 100


@pytest.fixture
def runs(sized):
    """Number of simulated sweeps."""
    return range(sized(30, 60))


def returns(rng, better):
    """Returns before and after a change that raises a share `better` of them a little and ruins one in twenty."""
    before = rng.normal(0, 10, EPISODES)
    after = before + np.where(rng.random(EPISODES) < better, 1.0, -1.0)
    return before, np.where(rng.random(EPISODES) < 0.05, after - 2000, after)


def sweep_of(before, after, p, change):
    return pd.DataFrame(
        {
            "disturbance": "noise", "level": [0.0, 1.0], "policy": "a", "success": math.nan, "sees": "state",
            "return": [before.mean(), after.mean()], "p": [1.0, p], "change": [0.0, change],
            "spared": False,
        }
    )  # fmt: skip


def drops(rng, better, up=1.0):
    """Whether a drop is told."""
    before, after = (up * values for values in returns(rng, better))
    before_table, after_table = (
        pd.DataFrame({"policy": "a", "episode": np.arange(EPISODES), "return": values}) for values in (before, after)
    )
    (found,) = degradations(sweep_of(before, after, *change_between(before_table, after_table, "return")))
    return found.drops is not None


def test_where_more_episodes_get_better_than_worse_no_drop_is_told_whatever_the_mean(runs):
    """Eight episodes in ten rise, and the mean falls by 100. The sign test is sure of a rise."""
    rng = np.random.default_rng(0)
    assert not any(drops(rng, 0.85) for _ in runs)


def test_where_more_episodes_get_worse_a_drop_is_told_whatever_the_mean(runs):
    """The same upside down: eight episodes in ten fall, and the mean rises by 100."""
    rng = np.random.default_rng(0)
    assert np.mean([drops(rng, 0.85, up=-1.0) for _ in runs]) >= 0.95


@pytest.mark.one_case
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_without_an_effect_drops_are_as_rare_as_they_should_be(up, runs):
    rng = np.random.default_rng(1)
    fair = 0.5 / 0.95  # one in twenty gets worse in any case
    share = 0.025  # one side of a test at 5 %
    two_standard_errors = 2 * (share * (1 - share) / len(runs)) ** 0.5
    assert np.mean([drops(rng, fair, up) for _ in runs]) <= share + two_standard_errors


def group(values):
    return pd.DataFrame(
        {
            "policy": np.repeat(["g[0]", "g[1]", "g[2]"], EPISODES),
            "episode": np.tile(np.arange(EPISODES), 3),
            "return": values,
        }
    )


def test_a_change_on_other_episodes_has_no_pairs():
    rng = np.random.default_rng(0)
    for num_trainings in (1, 16):
        names = pd.MultiIndex.from_product(
            [[f"g[{i}]" for i in range(num_trainings)], range(60)], names=["policy", "episode"]
        )
        before, after = (
            pd.DataFrame(
                {"success": rng.random(len(names)) < rate, "return": rng.normal(10 * rate, 1, len(names))}, names
            )
            for rate in (0.95, 0.4)
        )
        fewer = after.reset_index().query("episode < 40")
        for score in ("success", "return"):
            p, change = change_between(before.reset_index(), fewer, score, paired=False)
            assert p < 0.05
            assert change < -0.3
            p, change = change_between(before.reset_index(), before.reset_index(), score, paired=False)
            assert (p, change) == pytest.approx((1, 0))
    assert change_between(before.reset_index(), fewer[:0], "success", paired=False) == (1.0, 0.0)


def test_a_group_of_trainings_goes_by_signs_too():
    rng = np.random.default_rng(2)
    before, after = np.concatenate([returns(rng, 0.95) for _ in range(3)], axis=1)
    _, change = change_between(group(before), group(after), "return")
    assert change > 0.5
    assert after.mean() < before.mean() - 50


@pytest.mark.parametrize("score", ["return", "success"])
@pytest.mark.parametrize("trainings", [FEWEST_TRAININGS - 1, FEWEST_TRAININGS])
def test_fewer_than_six_trainings_show_no_change_of_their_recipe(trainings, score):
    """One in two trainings may get better, and none of five shows it in 3 % of cases, which is more than 2.5 %."""
    names = [f"g[{seed}]" for seed in range(trainings)]
    episodes = pd.MultiIndex.from_product([names, range(500)], names=["policy", "episode"])
    before, after = (pd.DataFrame({score: value}, index=episodes).reset_index() for value in (1.0, 0.0))
    p, change = change_between(before, after, score)
    assert change == -1
    assert p == pytest.approx(2 * 0.5**trainings, rel=0.2)
    assert (p < 0.05) == (trainings >= FEWEST_TRAININGS)


def test_nobody_is_behind_who_has_the_higher_return_more_often():
    """b has a return higher by 1 in 19 of 20 episodes, and 2,000 lower in the other: its mean is 99 lower."""
    table = pd.DataFrame(
        {
            "disturbance": "noise", "level": [0.0, 0.0, 1.0, 1.0], "policy": ["a", "b"] * 2, "success": math.nan,
            "return": [0.0, -99.0] * 2, "return_low": math.nan, "return_high": math.nan, "unit": "m", "spared": False,
        }
    )  # fmt: skip
    rng = np.random.default_rng(0)
    both = frozenset("ab")
    for _ in range(20):
        gains = np.where(rng.random(EPISODES) < 0.05, -2000.0, 1.0)
        pair = difference_between("a", "b", Scores(None, (np.zeros(EPISODES), gains), None, (-2000.0, 1.0)))
        (noise,) = robustness_rankings(table, {("none", 0.0, both): pair, ("noise", 1.0, both): pair})
        assert (noise.first, noise.leads, noise.score) == ("b", True, "share of higher returns")
        assert noise.worse == {"a": Onset(0.0)}


def test_the_false_discovery_rate_is_five_percent():
    """One significant p-value of one is told below 5 %, and not between 5 and 5.5 %."""
    assert FALSE_DISCOVERY_RATE == 0.05
    values = np.array([1.0, 0.0])
    for p, told in ((0.0499, True), (0.0501, False), (0.0525, False)):
        (found,) = degradations(sweep_of(values[:1], values[1:], p, -0.5))
        assert (found.drops is not None) == told


@pytest.mark.parametrize(("later", "lasts"), [(-0.1, True), (0.0, False), (0.1, False)])
def test_a_drop_lasts_until_as_many_returns_are_higher_as_lower(later, lasts):
    first = sweep_of(np.zeros(1), np.zeros(1), 1e-6, -0.5)
    points = pd.concat([first, first[1:].assign(level=2.0, p=1.0, change=later)], ignore_index=True)
    (found,) = degradations(points)
    assert found.drops == Onset(1.0, lasts)
