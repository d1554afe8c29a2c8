"""The verdict of a comparison: whether a planner or a learned agent is better, by how much, and at what cost.

First by success; where that does not differ significantly, by the steps to the goal as well; then by the return.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from armctl.episodes.table import EpisodeTable
from armctl.policies import interfaces_in_words, isolation, privileges
from armctl.runtime.provenance import looks_in_words
from armctl.stats.difference import MARGIN, SIGNIFICANT, Difference, significant, within
from armctl.stats.intervals import FEWEST
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.verdict.facts import Facts
from armctl.verdict.pairs import Pair, verdict_pairs
from armctl.verdict.summary import PolicySummary, summarise
from armctl.verdict.tables import UNKNOWN, p_value, points, size

ANY_NUMBER = 1.5
"""Episodes that a test which holds at any number of them takes for a power of 80 %, over those of a fixed number.

It is 1.0 to 1.8 in `benchmarks/sequential.py --table power`."""


@dataclass(frozen=True)
class Verdict:
    """The verdict of a comparison, in the order in which it is read; as a string, all of it."""

    result: str
    """Sentence on the better policy of the first pair, by how much, and how certain that is."""
    cost: str = ""
    """Decision times of both, and the decisions that their training took; empty without a pair."""
    context: str = ""
    """Everything else: further pairs, the training, the privileges, the networks for which the result holds."""

    def __str__(self) -> str:
        return " ".join(filter(None, (self.result, self.cost, self.context)))


def verdict(
    policies: Sequence[PolicySummary],
    differences: Sequence[Difference],
    baseline: str | None = None,
    margin: float = MARGIN,
    looks: Sequence[int] = (),
    overwritten: Sequence[int] = (),
    at_most: int | None = None,
) -> Verdict:
    """Return the verdict on the best policies of each kind, each against each, or on the two best, with their costs.

    With `baseline`, every other policy is compared with it instead. Policies that did not come with armctl are always
    named. The best have the highest success rate, or return where success is unknown. `margin` is the difference in
    success below which policies count as equivalent. `looks` are the numbers of episodes after which a verdict was
    printed before, `overwritten` those of them that were overwritten, and `at_most` is the largest number of a
    comparison that stopped early. Policies that a disturbance does not affect are in no pair, and named at the end.
    """
    fewest = min((pair.episodes for pair in differences), default=FEWEST)
    apart = isolation({policy.policy: policy.isolated for policy in policies})
    remarks = (apart, *map(_physics_failed, policies), _not_tested(policies))
    if fewest < FEWEST:
        result = f"No verdict from {fewest} episode{'s' if fewest > 1 else ''}: at least {FEWEST} are needed."
        return Verdict(result, context=_joined(*remarks))
    pairs = verdict_pairs(policies, differences, baseline)
    if not pairs:
        return Verdict(_joined(*remarks))
    first, *others = (_sentences(pair, margin, _validity(pair, looks, overwritten, at_most)) for pair in pairs)
    further = (sentence for sentences in others for sentence in sentences)
    main = _main_policies(pairs)
    sees = privileges({policy.policy: policy.privilege for policy in main})
    commands = interfaces_in_words({policy.policy: policy.interface for policy in main})
    context = _joined(*first[1:], *further, _effort(main), sees, commands, _scope(pairs), *remarks)
    return Verdict(first[0], _decision_times(main), context)


def is_decided(results: EpisodeTable, facts: Facts, num_verdicts: int = 1) -> bool:
    """Return True if no pair is undecided after these episodes of a cell, corrected for so many verdicts."""
    policies, differences = summarise(results, facts) if len(results) else ([], [])
    pairs = verdict_pairs(policies, differences, facts.baseline)
    fewest = min((pair.episodes for pair in differences), default=0)
    return fewest >= FEWEST and bool(pairs) and all(_decided(pair.among(num_verdicts), facts.margin) for pair in pairs)


def _decided(pair: Pair, margin: float) -> bool:
    if pair.p.success is not None:
        return pair.p.success < SIGNIFICANT or pair.difference.equivalent(margin, pair.num_comparisons)
    return bool(_earns_more(pair)) if pair.p.returns is not None else _by_sign(pair)


def _joined(*sentences: str) -> str:
    return " ".join(filter(None, sentences))


def _validity(pair: Pair, looks: Sequence[int], overwritten: Sequence[int], at_most: int | None) -> str:
    """Return whether p and intervals hold after earlier looks, as the end of a sentence; empty without any."""
    if not pair.difference.any_number or overwritten:
        return f"; {looks_in_words(looks)}" if looks else ""
    stopped = f"stopped after {pair.first.planned:,} of at most {at_most:,} episodes: " if at_most else ""
    return f"; {stopped}p and intervals hold at any number of episodes"


def _sentences(pair: Pair, margin: float, validity: str) -> list[str]:
    """Return the difference in success, and if that is not significant, in steps; then that in return."""
    first, second, p = pair.first.policy, pair.second.policy, pair.p.success
    if p is None:
        return [f"{_by_return(pair)}{validity}."]
    limit = f"{100 * margin:g} points"
    equivalent = pair.difference.equivalent(margin, pair.num_comparisons)
    steps, plan = _by_steps(pair), ""
    if p < SIGNIFICANT:
        but = f", but by less than {limit}" if equivalent else ""
        sentence = f"{first} is better than {second}{but}: success {_points(pair)}, {_p(pair, p)}"
        steps = ""
    elif equivalent:
        tests = _bracketed(pair, "two one-sided tests at 5 %" * (not pair.success or not within(pair.success, margin)))
        sentence = f"{first} and {second} are equivalent in success within {limit}{tests}: {_points(pair)}"
    else:
        sentence = f"Undecided between {first} and {second}: success {_points(pair)}, {_p(pair, p)}"
        plan = f"{_plan(pair, margin)}."
    if steps:
        sentence += f"; {steps}, p = {p_value(pair.p.steps)}{'' if _p(pair, p) in sentence else _family(pair)}"
    earns = _earns_more(pair)
    return [f"{sentence}{validity}.", *filter(None, (plan, f"{earns}." if earns else ""))]


def _p(pair: Pair, p: float | None) -> str:
    return f"p = {p_value(p)}{_family(pair, pair.interval_in_words)}"


def _family(pair: Pair, *details: str) -> str:
    return _bracketed(pair, f"Holm, {pair.p.tests} tests" * (pair.p.tests > 1), *details)


def _bracketed(pair: Pair, *details: str) -> str:
    """Return details of a test in brackets, and that episodes are different ones; empty without any."""
    details = tuple(filter(None, ("" if pair.difference.paired else "on different episodes", *details)))
    return f" ({'; '.join(details)})" if details else ""


def _points(pair: Pair) -> str:
    """Return the difference in success in points, with its interval."""
    return UNKNOWN if pair.success is None else points(pair.success)


def _plan(pair: Pair, margin: float) -> str:
    """Return what it takes to resolve a difference of the margin."""
    difference = pair.difference
    if difference.crossed is not None:
        return "To resolve it, add training seeds rather than episodes"
    share, paired = difference.planning_share, difference.paired
    needed = max(
        episodes_to_detect(margin, share, tests=pair.p.tests, paired=paired),
        episodes_to_show_equivalence(margin, share, num_comparisons=pair.num_comparisons, paired=paired),
    )
    if difference.any_number:
        needed = round(ANY_NUMBER * needed)
    more = max(needed - difference.episodes, difference.episodes // 2)
    rounded = round(more, 1 - len(str(more)))
    return f"To resolve a {100 * margin:g}-point difference, run about {rounded:,} more episodes"


def _main_policies(pairs: Sequence[Pair]) -> list[PolicySummary]:
    """Return the policies of the first pair, and the first one of any other kind."""
    main = [pairs[0].first, pairs[0].second]
    for pair in pairs[1:]:
        main += [policy for policy in (pair.first, pair.second) if policy.side not in {other.side for other in main}]
    return main


def _decision_times(policies: Sequence[PolicySummary]) -> str:
    """Return the policies' decision times, and the decisions of their training."""
    if all(math.isnan(policy.decision_ms_p50) for policy in policies):
        return ""
    times = ", ".join(f"{policy.policy} {policy.decision_time}{policy.training.brief}" for policy in policies)
    return f"Median decision time: {times}{_timing(policies)}."


def _effort(policies: Sequence[PolicySummary]) -> str:
    """Return the effort of training the policies; empty if none was trained."""
    efforts = "; ".join(words for policy in policies for words in policy.effort)
    return f"{efforts}." if efforts else ""


def _timing(policies: Sequence[PolicySummary]) -> str:
    """Return the kind of these times, unless they are latencies."""
    kinds = dict.fromkeys(policy.timing for policy in policies)
    return f" ({', '.join(kind or 'latencies' for kind in kinds)})" if any(kinds) else ""


def _scope(pairs: Sequence[Pair]) -> str:
    """Return for which policies with a network the result holds for that, and for which it holds for a recipe."""
    policies = {policy.policy: policy for pair in pairs for policy in (pair.first, pair.second)}
    learned = {name: policy for name, policy in policies.items() if policy.side != "classical"}
    parts = [
        f"for {name} as a recipe ({len(policy.trainings)} trainings)"
        if policy.trainings
        else f"for {name} as one network"
        for name, policy in learned.items()
    ]
    return f"The result holds {', '.join(parts)}." if parts else ""


def _by_steps(pair: Pair) -> str:
    """Return which of two policies takes fewer steps to the goal; empty if that is not significant."""
    steps = pair.difference.simultaneous.steps
    if steps is None or not significant(steps, pair.p.steps):
        return ""
    faster = pair.first if steps.value < 0 else pair.second
    return f"{faster.policy} takes {size(steps)} fewer steps"


def _earns_more(pair: Pair) -> str:
    """Return which of two policies has the higher mean return; empty if that is not significant, or unknown."""
    gain, p = pair.difference.simultaneous.returns, pair.p.returns
    if not significant(gain, p):
        return ""
    better, other = (pair.first, pair.second)[:: 1 if gain.value > 0 else -1]
    return f"{better.policy} earns {size(gain)} more return per episode than {other.policy}, p = {p_value(p)}"


def _by_sign(pair: Pair) -> bool:
    """Return True if one policy has the higher return in significantly more than half of the episodes."""
    low, high = pair.difference.simultaneous.superiority.bounds
    return pair.p.higher < SIGNIFICANT and not low <= 0.5 <= high


def _by_return(pair: Pair) -> str:
    """Return which of two policies is better where success is unknown: by mean return, or else by the sign test."""
    first, second = pair.first.policy, pair.second.policy
    if pair.p.returns is not None:
        earns = _earns_more(pair)
        sentence = (
            f"{earns}{_family(pair)}"
            if earns
            else f"The returns of {first} and {second} do not differ significantly{_bracketed(pair)}"
        )
    else:
        higher = pair.difference.simultaneous.superiority
        value, low, high = (100 * share for share in (higher.value, *higher.bounds))
        family = f" (Holm, {pair.p.pairs} pairs)" if pair.p.pairs > 1 else ""
        share = f"{value:.0f} % [{low:.0f}, {high:.0f}]"
        if pair.difference.paired:
            test = f"sign test, p = {p_value(pair.p.higher)}{family}; ties count half"
            sentence = f"{first} has the higher return in {share} of episodes ({test})"
        else:
            test = f"on different episodes, p = {p_value(pair.p.higher)}{family}; ties count half"
            sentence = f"{first} has the higher return with a probability of {share} ({test})"
        if not _by_sign(pair):
            sentence = f"Undecided between {first} and {second}: {sentence}"
    return sentence


def _physics_failed(policy: PolicySummary) -> str:
    if not policy.unstable:
        return ""
    share = f"{policy.unstable} of {sum(policy.outcomes.values())} episodes"
    return f"{share} of {policy.policy} count as failures, because their physics became unstable."


def _not_tested(policies: Sequence[PolicySummary]) -> str:
    """Return a sentence on the policies that a disturbance does not affect, which are in no pair; empty without any."""
    parts = [f"{policy.policy} ({', '.join(policy.spared)})" for policy in policies if policy.spared]
    return f"Not tested, because the disturbance does not affect them: {', '.join(parts)}." if parts else ""
