"""Who holds out against what: the policies of a sweep, compared with each other at each level of each disturbance."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
NEUTRAL = ("none", 0.0)
"""The disturbance and level of a pair without any: all disturbances share these episodes."""
GROUP = "[*]"
"""Ends the name of several trainings."""


@dataclass(frozen=True)
class Endurance:
    """Who holds out longest against a disturbance."""

    disturbance: str
    leaders: Sequence[str]
    """The policy with the best mean over all disturbed levels, and those that are at no level shown to be worse."""
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


def endurances(points: pd.DataFrame, pairs: Mapping[Pair, float]) -> list[Endurance]:
    """Who holds out longest against each disturbance, from the rows of `sweep.csv`.

    `pairs` are the p-values of each two policies in the same episodes (`Sweep.pairs`). They differ at a level if that
    shows it at a false discovery rate of 5 % over all pairs, levels and disturbances. Sweeps of older versions have no
    such p-values: Fisher's exact test takes their place, or where it does not apply (groups of trainings, returns),
    whether 95 % intervals overlap.
    """
    score, low, high = SUCCESS if points.success.notna().any() else RETURN
    if not {score, low, high} <= set(points):
        return []
    known = points[points[score].notna() & points.groupby("disturbance")["level"].transform("nunique").gt(1)]
    if known.empty:
        return []
    neutral = known.groupby("disturbance")["level"].transform("first")
    p: dict[Pair, float] = {}
    for (disturbance, level, first), rows in known.groupby(["disturbance", "level", neutral.rename("neutral")]):
        for a, b in itertools.combinations(rows.to_dict("records"), 2):
            pair = _pair(str(disturbance), float(str(level)), float(str(first)), str(a["policy"]), str(b["policy"]))
            if pair in pairs:
                p[pair] = pairs[pair]
            elif pair not in p:
                overlap = not (a[low] > b[high] or b[low] > a[high])
                fisher = _fisher(a, b) if score == "success" else None
                p[pair] = float(overlap) if fisher is None else fisher
    corrected: Any = stats.false_discovery_control(list(p.values())) if p else []
    apart = {pair for pair, one in zip(p, corrected, strict=True) if one < FALSE_DISCOVERY_RATE}
    harmed = _harmed(known)
    return [
        _endurance(str(name), rows, score, (low, high), apart, harmed)
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
    apart: set[Pair],
    harmed: set[tuple[str, str]],
) -> Endurance:
    levels = [float(level) for level in rows.level.unique()]
    values: dict[str, dict[float, float]] = {}
    for one in rows.to_dict("records"):
        values.setdefault(str(one["policy"]), {})[float(one["level"])] = float(one[score])
    leader = max(values, key=lambda name: np.mean([values[name].get(level, -np.inf) for level in levels[1:]]))
    leaders, behind, before = [leader], {}, []
    for name in (name for name in values if name != leader):
        shared = [level for level in levels if level in values[name] and level in values[leader]]
        gains = [values[name][level] - values[leader][level] for level in shared]
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
    at = {
        str(one["policy"]): f"{percent * one[score]:.{digits}f}{' %' * (percent > 1)} "
        f"[{percent * one[bounds[0]]:.{digits}f}, {percent * one[bounds[1]]:.{digits}f}]"
        for one in rows[rows.level == levels[-1]].to_dict("records")
    }
    unit = rows["unit"].iloc[0] if "unit" in rows else None
    strongest = f"{levels[-1]:g}{f' ({unit})' if isinstance(unit, str) else ''}"
    unharmed = not any((disturbance, name) in harmed for name in leaders)
    return Endurance(disturbance, leaders, behind, before, unharmed, strongest, at)


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
