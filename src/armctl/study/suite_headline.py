"""The headline of a suite: in which tasks which kind is better."""

import math
import re
from collections.abc import Sequence

from armctl.core.registration import short_name
from armctl.episodes.stored import UNDISTURBED
from armctl.runtime.provenance import looks_in_words
from armctl.stats.difference import MARGIN
from armctl.stats.intervals import FEWEST
from armctl.stats.robustness import listed
from armctl.study.task_verdict import TaskVerdict, kind_in_words


def suite_headline(verdicts: Sequence[TaskVerdict]) -> tuple[str, str]:
    """Return two sentences: in which tasks each kind is better in success, and the details of the others.

    `verdicts` are corrected for all tasks, as `Study.verdicts` is. The second one may be empty.
    """
    if not verdicts:
        return "No task", ""
    by_claim: dict[str, list[str]] = {"classical is better": [], "learned is better": []}
    faster: dict[str, list[str]] = {"classical takes fewer steps": [], "learned takes fewer steps": []}
    details, ahead = [], list[str]()
    for verdict, task in zip(verdicts, _brief_names(verdicts), strict=True):
        claim, detail = _claim(verdict)
        by_claim.setdefault(claim, []).append(task)
        details += [f"{task}: {detail}"] if detail else []
        if verdict.undisturbed and verdict.undisturbed.faster:
            faster[f"{kind_in_words(verdict.undisturbed.faster).lower()} takes fewer steps"].append(task)
        rivals = verdict.hybrid_pairs.values()
        if rivals and all(UNDISTURBED in pairs and pairs[UNDISTURBED].better > 0 for pairs in rivals):
            ahead.append(task)
    claims, steps = (
        [f"{claim} in {listed(tasks)}" for claim, tasks in named.items() if tasks] for named in (by_claim, faster)
    )
    if ahead:
        claims.append(f"the best hybrid is better than the best of the other kinds in {listed(ahead)}")
    looks = sorted({episodes for verdict in verdicts for episodes in verdict.looks})
    details += [*steps, *([looks_in_words(looks)] if looks else [])]
    return f"Of {len(verdicts)} task{'s' * (len(verdicts) > 1)}, by success: {'; '.join(claims)}", "; ".join(details)


def _brief_names(verdicts: Sequence[TaskVerdict]) -> list[str]:
    """Return the tasks' names without versions, unless these tell two of them apart."""
    names = [short_name(verdict.env) for verdict in verdicts]
    brief = [re.sub(r"-v\d+$", "", name) for name in names]
    return brief if len(set(brief)) == len(set(names)) else names


def _claim(verdict: TaskVerdict) -> tuple[str, str]:
    """Return what holds in a task, undisturbed, and a detail; empty without any."""
    pair = verdict.undisturbed
    if pair is None:
        return "no verdict", verdict.reason_for_no_pair
    if pair.episodes < FEWEST:
        return "no verdict", f"{pair.episodes} episode{'s' * (pair.episodes > 1)}"
    margin = f"{100 * MARGIN:g} points"
    if pair.better:
        return f"{kind_in_words(pair.better).lower()} is better", f"by less than {margin}" if pair.equivalent(
            MARGIN
        ) else ""
    if pair.equivalent(MARGIN):
        return f"equivalent within {margin}", ""
    largest = max(map(abs, pair.equivalence_interval.bounds))
    return "undecided", f"up to {math.ceil(1000 * largest) / 10:g} points apart after {pair.episodes} episodes"
