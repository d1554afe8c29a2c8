"""From which level of a disturbance a policy gets worse, and from which it fails."""

from dataclasses import dataclass

import pandas as pd
from scipy import stats

FALSE_DISCOVERY_RATE = 0.05
"""Of the significant drops in success of a sweep (Benjamini and Hochberg 1995)."""


@dataclass(frozen=True)
class Degradation:
    """The effect of one disturbance on one policy."""

    disturbance: str
    policy: str
    sees: str
    drops: float | None
    """The first level with a significant drop in success, or in return if success is unknown; None if there is none."""
    below_half: float | None
    """The first level with a success rate below one half; None if there is none."""


def degradations(points: pd.DataFrame) -> list[Degradation]:
    """The effect of each disturbance on each policy, from the rows of `sweep.csv`."""
    points = points.assign(neutral=~points.duplicated(["disturbance", "policy"]))
    levels = points[~points.neutral]
    significant = pd.Series(False, index=points.index)
    if len(levels):
        significant[levels.index] = stats.false_discovery_control(levels.p) < FALSE_DISCOVERY_RATE
    score = "success" if points.success.notna().any() else "return"
    fell = points[score] < points.groupby(["disturbance", "policy"])[score].transform("first")
    points = points.assign(drops=significant & fell)
    return [
        Degradation(
            str(disturbance),
            str(policy),
            str(rows.sees.iloc[0]),
            _first(rows.level[rows.drops]),
            _first(rows.level[rows.success < 0.5]),
        )
        for (disturbance, policy), rows in points.groupby(["disturbance", "policy"], sort=False)
    ]


def _first(levels: "pd.Series[float]") -> float | None:
    return float(levels.iloc[0]) if len(levels) else None
