"""The verdict of a comparison: whether a planner or a learned agent is better, by how much, and at what cost.

First by success; where that does not differ significantly, by the steps to the goal as well; then by the return.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from armctl.policies import policy_names, privileges
from armctl.runtime.provenance import looks_in_words
from armctl.stats.intervals import FEWEST, Estimate
from armctl.stats.paired import (
    MARGIN,
    SIGNIFICANT,
    Corrected,
    PairedDifference,
    corrected,
    shown,
    within,
)
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import UNKNOWN, p_value, points, size


@dataclass(frozen=True)
class Contest:
    """Two policies on the same episodes, the first being the one that does better."""

    first: PolicySummary
    second: PolicySummary
    pair: PairedDifference
    p: Corrected
    claims: int
    """Number of pairs from which this one was chosen after they had been seen, or which are told beside it."""

    @property
    def first_ahead(self) -> Estimate | None:
        """Success of the first minus that of the second; None if it is unknown.

        The interval holds for the chosen pair: at once for all `claims`.
        """
        return self._of_first(self.pair.success_among(self.claims))

    @property
    def steps_ahead(self) -> Estimate | None:
        """Steps to the goal of the first minus those of the second, with an interval that holds for all pairs."""
        wide = self.pair.simultaneous
        return self._of_first(wide.steps if wide else self.pair.steps_difference)

    @property
    def return_ahead(self) -> Estimate:
        """Return of the first minus that of the second, with an interval that holds for all pairs."""
        wide = self.pair.simultaneous
        found = self._of_first(wide.returns if wide else self.pair.return_difference)
        assert found is not None
        return found

    @property
    def higher(self) -> Estimate:
        """Share of episodes in which the first has the higher return, with an interval that holds for all pairs."""
        wide = self.pair.simultaneous
        found = wide.superiority if wide else self.pair.superiority.probability
        return found if self.first.policy == self.pair.a else _negated(found, 1.0)

    def _of_first(self, found: Estimate | None) -> Estimate | None:
        return found if found is None or self.first.policy == self.pair.a else _negated(found)


def verdict(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    baseline: str | None = None,
    margin: float = MARGIN,
    looks: Sequence[int] = (),
) -> str:
    """A sentence about the best classical and the best learned policy, or about the two best, and about costs.

    With `baseline`, every other policy is held against it instead. Policies that did not come with armctl are always
    named. The best are those of the highest success rate, or return where success is unknown. `margin` is the
    difference in success below which policies count as equivalent. `looks` are the numbers of episodes after which a
    verdict was told before. Policies that a disturbance does not reach are in no pair, and named at the end.
    """
    fewest = min((pair.episodes for pair in paired), default=FEWEST)
    if fewest < FEWEST:
        said = [f"No verdict from {fewest} episode{'s' if fewest > 1 else ''}: it takes {FEWEST}."]
    else:
        told = contests(policies, paired, baseline)
        said = [_sentence(contest, margin, looks) for contest in told]
        said += [_cost(told[0]), _privileges(told[0]), _networks(told)] if told else []
    return " ".join(filter(None, (*said, *map(_physics_failed, policies), _not_judged(policies))))


def headline(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    baseline: str | None = None,
    margin: float = MARGIN,
    looks: Sequence[int] = (),
) -> tuple[str, str]:
    """The verdict's first pair in two short sentences: who wins by how much, and at what cost (empty without one)."""
    told = contests(policies, paired, baseline)
    if not told:
        return verdict(policies, paired, baseline, margin), ""
    if min(pair.episodes for pair in paired) < FEWEST:
        return verdict(policies, paired, baseline, margin).partition(". ")[0].rstrip(".") + ".", ""
    contest = told[0]
    first, second = contest.first, contest.second
    names = f"{first.policy} and {second.policy}"
    if contest.p.success is None:
        said = [_by_return(contest, looks)]
    elif contest.p.success < SIGNIFICANT:
        gain, _, interval = _difference(contest).removeprefix("+").partition(" [")
        said = [f"{first.policy} beats {second.policy} by {gain} of success [{interval}"]
    elif contest.pair.equivalent(margin, contest.claims):
        said = [f"{names} are equivalent within {100 * margin:g} points of success", _by_steps(contest)]
    else:
        said = [f"Undecided between {names}: success {_difference(contest)}", _by_steps(contest)]
    if contest.p.success is not None and looks:
        said.append(looks_in_words(looks))
    times = [f"{one.policy} {one.decision_ms:.2g} ms{one.training.brief}" for one in (first, second)]
    cost = f"On average, a decision takes {', and '.join(times)}{_timing(contest)}."
    return f"{'; '.join(filter(None, said))}.", cost


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
    """The number of pairs among which the best two were chosen; all pairs if further ones are told beside them."""
    learned = sum(policy.learned for policy in policies)
    between = learned * (len(policies) - learned)
    if baseline:
        return told
    return between if between and told == 1 else math.comb(len(policies), 2)


def _contest(
    policies: Sequence[PolicySummary],
    paired: Sequence[PairedDifference],
    names: tuple[str, str],
    baseline: str | None,
    claims: int,
) -> Contest:
    by_name = {policy.policy: policy for policy in policies}
    pair = next(pair for pair in paired if {pair.a, pair.b} == set(names))
    p = corrected(paired, baseline)[paired.index(pair)]
    first, second = sorted((by_name[pair.a], by_name[pair.b]), key=lambda one: names.index(one.policy))
    gain = _gain(pair)
    if gain and (first.policy == pair.a) != (gain > 0):
        first, second = second, first
    return Contest(first, second, pair, p, claims)


def _gain(pair: PairedDifference) -> float:
    """By how much a does better than b, by the first figure in which they differ at all; 0 if there is none."""
    success, steps = pair.success_difference, pair.steps_difference
    if success is None and pair.return_p is None:
        return pair.superiority.probability.value - 0.5
    gains = (success.value if success else 0.0, -steps.value if steps else 0.0, pair.return_difference.value)
    return next(filter(None, gains), 0.0)


def _sentence(contest: Contest, margin: float, looks: Sequence[int]) -> str:
    """The difference in success, and if that is not significant, in steps; then that in return."""
    first, second, p = contest.first.policy, contest.second.policy, contest.p.success
    if p is None:
        return f"{_by_return(contest, looks)}."
    difference, least = _difference(contest), f"{100 * margin:g} points"
    equivalent = contest.pair.equivalent(margin, contest.claims)
    steps, more = _by_steps(contest), ""
    if p < SIGNIFICANT:
        though = f", though by less than {least}" if equivalent else ""
        said = f"{first} is better than {second}{though}: success {difference}, {_p(contest, p)}"
        steps = ""
    elif equivalent:
        ahead = contest.first_ahead
        tests = "" if ahead and within(ahead, margin) else " (two one-sided tests at 5 %)"
        said = f"{first} and {second} are equivalent in success within {least}{tests}: {difference}"
    else:
        said = f"Undecided between {first} and {second}: success {difference}, {_p(contest, p)}"
        more = f" {_more(contest, margin, least)}."
    if steps:
        said += f"; {steps}, p = {p_value(contest.p.steps)}{'' if _p(contest, p) in said else _family(contest)}"
    caution = f"; {looks_in_words(looks)}" if looks else ""
    earns = _earns_more(contest)
    return f"{said}{caution}.{more}{f' {earns}.' if earns else ''}"


def _p(contest: Contest, p: float | None) -> str:
    return f"p = {p_value(p)}{_family(contest)}"


def _family(contest: Contest) -> str:
    return f" after Holm's correction for {contest.p.tests} tests" if contest.p.tests > 1 else ""


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
        episodes_to_detect(margin, discordant, tests=contest.p.tests),
        episodes_to_show_equivalence(margin, discordant, claims=contest.claims),
    )
    more = max(needed - pair.episodes, pair.episodes // 2)
    rounded = round(more, 1 - len(str(more)))
    return f"About {rounded:,} more episodes would tell {least}"


def _cost(contest: Contest) -> str:
    """What the two policies need: training, and time for a decision."""
    both = (contest.first, contest.second)
    trained = [words for policy in both for words in policy.effort]
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


def _by_steps(contest: Contest) -> str:
    """Which of two policies takes fewer steps to the goal; empty if that is not significant."""
    lead = contest.steps_ahead
    if lead is None or not shown(lead, contest.p.steps):
        return ""
    faster = contest.first if lead.value < 0 else contest.second
    return f"{faster.policy} takes {size(lead)} steps fewer"


def _earns_more(contest: Contest) -> str:
    """Which of two policies earns more in the mean; empty if that is not significant, or unknown."""
    gain, p = contest.return_ahead, contest.p.returns
    if not shown(gain, p):
        return ""
    better, other = (contest.first, contest.second)[:: 1 if gain.value > 0 else -1]
    return f"{better.policy} earns {size(gain)} more an episode than {other.policy}, p = {p_value(p)}"


def _by_return(contest: Contest, looks: Sequence[int]) -> str:
    """Which of two policies does better where success is unknown: by its mean return, or else by the sign test."""
    first, second = contest.first.policy, contest.second.policy
    if contest.p.returns is not None:
        earns = _earns_more(contest)
        said = f"{earns}{_family(contest)}" if earns else f"The returns of {first} and {second} are not shown to differ"
    else:
        value, *bounds = (100 * one for one in (contest.higher.value, *contest.higher.bounds))
        share = f"in {value:.0f} % [{bounds[0]:.0f}, {bounds[1]:.0f}] of episodes"
        family = f" after Holm's correction for {contest.p.pairs} pairs" if contest.p.pairs > 1 else ""
        test = f"sign test, p = {p_value(contest.p.higher)}{family}; ties count half"
        apart = contest.p.higher < SIGNIFICANT and not bounds[0] <= 50 <= bounds[1]
        than = f"{first} has the higher return {share}"
        said = f"{than} ({test})" if apart else f"Undecided between {first} and {second}: {than} ({test})"
    return f"{said}; {looks_in_words(looks)}" if looks else said


def _negated(found: Estimate, whole: float = 0.0) -> Estimate:
    """`whole` minus a value, with its interval."""
    low, high = (None if bound is None else whole - bound for bound in (found.low, found.high))
    return Estimate(whole - found.value, high, low)


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
