"""From which level of a disturbance a policy gets worse, and from which it fails."""

from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd
from scipy import stats

from armctl.stats.intervals import paired_superiority, sign_of_difference
from armctl.stats.paired import mcnemar
from armctl.stats.trainings import mean_over_trainings

FALSE_DISCOVERY_RATE = 0.05
"""Of the significant drops in success of a sweep (Benjamini and Hochberg 1995)."""


@dataclass(frozen=True)
class Onset:
    """A level at which something is shown."""

    level: float
    lasts: bool = True
    """Whether figures agree at all later levels."""

    def __str__(self) -> str:
        return f"from {self.level:g} on" if self.lasts else f"at {self.level:g}"


@dataclass(frozen=True)
class Degradation:
    """The effect of one disturbance on one policy."""

    disturbance: str
    policy: str
    sees: str
    drops: Onset | None
    """The first significant drop in success, or if it is unknown, in the chance of the higher return.

    It lasts until figures are as before."""
    below_half: Onset | None
    """The first level with a success rate below one half; None if there is none."""


def degradations(points: pd.DataFrame) -> list[Degradation]:
    """The effect of each disturbance on each policy that it reaches, from the rows of `sweep.csv`.

    The direction of a change is that of the statistic that `p` tests (the column `change`). Sweeps of older versions
    have none: differences in success take its place, and of returns no drop is shown.
    """
    points = points[~spares(points)]
    points = points.assign(neutral=~points.duplicated(["disturbance", "policy"]))
    levels = points[~points.neutral]
    significant = pd.Series(False, index=points.index)
    if len(levels):
        significant[levels.index] = stats.false_discovery_control(levels.p) < FALSE_DISCOVERY_RATE
    by_success = points.success - points.groupby(["disturbance", "policy"]).success.transform("first")
    fell = pd.to_numeric(points["change"], errors="coerce") < 0 if "change" in points else by_success < 0
    points = points.assign(fell=fell, drops=significant & fell, below_half=points.success < 0.5)
    return [
        Degradation(
            str(disturbance),
            str(policy),
            str(rows.sees.iloc[0]),
            next(iter(onsets(rows.level, rows.drops, rows.fell)), None),
            next(iter(onsets(rows.level, rows.below_half, rows.below_half)), None),
        )
        for (disturbance, policy), rows in points.groupby(["disturbance", "policy"], sort=False)
    ]


def spares(points: pd.DataFrame) -> "pd.Series[bool]":
    """Return which rows of `sweep.csv` are of a disturbance and of a policy that it does not reach at some level."""
    if "spared" not in points:  # by an older version
        return pd.Series(False, points.index)
    spared = points.spared.astype(str) == "True"
    return spared.groupby([points.disturbance, points.policy]).transform("any")


def onsets(levels: Iterable[float], shown: Iterable[bool], holds: Iterable[bool]) -> list[Onset]:
    """The levels at which something is shown. It lasts if it `holds`, shown or not, at all later ones."""
    later = list(holds)
    return [
        Onset(float(level), all(later[i + 1 :]))
        for i, (level, one) in enumerate(zip(levels, shown, strict=True))
        if one
    ]


def change_between(before: pd.DataFrame, after: pd.DataFrame, score: str) -> tuple[float, float]:
    """The p-value for no change in the `score` of one policy, from its rows of `episodes.csv`, and the change."""
    before, after = before.set_index("episode"), after.set_index("episode")
    both = before.index.intersection(after.index)
    if both.empty:
        return 1.0, 0.0
    before, after = before.loc[both], after.loc[both]
    if score == "return":
        higher = paired_superiority(after["return"].to_numpy(), before["return"].to_numpy())
        return higher.p, 2 * higher.probability.value - 1
    won, won_after = before.success.astype(bool), after.success.astype(bool)
    lost, gained = int((won & ~won_after).sum()), int((~won & won_after).sum())
    return mcnemar(lost, gained), (gained - lost) / len(both)


def change_of_group(before: pd.DataFrame, after: pd.DataFrame, score: str) -> tuple[float, float]:
    """The same over a group's trainings and episodes; (1, 0) if there is nothing to compare."""
    tables = (one.pivot(index="policy", columns="episode", values=score).astype(float) for one in (before, after))
    first, second = (one.dropna(axis=1) for one in tables)
    both = first.columns.intersection(second.columns)
    changes = sign_of_difference(second[both].to_numpy(), first[both].to_numpy())
    if 0 in changes.shape:
        return 1.0, 0.0
    change = mean_over_trainings(changes, (-1.0, 1.0))
    return 1.0 if change.p is None else change.p, change.mean.value
