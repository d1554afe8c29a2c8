"""Degradation of policies by disturbances, level by level, and their robustness ranking."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from armctl.core.arrays import Array
from armctl.stats.difference import MARGIN, Difference
from armctl.stats.intervals import sign_of_difference
from armctl.stats.paired import mcnemar
from armctl.stats.sequential import ConfidenceSequence
from armctl.stats.trainings import difference_over_trainings, mean_over_trainings, superiority_over_trainings
from armctl.stats.unpaired import unconditional

if TYPE_CHECKING:
    import pandas as pd

FALSE_DISCOVERY_RATE = 0.05
"""False discovery rate of the significant drops in success of a sweep (Benjamini and Hochberg 1995)."""
SUCCESS, RETURN = ("success", "low", "high"), ("return", "return_low", "return_high")
"""Columns of `sweep.csv`: a score, and its 95 % interval."""
PairKey = tuple[str, float, frozenset[str]]
"""A disturbance, a level, and two policies."""


NEUTRAL = ("none", 0.0)
"""The disturbance and level of a pair without any: all disturbances share these episodes."""
GROUP = "[*]"
"""End of the name of several trainings."""


@dataclass(frozen=True)
class Onset:
    """A level at which a change is significant."""

    level: float
    lasts: bool = True
    """True if the figures agree at all later levels."""

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
    largest_drop: tuple[float, float] | None
    """The largest drop of the tested statistic, significant or not, and its level; None if it falls nowhere."""


def degradations(points: "pd.DataFrame") -> list[Degradation]:
    """Return the effect of each disturbance on each policy that it reaches, from the rows of `sweep.csv`.

    The direction of a change is that of the statistic that `p` tests (the column `change`).
    """
    import pandas as pd

    points = points[~spares(points)]
    points = points.assign(neutral=~points.duplicated(["disturbance", "policy"]))
    levels = points[~points.neutral]
    significant = pd.Series(False, index=points.index)
    if len(levels):
        significant[levels.index] = scipy.stats.false_discovery_control(levels.p) < FALSE_DISCOVERY_RATE
    change = pd.to_numeric(points["change"], errors="coerce")
    points = points.assign(
        change=change, fell=change < 0, drops=significant & (change < 0), below_half=points.success < 0.5
    )
    return [
        Degradation(
            str(disturbance),
            str(policy),
            str(rows.sees.iloc[0]),
            next(iter(onsets(rows.level, rows.drops, rows.fell)), None),
            next(iter(onsets(rows.level, rows.below_half, rows.below_half)), None),
            min(
                ((float(x), float(level)) for x, level in zip(rows["change"], rows.level, strict=True) if x < 0),
                default=None,
            ),
        )
        for (disturbance, policy), rows in points.groupby(["disturbance", "policy"], sort=False)
    ]


def spares(points: "pd.DataFrame") -> "pd.Series[bool]":
    """Return which rows of `sweep.csv` are of a disturbance and of a policy that it does not reach at some level."""
    spared = points.spared.astype(str) == "True"
    return spared.groupby([points.disturbance, points.policy]).transform("any")


def onsets(levels: Iterable[float], significant: Iterable[bool], holds: Iterable[bool]) -> list[Onset]:
    """Return the levels of significant changes. A change lasts if it `holds`, significant or not, at all later ones."""
    later = list(holds)
    return [
        Onset(float(level), all(later[i + 1 :]))
        for i, (level, is_significant) in enumerate(zip(levels, significant, strict=True))
        if is_significant
    ]


def change_between(
    undisturbed: "pd.DataFrame", disturbed: "pd.DataFrame", score: str, paired: bool = True, any_number: bool = False
) -> tuple[float, float]:
    """Return the p-value for no change in the `score` of a policy, from its rows of `episodes.csv`, and the change.

    (1, 0) if there is nothing to compare. Episodes of the same number are the same ones if they are `paired`. The
    p-value holds at `any_number` of them if asked for, except for trainings.
    """
    tables = (rows.pivot(index="policy", columns="episode", values=score) for rows in (undisturbed, disturbed))
    finished = [table.astype(float).dropna(axis=1) for table in tables]
    if paired:
        episodes = finished[0].columns.intersection(finished[1].columns)
        finished = [table[episodes] for table in finished]
    first, second = (table.to_numpy() for table in finished)
    if 0 in (*first.shape, *second.shape):
        return 1.0, 0.0
    if not paired:
        return _unpaired_change(first, second, score)
    if len(first) > 1:  # a group: over its trainings and episodes
        change = mean_over_trainings(sign_of_difference(second, first), (-1.0, 1.0))
        return 1.0 if change.p is None else change.p, change.mean.value
    signs = sign_of_difference(second[0], first[0])
    if any_number:
        return ConfidenceSequence(signs, (-1.0, 1.0)).p(), float(signs.mean())
    return mcnemar(int((signs < 0).sum()), int((signs > 0).sum())), float(signs.mean())


def _unpaired_change(first: Array, second: Array, score: str) -> tuple[float, float]:
    """Return what `change_between` does, of scores (trainings, episodes) in different episodes."""
    if score == "return":
        higher, _ = superiority_over_trainings(second, first, paired=False)
        return higher.p, 2 * higher.probability.value - 1
    if len(first) > 1:
        change = difference_over_trainings(second, first, (0.0, 1.0), paired=False)
        return 1.0 if change.p is None else change.p, change.estimate.value
    lost, won = int(first.sum()), int(second.sum())
    return unconditional(won, second.shape[1], lost, first.shape[1]), won / second.shape[1] - lost / first.shape[1]


@dataclass(frozen=True)
class RobustnessRanking:
    """The policies that a disturbance reaches, from its tests of each two of them."""

    disturbance: str
    first: str
    """The policy with the largest mean lead over all others and disturbed levels; empty without a test."""
    not_worse: Sequence[str]
    """Policies that are at no level significantly worse than the first."""
    worse: Mapping[str, Onset]
    """Onsets of significantly worse policies. An onset lasts if the policy is not better at any later level."""
    better: Mapping[str, Onset]
    """Onsets of policies that are significantly better than the first, which was chosen by its mean."""
    spared: Sequence[str]
    """Policies that the disturbance does not reach: they are not ranked."""
    neutral: float
    """The level that changes nothing."""
    strongest: str
    """The level that is furthest from the neutral one, with its unit."""
    scores: Mapping[str, str]
    """Success or return of each ranked policy there, with its 95 % interval."""
    score: str
    """Name of the score whose mean is highest for the first."""
    episodes: int
    """Number of episodes of the smallest test among these policies."""
    equivalent: bool
    """True if success of each two of them is shown to differ by less than `MARGIN`, at every level."""
    differ: bool
    """True if the test of any two of them is significant, at any level."""

    @property
    def leads(self) -> bool:
        """True if the first is significantly better than all others ranked, and at no level worse."""
        return bool(self.worse) and not self.not_worse and not self.better

    @property
    def claim(self) -> str:
        """The result, without the levels at which others are worse."""
        if not self.first:
            return "no ranking: fewer than two policies are affected and tested"
        points = f"{100 * MARGIN:g} points"
        if self.leads:
            return f"{self.first} leads{f', but by less than {points}' if self.equivalent else ''}"
        if self.equivalent:
            return f"all policies are equivalent in success within {points} at all levels"
        if not self.differ:
            return f"undecided: no significant difference between policies in {self.episodes} episodes"
        beside = [f"not shown to be worse: {', '.join(self.not_worse)}"] if self.not_worse else []
        beside += [f"better {_where(self.better)}"] if self.better else []
        return f"highest mean {self.score}: {self.first} ({'; '.join(beside)})"

    def __str__(self) -> str:
        names = dict.fromkeys((self.first, *self.not_worse, *self.worse, *self.better))
        sentences = [f"Under {self.disturbance}, {self.claim}"]
        if self.worse:
            sentences[0] += f"; worse: {_where(self.worse, self.neutral)}"
        if at := ", ".join(f"{name} {self.scores[name]}" for name in names if name in self.scores):
            sentences.append(f"At {self.strongest}: {at}")
        if self.spared:
            sentences.append(f"Not affected, so not ranked: {', '.join(self.spared)}")
        return f"{'. '.join(sentences)}."


def robustness_rankings(points: "pd.DataFrame", pairs: Mapping[PairKey, Difference]) -> list[RobustnessRanking]:
    """Return the ranking under each disturbance, from the rows of `sweep.csv`.

    `pairs` are the tests of each two policies (`Sweep.pairs`). Two policies differ at a level if
    their test is significant at a false discovery rate of 5 % over all pairs, levels and disturbances, in the direction
    of the statistic that was tested. Policies that a disturbance does not reach are in none of these tests.
    """
    score, low, high = SUCCESS if points.success.notna().any() else RETURN
    if not {score, low, high} <= set(points):
        return []
    scored = points[points[score].notna() & points.groupby("disturbance")["level"].transform("nunique").gt(1)]
    if scored.empty:
        return []
    ranked = scored[~spares(scored)]
    tests = {pair: pairs[pair] for pair in _pairs_of(ranked) if pair in pairs}
    adjusted: Any = scipy.stats.false_discovery_control([test.p for test in tests.values()]) if tests else []
    significant = {pair for pair, p in zip(tests, adjusted, strict=True) if p < FALSE_DISCOVERY_RATE}
    count = scored.disturbance.nunique()
    return [
        _ranking(str(name), rows, ranked[ranked.disturbance == name], (score, low, high), tests, significant, count)
        for name, rows in scored.groupby("disturbance", sort=False)
    ]


def robustness_headline(rankings: Sequence[RobustnessRanking]) -> str:
    """Return the results under all disturbances in a sentence; empty without any disturbance."""
    under: dict[str, list[str]] = {}
    for ranking in rankings:
        under.setdefault(ranking.claim, []).append(ranking.disturbance)
    claims = sorted(under.items(), key=lambda item: (item[0].startswith(("no ", "undecided")), -len(item[1])))
    sentence = "; ".join(f"under {listed(names)}, {claim}" for claim, names in claims)
    return f"{sentence[0].upper()}{sentence[1:]}." if sentence else ""


def _pairs_of(ranked: "pd.DataFrame") -> list[PairKey]:
    """Return each two policies at each level of each disturbance; the undisturbed level, which all share, once."""
    neutral = ranked.groupby("disturbance")["level"].transform("first")
    pairs: dict[PairKey, None] = {}
    for (disturbance, level, first), rows in ranked.groupby(["disturbance", "level", neutral.rename("neutral")]):
        for policies in itertools.combinations(rows.policy.astype(str).unique(), 2):
            pairs[_pair(str(disturbance), float(str(level)), float(str(first)), *policies)] = None
    return list(pairs)


def _pair(disturbance: str, level: float, neutral: float, *policies: str) -> PairKey:
    where = NEUTRAL if level == neutral else (disturbance, level)
    return (*where, frozenset(policies))


def _ranking(
    disturbance: str,
    rows: "pd.DataFrame",
    ranked: "pd.DataFrame",
    columns: tuple[str, str, str],
    tests: Mapping[PairKey, Difference],
    significant: set[PairKey],
    num_disturbances: int,
) -> RobustnessRanking:
    levels = [float(level) for level in rows.level.unique()]
    names = list(dict.fromkeys(ranked.policy.astype(str)))

    def gains(name: str, other: str) -> dict[float, float]:
        """Return the lead of a policy over another one, by level, as far as it is tested."""
        by_level = {level: tests.get(_pair(disturbance, level, levels[0], name, other)) for level in levels}
        return {level: test.lead_of(name) for level, test in by_level.items() if test}

    def mean_lead(name: str) -> float:
        leads = [gains(name, other) for other in names if other != name]
        disturbed = [gain for by_level in leads for level, gain in by_level.items() if level != levels[0]]
        own_levels = set(ranked.level[ranked.policy.astype(str) == name].astype(float))
        return float(np.mean(disturbed)) if disturbed and own_levels >= set(levels) else -np.inf

    first = max(names, key=mean_lead, default="")
    if not first or mean_lead(first) == -np.inf:
        first, names = "", []
    not_worse, worse, better = [], {}, {}
    for name in names:
        gain = gains(name, first) if name != first else {}
        tested = {x for x in gain if _pair(disturbance, x, levels[0], name, first) in significant}
        if behind := onsets(gain, [gain[x] < 0 and x in tested for x in gain], [gain[x] <= 0 for x in gain]):
            worse[name] = next((onset for onset in behind if onset.lasts), behind[0])
        elif name != first:
            not_worse.append(name)
        above = {x: value for x, value in gain.items() if x != levels[0]}
        if ahead := onsets(above, [above[x] > 0 and x in tested for x in above], [above[x] >= 0 for x in above]):
            better[name] = next((onset for onset in ahead if onset.lasts), ahead[0])
    unit = rows["unit"].iloc[0]
    pairs = {_pair(disturbance, x, levels[0], *two) for x in levels for two in itertools.combinations(names, 2)}
    covered = pairs & tests.keys()
    return RobustnessRanking(
        disturbance,
        first,
        [name for name in not_worse if name not in better],
        worse,
        better,
        sorted(set(rows.policy.astype(str)) - set(ranked.policy.astype(str))),
        levels[0],
        f"{levels[-1]:g}{f' ({unit})' if isinstance(unit, str) else ''}",
        {str(row["policy"]): _score(row, columns) for row in ranked[ranked.level == levels[-1]].to_dict("records")},
        "success" if columns == SUCCESS else "share of higher returns",
        min((tests[pair].episodes for pair in covered), default=0),
        covered == pairs and all(_equivalent(tests[pair], num_disturbances) for pair in covered),
        not significant.isdisjoint(pairs),
    )


def _equivalent(test: Difference, num_disturbances: int) -> bool:
    """Return True for equivalence in one of so many claims, each of which needs it at all of its levels.

    That all levels must show it needs no correction; that there are several claims does. Groups of trainings are left
    out, since their interval is for another number of claims.
    """
    return test.crossed is None and test.equivalent(MARGIN, num_disturbances)


def _score(row: Mapping[Any, Any], columns: tuple[str, str, str]) -> str:
    percent, digits = (100.0, 0) if columns == SUCCESS else (1.0, 1)
    value, low, high = (percent * row[column] for column in columns)
    interval = "" if np.isnan(low) else f" [{low:.{digits}f}, {high:.{digits}f}]"
    return f"{value:.{digits}f}{' %' * (percent > 1)}{interval}"


def _where(onset_of: Mapping[str, Onset], neutral: float | None = None) -> str:
    """Return policies with the levels of their onsets."""
    undisturbed = Onset(neutral) if neutral is not None else None
    return ", ".join(
        f"{name} {'also undisturbed' if onset == undisturbed else onset}" for name, onset in onset_of.items()
    )


def listed(names: Sequence[str]) -> str:
    """Return names with commas and a last "and"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
