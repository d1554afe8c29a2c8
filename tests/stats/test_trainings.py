"""Few trainings of one recipe, of whose distribution nothing is known."""

import numpy as np
import pytest
from scipy import stats

from armctl.stats import intervals as statistics
from armctl.stats.difference import EQUIVALENCE, Scores, difference_between
from armctl.stats.trainings import (
    difference_over_trainings,
    interquartile_mean,
    mean_over_trainings,
    superiority_over_trainings,
)

from .test_intervals import students

SHARES = (0.0, 1.0)


def test_interquartile_mean_is_the_mean_of_the_middle_half():
    # rliable: scipy.stats.trim_mean(scores, 0.25) over all runs; of 10, floor(2.5) are cut at either end.
    assert interquartile_mean([np.array([-900.0, 1, 2, 3, 4, 5, 6, 900])]).value == (2 + 3 + 4 + 5) / 4
    assert interquartile_mean([np.arange(5.0), np.arange(5.0) + 5]).value == (2 + 3 + 4 + 5 + 6 + 7) / 6
    assert interquartile_mean([np.arange(4.0)]).low is None
    assert interquartile_mean([np.array([])]) is None


def test_interquartile_mean_is_resampled_within_each_training():
    # Within a stratum all are alike, so that no resampling of episodes moves the mean: nothing is known.
    apart = interquartile_mean([np.zeros(10), np.ones(10)])
    assert (apart.value, apart.low, apart.high) == (0.5, None, None)
    together = interquartile_mean([np.repeat([0.0, 1.0], 10)])
    assert together.low < 0.5 < together.high


def test_interquartile_mean_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    estimates = [interquartile_mean([rng.normal(3, 2, 40)]) for _ in range(100)]
    assert 0.86 <= np.mean([one.low <= 3 <= one.high for one in estimates]) <= 1


def test_variance_components_against_shrout_and_fleiss():
    # Shrout and Fleiss, "Intraclass correlations", Psychological Bulletin 86 (1979), table 2: six targets, four judges;
    # table 3: mean squares 11.24 between targets, 32.49 between judges, 1.02 of the rest.
    ratings = np.array([[9, 6, 8, 7, 10, 6], [2, 1, 4, 1, 5, 2], [5, 3, 6, 2, 6, 4], [8, 2, 8, 6, 9, 7]])
    found = mean_over_trainings(ratings)
    assert found.between_seed_std**2 == pytest.approx((32.49 - 1.02) / 6, abs=0.01)
    assert found.episodes**2 == pytest.approx((11.24 - 1.02) / 4, abs=0.01)
    assert found.mean.value == pytest.approx(ratings.mean())
    assert found.trainings == 4


def test_one_training_says_nothing_of_others():
    found = mean_over_trainings(np.arange(1000.0)[None])
    assert (found.mean.value, found.mean.low, found.mean.high, found.between_seed_std) == (499.5, None, None, None)
    assert (found.if_normal, found.p) == (found.mean, None)


@pytest.mark.parametrize("scores", [[[]], [1.0, 2.0], []])
def test_scores_are_a_table(scores):
    with pytest.raises(ValueError, match="trainings, episodes"):
        mean_over_trainings(scores)


# What is known of any population of trainings

POPULATIONS = {
    "all perfect": (lambda rng, k: np.ones(k), 1.0),
    "all alike": (lambda rng, k: np.full(k, 0.95), 0.95),
    "normal": (lambda rng, k: rng.normal(0.8, 0.05, k), 0.8),
    "skewed": (lambda rng, k: rng.beta(1.9, 0.1, k), 0.95),
    "one in five fails": (lambda rng, k: np.where(rng.random(k) < 0.2, 0.0, 0.99), 0.792),
    "one in ten fails": (lambda rng, k: np.where(rng.random(k) < 0.1, 0.0, 0.99), 0.891),
    "one in two is bad": (lambda rng, k: np.where(rng.random(k) < 0.5, 0.1, 0.9), 0.5),
}
"""A sampler of trainings' success rates, and their mean."""


def successes(rng, rates, n):
    """Successes (k, n); one half of the episodes is hard or easy for all alike."""
    difficulty = np.hstack(
        (np.repeat(rng.random((1, n // 2)), len(rates), axis=0), rng.random((len(rates), n - n // 2)))
    )
    return (difficulty < rates[:, None]).astype(float)


def misses(estimates, truth):
    """How often the interval is too high, and too low."""
    return np.mean([(one.low > truth, one.high < truth) for one in estimates], axis=0)


def allowed(share, runs):
    """A share, and three standard errors of its simulation."""
    return share + 3 * (share * (1 - share) / runs) ** 0.5


@pytest.fixture
def few_draws(monkeypatch):
    monkeypatch.setattr(statistics, "DRAWS", 400)


@pytest.mark.one_case
@pytest.mark.parametrize("trainings", [2, 3, 5, 10])
@pytest.mark.parametrize("population", POPULATIONS)
def test_intervals_and_p_values_hold_whatever_the_population_of_trainings(trainings, population, few_draws, sized):
    sample, rate = POPULATIONS[population]
    runs = sized(25, 40)
    for episodes in sized((200, 1000), (200, 2500)):
        rng = np.random.default_rng(episodes)
        means, differences, against_group = [], [], []
        for _ in range(1 if rate == 1 else runs):
            group = successes(rng, sample(rng, trainings), episodes)
            network, other = (successes(rng, rates, episodes) for rates in (np.array([rate]), sample(rng, trainings)))
            means.append(mean_over_trainings(group, SHARES).mean)
            differences.append(difference_over_trainings(group, network, SHARES))
            against_group.append(difference_over_trainings(other, group, SHARES))
        for found, truth in ((means, rate), ([one.estimate for one in differences + against_group], 0)):
            assert max(misses(found, truth)) <= allowed(0.025, runs)
        for pairs in (differences, against_group):
            assert np.mean([one.p < 0.05 for one in pairs]) <= allowed(0.05, runs)
            assert max(misses([one.ci90 for one in pairs], 0)) <= allowed(0.05, runs)


@pytest.mark.parametrize("failures", [0, 1])
@pytest.mark.parametrize("trainings", [3, 10])
def test_a_failure_more_makes_no_recipe_safer(trainings, failures):
    """What trainings have not shown does not depend on whether one episode of each was lost."""
    scores = np.ones((trainings, 1000))
    scores[np.arange(trainings), np.arange(trainings)] = 1 - failures
    found = mean_over_trainings(scores, SHARES).mean
    assert found.low == pytest.approx(0.025 ** (1 / trainings), abs=0.02)
    assert found.high > 0.999


def test_students_interval_holds_where_trainings_are_normal_and_not_else(sized):
    runs, rng = sized(200, 500), np.random.default_rng(0)
    normal = [rng.normal(0.8, 0.05, 5) for _ in range(runs)]
    bimodal = [np.where(rng.random(5) < 0.1, 0.0, 0.98) for _ in range(runs)]
    by_student = [
        [mean_over_trainings(successes(rng, rates, 200)).if_normal for rates in drawn] for drawn in (normal, bimodal)
    ]
    assert max(misses(by_student[0], 0.8)) <= allowed(0.025, runs)
    assert misses(by_student[1], 0.9 * 0.98)[0] > 0.4  # none of five trainings has failed in 59 % of cases


def test_trainings_that_are_alike_are_by_student_as_uncertain_as_their_episodes():
    episodes = np.random.default_rng(0).normal(0, 1, 200)
    found, flat = mean_over_trainings(np.tile(episodes, (5, 1))).if_normal, students(episodes)
    assert found.high - found.low == pytest.approx((flat.high - flat.low) * 2.776 / 1.972, rel=1e-3)


def test_where_nothing_varies_student_says_nothing():
    assert mean_over_trainings(np.ones((3, 10)), SHARES).if_normal.low is None
    assert difference_over_trainings(np.ones((3, 10)), np.ones((1, 10)), SHARES).if_normal.low is None


def test_without_bounds_there_is_neither_an_interval_nor_a_p_value():
    a, b = np.random.default_rng(0).normal(0, 1, (2, 3, 50))
    found = difference_over_trainings(a, b, None)
    assert (found.estimate.low, found.ci90.high, found.p) == (None, None, None)
    assert found.if_normal.low < found.estimate.value < found.if_normal.high
    alone = mean_over_trainings(a)
    assert (alone.mean.low, alone.mean.high, alone.p) == (None, None, None)


def test_few_trainings_that_all_succeed_conclude_little():
    # No training fails, which 0.025 ** (1 / k) of all may do.
    for k in (2, 3, 5, 10):
        found = mean_over_trainings(np.ones((k, 10_000)), SHARES).mean
        assert found.low == pytest.approx(0.025 ** (1 / k), abs=0.02)
        assert found.high == 1
    expert = difference_over_trainings(np.ones((1, 1000)), np.ones((3, 1000)), SHARES)
    assert (expert.estimate.value, expert.p) == (0, 1)
    assert expert.estimate.high == pytest.approx(1 - 0.025 ** (1 / 3), abs=0.02)
    assert expert.estimate.low > -0.02


@pytest.mark.parametrize("expert", [0.2, 0.4, 0.6])
def test_three_perfect_trainings_beat_a_network_of_less_than_29_percent(expert):
    won = np.arange(10_000) < 10_000 * expert
    found = difference_over_trainings(np.ones((3, 10_000)), won[None].astype(float), SHARES)
    assert found.p == pytest.approx(2 * expert**3, abs=0.03)
    assert (found.p < 0.05, found.estimate.low > 0) == (expert < 0.29,) * 2


def test_moderate_trainings_are_shown_to_be_behind_an_expert_but_not_by_how_much():
    won = np.arange(1000) < np.array([[940], [950], [955]])
    found = difference_over_trainings(np.ones((1, 1000)), won.astype(float), SHARES)
    assert found.p < 0.05
    assert 0.01 < found.estimate.low < found.estimate.value
    assert found.estimate.high == pytest.approx(0.05 + 0.95 * (1 - 0.025 ** (1 / 3)), abs=0.02)
    turned = difference_over_trainings(won.astype(float), np.ones((1, 1000)), SHARES)
    assert (turned.estimate.low, turned.estimate.high) == pytest.approx(
        (-found.estimate.high, -found.estimate.low), abs=0.01
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_p_value_is_that_of_the_interval(seed):
    """The interval of confidence 1 - p ends at 0, and the 95 % interval leaves out 0 if and only if p < 0.05."""
    rng = np.random.default_rng(seed)
    a, b = (successes(rng, rng.uniform(low, 1, k), 50) for low, k in ((0.8, 6), (0.0, 3)))
    found = difference_over_trainings(a, b, SHARES)
    assert 0 < found.p < 1
    ends = [abs(getattr(difference_over_trainings(a, b, SHARES, 1 - found.p).ci90, end)) for end in ("low", "high")]
    assert min(ends) < 0.005
    for p in (0.5 * found.p, 2 * found.p):
        other = difference_over_trainings(a, b, SHARES, 1 - p, 1 - p)
        assert other.simultaneous == other.ci90
        assert (other.simultaneous.low <= 0 <= other.simultaneous.high) == (p < found.p)
    assert (found.estimate.low > 0 or found.estimate.high < 0) == (found.p < 0.05)
    mean_found = mean_over_trainings(a - b[0], (-1.0, 1.0))
    assert (mean_found.mean.low > 0 or mean_found.mean.high < 0) == (mean_found.p < 0.05)


def test_two_groups_have_welchs_degrees_of_freedom():
    # With episodes that are all alike, it is Welch's test of the trainings' means.
    a, b = np.array([0.50, 0.52, 0.55, 0.47]), np.array([0.40, 0.47, 0.38])
    found = difference_over_trainings(np.tile(a[:, None], 5), np.tile(b[:, None], 5), SHARES)
    interval = stats.ttest_ind(a, b, equal_var=False).confidence_interval()
    assert (found.if_normal.low, found.if_normal.high) == pytest.approx((interval.low, interval.high))


@pytest.mark.parametrize("num_comparisons", [1, 3, 10])
def test_equivalence_of_groups_is_corrected_for_the_number_of_claims(num_comparisons):
    won, other = np.ones((4, 300)), np.ones((1, 300))
    single = difference_between("a", "b", Scores((won, other), (9 * won, other), None, (0.0, 9.0)))
    pair = difference_between("a", "b", Scores((won, other), (9 * won, other), None, (0.0, 9.0)), num_comparisons)
    # Two tests at 5 % / num_comparisons: one more training of a fails with a probability of 1 - level^(1/4).
    level = EQUIVALENCE / num_comparisons
    assert -pair.crossed.ci90.low == pytest.approx(1 - level ** (1 / 4), abs=0.03)
    for same in (pair, pair.reversed(), single):  # in a comparison of one pair, but of so many tasks
        assert not same.equivalent(0.96 - level ** (1 / 4), num_comparisons)
        assert same.equivalent(1.04 - level ** (1 / 4), num_comparisons)
    assert pair.crossed.estimate == difference_over_trainings(won, other, SHARES).estimate
    assert (pair.success_p, pair.crossed.p) == (1, 1)
    earned = difference_over_trainings(9 * won, other, (0.0, 9.0))
    assert (pair.return_difference, pair.return_p) == (earned.estimate, earned.p)
    assert earned.p < 1


@pytest.mark.parametrize("trainings", [(3, 1), (1, 5), (3, 3)])
def test_superiority_over_trainings_holds_for_bimodal_trainings(trainings, few_draws, sized):
    """One training in ten earns less than the others ever do: its superiority is 0.1 to 0.5, not what most show."""
    runs, rng = sized(60, 200), np.random.default_rng(0)
    found = []
    for _ in range(runs):
        a, b = (np.where(rng.random((k, 1)) < 0.1 * (k > 1), -9.0, 0.0) + rng.random((k, 100)) for k in trainings)
        found.append(superiority_over_trainings(a, b)[0])
    fails = [0.1 * (k > 1) for k in trainings]
    truth = (1 - fails[0]) * fails[1] + (fails[0] * fails[1] + (1 - fails[0]) * (1 - fails[1])) / 2
    assert max(misses([one.probability for one in found], truth)) <= allowed(0.025, runs)
    assert np.mean([one.p < 0.05 for one in found]) <= allowed(0.05, runs) + (truth != 0.5)


def test_superiority_counts_ties_half_and_its_p_value_is_that_of_one_half():
    a, b = np.array([[1.0, 1, 2, 0]] * 12), np.array([[0.0, 1, 1, 1]])
    assert superiority_over_trainings(a, b)[0].probability.value == pytest.approx(0.625)
    a = np.ones((12, 500))
    for other, sign in ((0.0, 1), (2.0, -1), (1.0, 0)):
        found, wide = superiority_over_trainings(a, np.full((1, 500), other), 0.998)
        assert found.probability.value == wide.value == 0.5 + sign / 2
        if sign:
            assert found.probability.high - found.probability.low == pytest.approx(1 - 0.025 ** (1 / 12), abs=0.03)
            assert wide.high - wide.low == pytest.approx(1 - 0.001 ** (1 / 12), abs=0.05)
        assert found.p == pytest.approx(2 * 0.5**12, abs=0.002) if sign else found.p == 1


def test_many_episodes_do_not_make_up_for_few_trainings():
    rng = np.random.default_rng(0)
    crossed, pooled = [], []
    for _ in range(200):
        scores = rng.normal(0, 1, (3, 1)) + rng.normal(0, 1, (1, 100)) + rng.normal(0, 1, (3, 100))
        crossed.append(mean_over_trainings(scores).if_normal)
        pooled.append(students(scores.ravel()))
    assert max(misses(crossed, 0)) <= allowed(0.025, 200)
    assert sum(misses(pooled, 0)) > 0.5


@pytest.mark.parametrize("sign", [1, -1])
def test_superiority_of_two_single_trainings_is_limited_by_their_episodes(sign):
    ahead, behind = np.ones((1, 10)), np.zeros((1, 10))
    a, b = (ahead, behind)[::sign]
    found = superiority_over_trainings(a, b)[0].probability
    assert found.value == (sign + 1) / 2
    assert found.high - found.low == pytest.approx(1 - 0.025 ** (1 / 10), abs=0.02)


def test_students_interval_is_paired_by_episodes_and_within_what_is_possible():
    rng = np.random.default_rng(0)
    episode = rng.normal(0, 5, (1, 200))
    a, b = (episode + rng.normal(0, 0.1, (3, 200)) for _ in range(2))
    paired = difference_over_trainings(a, b, None).if_normal
    assert paired.high - paired.low < 0.2 < 4 * 5 / 200**0.5
    nearly = np.ones((3, 100))
    nearly[0, 0] = 0
    within, beyond = (mean_over_trainings(nearly, bounds).if_normal for bounds in (SHARES, None))
    assert within.low == beyond.low
    assert within.high == 1 < beyond.high
    difference = difference_over_trainings(nearly, np.zeros((3, 100)), SHARES).if_normal
    assert difference.high == 1
