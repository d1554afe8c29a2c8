"""How often intervals and verdicts are right where the truth is known. `benchmarks/intervals.py` has whole tables."""

import numpy as np
import pytest

from armctl.stats import intervals as statistics
from armctl.stats.intervals import bounded_mean, worst_decile
from armctl.stats.paired import mcnemar, mover

from .test_intervals import students

RUNS = 400
BOUNDS = (-100.0, 99.0)
CASES = [(n, failures) for n in (20, 50, 200) for failures in (0.0, 0.005, 0.01, 0.05, 0.5)]


def returns(rng, n, failures):
    return np.where(rng.random(n) < failures, -100.0, 88.0 + np.clip(rng.normal(0, 2, n), -10, 10))


@pytest.fixture(autouse=True)
def few_draws(monkeypatch, sized):
    """Single intervals are less exact for it, but do not hold less often."""
    monkeypatch.setattr(statistics, "DRAWS", sized(500, 1000))


def allowed(share, runs):
    """A share, and three standard errors of its simulation."""
    return share + 3 * (share * (1 - share) / runs) ** 0.5


def misses(found, truth):
    """How often the interval is too high, and too low."""
    return np.mean([(one.low > truth, one.high < truth) for one in found], axis=0)


@pytest.mark.parametrize(("n", "failures"), CASES)
def test_intervals_of_returns_hold_however_rare_failures_are(n, failures, sized):
    rng, runs = np.random.default_rng(0), sized(40, 150)
    found = [bounded_mean(returns(rng, n, failures), BOUNDS) for _ in range(runs)]
    assert max(misses(found, -100 * failures + 88 * (1 - failures))) <= allowed(0.025, runs)


def test_students_interval_does_not_hold_for_rare_failures():
    rng = np.random.default_rng(0)
    found = [students(returns(rng, 50, 0.01)) for _ in range(RUNS)]
    assert np.mean([one.low <= 86.12 <= one.high for one in found]) < 0.6


@pytest.mark.parametrize("failures", [0.002, 0.02, 0.3])
@pytest.mark.parametrize("n", [50, 200])
def test_intervals_of_the_worst_tenth_hold(n, failures, sized):
    rng, runs = np.random.default_rng(0), sized(40, 150)
    truth = float(np.sort(returns(rng, 200_000, failures))[:20_000].mean())
    found = [worst_decile(returns(rng, n, failures), BOUNDS) for _ in range(runs)]
    assert max(misses(found, truth)) <= allowed(0.025, runs)


def test_without_the_bounds_the_sample_knows_too_little_of_rare_failures():
    """Why there is no interval where the bounds are unknown: most samples have not seen the disaster."""
    rng = np.random.default_rng(0)
    data = [returns(rng, 50, 0.01) for _ in range(100)]
    worst = float(np.sort(returns(rng, 200_000, 0.01))[:20_000].mean())
    for statistic, truth in ((bounded_mean, 86.12), (worst_decile, worst)):
        found = [statistic(one, (one.min(), one.max())) for one in data]
        assert misses(found, truth)[0] > 0.4
        assert misses([statistic(one, BOUNDS) for one in data], truth)[0] <= allowed(0.025, 100)


@pytest.mark.parametrize("n", [20, 50, 200, 1000])
def test_a_faster_policy_that_fails_is_not_declared_better(n):
    rng = np.random.default_rng(0)
    failures = rng.binomial(n, 0.01, size=RUNS)
    gains = {k: bounded_mean(np.where(np.arange(n) < k, -188.0, 1.0), (-199.0, 199.0)) for k in set(failures)}
    assert np.mean([gains[k].low > 0 for k in failures]) <= 0.025  # its mean gain is -0.89


@pytest.mark.parametrize(("only_a", "only_b"), [(0.005, 0.005), (0.02, 0.01), (0.2, 0.2)])
def test_verdicts_on_success_rarely_have_the_wrong_sign(only_a, only_b):
    counts = np.random.default_rng(0).multinomial(200, [only_a, only_b, 1 - only_a - only_b], size=2000)
    found = {(a, b): (mover(int(a), int(b), 200), mcnemar(int(a), int(b))) for a, b, _ in counts}
    both = [found[a, b] for a, b, _ in counts]
    assert max(misses([one for one, _ in both], only_a - only_b)) <= allowed(0.025, 2000)
    assert np.mean([one.value < 0 and p < 0.05 for one, p in both]) <= 0.025
