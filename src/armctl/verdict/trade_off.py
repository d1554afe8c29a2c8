"""The trade-off between what a policy achieves and what it costs: the Pareto front, and where training breaks even."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from armctl.agents.costs import rounded
from armctl.policies import UNSKILLED
from armctl.stats.intervals import Estimate
from armctl.verdict.summary import PolicySummary

SHORTEST_MS = 1e-4
"""ms: resolution of decision times, the shortest that the plot shows."""


@dataclass(frozen=True)
class Point:
    """Success or return of a policy, and the time of its decisions."""

    label: str
    score: Estimate
    """Success rate, or return if success is unknown."""
    decision_ms: float
    """`PolicySummary.control_step_ms`."""
    slow_ms: float
    """99th percentile."""


def points(policies: Sequence[PolicySummary]) -> list[Point]:
    """Return a point for each policy that all disturbances affect; none if decision times are not comparable."""
    policies = [policy for policy in policies if not policy.spared]
    by_success = any(policy.success for policy in policies)
    if len({policy.timing for policy in policies}) > 1:
        return []
    return [
        Point(policy.policy, score, max(policy.control_step_ms, SHORTEST_MS), max(policy.decision_ms_p99, SHORTEST_MS))
        for policy in policies
        if (score := policy.success if by_success else policy.episode_return) and math.isfinite(policy.control_step_ms)
    ]


def pareto_front(candidates: Sequence[Point]) -> list[Point]:
    """Return the points that no other one dominates, as fast and better, or as good and faster; the fastest first.

    `UNSKILLED` policies, which are fast at nothing, are no part of it, unless there are no others.
    """
    front: list[Point] = []
    skilled = [point for point in candidates if point.label not in UNSKILLED] or candidates
    for point in sorted(skilled, key=lambda point: (point.decision_ms, -point.score.value)):
        if not front or point.score.value > front[-1].score.value:
            front.append(point)
    return front


@dataclass(frozen=True)
class BreakEven:
    """Point at which an agent's training reaches the success of the best policy that was not trained."""

    agent: str
    expert: str
    target: float
    """Success of the expert."""
    decisions: float | None
    """The first decisions of the learning curve after which the agent is as successful; None if it never is."""
    success: Estimate
    """Success of the agent at that point; its best if it never gets there."""
    trained: float
    """Decisions of the whole training."""

    def __str__(self) -> str:
        share = f"{100 * self.success.value:.1f} %"
        if self.success.low is not None and self.success.high is not None:
            share += f" [{100 * self.success.low:.1f}, {100 * self.success.high:.1f}]"
        target = f"the {100 * self.target:.1f} % of {self.expert}"
        if self.decisions is None:
            best = f"its best in {rounded(int(self.trained))} decisions of training is {share}"
            return f"{self.agent} does not reach {target}: {best}."
        return f"{self.agent} reaches {target} after {rounded(int(self.decisions))} decisions: {share}."


def break_evens(policies: Sequence[PolicySummary], curves: Mapping[str, pd.DataFrame]) -> list[BreakEven]:
    """Return where each agent's success on held-out episodes reaches the best expert's in the comparison.

    `curves` have the columns `decisions`, `success`, `low` and `high`; an agent without one is judged by its success in
    the comparison, after its whole training. Agents are left out if their decisions are unknown, and all are if there
    is no expert.
    """
    experts = [policy for policy in policies if policy.side == "classical" and policy.success]
    if not experts:
        return []
    best = max(experts, key=_success)
    crossings = []
    for policy in policies:
        curve = cost_curve(policy, curves.get(policy.policy))
        if policy.side == "classical" or curve.empty:
            continue
        rows = curve.to_dict("records")
        reached = next((row for row in rows if row["success"] >= _success(best)), None)
        row = reached or max(rows, key=lambda row: row["success"])
        success = Estimate(row["success"], row["low"], row["high"])
        first = None if reached is None else float(reached["decisions"])
        trained = float(rows[-1]["decisions"])
        crossings.append(BreakEven(policy.policy, best.policy, _success(best), first, success, trained))
    return crossings


def cost_curve(policy: PolicySummary, curve: pd.DataFrame | None) -> pd.DataFrame:
    """Return success by decisions of training: the learning curve, or else the result of the comparison.

    Empty if the decisions are unknown. The curve has a row for each number of decisions above 0.
    """
    cost, success = policy.training, policy.success
    columns = ["decisions", "success", "low", "high"]
    if curve is not None:
        if cost.decisions is not None and cost.decisions == cost.steps:  # the learner counts decisions
            curve = curve.assign(decisions=curve.decisions.fillna(curve.steps))
        finite = curve[columns][(curve.decisions > 0) & (curve.decisions < math.inf)]
        if finite.decisions.nunique() > 1:
            return finite.sort_values("decisions", kind="stable").reset_index(drop=True)
    if not cost.decisions or success is None:
        return pd.DataFrame(columns=columns)
    return pd.DataFrame([(cost.decisions, success.value, success.low, success.high)], columns=columns)


def _success(policy: PolicySummary) -> float:
    return policy.success.value if policy.success else 0.0
