"""The compiled end of a control step does what is written here in NumPy."""

import numpy as np
import pytest

from armctl.kernels.compiling import bound
from armctl.kernels.step_end import RUNNING, TIMEOUT, Episodes, Rules, StepResults, end_step

N, TERMS = 7, 3
SUCCESSES = np.array([False, True, False, False])
UNSTABLE = len(SUCCESSES) - 1
RULES = Rules(np.array([False, True, True]), np.array([1.0, 0.5, 1.0]), 2.0, 1e90, 5, UNSTABLE, SUCCESSES)


def fresh_episodes():
    return Episodes(
        np.zeros(N, np.int64), np.zeros(N, np.int64), np.zeros(N, bool), np.zeros(N, bool), np.zeros((TERMS, N), bool)
    )


def reference(episodes, terms, outcomes):
    was_finished, unstable = episodes.finished.copy(), episodes.unstable
    episodes.steps[:] += 1
    episodes.clock[:] = episodes.steps
    unpaid = ~(RULES.paid_once[:, None] & episodes.paid_terms) & ~was_finished & ~unstable
    terms = np.where(unpaid, terms, 0.0)
    episodes.paid_terms[:] |= terms != 0
    outcomes = np.where(was_finished, TIMEOUT, np.where(unstable, UNSTABLE, outcomes))
    terminated = outcomes != TIMEOUT
    truncated = ~was_finished & ~terminated & (episodes.steps >= RULES.max_steps)
    ends = terminated | truncated
    episodes.finished[:] = was_finished | ends
    rewards = RULES.scale * (RULES.weights[:, None] * terms).sum(axis=0)
    return terms, rewards, terminated, truncated, ends & SUCCESSES[outcomes], np.where(ends, outcomes, RUNNING)


def empty_results():
    return StepResults(np.zeros((TERMS, N)), np.zeros(N, np.int64), np.zeros(N), np.zeros((3, N), bool))


@pytest.mark.parametrize("seed", range(5))
def test_ends_and_rewards_are_those_of_the_reference(seed):
    rng = np.random.default_rng(seed)
    compiled, plain = fresh_episodes(), fresh_episodes()
    results = empty_results()
    arguments = bound((compiled, RULES, results))
    ends = set[int]()
    for _ in range(40):
        terms = rng.integers(-2, 3, (TERMS, N)).astype(float)
        outcomes = np.where(rng.random(N) < 0.1, rng.integers(1, UNSTABLE, N), TIMEOUT)
        begins, unstable = rng.random(N) < 0.2, rng.random(N) < 0.05
        for episodes in (compiled, plain):
            episodes.unstable[:] = unstable
            episodes.finished[begins] = False
            episodes.steps[begins] = 0
            episodes.paid_terms[:, begins] = False
        expected = reference(plain, terms, outcomes)
        results.terms[:], results.outcomes[:] = terms, outcomes
        assert end_step(arguments)
        found = results.terms, results.rewards, *results.ends, results.outcomes
        for value, right in zip(found, expected, strict=True):
            np.testing.assert_array_equal(value, right)
        for value, right in zip(compiled, plain, strict=True):
            np.testing.assert_array_equal(value, right)
        ends |= set(results.outcomes.tolist())
    assert ends == {RUNNING, TIMEOUT, 1, 2, UNSTABLE}


@pytest.mark.parametrize(
    ("term", "outcome"), [(np.nan, 0), (np.inf, 0), (-2e90, 0), (0.0, -1), (0.0, len(SUCCESSES)), (0.0, 2**40)]
)
def test_no_number_and_no_outcome_are_refused_except_where_nothing_counts(term, outcome):
    def is_valid(finished):
        episodes, results = fresh_episodes(), empty_results()
        episodes.finished[3] = finished
        results.terms[0, 3], results.outcomes[3] = term, outcome
        return end_step(bound((episodes, RULES, results)))

    assert not is_valid(False)
    assert is_valid(True)
