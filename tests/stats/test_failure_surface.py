"""The mildest failure: of known surfaces, and of simulated policies whose episodes alone are known."""

import numpy as np
import pytest
from scipy.special import expit

from armctl.stats.failure_surface import (
    ROUND_WIDTHS,
    FailureSurface,
    fitted_surface,
    round_box,
    round_sizes,
)
from armctl.stats.intervals import success_rate

BUDGET, JUDGING = 400, 200
POLICIES = {
    "sum": (lambda x: 4 - 12 * x[:, 0] - 6 * x[:, 1], 0.298),
    "one disturbance alone": (lambda x: 30 * (0.4 - x[:, 0]) - 2 * x[:, 1], 0.4),
    "only together": (lambda x: 4 - 20 * x[:, 0] * x[:, 1], 0.632),
    "the worse of two": (lambda x: 12 * np.minimum(0.5 - x[:, 0], 0.7 - x[:, 1]), 0.5),
    "early": (lambda x: 3 - 30 * x[:, 0] - 15 * x[:, 1], 0.089),
}
"""Logarithmic odds of success, and the distance of the mildest point at which they are 0."""


def searched(odds, rng, dimension=3, budget=BUDGET):
    """The mildest point that a search finds."""
    center, points, success = np.full(dimension, 0.5), np.empty((0, dimension)), np.empty(0, dtype=bool)
    for number, count in enumerate(round_sizes(budget)):
        low, high = round_box(center, number)
        new = rng.uniform(low, high, (count, dimension))
        points = np.vstack([points, new])
        success = np.concatenate([success, rng.random(count) < expit(odds(new))])
        point = fitted_surface(points, success).mildest({})
        center = np.ones(dimension) if point is None else point
    return point


def test_the_rounds_play_the_budget():
    for budget in (50, 51, 52, 53, 400):
        sizes = round_sizes(budget)
        assert sum(sizes) == budget
        assert len(sizes) == len(ROUND_WIDTHS)
        assert min(sizes) > 0


def test_the_mildest_point_is_on_the_surface_and_none_is_milder():
    rng = np.random.default_rng(0)
    for _ in range(20):
        curvature = np.triu(rng.uniform(0, 6, (3, 3)))
        surface = FailureSurface(2.0, rng.uniform(0, 6, 3), curvature)
        point = surface.mildest({})
        assert surface.success(point[None])[0] == pytest.approx(0.5)
        others = rng.uniform(0, 1, (20_000, 3))
        failing = others[surface.success(others) <= 0.5]
        assert np.linalg.norm(point) <= np.linalg.norm(failing, axis=1).min() + 0.02


def test_whole_coordinates_have_their_values_only():
    surface = FailureSurface(2.0, np.array([4.0, 1.0]), np.zeros((2, 2)))
    steps = np.arange(5) / 4
    point = surface.mildest({0: steps})
    assert point[0] in steps
    assert surface.success(point[None])[0] <= 0.5
    assert surface.mildest({0: steps, 1: np.array([0.0, 1.0])}) == pytest.approx([0.5, 0.0])


def test_a_policy_that_fails_undisturbed_has_radius_0_and_one_that_never_fails_none():
    assert FailureSurface(-1.0, np.ones(2), np.zeros((2, 2))).mildest({}) == pytest.approx([0, 0])
    assert FailureSurface(9.0, np.ones(2), np.zeros((2, 2))).mildest({}) is None


def test_success_in_all_episodes_has_a_fit():
    points = np.random.default_rng(0).uniform(0, 1, (60, 2))
    surface = fitted_surface(points, np.ones(60, dtype=bool))
    assert surface.success(points).min() > 0.9
    assert surface.mildest({}) is None


@pytest.mark.parametrize("name", POLICIES)
def test_a_search_finds_the_mildest_failure_of_simulated_policies(name, sized):
    odds, radius = POLICIES[name]
    searches = [searched(odds, np.random.default_rng([seed, 1])) for seed in range(sized(2, 30))]
    radii = np.array([np.linalg.norm(point) for point in searches])
    assert np.abs(radii / radius - 1).max() < 0.25
    assert abs(np.median(radii) / radius - 1) < 0.08


@pytest.mark.slow
def test_new_episodes_judge_what_a_search_selected():
    """Their exact 95 % interval covers the true success at the selected point in at least 90 % of searches."""
    rng, covered, count = np.random.default_rng(3), 0, 60
    for seed in range(count):
        odds, _ = list(POLICIES.values())[seed % len(POLICIES)]
        point = searched(odds, np.random.default_rng([seed, 2]), budget=200)
        truth = expit(odds(point[None]))[0]
        covered += covers(rng.random(JUDGING) < truth, truth)
        assert 0.25 < truth < 0.75
    assert covered >= 0.9 * count


def covers(success, truth):
    rate = success_rate(success)
    return rate.low <= truth <= rate.high


def test_the_episodes_that_selected_a_failure_do_not_judge_it(sized):
    """Of 1,500 points, the mildest with at most half of 10 episodes won: the selection is wrong more often than not.

    New episodes are above half where the truth is not, or below, in at most 5 % of all cases.
    """
    rng, odds, count = np.random.default_rng(4), POLICIES["sum"][0], sized(200, 2000)
    wrong_claims, local_covers, wrong_judgements, refused = 0, 0, 0, 0
    for _ in range(count):
        points = rng.uniform(0, 1, (1500, 3))
        truths = expit(odds(points))
        success = rng.random((1500, 10)) < truths[:, None]
        failing = np.flatnonzero(success.mean(axis=1) <= 0.5)
        chosen = failing[np.linalg.norm(points[failing], axis=1).argmin()]
        truth = truths[chosen]
        wrong_claims += truth > 0.5
        local_covers += covers(success[chosen], truth)
        rate = success_rate(rng.random(JUDGING) < truth)
        wrong_judgements += (rate.low > 0.5 >= truth) or (rate.high < 0.5 <= truth)
        refused += rate.low > 0.5
    assert wrong_claims > 0.5 * count
    assert local_covers < 0.93 * count
    assert refused > 0.4 * count
    assert wrong_judgements <= 0.05 * count
