import math
import time
from typing import Any

import numpy as np
import pytest
from scipy.special import betaln, logsumexp

from armctl.stats import sequential
from armctl.stats.difference import Scores, difference_between
from armctl.stats.sequential import NODES, PRIOR, ConfidenceSequence, block_ends, sequential_difference

SIGNS = (-1.0, 1.0)


def signs(only_a, only_b, n, seed=0):
    return np.random.default_rng(seed).choice([1.0, -1.0, 0.0], p=[only_a, only_b, 1 - only_a - only_b], size=n)


def capitals(values, bounds, mean):
    """The capital after each value of who bets that the mean is above `mean`, written out."""
    bets, weights = sequential._bets()
    share = (mean - bounds[0]) / (bounds[1] - bounds[0])
    capital, history = np.exp(weights), []
    for value in values:
        capital = capital * (1 + bets * ((value - bounds[0]) / (bounds[1] - bounds[0]) / share - 1))
        history.append(capital.sum())
    return np.array(history)


@pytest.mark.parametrize(("values", "bounds"), [(signs(0.2, 0.05, 60), SIGNS), (np.arange(25.0) % 7 - 1, (-3.0, 8.0))])
def test_limits_are_the_means_that_were_never_refuted(values, bounds):
    estimate, means = ConfidenceSequence(values, bounds).estimate(0.9), np.linspace(bounds[0], bounds[1], 801)[1:-1]
    refuted = [capitals(values, bounds, mean).max() >= 20 for mean in means]
    mirrored = [capitals(-values, (-bounds[1], -bounds[0]), -mean).max() >= 20 for mean in means]
    inside = means[~np.array(refuted) & ~np.array(mirrored)]
    step = means[1] - means[0]
    assert inside[0] - step <= estimate.low <= inside[0] + 1e-6
    assert inside[-1] - 1e-6 <= estimate.high <= inside[-1] + step
    assert estimate.value == values.mean()


def test_of_discordant_episodes_it_is_robbins_beta_binomial_mixture():
    values = signs(0.6, 0.4, 2 * NODES - 1)
    both = (capitals(values, SIGNS, 0.0) + capitals(-values, SIGNS, 0.0)) / 2
    won, lost = np.cumsum(values > 0), np.cumsum(values < 0)
    mixture = np.exp((won + lost) * math.log(2) + betaln(won + PRIOR, lost + PRIOR) - betaln(PRIOR, PRIOR))
    np.testing.assert_allclose(both, mixture, rtol=1e-9)


def test_p_is_twice_the_inverse_of_the_largest_capital_on_the_present_side():
    values = signs(0.3, 0.1, 80)
    assert ConfidenceSequence(values, SIGNS).p() == pytest.approx(2 / capitals(values, SIGNS, 0.0).max())
    assert ConfidenceSequence(np.zeros(5), SIGNS).p() == 1
    fallen = np.r_[np.ones(20), -np.ones(30)]  # ahead at first, behind now: what was won then shows nothing now
    assert ConfidenceSequence(fallen, SIGNS).p() == pytest.approx(min(1, 2 / capitals(-fallen, SIGNS, 0.0).max()))


def test_ties_do_not_change_p_but_narrow_the_interval():
    few = np.array([1.0, 1.0, -1.0, 1.0])
    many = np.insert(few, 2, np.zeros(200))
    assert ConfidenceSequence(few, SIGNS).p() == pytest.approx(ConfidenceSequence(many, SIGNS).p())
    low, high = ConfidenceSequence(many, SIGNS).estimate().bounds
    assert high - low < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_it_is_symmetric_and_p_agrees_with_the_interval(seed):
    values = signs(0.12 + 0.04 * seed, 0.1, 300, seed)
    a, b = ConfidenceSequence(values, SIGNS), ConfidenceSequence(-values, SIGNS)
    assert a.p() == pytest.approx(b.p())
    np.testing.assert_allclose(a.estimate().bounds, (-b.estimate()).bounds, atol=1e-7)
    low, high = a.estimate().bounds
    assert (a.p() < 0.05) == (low > 0 or high < 0)


def test_intervals_only_shrink():
    values = signs(0.15, 0.05, 200)
    sequences = [ConfidenceSequence(values[:n], SIGNS).estimate() for n in range(1, 201)]
    lows, highs = (np.array([getattr(estimate, side) for estimate in sequences]) for side in ("low", "high"))
    means = np.array([estimate.value for estimate in sequences])
    assert ((np.diff(lows) >= -1e-7) | (lows[1:] == means[1:])).all()
    assert ((np.diff(highs) <= 1e-7) | (highs[1:] == means[1:])).all()


def logarithm_of_largest_capital(shares, mean):
    """The same without products, which may have no number."""
    bets, weights = sequential._bets()
    capitals = weights + np.cumsum(np.log1p(bets * (shares[:, None] / mean - 1)), axis=0)
    return logsumexp(capitals, axis=1).max()


@pytest.mark.parametrize("mean", [1e-12, 1e-3, 0.3, 0.999, 1 - 1e-12])
@pytest.mark.parametrize("n", [1, 23, 24, 25, 5_000])
def test_capitals_beyond_what_a_float_holds(mean, n):
    """Also of those that are lost at first, and won back."""
    rng = np.random.default_rng(n)
    for shares in (np.zeros(n), np.ones(n), rng.random(n), np.sort(rng.integers(0, 2, n) * 1.0)):
        capital = sequential._Gambler(shares).largest_capital(mean)
        assert capital == pytest.approx(logarithm_of_largest_capital(shares, mean), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("discordant", [0.02, 0.1, 0.5])
def test_whoever_always_looks_errs_in_at_most_5_percent(discordant):
    runs, wrong = 400, 0
    for seed in range(runs):
        above, below = ConfidenceSequence(signs(discordant / 2, discordant / 2, 400, seed), SIGNS)._gamblers
        wrong += max(above.largest_capital(0.5), below.largest_capital(0.5)) > math.log(40)
    assert wrong <= 0.05 * runs + 2 * math.sqrt(runs * 0.05 * 0.95)


def test_returns_with_rare_disasters_are_covered_at_any_time():
    bounds, missed, rng = (-199.0, 199.0), 0, np.random.default_rng(0)
    for _ in range(200):
        gains = np.where(rng.random(300) < 0.01, -188.0, 2.0)
        low, high = ConfidenceSequence(gains, bounds).estimate().bounds
        missed += not low <= 0.1 <= high
    assert missed <= 0.05 * 200


def test_ten_thousand_episodes_take_less_than_half_a_second():
    values = signs(0.05, 0.04, 10_000)
    start = time.process_time()
    ConfidenceSequence(values, SIGNS).estimate()
    assert time.process_time() - start < 0.5


def test_values_at_and_beyond_their_bounds():
    assert ConfidenceSequence(np.ones(50), (0.0, 1.0)).estimate().high == 1
    rounded = ConfidenceSequence(np.array([1 + 1e-12] * 5), (0.0, 1.0)).estimate()
    assert 0 < rounded.low < rounded.value <= rounded.high
    assert ConfidenceSequence(np.zeros(50), (0.0, 1.0)).estimate().low == 0


def pair_of(num_comparisons=1, bounds=(-100.0, 99.0), seed=0):
    rng = np.random.default_rng(seed)
    won: Any = (rng.random(200) < 0.99, rng.random(200) < 0.8)
    steps: Any = tuple(np.where(of, rng.integers(10, 20, 200), 100).astype(float) for of in won)
    returns: Any = tuple(np.where(of, 99 - step, -100.0) for of, step in zip(won, steps, strict=True))
    fixed = difference_between("a", "b", Scores(won, returns, steps, bounds, 100), num_comparisons)
    return sequential_difference("a", "b", Scores(won, returns, steps, bounds, 100), num_comparisons), fixed


def test_a_difference_has_the_same_values_as_that_of_fixed_tests_and_wider_intervals():
    pair, fixed = pair_of()
    for name in ("both_won", "only_a", "only_b", "neither", "episodes", "paired"):
        assert getattr(pair, name) == getattr(fixed, name)
    for name in ("success_difference", "return_difference", "steps_difference"):
        here, there = getattr(pair, name), getattr(fixed, name)
        assert here.value == pytest.approx(there.value)
        assert here.low < there.value < here.high
    assert pair.superiority.probability.value == pytest.approx(fixed.superiority.probability.value)
    assert fixed.p < pair.p < 0.05
    assert pair.any_number
    assert not fixed.any_number
    reversed_pair = pair.reversed()
    assert reversed_pair.success_difference == -pair.success_difference
    assert reversed_pair.equivalent(0.3) == pair.equivalent(0.3) is True
    assert not pair.equivalent(0.02)


def test_intervals_of_several_pairs_are_wider_and_unknown_bounds_stay_unknown():
    single, several = pair_of()[0], pair_of(3)[0]
    assert several.success_among(3).low < single.success_among(1).low == several.success_among(1).low
    reach = max(map(abs, single.anytime.at(0.9).bounds))
    assert max(map(abs, single.anytime.at(0.99).bounds)) > reach
    for pair in (single, several, single.reversed()):
        assert [pair.equivalent(reach + 1e-6, claims) for claims in (1, 2, 10)] == [True, False, False]
    assert (-single.anytime).at(0.9) == -(single.anytime.at(0.9))
    unknown = pair_of(bounds=None)[0]
    assert (unknown.return_p, unknown.return_difference.low) == (None, None)
    assert unknown.superiority.p == single.superiority.p


def test_a_policy_that_failed_at_an_unknown_cost_has_no_mean_return():
    returns = np.array([-math.inf, 1.0, 2.0]), np.array([-math.inf, 1.0, 1.0])
    pair = sequential_difference("a", "b", Scores(None, returns, None))
    assert math.isnan(pair.return_difference.value)
    assert (pair.success_p, pair.anytime, pair.steps_p) == (None, None, None)
    assert pair.superiority.probability.value == pytest.approx(2 / 3)


def test_blocks_grow_and_the_last_one_ends_at_the_most():
    assert block_ends(500)[:3] == [10, 20, 30]
    assert [block_ends(n)[-1] for n in (1, 9, 10, 11, 500)] == [1, 9, 10, 11, 500]
    assert block_ends(5) == [5]
    assert np.all(np.diff(block_ends(10_000)) > 0)
