"""How often intervals and verdicts are right where the truth is known. `benchmarks/intervals.py` has whole tables."""

import numpy as np
import pytest

from armctl.evaluation.paired import mcnemar, mover
from armctl.evaluation.statistics import bounded_mean, mean, worst_decile

RUNS = 400
BOUNDS = (-100.0, 99.0)
CASES = [(n, failures) for n in (20, 50, 200) for failures in (0.0, 0.005, 0.01, 0.05, 0.5)]


def returns(rng, n, failures):
    return np.where(rng.random(n) < failures, -100.0, 88.0 + np.clip(rng.normal(0, 2, n), -10, 10))


@pytest.mark.slow
@pytest.mark.parametrize(("n", "failures"), CASES)
def test_intervals_of_returns_hold_however_rare_failures_are(n, failures):
    rng = np.random.default_rng(0)
    truth = -100 * failures + 88 * (1 - failures)
    found = [bounded_mean(returns(rng, n, failures), BOUNDS) for _ in range(RUNS)]
    too_high, too_low = np.mean([(one.low > truth, one.high < truth) for one in found], axis=0)
    assert too_high + too_low <= 0.07
    assert max(too_high, too_low) <= 0.04  # 2.5 %, and two standard errors of the simulation


def test_students_interval_does_not_hold_for_rare_failures():
    rng = np.random.default_rng(0)
    found = [mean(returns(rng, 50, 0.01)) for _ in range(RUNS)]
    assert np.mean([one.low <= 86.12 <= one.high for one in found]) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("n", [50, 200])
def test_intervals_of_the_worst_tenth_hold(n):
    rng = np.random.default_rng(0)
    truth = float(np.sort(returns(rng, 1_000_000, 0.02))[:100_000].mean())
    found = [worst_decile(returns(rng, n, 0.02), BOUNDS) for _ in range(RUNS)]
    assert np.mean([one.low <= truth <= one.high for one in found]) >= 0.93


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
    assert np.mean([one.low <= only_a - only_b <= one.high for one, _ in both]) >= 0.93
    assert np.mean([one.value < 0 and p < 0.05 for one, p in both]) <= 0.025
