import numpy as np
import pytest

from armctl.evaluation.statistics import mean
from armctl.evaluation.trainings import interquartile_mean, mean_over_trainings


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
