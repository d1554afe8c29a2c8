"""The verdict of a comparison: whether a planner or a learned agent is better, by how much, and at what cost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from armctl.evaluation.paired import (
    MARGIN,
    SIGNIFICANT,
    PairedDifference,
    corrected,
    episodes_to_detect,
    episodes_to_show_equivalence,
    holm,
)
from armctl.evaluation.statistics import FEWEST, Estimate
from armctl.evaluation.summary import PolicySummary
from armctl.evaluation.tables import UNKNOWN, points
from armctl.policies import policy_names, privileges


@dataclass(frozen=True)
class Contest:
    """Two policies on the same episodes, the first being the one that does better."""

    first: PolicySummary
    second: PolicySummary
    pair: PairedDifference
    p: float | None
    """McNemar's p-value after Holm's correction for all pairs of the comparison; None if success is unknown."""
    return_p: float | None
    """Of equal returns, corrected likewise; None in results of older versions."""
    pairs: int
    """Number of pairs."""
    claims: int
    """Number of pairs from which this one was chosen after they had been seen, or which are told beside it."""

    @property
    def first_ahead(self) -> Estimate | None:
        """Success of the first minus that of the second; None if it is unknown."""
        found = self.pair.success_difference
        if found is None or self.first.policy == self.pair.a:
            return found
        low, high = found.bounds
        return Estimate(-found.value, -high, -low)


def verdict(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    baseline: str | None = None,
    margin: float = MARGIN,
) -> str:
    """A sentence about the best classical and the best learned policy, or about the two best, and about costs.

    With `baseline`, every other policy is held against it instead. Policies that did not come with armctl are always
    named. The best are those of the highest success rate, or return where success is unknown. `margin` is the
    difference in success below which policies count as equivalent. Policies that a disturbance does not reach are in no
    pair, and named at the end.
    """
    fewest = min((pair.episodes for pair in paired), default=FEWEST)
    if fewest < FEWEST:
        said = [f"No verdict from {fewest} episode{'s' if fewest > 1 else ''}: it takes {FEWEST}."]
    else:
        told = contests(policies, paired, baseline)
        said = [_sentence(contest, margin) for contest in told]
        said += [_cost(told[0]), _privileges(told[0]), _networks(told)] if told else []
    return " ".join(filter(None, (*said, *map(_physics_failed, policies), _not_judged(policies))))


def headline(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    baseline: str | None = None,
    margin: float = MARGIN,
) -> tuple[str, str]:
    """The verdict's first pair in two short sentences: who wins by how much, and at what cost (empty without one)."""
    told = contests(policies, paired, baseline)
    if not told:
        return verdict(policies, paired, baseline, margin), ""
    if min(pair.episodes for pair in paired) < FEWEST:
        return verdict(policies, paired, baseline, margin).partition(". ")[0].rstrip(".") + ".", ""
    contest = told[0]
    first, second = contest.first, contest.second
    if contest.p is None:
        result = _sentence(contest, margin)
    elif contest.p < SIGNIFICANT:
        gain, _, interval = _difference(contest).removeprefix("+").partition(" [")
        result = f"{first.policy} beats {second.policy} by {gain} of success [{interval}."
    elif contest.pair.equivalent(margin, contest.claims):
        result = f"{first.policy} and {second.policy} are equivalent within {100 * margin:g} points of success."
    else:
        result = f"Undecided between {first.policy} and {second.policy}: success {_difference(contest)}."
    times = [f"{one.policy} {one.decision_ms:.2g} ms{one.training.brief}" for one in (first, second)]
    return result, f"On average, a decision takes {', and '.join(times)}{_timing(contest)}."


def contests(
    policies: Sequence[PolicySummary], paired: Sequence[PairedDifference], baseline: str | None
) -> list[Contest]:
    """The pairs that a verdict tells, the most important one first. A `baseline` that has not played is none.

    There is no pair with a policy that a disturbance does not reach: none at all if it is the baseline.
    """
    baseline = next((one.policy for one in policies if one.policy == baseline), None)
    policies = [one for one in policies if not one.spared]
    if len(policies) < 2 or baseline not in (None, *(one.policy for one in policies)):
        return []
    told = _pairs_to_tell(policies, baseline)
    claims = _claims(policies, len(told), baseline)
    return [_contest(policies, paired, names, baseline, claims) for names in told]


def _pairs_to_tell(policies: Sequence[PolicySummary], baseline: str | None) -> list[tuple[str, str]]:
    ranked = sorted(policies, key=lambda policy: _rank(policy.success, policy.episode_return), reverse=True)
    names = [policy.policy for policy in ranked]
    if baseline:
        return [(baseline, name) for name in names if name != baseline]
    classical = [policy.policy for policy in ranked if not policy.learned]
    learned = [policy.policy for policy in ranked if policy.learned]
    best = (classical[0], learned[0]) if classical and learned else (names[0], names[1])
    own = [name for name in names if name not in policy_names() and name not in best]
    return [best, *((name, best[names.index(best[1]) < names.index(best[0])]) for name in own)]


def _claims(policies: Sequence[PolicySummary], told: int, baseline: str | None) -> int:
    """The number of pairs among which the best two were chosen, or of those that are told, if that is larger."""
    learned = sum(policy.learned for policy in policies)
    between = learned * (len(policies) - learned)
    return told if baseline else max(told, between or math.comb(len(policies), 2))


def _contest(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    names: tuple[str, str],
    baseline: str | None,
    claims: int,
) -> Contest:
    by_name = {policy.policy: policy for policy in policies}
    pair = next(pair for pair in paired if {pair.a, pair.b} == set(names))
    p = None if pair.mcnemar_p is None else corrected(paired, baseline)[paired.index(pair)]
    family = [one for one in paired if baseline in (None, one.a, one.b)]
    earned = [one.return_p for one in family if one.return_p is not None]
    return_p = holm(earned)[family.index(pair)] if len(earned) == len(family) else None
    first, second = sorted((by_name[pair.a], by_name[pair.b]), key=lambda one: names.index(one.policy))
    ahead = pair.success_difference
    gain = ahead.value if ahead and ahead.value else pair.return_difference.value
    if gain and (first.policy == pair.a) != (gain > 0):
        first, second = second, first
    return Contest(first, second, pair, p, return_p, len(family), claims)


def _sentence(contest: Contest, margin: float) -> str:
    first, second, pair = contest.first.policy, contest.second.policy, contest.pair
    by_return = _by_return(contest)
    if contest.p is None:
        return f"{by_return or f'The returns of {first} and {second} are not shown to differ'}."
    difference, least = _difference(contest), f"{100 * margin:g} points"
    family = f" after Holm's correction for {contest.pairs} pairs" if contest.pairs > 1 else ""
    p = f"p = {contest.p:.2g}{family}"
    equivalent = pair.equivalent(margin, contest.claims)
    if contest.p < SIGNIFICANT:
        within = f", though by less than {least}" if equivalent else ""
        said = f"{first} is better than {second}{within}: success {difference}, {p}"
    elif equivalent:
        said = f"{first} and {second} are equivalent within {least}: success {difference}"
    else:
        said = f"Undecided between {first} and {second}: success {difference}. {_more(contest, margin, least)} ({p})"
    return f"{said}. {by_return}{'.' if by_return else ''}".rstrip()


def _difference(contest: Contest) -> str:
    """In points, of the first over the second, with its interval."""
    found = contest.first_ahead
    return UNKNOWN if found is None else points(found)


def _more(contest: Contest, margin: float, least: str) -> str:
    pair = contest.pair
    if pair.crossed is not None:
        return "More trainings would tell more than more episodes"
    discordant = (pair.only_a + pair.only_b + 1) / (pair.episodes + 2)
    needed = max(
        episodes_to_detect(margin, discordant), episodes_to_show_equivalence(margin, discordant, claims=contest.claims)
    )
    more = max(needed - pair.episodes, pair.episodes // 2)
    rounded = round(more, 1 - len(str(more)))
    return f"About {rounded:,} more episodes would tell {least}"


def _cost(contest: Contest) -> str:
    """What the two policies need: training, and time for a decision."""
    both = (contest.first, contest.second)
    trained = [
        f"{one.policy} was trained for {one.training}{' each' * bool(one.trainings)}" for one in both if one.learned
    ]
    times = " and ".join(f"{one.policy} {one.decision_ms:.2g} ms" for one in both) + _timing(contest)
    said = "; ".join((*trained, f"on average, a decision takes {times}"))
    return f"{said[0].upper() if not trained else said[0]}{said[1:]}."


def _timing(contest: Contest) -> str:
    """What these times are, unless they are latencies."""
    kinds = dict.fromkeys(one.timing for one in (contest.first, contest.second))
    return f" ({', '.join(kind or 'latencies' for kind in kinds)})" if any(kinds) else ""


def _privileges(contest: Contest) -> str:
    return privileges({one.policy: one.sees for one in (contest.first, contest.second)})


def _networks(contests: Sequence[Contest]) -> str:
    """Which learned policies are one network, and which are a recipe."""
    told = {one.policy: one for contest in contests for one in (contest.first, contest.second) if one.learned}
    said = [
        f"{name} is this recipe, by {len(one.trainings)} trainings" if one.trainings else f"{name} is this network"
        for name, one in told.items()
    ]
    return f"{'; '.join(said)}." if said else ""


def _by_return(contest: Contest) -> str:
    """Which of two policies earns more; empty if that is not significant."""
    gain = contest.pair.return_difference
    low, high = gain.bounds
    if not (low > 0 or high < 0):
        return ""
    if contest.return_p is not None and contest.return_p >= SIGNIFICANT:
        return ""
    better, other = (contest.pair.a, contest.pair.b) if gain.value > 0 else (contest.pair.b, contest.pair.a)
    low, high = sorted((abs(low), abs(high)))
    return f"{better} earns {abs(gain.value):.1f} [{low:.1f}, {high:.1f}] more an episode than {other}"


def _physics_failed(policy: PolicySummary) -> str:
    if not policy.unstable:
        return ""
    share = f"{policy.unstable} of {sum(policy.outcomes.values())} episodes"
    return f"{policy.policy} counts {share} as failures because their physics became unstable."


def _not_judged(policies: Sequence[PolicySummary]) -> str:
    """Which policies are in no pair, and which disturbances do not reach them."""
    spared = [f"{one.policy} (spared {', '.join(one.spared)})" for one in policies if one.spared]
    return f"Not judged: {', '.join(spared)}." if spared else ""


def _rank(success: Estimate | None, episode_return: Estimate | None) -> tuple[float, float]:
    return (success.value if success else 0.0, episode_return.value if episode_return else 0.0)
