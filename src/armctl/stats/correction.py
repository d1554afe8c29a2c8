"""Correction of p-values for their number."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armctl.stats.difference import Difference


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979), in the same order."""
    order = np.argsort(p_values)
    adjusted = np.asarray(p_values, dtype=float)[order] * np.arange(len(p_values), 0, -1)
    result = np.empty(len(p_values))
    result[order] = np.minimum(np.maximum.accumulate(adjusted), 1.0)
    return [float(p) for p in result]


@dataclass(frozen=True)
class AdjustedP:
    """The p-values of a pair after Holm's correction; None where they are unknown."""

    success: float | None
    """p-value for equal success."""
    steps: float | None
    """p-value for equal steps to the goal in the mean."""
    returns: float | None
    """p-value for equal returns in the mean."""
    higher: float
    """p-value for equal chances of the higher return (sign test), stated only where success is unknown."""
    tests: int
    """Number of tests for which success, steps and returns were corrected together."""
    pairs: int
    """Number of pairs for which the sign test was corrected."""

    def among(self, num_verdicts: int) -> "AdjustedP":
        """Return the p-values after a further correction for so many verdicts (Bonferroni)."""
        by_name = {name: getattr(self, name) for name in ("success", "steps", "returns", "higher")}
        return replace(self, **{name: num_verdicts * p for name, p in by_name.items() if p is not None})


def holm_adjusted(pairs: Sequence[Difference], baseline: str | None = None) -> list[AdjustedP]:
    """Return the p-values of each pair, after Holm's correction for all pairs, and for success, steps and returns.

    A verdict may state any of the three, also steps and returns where success does not differ significantly, so that no
    order of tests would make up for their number. The sign test is corrected for all pairs. With a `baseline`, the
    pairs against it are a family by themselves; otherwise, and for all others, the family is all pairs.
    """
    against = [i for i, pair in enumerate(pairs) if baseline in (pair.a, pair.b)]
    of_baseline = dict(zip(against, _adjusted([pairs[i] for i in against]), strict=True))
    return [of_baseline.get(i, p) for i, p in enumerate(_adjusted(pairs))]


def _adjusted(pairs: Sequence[Difference]) -> list[AdjustedP]:
    raw = {
        (i, name): p
        for i, pair in enumerate(pairs)
        for name, p in (("success", pair.success_p), ("steps", pair.steps_p), ("returns", pair.return_p))
        if p is not None
    }
    p = dict(zip(raw, holm(list(raw.values())), strict=True))
    higher = holm([pair.superiority.p for pair in pairs])
    return [
        AdjustedP(p.get((i, "success")), p.get((i, "steps")), p.get((i, "returns")), higher[i], len(raw), len(pairs))
        for i in range(len(pairs))
    ]
