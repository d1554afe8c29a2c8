"""Who holds out against what: the policies of a sweep, compared with each other at each level of each disturbance."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from armctl.evaluation.degradation import FALSE_DISCOVERY_RATE

SUCCESS, RETURN = ("success", "low", "high"), ("return", "return_low", "return_high")
"""Columns of `sweep.csv`: a score, and its 95 % interval."""
MOST_EPISODES = 10**6
"""Fisher's test of more takes too long for a row that somebody else has written."""
Pair = tuple[str, float, frozenset[str]]
"""A disturbance, a level, and two policies."""


@dataclass(frozen=True)
class Endurance:
    """Who holds out longest against a disturbance."""

    disturbance: str
    leaders: Sequence[str]
    """The policy with the best mean over all disturbed levels, and those that are never shown to fall behind it."""
    behind: Mapping[str, float]
    """From which level on a policy is worse than the first leader: significantly there, and in figures from then on."""
    from_the_start: Sequence[str]
    """Those that are behind without the disturbance already."""
    strongest: str
    """The level that is furthest from the neutral one, with its unit."""
    scores: Mapping[str, str]
    """Success or return of each policy there, with its 95 % interval."""

    def __str__(self) -> str:
        if not self.behind:
            told = f"Against {self.disturbance}, {_named(self.leaders)}"
            told += " cannot be told apart" if len(self.leaders) > 1 else " holds out"
        else:
            told = f"Against {self.disturbance}, {_named(self.leaders, 'holds', 'hold')} out longest"
        at = ", ".join(f"{name} {self.scores[name]}" for name in (*self.leaders, *self.behind) if name in self.scores)
        after = [f"{name} falls behind from {level:g} on" for name, level in self.behind.items()]
        if self.from_the_start:
            after.append(f"{_named(self.from_the_start, 'is', 'are')} behind undisturbed already")
        return f"{told}: at {self.strongest}, {at}. {'; '.join(after)}{'.' if after else ''}".rstrip()


def endurances(points: pd.DataFrame) -> list[Endurance]:
    """Who holds out longest against each disturbance, from the rows of `sweep.csv`.

    Two policies differ at a level if Fisher's exact test tells their successes apart, at a false discovery rate of 5 %
    over all pairs, levels and disturbances. Since they play the same episodes, that is on the safe side. Where success
    or the number of episodes is unknown, their 95 % intervals must not overlap.
    """
    score, low, high = SUCCESS if points.success.notna().any() else RETURN
    if not {score, low, high} <= set(points):
        return []
    known = points[points[score].notna() & points.groupby("disturbance")["level"].transform("nunique").gt(1)]
    p: dict[Pair, float] = {}
    for (disturbance, level), rows in known.groupby(["disturbance", "level"]):
        for a, b in itertools.combinations(rows.to_dict("records"), 2):
            both = frozenset((str(a["policy"]), str(b["policy"])))
            overlap = not (a[low] > b[high] or b[low] > a[high])
            fisher = _fisher(a, b) if score == "success" else None
            p[str(disturbance), float(str(level)), both] = float(overlap) if fisher is None else fisher
    corrected: Any = stats.false_discovery_control(list(p.values())) if p else []
    apart = {pair for pair, one in zip(p, corrected, strict=True) if one < FALSE_DISCOVERY_RATE}
    return [
        _endurance(str(name), rows, score, (low, high), apart)
        for name, rows in known.groupby("disturbance", sort=False)
    ]


def endurance_headline(found: Sequence[Endurance]) -> str:
    """Who holds out against what, in a sentence; empty without any disturbance."""
    against: dict[tuple[str, ...], list[str]] = {}
    for one in found:
        against.setdefault(tuple(sorted(one.leaders)) if one.behind else (), []).append(one.disturbance)
    nobody = against.pop((), [])
    ranked = sorted(against.items(), key=lambda item: -len(item[1]))
    said = [f"{_named(names, 'holds', 'hold')} out longest against {_named(what)}" for names, what in ranked]
    said += [f"{'under' if said else 'Under'} {_named(nobody)}, nobody is shown to fall behind"] if nobody else []
    return f"{'; '.join(said)}." if said else ""


def _endurance(
    disturbance: str, rows: pd.DataFrame, score: str, bounds: tuple[str, str], apart: set[Pair]
) -> Endurance:
    levels = [float(level) for level in rows.level.unique()]
    values: dict[str, dict[float, float]] = {}
    for one in rows.to_dict("records"):
        values.setdefault(str(one["policy"]), {})[float(one["level"])] = float(one[score])
    leader = max(values, key=lambda name: np.mean([values[name].get(level, -np.inf) for level in levels[1:]]))
    leaders, behind, before = [leader], {}, []
    for name in (name for name in values if name != leader):
        shared = [level for level in levels if level in values[name] and level in values[leader]]
        worse = [values[name][level] < values[leader][level] for level in shared]
        shown = [(disturbance, level, frozenset((name, leader))) in apart for level in shared]
        first = next((level for i, level in enumerate(shared) if shown[i] and all(worse[i:])), None)
        if first is None:
            leaders.append(name)
        elif first == levels[0]:
            before.append(name)
        else:
            behind[name] = first
    percent, digits = (100.0, 0) if score == "success" else (1.0, 1)
    at = {
        str(one["policy"]): f"{percent * one[score]:.{digits}f}{' %' * (percent > 1)} "
        f"[{percent * one[bounds[0]]:.{digits}f}, {percent * one[bounds[1]]:.{digits}f}]"
        for one in rows[rows.level == levels[-1]].to_dict("records")
    }
    unit = rows["unit"].iloc[0] if "unit" in rows else None
    strongest = f"{levels[-1]:g}{f' ({unit})' if isinstance(unit, str) else ''}"
    return Endurance(disturbance, leaders, behind, before, strongest, at)


def _fisher(a: Mapping[Any, Any], b: Mapping[Any, Any]) -> float | None:
    """The p-value of Fisher's exact test for equal success of two rows; None if their counts are unknown."""
    counts = []
    for row in (a, b):
        episodes = row.get("episodes")
        if not (isinstance(episodes, int) and 0 < episodes <= MOST_EPISODES and 0 <= row["success"] <= 1):
            return None
        won = round(row["success"] * episodes)
        counts.append((won, episodes - won))
    return float(stats.fisher_exact(np.array(counts)).pvalue)


def _named(names: Sequence[str], one: str = "", several: str = "") -> str:
    """Names as a list in a sentence, and the verb that goes with them."""
    text = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return f"{text} {one if len(names) == 1 else several}".rstrip()
