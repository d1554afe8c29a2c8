"""Statistics over tasks: the best classical against the best learned policy, ranks of families, performance profiles.

Each task weighs the same. Intervals are over episodes: they hold for these tasks and disturbances, not for others. No
bootstrap makes them: where all episodes are won, each resample is the same, and so an interval of no width, which
holds in far less than 95 % of all cases (`tests/evaluation/test_across_tasks.py` shows it). Instead, each task has an
interval that holds near 100 %, and `mean_over_tasks` combines them.

Success is a table for each setting, undisturbed or disturbed: a row for each episode, a column for each policy, 1 for a
success, 0 for a failure, NaN for an episode that does not count.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl.evaluation.paired import EQUIVALENCE, SIGNIFICANT, holm, mcnemar, mover, within
from armctl.evaluation.statistics import FEWEST, Estimate, bounded_mean, success_rate

FAMILIES = {
    "ik": "IK", "mpc": "MPC", "ompl": "OMPL", "ppo": "PPO", "sac": "SAC", "bc": "BC", "dagger": "DAgger",
    "distil": "distillation", "imagined": "imagination",
}  # fmt: skip
"""By the last word of a policy's name."""
Choice = tuple[str, str]
"""The policies that stand for a kind in episodes of even and of odd number."""


def family(policy: str) -> str:
    """The family of a policy by the last word of its name, such as MPC; of any other, its name."""
    return FAMILIES.get(policy.rpartition("_")[2], policy)


def choose(success: pd.DataFrame, returns: pd.DataFrame, candidates: Sequence[str]) -> Choice:
    """Which of several policies stand for the best of them: the best on odd episodes in even ones, and vice versa.

    So nobody is chosen by the episodes that he is judged by, which would flatter the larger group (the winner's curse).
    The best is the one of highest success, then of highest return, then the first. This cross-fitting makes the two
    halves depend on each other a little: where all candidates are equally good, McNemar's test at 5 % errs in up to 9 %
    of all cases (6 % at 50 episodes), and a 95 % interval of the difference holds in as few as 91 %.
    """

    def best(parity: int) -> str:
        half = success.index % 2 == parity
        rows = success.index[half if half.any() else ~half]
        scores = {name: (success.loc[rows, name].mean(), returns.loc[rows, name].mean()) for name in candidates}
        return max(candidates, key=lambda name: tuple(np.nan_to_num(scores[name], nan=-np.inf)))

    return best(1), best(0)


def success_of(success: pd.DataFrame, choice: Choice) -> "pd.Series[float]":
    """The success of a choice in each episode; NaN where its policy did not play."""
    even, odd = (success[name] if name in success else pd.Series(math.nan, success.index) for name in choice)
    return even.where(success.index % 2 == 0, odd)


@dataclass(frozen=True)
class HeadToHead:
    """The choice of classical policies against that of learned ones, on the same episodes of one setting."""

    episodes: int
    only_classical: int
    """Number of episodes that only the classical policy won."""
    only_learned: int
    p: float
    """McNemar's exact p-value; of a disturbed setting after Holm's correction for all of the task.

    In `Suite.answers`, the undisturbed one is after Holm's correction for all tasks."""
    claims: int = 1
    """Number of tasks that are told beside it, for which the tests of equivalence are corrected (Bonferroni)."""

    @property
    def difference(self) -> Estimate:
        """Success of the classical minus that of the learned policy, with MOVER's 95 % interval."""
        return mover(self.only_classical, self.only_learned, self.episodes)

    @property
    def better(self) -> int:
        """1 if the classical policy is significantly better, -1 if the learned one is, else 0; 0 for few episodes."""
        shown = self.p < SIGNIFICANT and self.episodes >= FEWEST
        return int(np.sign(self.only_classical - self.only_learned)) if shown else 0

    def equivalent(self, margin: float) -> bool:
        """Whether success differs by less than `margin`: two one-sided tests at 5 % / `claims`."""
        confidence = 1 - 2 * EQUIVALENCE / self.claims
        return within(mover(self.only_classical, self.only_learned, self.episodes, confidence), margin)


def heads_to_head(
    cells: Mapping[str, pd.DataFrame], undisturbed: str, classical: Choice, learned: Choice
) -> dict[str, HeadToHead]:
    """Both choices in each setting of a task where both have played."""
    found: dict[str, HeadToHead] = {}
    for setting, success in cells.items():
        gains = (success_of(success, classical) - success_of(success, learned)).dropna()
        if len(gains):
            only_a, only_b = int((gains > 0).sum()), int((gains < 0).sum())
            found[setting] = HeadToHead(len(gains), only_a, only_b, mcnemar(only_a, only_b))
    disturbed = [setting for setting in found if setting != undisturbed]
    for setting, p in zip(disturbed, holm([found[setting].p for setting in disturbed]), strict=True):
        one = found[setting]
        found[setting] = HeadToHead(one.episodes, one.only_classical, one.only_learned, p)
    return found


def improvement(cells: Mapping[str, pd.DataFrame], classical: Choice, learned: Choice) -> Estimate | None:
    """Probability that the classical choice does better in an episode, in the mean over a task's settings.

    A tie counts half. An episode is a sample with all its settings, as these begin alike.
    """
    gains = [success_of(success, classical) - success_of(success, learned) for success in cells.values()]
    return _mean_of_episodes([0.5 + gain / 2 for gain in gains])


def rank(cells: Mapping[str, pd.DataFrame], members: Sequence[str]) -> Estimate | None:
    """The mean rank of some policies of a task, over its episodes and settings: 0 is the last, 1 the first.

    In each episode, who wins comes before who does not, and ties share the middle: it is the share of its rivals that
    a policy beats, ties counting half. So ranks among few and among many rivals can be averaged.
    """
    ranks = []
    for success in cells.values():
        played = success.dropna(axis=1, how="all").dropna()
        ours = [name for name in members if name in played]
        if ours and len(played.columns) > 1:
            ranks.append(((played.rank(axis=1) - 1) / (len(played.columns) - 1))[ours].mean(axis=1))
    return _mean_of_episodes(ranks)


def _mean_of_episodes(values: Sequence["pd.Series[float]"]) -> Estimate | None:
    """Mean of shares (one series by episode for each setting), with an interval over whole episodes."""
    if not values:
        return None
    table = pd.concat(values, axis=1).dropna(axis=1, how="all")
    return bounded_mean(table.dropna().mean(axis=1).to_numpy(float), (0.0, 1.0))


def mean_over_tasks(estimates: Sequence[Estimate | None]) -> Estimate | None:
    """Mean of independent estimates, one for each task, with a 95 % interval; None without any.

    The distances to the limits add up by their squares (MOVER: Zou and Donner, Statistics in Medicine 27, 2008).
    """
    known = [one for one in estimates if one is not None]
    if not known:
        return None
    value = math.fsum(one.value for one in known) / len(known)
    if any(one.low is None or one.high is None for one in known):
        return Estimate(value, None, None)
    low, high = np.array([one.bounds for one in known]).T
    values = np.array([one.value for one in known])
    down, up = (float(np.linalg.norm(values - bound)) / len(known) for bound in (low, high))
    return Estimate(value, value - down, value + up)


def success_profile(cells: Sequence[Estimate], thresholds: NDArray[np.float64]) -> list[Estimate]:
    """Share of cells (task and setting) with a success of at least each threshold (Agarwal et al. 2021).

    The band is the same share of the cells' lower and of their upper limits.
    """
    values = np.array([(one.value, *one.bounds) for one in cells])
    return [Estimate(*map(float, (values >= threshold).mean(axis=0))) for threshold in thresholds]


def cell_rates(cells: Mapping[str, pd.DataFrame], choice: Choice) -> list[Estimate]:
    """The success rate of a choice in each setting, with Clopper and Pearson's interval."""
    rates = [rate_of(success, choice) for success in cells.values()]
    return [rate for rate in rates if rate is not None]


def rate_of(success: pd.DataFrame, choice: Choice) -> Estimate | None:
    """The success rate of a choice in one setting; None if it has not played."""
    return success_rate(success_of(success, choice).dropna().to_numpy() == 1)
