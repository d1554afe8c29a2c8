"""Scores of the episodes of each learner: of a policy, or of several trainings that count as one."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable
from armctl.policies import learners
from armctl.stats.intervals import Bounds
from armctl.stats.paired import PairedDifference, difference_of_groups, paired_difference

WITHIN_RANGE, WITHIN_SPEED = 1.01, 1.2
"""Largest use of a joint's range, and of its speed limit, in a clean episode: servos overshoot a little."""


@dataclass(frozen=True)
class Limits:
    """Between which numbers returns and times lie."""

    returns: Bounds | None
    """None if nobody knows: then no mean of returns has an interval."""
    steps: int | None


def clean(results: EpisodeTable) -> NDArray[np.bool_]:
    """Which episodes were won without a forbidden contact, and within the joints' ranges and speed limits.

    `WITHIN_RANGE` and `WITHIN_SPEED` allow for what servos overshoot. None is, of which contacts are unknown.
    """
    beyond = (results.column("range_use") > WITHIN_RANGE) | (results.column("speed_use") > WITHIN_SPEED)
    return np.asarray(results.won & (results.column("contacts") == 0) & ~beyond, dtype=bool)


def paid_returns(results: EpisodeTable, least: float) -> NDArray[np.float64]:
    """The returns; the `least` possible one of episodes in which the policy failed, so that a crash never pays."""
    return np.where(results.column("outcome") == ERROR, least, results.column("total_reward"))


def counted_rows(episodes: pd.DataFrame) -> pd.DataFrame:
    """The rows of `episodes.csv` that count, by episode; which do is as in `counted_results`.

    The return of an episode in which the policy failed is -inf: less than any other.
    """
    played = episodes.sort_values("episode")
    unbroken = played[played.episode == played.groupby("policy").cumcount()]
    counted = unbroken[~unbroken.episode.isin(played.episode[~played.feasible.astype(bool)])]
    return counted.assign(**{"return": counted["return"].where(counted.outcome != ERROR, -math.inf)})


def by_learner(
    counted: Mapping[str, EpisodeTable], policies: Iterable[str], groups: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, EpisodeTable]]:
    """The results that count of each training of each learner: of one, unless it is a group.

    Of a group, those episodes count that all its trainings have finished. A learner without any is left out.
    """
    found = {}
    for name in learners(list(policies), groups):
        members = groups.get(name, [name])
        fewest = min(len(counted.get(member, [])) for member in members)
        if fewest:
            found[name] = {member: counted[member][: fewest if name in groups else None] for member in members}
    return found


def scores_of(name: str, trainings: Sequence[EpisodeTable], limits: Limits) -> NDArray[np.float64]:
    """A field of `PolicySummary`, (trainings, episodes), whose mean it is."""
    return np.array([_score(name, one, limits) for one in trainings], dtype=np.float64)


def _score(name: str, results: EpisodeTable, limits: Limits) -> NDArray[Any]:
    length = results.column("length")
    match name:
        case "success":
            return results.won
        case "clean_success":
            return clean(results)
        case "efficiency":
            least = results.column("least_length")
            return np.asarray(results.won * least / np.maximum(length, least))
        case "episode_return":
            return paid_returns(results, -math.inf if limits.returns is None else limits.returns[0])
        case "restricted_steps":
            return np.where(results.won, length, limits.steps or 0)
    return np.asarray(np.maximum(length, 1))  # a policy that failed at once had begun its first step


def pairs_of(trained: Mapping[str, list[EpisodeTable]], scored: bool, limits: Limits) -> list[PairedDifference]:
    """The difference of each two learners, whose trainings' results are given, on the episodes that both played."""
    found = []
    for a, b in itertools.combinations(trained, 2):
        fewest = min(len(trained[a][0]), len(trained[b][0]))
        both = [[one[:fewest] for one in trained[name]] for name in (a, b)]

        def of(score: str, both: list[list[EpisodeTable]] = both) -> tuple[Any, Any]:
            return scores_of(score, both[0], limits), scores_of(score, both[1], limits)

        success = of("success") if scored else None
        steps = of("restricted_steps") if scored and limits.steps is not None else None
        returns = of("episode_return")
        claims = math.comb(len(trained), 2)
        if max(map(len, both)) > 1:
            found.append(difference_of_groups(a, b, success, returns, steps, limits.returns, limits.steps, claims))
            continue
        won = None if success is None else (success[0][0] > 0, success[1][0] > 0)
        late = None if steps is None else (steps[0][0], steps[1][0])
        earned = (returns[0][0], returns[1][0])
        found.append(paired_difference(a, b, won, earned, late, limits.returns, limits.steps, claims))
    return found
