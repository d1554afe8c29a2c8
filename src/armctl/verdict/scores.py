"""Scores of the episodes of each learner: of a policy, or of several trainings that count as one."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable
from armctl.policies import learners
from armctl.stats.difference import Difference, Scores, difference_between
from armctl.stats.intervals import Bounds
from armctl.stats.sequential import sequential_difference

WITHIN_RANGE, WITHIN_SPEED = 1.01, 1.2
"""Largest use of a joint's range, and of its speed limit, in a clean episode: servos overshoot a little."""


@dataclass(frozen=True)
class Limits:
    """Bounds of returns and times."""

    returns: Bounds | None
    """None if unknown: then no mean of returns has an interval."""
    steps: int | None


def clean(results: EpisodeTable) -> NDArray[np.bool_]:
    """Return which episodes were won without a forbidden contact, and within the joints' ranges and speed limits.

    `WITHIN_RANGE` and `WITHIN_SPEED` allow for what servos overshoot. Episodes with unknown contacts are not clean.
    """
    beyond = (results.column("range_use") > WITHIN_RANGE) | (results.column("speed_use") > WITHIN_SPEED)
    return np.asarray(results.won & (results.column("contacts") == 0) & ~beyond, dtype=bool)


def paid_returns(results: EpisodeTable, lowest: float) -> NDArray[np.float64]:
    """Return the returns; the `lowest` possible one of episodes in which the policy failed: a crash never pays."""
    return np.where(results.column("outcome") == ERROR, lowest, results.column("total_reward"))


def by_learner(
    counted: Mapping[str, EpisodeTable], policies: Iterable[str], groups: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, EpisodeTable]]:
    """Return the results that count of each training of each learner: of one training, unless it is a group.

    Of a group, those episodes count that all its trainings have finished. A learner without any is left out.
    """
    trained = {}
    for name in learners(list(policies), groups):
        members = groups.get(name, [name])
        fewest = min(len(counted.get(member, [])) for member in members)
        if fewest:
            trained[name] = {member: counted[member][: fewest if name in groups else None] for member in members}
    return trained


def scores_of(name: str, trainings: Sequence[EpisodeTable], limits: Limits) -> NDArray[np.float64]:
    """Return the scores (trainings, episodes) whose mean is the field `name` of `PolicySummary`."""
    return np.array([_score(name, results, limits) for results in trainings], dtype=np.float64)


def _score(name: str, results: EpisodeTable, limits: Limits) -> NDArray[Any]:
    length = results.column("length")
    match name:
        case "success":
            return results.won
        case "clean_success":
            return clean(results)
        case "efficiency":
            bound = results.column("lower_bound_steps")
            return np.asarray(results.won * bound / np.maximum(length, bound))
        case "episode_return":
            return paid_returns(results, -math.inf if limits.returns is None else limits.returns[0])
        case "restricted_steps":
            return np.where(results.won, length, limits.steps or 0)
    return np.asarray(np.maximum(length, 1))  # a policy that failed at once had begun its first step


def pairs_of(
    trained: Mapping[str, list[EpisodeTable]],
    scored: bool,
    limits: Limits,
    paired: bool = True,
    any_number: bool = False,
) -> list[Difference]:
    """Compare each two learners, given the results of their trainings, on the episodes that both played.

    Where episodes of the same number are not the same ones, learners are not `paired`, and all of either count. With
    `any_number`, what is concluded holds at any number of episodes, except for groups of trainings.
    """
    pairs, num_pairs = [], math.comb(len(trained), 2)
    for a, b in itertools.combinations(trained, 2):
        fewest = min(len(trained[a][0]), len(trained[b][0])) if paired else None
        common_a, common_b = ([results[:fewest] for results in trained[name]] for name in (a, b))

        def of(score: str, a: Sequence[EpisodeTable] = common_a, b: Sequence[EpisodeTable] = common_b) -> Any:
            return scores_of(score, a, limits), scores_of(score, b, limits)

        scores = Scores(
            success=of("success") if scored else None,
            returns=of("episode_return"),
            steps=of("restricted_steps") if scored and limits.steps is not None else None,
            return_bounds=limits.returns,
            time_limit=limits.steps,
        )
        if any_number and len(trained[a]) == len(trained[b]) == 1:
            pairs.append(sequential_difference(a, b, scores, num_pairs))
        else:
            pairs.append(difference_between(a, b, scores, num_pairs, paired=paired))
    return pairs
