"""The verdict of a comparison: a sentence about its two best policies."""

from collections.abc import Sequence

from armctl.evaluation.statistics import FEWEST, Estimate, PairedDifference
from armctl.evaluation.summary import PolicySummary
from armctl.policies import privileges


def verdict(policies: Sequence[PolicySummary], paired: Sequence[PairedDifference]) -> str:
    """Which of the two best policies wins more often, and which earns more, if the differences are significant.

    The best are those with the highest success rate, or return where success is unknown. Episodes whose physics failed
    are counted apart. Privileges are named if they differ.
    """
    seen = privileges({policy.policy: policy.sees for policy in policies})
    return " ".join(filter(None, (_best_two(policies, paired), seen, *map(_physics_failed, policies))))


def _physics_failed(policy: PolicySummary) -> str:
    if not policy.unstable:
        return ""
    share = f"{policy.unstable} of {policy.episodes} episodes"
    return f"{policy.policy} counts {share} as failures because their physics became unstable."


def _best_two(policies: Sequence[PolicySummary], paired: Sequence[PairedDifference]) -> str:
    fewest = min(pair.episodes for pair in paired)
    if fewest < FEWEST:
        return f"No verdict from {fewest} episode{'s' if fewest > 1 else ''}: it takes {FEWEST}."
    ranked = sorted(policies, key=lambda policy: _rank(policy.success, policy.episode_return), reverse=True)
    best, second = (policy.policy for policy in ranked[:2])
    pair = next(pair for pair in paired if {pair.a, pair.b} == {best, second})
    by_return = _by_return(pair)
    if pair.mcnemar_p is None:
        return f"{by_return or f'The returns of {best} and {second} cannot be told apart'}."
    won = {pair.a: pair.only_a, pair.b: pair.only_b}
    if pair.mcnemar_p < 0.05:
        first = f"{best} wins more episodes than {second} ({won[best]} against {won[second]} that the other lost)"
    else:
        first = f"{best} and {second} cannot be told apart by success (p = {pair.mcnemar_p:.2g})"
    return f"{first}; {by_return or 'their returns cannot be told apart'}."


def _by_return(pair: PairedDifference) -> str:
    """Which of two policies earns more; empty if that is not significant."""
    gain = pair.return_difference
    if gain.low is None or gain.high is None or gain.low <= 0 <= gain.high:
        return ""
    better, other = (pair.a, pair.b) if gain.value > 0 else (pair.b, pair.a)
    low, high = sorted((abs(gain.low), abs(gain.high)))
    return f"{better} earns {abs(gain.value):.1f} [{low:.1f}, {high:.1f}] more an episode than {other}"


def _rank(success: Estimate | None, episode_return: Estimate | None) -> tuple[float, float]:
    return (success.value if success else 0.0, episode_return.value if episode_return else 0.0)
