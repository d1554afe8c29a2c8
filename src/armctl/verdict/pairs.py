"""The pairs of policies of a verdict: the best of each kind against each other, and those that are of others."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from armctl.core.kinds import KINDS
from armctl.policies import policy_names
from armctl.stats.correction import AdjustedP, holm_adjusted
from armctl.stats.difference import SIGNIFICANT, Difference
from armctl.stats.intervals import Estimate
from armctl.verdict.summary import PolicySummary


@dataclass(frozen=True)
class Pair:
    """Two policies, the better one first."""

    first: PolicySummary
    second: PolicySummary
    difference: Difference
    """The first minus the second."""
    p: AdjustedP
    num_comparisons: int
    """Number of pairs from which this one was chosen by their results, or which are in the same verdict."""

    @property
    def success(self) -> Estimate | None:
        """Difference in success; None if it is unknown. The interval holds at once for all `num_comparisons`."""
        return self.difference.success_among(self.num_comparisons)

    def among(self, num_verdicts: int) -> "Pair":
        """Return the pair, corrected for so many verdicts."""
        return replace(self, p=self.p.among(num_verdicts), num_comparisons=self.num_comparisons * num_verdicts)

    @property
    def interval_in_words(self) -> str:
        """Number of pairs for which that interval holds, where it contains 0 though Holm's p is significant.

        Each holds for all pairs, and a step of Holm's only for those that are left; empty otherwise.
        """
        low, high = self.success.bounds if self.success else (math.nan, math.nan)
        refuted = self.num_comparisons > 1 and self.p.success is not None and self.p.success < SIGNIFICANT
        return f"interval for {self.num_comparisons} pairs at once" if refuted and low <= 0 <= high else ""


def verdict_pairs(
    policies: Sequence[PolicySummary], differences: Sequence[Difference], baseline: str | None
) -> list[Pair]:
    """Return the pairs of a verdict, the most important one first. A `baseline` that has not played is none.

    There is no pair with a policy that a disturbance does not affect: none at all if it is the baseline.
    """
    baseline = next((policy.policy for policy in policies if policy.policy == baseline), None)
    policies = [policy for policy in policies if not policy.spared]
    if len(policies) < 2 or baseline not in (None, *(policy.policy for policy in policies)):
        return []
    chosen = _chosen_pairs(policies, baseline)
    num_comparisons = _num_comparisons(policies, chosen, baseline)
    by_name = {policy.policy: policy for policy in policies}
    adjusted = holm_adjusted(differences, baseline)
    pairs = []
    for names in chosen:
        i = next(i for i, pair in enumerate(differences) if {pair.a, pair.b} == set(names))
        difference, gain = differences[i], _gain(differences[i])
        if gain < 0 or (not gain > 0 and difference.a != names[0]):
            difference = difference.reversed()
        first, second = by_name[difference.a], by_name[difference.b]
        pairs.append(Pair(first, second, difference, adjusted[i], num_comparisons))
    return pairs


def _chosen_pairs(policies: Sequence[PolicySummary], baseline: str | None) -> list[tuple[str, str]]:
    ranked = sorted(policies, key=lambda policy: _rank(policy.success, policy.episode_return), reverse=True)
    names = [policy.policy for policy in ranked]
    if baseline:
        return [(baseline, name) for name in names if name != baseline]
    by_kind = [[policy.policy for policy in ranked if policy.side == kind] for kind in KINDS]
    best = [members[0] for members in by_kind if members]
    best = best if len(best) > 1 else names[:2]
    foreign = [name for name in names if name not in policy_names() and name not in best]
    return [*itertools.combinations(best, 2), *((name, min(best, key=names.index)) for name in foreign)]


def _num_comparisons(policies: Sequence[PolicySummary], chosen: Sequence[tuple[str, str]], baseline: str | None) -> int:
    """Return the number of pairs among which the best of each kind were chosen; all pairs if a verdict has others."""
    if baseline:
        return len(chosen)
    kinds = {policy.policy: policy.side for policy in policies}
    mixed = sum(a != b for a, b in itertools.combinations(kinds.values(), 2))
    return mixed if len(chosen) == math.comb(len(set(kinds.values())), 2) else math.comb(len(policies), 2)


def _gain(pair: Difference) -> float:
    """Return by how much a is better than b, by the first figure in which they differ at all; 0 if there is none."""
    success, steps = pair.success_difference, pair.steps_difference
    if success is None and pair.return_p is None:
        return pair.superiority.probability.value - 0.5
    gains = (success.value if success else 0.0, -steps.value if steps else 0.0, pair.return_difference.value)
    return next(filter(None, gains), 0.0)


def _rank(success: Estimate | None, episode_return: Estimate | None) -> tuple[float, float]:
    return (success.value if success else 0.0, episode_return.value if episode_return else 0.0)
