"""The robustness ranking: the policies of a sweep, compared with each other at each level of each disturbance."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from armctl.stats.degradation import FALSE_DISCOVERY_RATE, Onset, onsets, spares

SUCCESS, RETURN = ("success", "low", "high"), ("return", "return_low", "return_high")
"""Columns of `sweep.csv`: a score, and its 95 % interval."""
Pair = tuple[str, float, frozenset[str]]
"""A disturbance, a level, and two policies."""


class PairTest(NamedTuple):
    """A test of two policies on the same episodes, and the statistic that it tests."""

    p: float
    lead: float
    """Success of the policy whose name comes first minus that of the other; if success is unknown, the share of
    episodes in which it has the higher return minus the share in which it has the lower one."""


NEUTRAL = ("none", 0.0)
"""The disturbance and level of a pair without any: all disturbances share these episodes."""
GROUP = "[*]"
"""Ends the name of several trainings."""


@dataclass(frozen=True)
class RobustnessRanking:
    """The policies that a disturbance reaches, from its tests of each two of them."""

    disturbance: str
    first: str
    """The policy with the largest mean lead over all others and disturbed levels; empty without a test."""
    alike: Sequence[str]
    """Those that are at no level shown to be worse than the first."""
    worse: Mapping[str, Onset]
    """Where others are shown to be worse than the first. It lasts if they are not better at any later level."""
    better: Mapping[str, Onset]
    """Where any is shown to be better than the first, which was chosen by its mean."""
    spared: Sequence[str]
    """Those that the disturbance does not reach: they are not ranked."""
    neutral: float
    """The level that changes nothing."""
    strongest: str
    """The level that is furthest from the neutral one, with its unit."""
    scores: Mapping[str, str]
    """Success or return of each ranked policy there, with its 95 % interval."""
    score: str
    """What is highest in the first one's mean."""

    @property
    def leads(self) -> bool:
        """Whether the first is shown to be better than all others ranked, and never to be worse."""
        return bool(self.worse) and not self.alike and not self.better

    @property
    def claim(self) -> str:
        """What is shown, without the levels at which others are worse."""
        if not self.first:
            return "no ranking: fewer than two policies are reached and tested"
        if self.leads:
            return f"{self.first} leads"
        if not self.worse and not self.better:
            return "no significant difference between policies"
        beside = [f"not shown to be worse: {', '.join(self.alike)}"] if self.alike else []
        beside += [f"better {_where(self.better)}"] if self.better else []
        return f"highest mean {self.score}: {self.first} ({'; '.join(beside)})"

    def __str__(self) -> str:
        shown = dict.fromkeys((self.first, *self.alike, *self.worse, *self.better))
        said = [f"Under {self.disturbance}, {self.claim}"]
        if self.worse:
            said[0] += f"; worse: {_where(self.worse, self.neutral)}"
        if at := ", ".join(f"{name} {self.scores[name]}" for name in shown if name in self.scores):
            said.append(f"At {self.strongest}: {at}")
        if self.spared:
            said.append(f"Spared, and so not ranked: {', '.join(self.spared)}")
        return f"{'. '.join(said)}."


def robustness_rankings(points: pd.DataFrame, pairs: Mapping[Pair, PairTest]) -> list[RobustnessRanking]:
    """Return the ranking under each disturbance, from the rows of `sweep.csv`.

    `pairs` are the tests of each two policies in the same episodes (`Sweep.pairs`). They differ at a level if that
    shows it at a false discovery rate of 5 % over all pairs, levels and disturbances, in the direction of the statistic
    that was tested. Policies that a disturbance does not reach are in none of these tests.
    """
    score, low, high = SUCCESS if points.success.notna().any() else RETURN
    if not {score, low, high} <= set(points):
        return []
    known = points[points[score].notna() & points.groupby("disturbance")["level"].transform("nunique").gt(1)]
    if known.empty:
        return []
    ranked = known[~spares(known)]
    tests = {pair: pairs[pair] for pair in _pairs_of(ranked) if pair in pairs}
    corrected: Any = stats.false_discovery_control([test.p for test in tests.values()]) if tests else []
    apart = {pair for pair, p in zip(tests, corrected, strict=True) if p < FALSE_DISCOVERY_RATE}
    return [
        _ranking(str(name), rows, ranked[ranked.disturbance == name], (score, low, high), tests, apart)
        for name, rows in known.groupby("disturbance", sort=False)
    ]


def robustness_headline(rankings: Sequence[RobustnessRanking]) -> str:
    """Return what is shown under which disturbances, in a sentence; empty without any disturbance."""
    under: dict[str, list[str]] = {}
    for ranking in rankings:
        under.setdefault(ranking.claim, []).append(ranking.disturbance)
    claims = sorted(under.items(), key=lambda item: (item[0].startswith("no "), -len(item[1])))
    said = "; ".join(f"under {_listed(names)}, {claim}" for claim, names in claims)
    return f"{said[0].upper()}{said[1:]}." if said else ""


def _pairs_of(ranked: pd.DataFrame) -> list[Pair]:
    """Each two policies at each level of each disturbance; the undisturbed level, which all share, once."""
    neutral = ranked.groupby("disturbance")["level"].transform("first")
    pairs: dict[Pair, None] = {}
    for (disturbance, level, first), rows in ranked.groupby(["disturbance", "level", neutral.rename("neutral")]):
        for both in itertools.combinations(rows.policy.astype(str).unique(), 2):
            pairs[_pair(str(disturbance), float(str(level)), float(str(first)), *both)] = None
    return list(pairs)


def _pair(disturbance: str, level: float, neutral: float, *policies: str) -> Pair:
    where = NEUTRAL if level == neutral else (disturbance, level)
    return (*where, frozenset(policies))


def _ranking(
    disturbance: str,
    rows: pd.DataFrame,
    ranked: pd.DataFrame,
    columns: tuple[str, str, str],
    tests: Mapping[Pair, PairTest],
    apart: set[Pair],
) -> RobustnessRanking:
    levels = [float(level) for level in rows.level.unique()]
    names = list(dict.fromkeys(ranked.policy.astype(str)))

    def gains(name: str, other: str) -> dict[float, float]:
        """The lead of a policy over another one, by level, as far as it is tested."""
        found = {level: tests.get(_pair(disturbance, level, levels[0], name, other)) for level in levels}
        return {level: test.lead if name < other else -test.lead for level, test in found.items() if test}

    def mean_lead(name: str) -> float:
        leads = [gains(name, other) for other in names if other != name]
        disturbed = [gain for by_level in leads for level, gain in by_level.items() if level != levels[0]]
        played = set(ranked.level[ranked.policy.astype(str) == name].astype(float))
        return float(np.mean(disturbed)) if disturbed and played >= set(levels) else -np.inf

    first = max(names, key=mean_lead, default="")
    if not first or mean_lead(first) == -np.inf:
        first, names = "", []
    alike, worse, better = [], {}, {}
    for name in names:
        gain = gains(name, first) if name != first else {}
        shown = {level for level in gain if _pair(disturbance, level, levels[0], name, first) in apart}
        if behind := onsets(gain, [gain[x] < 0 and x in shown for x in gain], [gain[x] <= 0 for x in gain]):
            worse[name] = next((onset for onset in behind if onset.lasts), behind[0])
        elif name != first:
            alike.append(name)
        above = {x: value for x, value in gain.items() if x != levels[0]}
        if ahead := onsets(above, [above[x] > 0 and x in shown for x in above], [above[x] >= 0 for x in above]):
            better[name] = next((onset for onset in ahead if onset.lasts), ahead[0])
    unit = rows["unit"].iloc[0] if "unit" in rows else None
    return RobustnessRanking(
        disturbance,
        first,
        [name for name in alike if name not in better],
        worse,
        better,
        sorted(set(rows.policy.astype(str)) - set(ranked.policy.astype(str))),
        levels[0],
        f"{levels[-1]:g}{f' ({unit})' if isinstance(unit, str) else ''}",
        {str(row["policy"]): _score(row, columns) for row in ranked[ranked.level == levels[-1]].to_dict("records")},
        "success" if columns == SUCCESS else "share of higher returns",
    )


def _score(row: Mapping[Any, Any], columns: tuple[str, str, str]) -> str:
    percent, digits = (100.0, 0) if columns == SUCCESS else (1.0, 1)
    value, low, high = (percent * row[column] for column in columns)
    interval = "" if np.isnan(low) else f" [{low:.{digits}f}, {high:.{digits}f}]"
    return f"{value:.{digits}f}{' %' * (percent > 1)}{interval}"


def _where(onset_of: Mapping[str, Onset], neutral: float | None = None) -> str:
    """Policies and the levels from which something is shown of them."""
    undisturbed = Onset(neutral) if neutral is not None else None
    return ", ".join(
        f"{name} {'also undisturbed' if onset == undisturbed else onset}" for name, onset in onset_of.items()
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
