"""Who holds out against what: the policies of a sweep, compared with each other at each level of each disturbance."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from armctl.evaluation.degradation import FALSE_DISCOVERY_RATE, Onset, degradations, onsets

SUCCESS, RETURN = ("success", "low", "high"), ("return", "return_low", "return_high")
"""Columns of `sweep.csv`: a score, and its 95 % interval."""
MOST_EPISODES = 10**6
"""Fisher's test of more takes too long for a row that somebody else has written."""
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
class Endurance:
    """Who holds out longest against a disturbance."""

    disturbance: str
    leaders: Sequence[str]
    """The policy with the largest mean lead over all others and disturbed levels, and those that are at no level
    shown to be worse."""
    behind: Mapping[str, Onset]
    """Where a policy is shown to be worse than the first leader. It lasts if it is not better at any later level."""
    from_the_start: Sequence[str]
    """Those that are behind without the disturbance already."""
    unharmed: bool
    """Whether no leader is shown to get worse itself."""
    strongest: str
    """The level that is furthest from the neutral one, with its unit."""
    scores: Mapping[str, str]
    """Success or return of each policy there, with its 95 % interval."""

    @property
    def ranked(self) -> bool:
        """Whether anybody is shown to be worse than the leaders."""
        return bool(self.behind or self.from_the_start)

    def __str__(self) -> str:
        told = f"Against {self.disturbance}, "
        if self.ranked:
            told += _held(self.leaders, self.unharmed)
        elif len(self.leaders) > 1:
            told += f"no difference is shown between {_named(self.leaders)}"
        else:
            told += f"only {self.leaders[0]} has played"
        shown = (*self.leaders, *self.behind, *self.from_the_start)
        at = ", ".join(f"{name} {self.scores[name]}" for name in shown if name in self.scores)
        after = [f"{name} falls behind {onset}" for name, onset in self.behind.items()]
        if self.from_the_start:
            after.append(f"{_named(self.from_the_start, 'is', 'are')} behind undisturbed already")
        return f"{told}: at {self.strongest}, {at}. {'; '.join(after)}{'.' if after else ''}".rstrip()


def endurances(points: pd.DataFrame, pairs: Mapping[Pair, PairTest]) -> list[Endurance]:
    """Who holds out longest against each disturbance, from the rows of `sweep.csv`.

    `pairs` are the tests of each two policies in the same episodes (`Sweep.pairs`). They differ at a level if that
    shows it at a false discovery rate of 5 % over all pairs, levels and disturbances, in the direction of the statistic
    that was tested. Sweeps of older versions have no such tests: Fisher's exact test takes their place, for groups of
    trainings whether 95 % intervals overlap, and returns show no difference.
    """
    score, low, high = SUCCESS if points.success.notna().any() else RETURN
    if not {score, low, high} <= set(points):
        return []
    known = points[points[score].notna() & points.groupby("disturbance")["level"].transform("nunique").gt(1)]
    if known.empty:
        return []
    neutral = known.groupby("disturbance")["level"].transform("first")
    tests: dict[Pair, PairTest] = {}
    for (disturbance, level, first), rows in known.groupby(["disturbance", "level", neutral.rename("neutral")]):
        for a, b in itertools.combinations(rows.to_dict("records"), 2):
            pair = _pair(str(disturbance), float(str(level)), float(str(first)), str(a["policy"]), str(b["policy"]))
            if pair in pairs:
                tests[pair] = pairs[pair]
            elif pair not in tests:
                tests[pair] = _from_rows(a, b) if score == "success" else PairTest(1.0, 0.0)
    corrected: Any = stats.false_discovery_control([test.p for test in tests.values()]) if tests else []
    apart = {pair for pair, one in zip(tests, corrected, strict=True) if one < FALSE_DISCOVERY_RATE}
    harmed = _harmed(known)
    return [
        _endurance(str(name), rows, score, (low, high), tests, apart, harmed)
        for name, rows in known.groupby("disturbance", sort=False)
    ]


def endurance_headline(found: Sequence[Endurance]) -> str:
    """Who holds out against what, in a sentence; empty without any disturbance."""
    against: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for one in found:
        leaders = tuple(sorted(one.leaders)) if one.ranked else ()
        against.setdefault((leaders, one.unharmed and one.ranked), []).append(one.disturbance)
    nobody = against.pop(((), False), [])
    ranked = sorted(against.items(), key=lambda item: -len(item[1]))
    said = [
        f"{_held(names, unharmed)} {'against' if unharmed else 'under'} {_named(what)}"
        for (names, unharmed), what in ranked
    ]
    said += [f"{'under' if said else 'Under'} {_named(nobody)}, nobody is shown to fall behind"] if nobody else []
    return f"{'; '.join(said)}." if said else ""


def _pair(disturbance: str, level: float, neutral: float, *policies: str) -> Pair:
    where = NEUTRAL if level == neutral else (disturbance, level)
    return (*where, frozenset(policies))


def _harmed(known: pd.DataFrame) -> set[tuple[str, str]]:
    """Disturbances, and the policies that they are shown to harm; where p is unknown, whoever gets worse at all."""
    p = pd.to_numeric(known["p"], errors="coerce") if "p" in known else pd.Series(np.nan, known.index)
    found = degradations(known.assign(p=p.where(p.between(0, 1), 0.0), sees=""))
    return {(one.disturbance, one.policy) for one in found if one.drops}


def _endurance(
    disturbance: str,
    rows: pd.DataFrame,
    score: str,
    bounds: tuple[str, str],
    tests: Mapping[Pair, PairTest],
    apart: set[Pair],
    harmed: set[tuple[str, str]],
) -> Endurance:
    levels = [float(level) for level in rows.level.unique()]
    played: dict[str, list[float]] = {}
    for one in rows.to_dict("records"):
        played.setdefault(str(one["policy"]), []).append(float(one["level"]))

    def gain(level: float, name: str, other: str) -> float:
        lead = tests[_pair(disturbance, level, levels[0], name, other)].lead
        return lead if name < other else -lead

    def mean_lead(name: str) -> float:
        if set(levels[1:]) - set(played[name]):
            return -np.inf
        others = [(level, other) for other in played if other != name for level in levels[1:] if level in played[other]]
        return float(np.mean([gain(level, name, other) for level, other in others])) if others else 0.0

    leader = max(played, key=mean_lead)
    leaders, behind, before = [leader], {}, []
    for name in (name for name in played if name != leader):
        shared = [level for level in levels if level in played[name] and level in played[leader]]
        gains = [gain(level, name, leader) for level in shared]
        worse = [
            gain < 0 and _pair(disturbance, level, levels[0], name, leader) in apart
            for level, gain in zip(shared, gains, strict=True)
        ]
        found = onsets(shared, worse, [gain <= 0 for gain in gains])
        if not found:
            leaders.append(name)
            continue
        onset = next((one for one in found if one.lasts), found[0])
        if onset == Onset(levels[0]):
            before.append(name)
        else:
            behind[name] = onset
    percent, digits = (100.0, 0) if score == "success" else (1.0, 1)
    at = {}
    for one in rows[rows.level == levels[-1]].to_dict("records"):
        value, low, high = (percent * one[column] for column in (score, *bounds))
        interval = "" if np.isnan(low) else f" [{low:.{digits}f}, {high:.{digits}f}]"
        at[str(one["policy"])] = f"{value:.{digits}f}{' %' * (percent > 1)}{interval}"
    unit = rows["unit"].iloc[0] if "unit" in rows else None
    strongest = f"{levels[-1]:g}{f' ({unit})' if isinstance(unit, str) else ''}"
    unharmed = not any((disturbance, name) in harmed for name in leaders)
    return Endurance(disturbance, leaders, behind, before, unharmed, strongest, at)


def _from_rows(a: Mapping[Any, Any], b: Mapping[Any, Any]) -> PairTest:
    """The test of a pair whose episodes are unknown: Fisher's, or whether intervals overlap."""
    first, second = sorted((a, b), key=lambda row: str(row["policy"]))
    (score, low, high), fisher = SUCCESS, _fisher(a, b)
    overlap = not (a[low] > b[high] or b[low] > a[high])
    return PairTest(float(overlap) if fisher is None else fisher, first[score] - second[score])


def _fisher(a: Mapping[Any, Any], b: Mapping[Any, Any]) -> float | None:
    """The p-value of Fisher's exact test for equal success; None if counts are unknown, or of several networks."""
    counts = []
    for row in (a, b):
        episodes = row.get("episodes")
        if str(row["policy"]).endswith(GROUP):
            return None
        if not (isinstance(episodes, int) and 0 < episodes <= MOST_EPISODES and 0 <= row["success"] <= 1):
            return None
        won = round(row["success"] * episodes)
        counts.append((won, episodes - won))
    return float(stats.fisher_exact(np.array(counts)).pvalue)


def _held(names: Sequence[str], unharmed: bool) -> str:
    if unharmed:
        return f"{_named(names, 'holds', 'hold')} out longest"
    return f"{_named(names, 'is', 'are')} ahead"


def _named(names: Sequence[str], one: str = "", several: str = "") -> str:
    """Names as a list in a sentence, and the verb that goes with them."""
    text = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return f"{text} {one if len(names) == 1 else several}".rstrip()
