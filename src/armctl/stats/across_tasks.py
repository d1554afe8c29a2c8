"""Statistics over tasks: the best classical against the best learned policy, ranks of families, performance profiles.

Each task weighs the same. Intervals are over episodes: they hold for these tasks and disturbances, not for others. No
bootstrap makes them: where all episodes are won, each resample is the same, and so an interval of no width, which
holds in far less than 95 % of all cases (`tests/stats/test_across_tasks.py` shows it). They are by random weights
of the episodes of each task (`armctl.stats.intervals.mean_of_means`).

Success is a table for each setting, undisturbed or disturbed: a row for each episode, a column for each policy, 1 for a
success, 0 for a failure, NaN for an episode that does not count.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.stats.correction import holm
from armctl.stats.difference import EQUIVALENCE, SIGNIFICANT, SuccessIntervals, significant, within
from armctl.stats.intervals import (
    FEWEST,
    Bounds,
    Estimate,
    MeanDifference,
    bounded_difference,
    bounded_sum,
    mean_of_means,
    success_rate,
)
from armctl.stats.paired import mcnemar, mover
from armctl.stats.sequential import ConfidenceSequence
from armctl.stats.unpaired import newcombe, unconditional

if TYPE_CHECKING:
    import pandas as pd

SELECTION_STRIDE = 3
"""Distance between two episodes that select a policy, and do not count for it."""
SELECTING = 30
"""Episodes that select a policy, the first ones, where a cell stops when it is decided: the choice has to be made by
then, for a test of a policy that changes holds at no number of episodes."""


@dataclass(frozen=True)
class Choice:
    """The policy that represents a kind."""

    policy: str
    of_several: bool = False
    """True if it was chosen from several: the episodes that selected it do not count for it."""
    any_number: bool = False
    """True if what is concluded is to hold at any number of episodes."""

    def selects(self, episodes: "pd.Index[int]") -> NDArray[np.bool_]:
        """Return which of the `episodes` selected it from several."""
        if not self.of_several:
            return np.zeros(len(episodes), dtype=bool)
        if self.any_number:
            return np.asarray(episodes < SELECTING, dtype=bool)
        return np.asarray(episodes % SELECTION_STRIDE == SELECTION_STRIDE - 1, dtype=bool)


def choose(
    success: "pd.DataFrame", returns: "pd.DataFrame", candidates: Sequence[str], any_number: bool = False
) -> Choice:
    """Return the best of several policies in every third episode (numbers 2, 5, 8 and so on).

    For what is to hold at `any_number` of episodes, that is the best in the first `SELECTING` ones.

    The other episodes judge it. The best in the episodes that judge it would flatter the larger kind (the winner's
    curse), and choosing crosswise, each half of the episodes for the other, would make the halves depend on each other:
    McNemar's test at 5 % erred in up to 9 % of all cases. The best has the highest success, then the highest return,
    then the first place.
    """
    rows = success.index[Choice("", of_several=True, any_number=any_number).selects(success.index)]
    scores = {name: (success.loc[rows, name].mean(), returns.loc[rows, name].mean()) for name in candidates}
    best = max(candidates, key=lambda name: tuple(np.nan_to_num(scores[name], nan=-np.inf)))
    return Choice(best, len(candidates) > 1, any_number)


def values_of(table: "pd.DataFrame", choice: Choice) -> "pd.Series[float]":
    """Return the success, or another value, of a choice by episode; NaN where it did not play, or was selected."""
    import pandas as pd

    values = table[choice.policy] if choice.policy in table else pd.Series(math.nan, table.index)
    return values.mask(choice.selects(table.index))


@dataclass(frozen=True)
class TaskPair:
    """The best classical policy against the best learned one, in one setting.

    In a pair with the best hybrid, this takes the place of the classical policy, and its rival that of the learned one.
    """

    episodes: int
    """Number of episodes that both played; of different ones, the smaller number."""
    only_classical: int
    """Number of episodes that only the classical policy won."""
    only_learned: int
    p: float
    """McNemar's exact p-value, or on different episodes that of `unconditional`.

    Of a disturbed setting it is after Holm's correction for all of the task.
    In `Study.verdicts`, the undisturbed one is after Holm's correction for all tasks, and for success and steps."""
    num_comparisons: int = 1
    """Number of tasks in one report, for which the tests of equivalence are corrected (Bonferroni)."""
    steps: Estimate | None = None
    """Mean steps to the goal of the classical minus those of the learned policy, a failure counting as the time limit.

    None if that is unknown, and in disturbed settings."""
    steps_p: float | None = None
    """p-value for equal steps, corrected like `p`."""
    change: Estimate | None = None
    """Change of the difference in success by the disturbance, on the same episodes; None for few common episodes."""
    change_p: float | None = None
    """p-value for no change, after Holm's correction for all disturbed settings of the task."""
    wins: tuple[int, int] | None = None
    """Episodes that the classical and that the learned policy won, if they played different ones; else None."""
    sample_sizes: tuple[int, int] = (0, 0)
    """Numbers of these episodes."""
    anytime: SuccessIntervals | None = None
    """Intervals that hold at any number of episodes, as `p` then does too; None: they are for a fixed number."""

    @property
    def difference(self) -> Estimate:
        """Success of the classical minus that of the learned policy, with MOVER's 95 % interval."""
        return self._difference_with(0.95)

    def _difference_with(self, confidence: float) -> Estimate:
        if self.anytime is not None:
            return self.anytime.at(confidence)
        if self.wins is None:
            return mover(self.only_classical, self.only_learned, self.episodes, confidence)
        (classical, learned), sizes = self.wins, self.sample_sizes
        return newcombe(classical, sizes[0], learned, sizes[1], confidence)

    @property
    def better(self) -> int:
        """1 if the classical policy is significantly better, -1 if the learned one is, else 0; 0 for few episodes."""
        if self.p >= SIGNIFICANT or self.episodes < FEWEST:
            return 0
        return int(np.sign(self.difference.value))

    @property
    def faster(self) -> int:
        """1 if the classical policy takes significantly fewer steps, -1 if the learned one does, else 0.

        0 if one of them is better in success: a failure counts as the time limit.
        """
        if self.steps is None or self.better or self.episodes < FEWEST or not significant(self.steps, self.steps_p):
            return 0
        return int(-np.sign(self.steps.value))

    @property
    def changed(self) -> int:
        """1 if the disturbance significantly shifts success towards the classical policy, -1 if away, else 0."""
        return int(np.sign(self.change.value)) if self.change and significant(self.change, self.change_p) else 0

    def equivalent(self, margin: float) -> bool:
        """Return True if success differs by less than `margin`: two one-sided tests at 5 % / `num_comparisons`."""
        return within(self.equivalence_interval, margin)

    @property
    def equivalence_interval(self) -> Estimate:
        """Difference in success with the interval that decides equivalence."""
        confidence = 1 - 2 * EQUIVALENCE / self.num_comparisons
        return self._difference_with(confidence)


def pairwise_by_task(
    cells: "Mapping[str, pd.DataFrame]",
    undisturbed: str,
    classical: Choice,
    learned: Choice,
    *,
    paired: bool = True,
    num_pairs: int = 1,
) -> dict[str, TaskPair]:
    """Compare both choices in each setting of a task in which both have played, on the same episodes if `paired`.

    What is concluded holds at any number of episodes if that was asked for the choices. This is one of `num_pairs` of
    choices: p-values of disturbed settings are corrected for these too (Bonferroni).
    """
    scores = {name: (values_of(table, classical), values_of(table, learned)) for name, table in cells.items()}
    any_number = classical.any_number and paired
    compared = {setting: _pair(*of_choices, paired, any_number) for setting, of_choices in scores.items()}
    pairs = {setting: pair for setting, pair in compared.items() if pair}
    disturbed = [setting for setting in pairs if setting != undisturbed]
    changes = {
        setting: change
        for setting in disturbed
        if undisturbed in pairs
        and (change := _change(scores[undisturbed], scores[setting], paired, any_number)) is not None
    }
    change_p = dict(zip(changes, _corrected([change.p for change in changes.values()], num_pairs), strict=True))
    for setting, p in zip(disturbed, _corrected([pairs[setting].p for setting in disturbed], num_pairs), strict=True):
        change = changes.get(setting)
        pairs[setting] = replace(
            pairs[setting], p=p, change=change.estimate if change else None, change_p=change_p.get(setting)
        )
    return pairs


def _corrected(p_values: Sequence[float], num_pairs: int) -> list[float]:
    return [min(1.0, num_pairs * p) for p in holm(p_values)]


def _pair(
    classical: "pd.Series[float]", learned: "pd.Series[float]", paired: bool, any_number: bool
) -> TaskPair | None:
    """Return the test of success by episode; None without an episode that is needed for it."""
    if paired:
        gains = np.asarray((classical - learned).dropna(), dtype=np.float64)
        only_a, only_b = int((gains > 0).sum()), int((gains < 0).sum())
        if not len(gains):
            return None
        if not any_number:
            return TaskPair(len(gains), only_a, only_b, mcnemar(only_a, only_b))
        sequence = ConfidenceSequence(gains, (-1.0, 1.0))
        return TaskPair(len(gains), only_a, only_b, sequence.p(), anytime=sequence.intervals())
    sizes = len(classical.dropna()), len(learned.dropna())
    wins = int(classical.sum()), int(learned.sum())
    if not all(sizes):
        return None
    p = unconditional(wins[0], sizes[0], wins[1], sizes[1])
    return TaskPair(min(sizes), 0, 0, p, wins=wins, sample_sizes=sizes)


def mean_difference(
    a: "pd.Series[float]", b: "pd.Series[float]", bounds: Bounds, paired: bool, any_number: bool = False
) -> MeanDifference | None:
    """Return the mean of scores by episode of a minus those of b; None without an episode that is needed for it."""
    if paired:
        gains = np.asarray((a - b).dropna(), dtype=np.float64)
        return _mean_of_pairs(gains, (bounds[0] - bounds[1], bounds[1] - bounds[0]), any_number)
    samples = [np.asarray(sample.dropna(), dtype=np.float64) for sample in (a, b)]
    return bounded_sum(samples, [1, -1], bounds) if all(map(len, samples)) else None


def _mean_of_pairs(gains: Array, bounds: Bounds, any_number: bool) -> MeanDifference | None:
    if not any_number or not len(gains):
        return bounded_difference(gains, bounds)
    return ConfidenceSequence(gains, bounds).mean_difference()


def _change(
    undisturbed: "tuple[pd.Series[float], pd.Series[float]]",
    disturbed: "tuple[pd.Series[float], pd.Series[float]]",
    paired: bool,
    any_number: bool,
) -> MeanDifference | None:
    """Return the change of a difference in success, episode by episode if `paired`; None for few episodes."""
    if paired:
        (a, b), (other_a, other_b) = disturbed, undisturbed
        changes = np.asarray((a - b - (other_a - other_b)).dropna(), dtype=np.float64)
        return _mean_of_pairs(changes, (-2.0, 2.0), any_number) if len(changes) >= FEWEST else None
    samples = [np.asarray(sample.dropna(), dtype=np.float64) for sample in (*disturbed, *undisturbed)]
    return bounded_sum(samples, [1, -1, -1, 1], (0.0, 1.0)) if min(map(len, samples)) >= FEWEST else None


def improvement(cells: "Mapping[str, pd.DataFrame]", classical: Choice, learned: Choice) -> Array:
    """Return 1 for each episode of a task in which the classical choice is better, 0 for the others, 1/2 for a tie.

    They are means over settings; their mean is the probability of improvement. An episode is a sample with all its
    settings, as these begin alike.
    """
    gains = [values_of(success, classical) - values_of(success, learned) for success in cells.values()]
    return _by_episode([0.5 + gain / 2 for gain in gains])


def rank(cells: "Mapping[str, pd.DataFrame]", members: Sequence[str]) -> Array:
    """Return the mean rank of some policies in each episode of a task, over settings: 0 is the last, 1 the first.

    A rank is the share of its rivals that a policy beats, ties counting half. So ranks among few and among many rivals
    can be averaged.
    """
    ranks = []
    for success in cells.values():
        common = success.dropna(axis=1, how="all").dropna()
        ours = [name for name in members if name in common]
        if ours and len(common.columns) > 1:
            ranks.append(((common.rank(axis=1) - 1) / (len(common.columns) - 1))[ours].mean(axis=1))
    return _by_episode(ranks)


def _by_episode(values: Sequence["pd.Series[float]"]) -> Array:
    """Return means over settings, each of which has a series by episode, for the episodes of all settings."""
    import pandas as pd

    if not values:
        return np.empty(0)
    table = pd.concat(values, axis=1).dropna(axis=1, how="all")
    return np.asarray(table.dropna().mean(axis=1), dtype=np.float64)


def mean_over_tasks(tasks: Sequence[Array]) -> Estimate | None:
    """Return the mean of shares by episode, one array for each task, with a 95 % interval; None without any."""
    return mean_of_means(tasks, (0.0, 1.0))


@dataclass(frozen=True)
class League:
    """Families that have all played the same tasks, and their mean ranks in these, the highest first."""

    tasks: tuple[str, ...]
    ranks: Mapping[str, Estimate]


def leagues(ranks: Mapping[str, Mapping[str, Array]]) -> list[League]:
    """Return leagues from ranks by family, task and episode: one for each set of tasks that some family has played.

    A league has all families that have played all of its tasks, so that rivals are compared over the same tasks. The
    league of most tasks is the first.
    """
    by_tasks: dict[frozenset[str], League] = {}
    for by_task in sorted(ranks.values(), key=len, reverse=True):
        tasks = tuple(by_task)
        if tasks and frozenset(tasks) not in by_tasks:
            members = {name: shares for name, shares in ranks.items() if set(tasks) <= set(shares)}
            means = {name: mean_over_tasks([shares[task] for task in tasks]) for name, shares in members.items()}
            ranked = [(name, mean) for name, mean in means.items() if mean is not None]
            by_tasks[frozenset(tasks)] = League(tasks, dict(sorted(ranked, key=lambda item: -item[1].value)))
    return list(by_tasks.values())


def success_profile(cells: Sequence[Estimate], thresholds: Array) -> list[Estimate]:
    """Return the share of cells (task and setting) with a success of at least each threshold (Agarwal et al. 2021).

    The band is the same share of the cells' lower and of their upper limits.
    """
    values = np.array([(rate.value, *rate.bounds) for rate in cells])
    return [Estimate(*map(float, (values >= threshold).mean(axis=0))) for threshold in thresholds]


def cell_rates(cells: "Mapping[str, pd.DataFrame]", choice: Choice) -> list[Estimate]:
    """Return the success rates of a choice in all settings, with Clopper and Pearson's intervals."""
    rates = [rate_of(success, choice) for success in cells.values()]
    return [rate for rate in rates if rate is not None]


def rate_of(success: "pd.DataFrame", choice: Choice) -> Estimate | None:
    """Return the success rate of a choice in one setting; None if it has not played."""
    return success_rate(values_of(success, choice).dropna().to_numpy() == 1)
