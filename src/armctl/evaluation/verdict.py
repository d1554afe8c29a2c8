"""The verdict of a comparison: a sentence about its two best policies."""

from collections.abc import Sequence

from armctl.evaluation.statistics import FEWEST, Estimate, PairedDifference
from armctl.evaluation.summary import PolicySummary


def verdict(policies: Sequence[PolicySummary], paired: Sequence[PairedDifference]) -> str:
    """Which of the two best policies wins more often, and which earns more, if the differences are significant."""
    fewest = min(pair.episodes for pair in paired)
    if fewest < FEWEST:
        return f"No verdict from {fewest} episodes: it takes {FEWEST}."
    ranked = sorted(policies, key=lambda policy: _rank(policy.success, policy.episode_return), reverse=True)
    best, second = (policy.policy for policy in ranked[:2])
    pair = next(pair for pair in paired if {pair.a, pair.b} == {best, second})
    won = {pair.a: pair.only_a, pair.b: pair.only_b}
    if pair.mcnemar_p < 0.05:
        first = f"{best} wins more episodes than {second} ({won[best]} against {won[second]} that the other lost)"
    else:
        first = f"{best} and {second} cannot be told apart by success (p = {pair.mcnemar_p:.2g})"
    gain = pair.return_difference
    if gain.low is None or gain.high is None or gain.low <= 0 <= gain.high:
        return f"{first}; their returns cannot be told apart."
    better, other = (pair.a, pair.b) if gain.value > 0 else (pair.b, pair.a)
    low, high = sorted((abs(gain.low), abs(gain.high)))
    return f"{first}; {better} earns {abs(gain.value):.1f} [{low:.1f}, {high:.1f}] more an episode than {other}."


def _rank(success: Estimate | None, episode_return: Estimate | None) -> tuple[float, float]:
    return (success.value if success else 0.0, episode_return.value if episode_return else 0.0)
