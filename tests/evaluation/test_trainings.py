import numpy as np
import pytest
from scipy import stats

from armctl.evaluation.statistics import mean
from armctl.evaluation.trainings import difference_over_trainings, interquartile_mean, mean_over_trainings


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
    assert found.between**2 == pytest.approx((32.49 - 1.02) / 6, abs=0.01)
    assert found.episodes**2 == pytest.approx((11.24 - 1.02) / 4, abs=0.01)
    assert found.mean.value == pytest.approx(ratings.mean())
    assert found.trainings == 4


def test_one_training_says_nothing_of_others():
    found = mean_over_trainings(np.arange(1000.0)[None])
    assert (found.mean.value, found.mean.low, found.mean.high, found.between) == (499.5, None, None, None)


@pytest.mark.parametrize("scores", [[[]], [1.0, 2.0], []])
def test_scores_are_a_table(scores):
    with pytest.raises(ValueError, match="trainings, episodes"):
        mean_over_trainings(scores)


def test_trainings_that_are_alike_are_as_uncertain_as_their_episodes():
    episodes = np.random.default_rng(0).normal(0, 1, 200)
    found, flat = mean_over_trainings(np.tile(episodes, (5, 1))).mean, mean(episodes)
    assert found.high - found.low == pytest.approx((flat.high - flat.low) * 2.776 / 1.972, rel=1e-3)


def test_trainings_that_all_succeed_conclude_little():
    # Nobody has seen a training that fails, which 0.025 ** (1 / k) of all may do.
    for k in (3, 5, 10):
        found = mean_over_trainings(np.ones((k, 10_000)), (0.0, 1.0)).mean
        assert found.low == pytest.approx(0.025 ** (1 / k), abs=0.02)
        assert found.high == 1
    expert = difference_over_trainings(np.ones((1, 1000)), np.ones((3, 1000)), (0.0, 1.0))
    assert (expert.estimate.value, expert.p) == (0, 1)
    assert expert.estimate.high > 0.6


def test_moderate_trainings_are_told_apart_from_an_expert():
    won = np.arange(1000) < np.array([[940], [950], [955]])
    found = difference_over_trainings(np.ones((1, 1000)), won.astype(float), (0.0, 1.0))
    assert found.p < 0.05
    assert 0.01 < found.estimate.low < found.estimate.value < found.estimate.high < 0.1
    turned = difference_over_trainings(won.astype(float), np.ones((1, 1000)), (0.0, 1.0))
    assert (turned.estimate.low, turned.estimate.high) == pytest.approx(
        (-found.estimate.high, -found.estimate.low), abs=0.01
    )


def test_two_groups_have_welchs_degrees_of_freedom():
    # With episodes that are all alike, it is Welch's test of the trainings' means.
    a, b = np.array([0.50, 0.52, 0.55, 0.47]), np.array([0.40, 0.47, 0.38])
    found = difference_over_trainings(np.tile(a[:, None], 5), np.tile(b[:, None], 5), (0.0, 1.0))
    welch = stats.ttest_ind(a, b, equal_var=False)
    assert found.p >= welch.pvalue - 1e-9
    assert found.estimate.low <= welch.confidence_interval().low + 1e-9
    assert found.estimate.high >= welch.confidence_interval().high - 1e-9


def beta_trainings(rng, k, n, rate, spread):
    both = rate * (1 - rate) / spread**2 - 1
    rates = rng.beta(rate * both, (1 - rate) * both, (k, 1))
    ease = (rng.normal(size=(1, n)) + rng.normal(size=(k, n))) / 2**0.5
    return (ease < stats.norm.ppf(rates)).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("k", "rate", "spread"), [(3, 0.95, 0.2), (5, 0.99, 0.006), (10, 0.95, 0.06), (10, 0.99, 0.02)]
)
def test_intervals_hold_near_full_success_however_trainings_vary(k, rate, spread):
    # Student's alone held in 20, 93, 90 and 94 % of cases.
    rng = np.random.default_rng(0)
    found = [mean_over_trainings(beta_trainings(rng, k, 200, rate, spread), (0.0, 1.0)).mean for _ in range(300)]
    assert np.mean([one.low <= rate <= one.high for one in found]) >= 0.92  # 93.8 %, and a standard error


@pytest.mark.parametrize("trainings", [3, 5, 10])
def test_many_episodes_do_not_make_up_for_few_trainings(trainings):
    rng = np.random.default_rng(0)
    held, pooled = 0, 0
    for _ in range(400):
        scores = rng.normal(0, 1, (trainings, 1)) + rng.normal(0, 1, (1, 100)) + rng.normal(0, 1, (trainings, 100))
        crossed, flat = mean_over_trainings(scores).mean, mean(scores.ravel())
        held += crossed.low <= 0 <= crossed.high
        pooled += flat.low <= 0 <= flat.high
    assert held / 400 >= 0.93
    assert pooled / 400 < 0.5
