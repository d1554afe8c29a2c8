"""The tables of a comparison and of a sweep, from their figures."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from armctl.runtime.provenance import with_looks
from armctl.stats.correction import holm_adjusted
from armctl.stats.difference import Difference
from armctl.stats.intervals import FEWEST, Estimate
from armctl.stats.robustness import (
    FALSE_DISCOVERY_RATE,
    GROUP,
    Degradation,
    PairKey,
    degradations,
    robustness_headline,
    robustness_rankings,
)
from armctl.stats.trainings import FEWEST_TRAININGS
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import AGAINST, UNKNOWN, Cell, Column, Remark, Table, milliseconds, p_value, percent, plain

if TYPE_CHECKING:
    import pandas as pd

UNCONDITIONAL, RANDOM_WEIGHTS = "Barnard", "random weights of either side's episodes"
"""Tests of success, and of the higher return, on different episodes."""
RANDOM_TRAININGS = "random weights of trainings and of episodes"
"""Test of several trainings."""
DISQUALIFIED, SPARED = "disqualified", "spared"
FEW_UNDETECTED = 0.02
"""Share of failures that may go undetected without a remark: 2 % of the possible returns."""


def policy_table(
    env: str,
    seed: int,
    policies: Sequence[PolicySummary],
    disqualified: Sequence[str] = (),
    sources: Sequence[str] = (),
) -> Table:
    """Return a row for each policy. Environments without a success signal have no columns of it.

    `sources` are the files of episodes that were played elsewhere: what they do not have has no column.
    """
    by_success = any(policy.success for policy in policies)
    unbounded = any(policy.median_return for policy in policies)
    columns = [Column("policy"), Column("success"), Column("return"), Column("median return", optional=by_success)]
    columns += [Column("steps"), Column("length")]
    columns += [Column(name, optional=True) for name in ("decision ms", "sees", "clean", "worst 10 %")]
    rows = [
        [
            Cell(policy.policy, _training(policy)),
            percent(policy.success),
            plain(policy.episode_return),
            plain(policy.median_return),
            plain(policy.restricted_steps),
            plain(policy.length),
            _times(policy),
            Cell(*policy.knowledge),
            percent(policy.clean_success),
            plain(policy.worst_decile),
        ]
        for policy in policies
    ]
    rows += [[Cell(name, DISQUALIFIED), *[Cell(UNKNOWN)] * (len(columns) - 1)] for name in disqualified]
    left_out = ["length"] if by_success and not sources else [] if by_success else ["success", "clean", "steps"]
    left_out += [] if unbounded else ["median return"]
    if sources:
        left_out += [column.heading for i, column in enumerate(columns) if all(row[i] == Cell(UNKNOWN) for row in rows)]
    columns, rows = _without(left_out, columns, rows)
    records = [dataclasses.asdict(policy) for policy in policies]
    records += [{"policy": name, "disqualified": True} for name in disqualified]
    title = f"{env}: {policies[0].planned} episodes of {listed_files(sources) if sources else f'seed {seed}'}"
    caption = (
        "With decisions in training (M: million), 95 % intervals, and median and 99th percentile of decision times."
    )
    caption = "95 % intervals." if sources else caption
    caption += _caption(policies, [column.heading for column in columns], disqualified)
    return Table("policies", title, columns, rows, records, caption)


def _caption(policies: Sequence[PolicySummary], headings: Sequence[str], disqualified: Sequence[str]) -> str:
    """Return what explains the columns with these headings."""
    unbounded, caption = "median return" in headings, ""
    if any(policy.trainings for policy in policies):
        caption += " [*]: the intervals of means are for other trainings and other episodes."
    if any(policy.spared for policy in policies):
        caption += " Spared: not affected by that disturbance, so in no pair and no verdict."
    if disqualified:
        caption += " Disqualified: wrote to the world."
    explained = {
        "clean": "Clean: without contacts and beyond no limit.",
        "steps": "Steps: to the goal; failures count as the time limit.",
        "length": "Length: steps of an episode.",
    }
    caption += "".join(f" {text}" for heading, text in explained.items() if heading in headings)
    fewest = min(policy.episodes for policy in policies)
    figures = ["returns"] * ("return" in headings and not unbounded) + ["steps"] * ("steps" in headings)
    if figures and fewest >= FEWEST and (share := _undetected_share(fewest)) > FEW_UNDETECTED:
        more = f"{_episodes_for(FEW_UNDETECTED)} would leave {100 * FEW_UNDETECTED:g} %"
        caption += (
            f" Intervals of {' and '.join(figures)} include rare failures, since {fewest} episodes without one do not "
            f"exclude them in {100 * share:.1f} % of episodes; {more}."
        )
    if unbounded:
        caption += " The return has no stated bounds: its mean has no interval, its median has one."
    return caption


def _undetected_share(episodes: int) -> float:
    """Return the largest share of failures that episodes without any do not exclude (Clopper and Pearson, 95 %)."""
    return 1.0 - math.exp(math.log(0.025) / episodes)


def _episodes_for(share: float) -> int:
    """Return the number of episodes that exclude a larger share of failures if none of them has any."""
    return math.ceil(math.log(0.025) / math.log1p(-share))


def _training(policy: PolicySummary) -> str:
    training = f"{trained(policy)} each" if policy.trainings else trained(policy)
    return ", ".join((training, *(f"spared {name}" for name in policy.spared)))


def _times(policy: PolicySummary) -> Cell:
    times = (policy.decision_ms_p50, policy.decision_ms_p99)
    if math.isnan(times[0]):
        return Cell("unknown")
    return Cell(*("" if math.isnan(spent) else f"{spent:.3f}" for spent in times))


def listed_files(sources: Sequence[str]) -> str:
    """Return the names of files, of many the first and their number."""
    return ", ".join(sources) if len(sources) < 4 else f"{sources[0]} and {len(sources) - 1} other files"


def trained(policy: PolicySummary) -> str:
    """Return the cost of a policy's training and of its teachers', in a few characters."""
    cost = policy.training
    if not cost.steps:
        return "untrained" if policy.kind in (None, "classical") else policy.kind
    cost = cost.total
    count = cost.decisions or cost.gradient_steps or cost.steps
    short = f"{count / 1e6:.3g} M" if count >= 999_500 else f"{count:,}"
    return short if cost.decisions else f"{short} {'updates' if cost.gradient_steps else 'steps'}"


def details(policy: PolicySummary) -> Remark:
    """Return the outcomes of a policy's episodes, and further figures."""
    ends = ", ".join(f"{count} {outcome}" for outcome, count in policy.outcomes.items())
    facts = [f"{policy.policy}: {ends}"]
    if policy.trainings:
        facts.append(trainings_in_words(policy))
    if policy.unstable:
        facts.append(f"physics failures: {policy.unstable}, counted as failures")
    if gap := policy.optimality_gap:
        facts.append(f"{100 * gap.value:.0f}{_bracketed(gap, 100, 0)} % over the least time (median)")
    if error := policy.tracking_error:
        facts.append(f"tracking error {1e3 * error.value:.1f}{_bracketed(error, 1e3, 1)} mm")
    if seconds := policy.decision_seconds:
        first = policy.first_decision_ms
        planning = "" if first is None else f"; until the first action {milliseconds(first)} (median)"
        facts.append(f"decisions {seconds.value:.2g} s per episode{planning}")
        if policy.construction_ms is not None:
            facts.append(f"construction {policy.construction_ms:.3g} ms")
    facts += policy.isolation
    facts += [f"solver failures: {policy.solver_failures}"] * (policy.solver_failures > 0)
    facts += policy.interventions
    if policy.missed_deadlines:
        facts.append(f"deadlines missed: {100 * policy.missed_deadlines:.2g} %")
    return Remark("; ".join(facts))


def trainings_in_words(policy: PolicySummary) -> str:
    """Return the scores of a group's trainings, their standard deviation without that of episodes, and Student's t."""
    scale, unit, points = (100, " %", " points") if policy.success else (1, "", "")
    each = ", ".join(f"{scale * score:.1f}" for score in policy.trainings.values())
    name = "success" if policy.success else "return"
    spread = f"standard deviation {scale * (policy.between_seed_std or 0):.1f}{points}"
    interval = _bracketed(policy.if_normal, scale, 1) if policy.if_normal else ""
    student = f", mean within{interval}{unit} if trainings vary normally (Student's t, 95 %)" if interval else ""
    return f"{name} by training {each}{unit}, {spread}{student}"


def difference_table(pairs: Sequence[Difference], baseline: str | None = None) -> Table:
    """Return a row for each pair of policies: by success, or by the higher return if success is unknown."""
    by_success, paired = any(pair.success_p is not None for pair in pairs), all(pair.paired for pair in pairs)
    name, gain = Column("a - b"), Column("return")
    counted = Column("only a / only b" if paired else "a won / b won", optional=True)
    columns = [name, Column("success"), counted, Column("p"), gain, Column("steps")]
    p_values = holm_adjusted(pairs, baseline)
    family = f"the pairs of {baseline}, and of all others for all pairs" if baseline else "all pairs"
    rows = []
    for pair, p in zip(pairs, p_values, strict=True):
        names, difference = Cell(pair.a, AGAINST + pair.b), plain(pair.return_difference, "+")
        if by_success:
            counts = Cell(f"{pair.only_a} / {pair.only_b}" if paired else _wins(pair))
            success, steps = percent(pair.success_difference, "+"), plain(pair.steps_difference, "+")
            rows.append([names, success, counts, Cell(p_value(p.success)), difference, steps])
        else:
            rows.append([names, difference, percent(pair.superiority.probability), Cell(p_value(p.higher))])
    if by_success:
        caption = f"p: {tests_in_words(pairs)} for equal success, after Holm's correction for {family}, "
        caption += "and for success, steps and returns together. Intervals: 95 %, each pair by itself."
        if any(pair.crossed for pair in pairs):
            caption += " [*]: for other trainings and other episodes, whatever the distribution of trainings."
        caption += _if_normal(pairs)
    else:
        columns = [name, gain, Column("a is better"), Column("p")]
        share = "share of episodes in which" if paired else "probability with which"
        caption = f"a is better: {share} a has the higher return; a tie counts half. "
        caption += f"p: {tests_in_words(pairs).rstrip(',')}, after Holm's correction for {family}. Intervals: 95 %."
    records = [
        {
            **dataclasses.asdict(pair), "p_corrected": p.success if by_success else p.higher,
            "steps_p_corrected": p.steps, "return_p_corrected": p.returns,
        }
        for pair, p in zip(pairs, p_values, strict=True)
    ]  # fmt: skip
    title = "Paired differences, on the same episodes" if paired else "Unpaired differences, on different episodes"
    return Table("differences", title, columns, rows, records, caption)


def tests_in_words(pairs: Sequence[Difference]) -> str:
    """Return by what tests success is compared, or if it is unknown, the higher return; with a comma if need be."""
    by_success, paired = any(pair.success_p is not None for pair in pairs), all(pair.paired for pair in pairs)
    if by_success:
        test = f"{'McNemar' if paired else UNCONDITIONAL}'s exact test"
    else:
        test = "sign test" if paired else RANDOM_WEIGHTS
    if any(pair.any_number for pair in pairs):
        test = f"{'test' if by_success else test} by betting, which holds at any number of episodes,"
    of_groups = [pair.a.endswith(GROUP) or pair.b.endswith(GROUP) for pair in pairs]
    if all(of_groups):
        return RANDOM_TRAININGS
    return f"{test.rstrip(',')}, of {GROUP} {RANDOM_TRAININGS}," if any(of_groups) else test


def _wins(pair: Difference) -> str:
    """Return the wins of both, each of so many episodes."""
    first, second = (f"{won} of {size}" for won, size in zip(pair.wins, pair.sample_sizes, strict=True))
    return f"{first} / {second}"


def _if_normal(pairs: Sequence[Difference]) -> str:
    """Return Student's intervals of pairs with several trainings, and their assumption."""
    differences = [
        f"{pair.a} - {pair.b} {100 * pair.crossed.if_normal.value:+.1f}{interval} points"
        for pair in pairs
        if pair.crossed and (interval := _bracketed(pair.crossed.if_normal, 100, 1))
    ]
    return f" Only if trainings vary normally (Student's t): success {', '.join(differences)}." if differences else ""


def sweep_parts(
    points: "pd.DataFrame", pairs: Mapping[PairKey, Difference], looks: Sequence[int] = (), paired: bool = True
) -> list[Table | Remark]:
    """Return a table for each disturbance, of all policies at all levels, and from which level each gets worse.

    `pairs` are the tests of each two policies, as `Sweep.pairs` has them, `looks` the earlier ones of `Sweep.looks`;
    episodes of all levels are the same ones if they are `paired`.
    """
    by_success, policies = bool(points.success.notna().any()), points.policy.nunique()
    effects, rankings = degradations(points), robustness_rankings(points, pairs)
    parts: list[Table | Remark] = []
    if rankings and policies > 1:
        parts.append(Remark(with_looks(robustness_headline(rankings), looks), "verdict"))
    for name, rows in points.groupby("disturbance", sort=False):
        levels = list(dict.fromkeys(rows.level))
        if len(levels) == 1:  # the undisturbed one: cut short
            continue
        heading, column = ("success, %", "success") if by_success else ("return", "return")
        table_rows = []
        for policy, own_rows in rows.groupby("policy", sort=False):
            values = own_rows.set_index("level")[column]
            spared = set(own_rows.level[own_rows.spared])
            cells = [
                Cell(SPARED)
                if x in spared
                else _at_level(float(values[x]), by_success)
                if x in values
                else Cell(UNKNOWN)
                for x in levels
            ]
            table_rows.append([Cell(str(policy)), *cells])
        parts.append(
            Table(
                "points",
                f"{name}, {rows.unit.iloc[0]}",
                [Column(heading), *(Column(f"{level:g}") for level in levels)],
                table_rows,
                [dict(zip(rows.columns, row, strict=True)) for row in rows.itertuples(index=False)],
            )
        )
        parts.append(
            Remark(_degradation_text([effect for effect in effects if effect.disturbance == name], by_success))
        )
        parts += [Remark(str(ranking)) for ranking in rankings if ranking.disturbance == name and policies > 1]
    test, rate = "McNemar's exact test" if by_success else "sign test", f"{100 * FALSE_DISCOVERY_RATE:g} %"
    if not paired:
        test = f"{UNCONDITIONAL}'s exact test" if by_success else RANDOM_WEIGHTS
    if points.policy.str.endswith(GROUP).any():
        test += (
            f"; {GROUP}: over trainings and episodes, never significant with fewer than {FEWEST_TRAININGS} trainings"
        )
    episodes = f"{'the same' if paired else 'different'} episodes"
    worse = f"Worse: than without disturbance, on {episodes} ({test}, false discovery rate {rate})."
    parts.append(Remark(with_looks(worse, looks)))
    return parts


def _at_level(value: float, by_success: bool) -> Cell:
    if math.isnan(value):
        return Cell(UNKNOWN)
    return Cell(f"{100 * value:.1f}" if by_success else plain(Estimate(value, None, None)).text)


def _degradation_text(effects: Sequence[Degradation], by_success: bool) -> str:
    """Return a sentence for each policy that gets significantly worse, and one for the others."""
    sentences, unharmed = [], []
    for effect in effects:
        name = f"{effect.policy} (sees the state)" if effect.sees == "state" else effect.policy
        drop = effect.largest_drop if by_success else None
        size = f" ({100 * drop[0]:.1f} points at {drop[1]:g})" if drop and round(1000 * drop[0]) else ""
        steps = [f"no significant drop{size}"] if effect.drops is None else [f"worse {effect.drops}"]
        steps += [] if effect.below_half is None else [f"below half {effect.below_half}"]
        if effect.drops or effect.below_half:
            sentences.append(f"{name}: {', '.join(steps)}.")
        else:
            unharmed.append(f"{name}{size}")
    if unharmed:
        sentences.append(f"No significant drop: {', '.join(unharmed)}.")
    return " ".join(sentences)


def _bracketed(estimate: Estimate, scale: float, digits: int) -> str:
    if estimate.low is None or estimate.high is None:
        return ""
    return f" [{scale * estimate.low:.{digits}f}, {scale * estimate.high:.{digits}f}]"


def _without(
    headings: Sequence[str], columns: Sequence[Column], rows: Sequence[Sequence[Cell]]
) -> tuple[list[Column], list[list[Cell]]]:
    kept = [i for i, column in enumerate(columns) if column.heading not in headings]
    return [columns[i] for i in kept], [[row[i] for i in kept] for row in rows]
