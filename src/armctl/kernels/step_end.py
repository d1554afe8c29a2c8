"""The end of a control step in n worlds: what it pays, and which episodes end."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled

RUNNING, TIMEOUT = -1, 0
"""Outcomes of episodes that go on, and of those that reach their time limit."""


class Episodes(NamedTuple):
    """Present episodes of n worlds."""

    steps: NDArray[np.int64]
    """(n,) control steps so far."""
    clock: NDArray[np.int64]
    """(n,) a copy of `steps`."""
    finished: NDArray[np.bool_]
    """(n,) whether they have ended: then nothing is paid."""
    unstable: NDArray[np.bool_]
    """(n,) whether their physics has failed: then nothing is paid either, and they end."""
    paid_terms: NDArray[np.bool_]
    """(k, n) whether each reward term has been paid."""


class Rules(NamedTuple):
    """Rules of rewards and ends for k reward terms."""

    paid_once: NDArray[np.bool_]
    """(k,) whether a term is paid once an episode."""
    weights: Array
    """(k,)"""
    scale: float
    largest: float
    """Largest term."""
    max_steps: int
    """Control steps after which an episode is truncated."""
    unstable: int
    """The outcome of unstable worlds."""
    successes: NDArray[np.bool_]
    """Success of each outcome."""


class StepResults(NamedTuple):
    """Results of a control step in n worlds, whose terms and outcomes are the task's before."""

    terms: Array
    """(k, n) reward terms, and then what is paid of them."""
    outcomes: NDArray[np.int64]
    """(n,) the task's, and then `RUNNING` where episodes go on."""
    rewards: Array
    """(n,)"""
    ends: NDArray[np.bool_]
    """(3, n): terminated, truncated, successful."""


@compiled
def end_step(bound):
    """Count a control step, and compute its results. Bound are `Episodes`, `Rules` and `StepResults`.

    Returns False if a term is too large or not a number, or if there is no such outcome.
    """
    episodes, rules, (terms, outcomes, rewards, ends) = bound.arguments
    terminated, truncated, successes = ends[0], ends[1], ends[2]
    valid = True
    for i in range(len(outcomes)):
        episodes.steps[i] += 1
        episodes.clock[i] = episodes.steps[i]
        was_finished, total = episodes.finished[i], 0.0
        for k in range(len(terms)):
            if was_finished or episodes.unstable[i] or (rules.paid_once[k] and episodes.paid_terms[k, i]):
                terms[k, i] = 0.0
            elif terms[k, i] != 0.0:
                episodes.paid_terms[k, i] = True
            valid = valid and abs(terms[k, i]) <= rules.largest
            total += rules.weights[k] * terms[k, i]
        rewards[i] = total * rules.scale
        if was_finished:
            outcomes[i] = TIMEOUT
        elif episodes.unstable[i]:
            outcomes[i] = rules.unstable
        valid = valid and 0 <= outcomes[i] < len(rules.successes)
        terminated[i] = outcomes[i] != TIMEOUT
        truncated[i] = not was_finished and not terminated[i] and episodes.steps[i] >= rules.max_steps
        has_ended = terminated[i] or truncated[i]
        successes[i] = has_ended and valid and rules.successes[outcomes[i]]
        episodes.finished[i] = was_finished or has_ended
        if not has_ended:
            outcomes[i] = RUNNING
    return valid
