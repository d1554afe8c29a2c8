"""Pairs that may have been chosen: by the episodes that are left out, or by files that were sorted by success."""

import itertools
import math
from collections.abc import Mapping, Sequence

from armctl.judging.trials import Trial
from armctl.stats.difference import SIGNIFICANT
from armctl.stats.unpaired import unconditional

MAX_LEFT_OUT = 0.1
"""Share of a policy's episodes beyond which leaving them out is a doubt by itself."""


def left_out_notes(
    kept: Mapping[str, Sequence[Trial]], left_out: Mapping[str, Sequence[Trial]]
) -> tuple[list[str], list[str]]:
    """Return a remark on the episodes that not all policies have, by policy, and a doubt if they may be chosen."""
    counts, doubtful = [], []
    for policy, trials in left_out.items():
        if not trials:
            continue
        pairs = kept[policy]
        is_doubtful = len(trials) > MAX_LEFT_OUT * (len(trials) + len(pairs))
        count = f"{len(trials)} of {policy}"
        if all(trial.success is not None for trial in (*trials, *pairs)):
            wins = [sum(bool(trial.success) for trial in part) for part in (trials, pairs)]
            count += f" ({wins[0]} of them and {wins[1]} of the {len(pairs)} kept are successes)"
            is_doubtful |= unconditional(wins[0], len(trials), wins[1], len(pairs)) < SIGNIFICANT
        counts.append(count)
        doubtful += [policy] * is_doubtful
    if not counts:
        return [], []
    notes = [f"Episodes that not all policies have are left out: {', '.join(counts)}."]
    doubt = (
        f"The pairs may have been chosen by their outcome: of {' and '.join(doubtful)}, many episodes or unlike ones "
        "are left out. --unpaired compares all."
    )
    return notes, [doubt] * bool(doubtful)


def sorted_policies(members: Mapping[str, Sequence[Trial]]) -> list[str]:
    """Return the policies whose successes, in the order of their keys, all come before or after their failures.

    In an order that is not sorted, this has a chance of at most 5 %.
    """
    policies = []
    for policy, trials in members.items():
        successes = [bool(trial.success) for trial in trials if trial.success is not None]
        changes = sum(a != b for a, b in itertools.pairwise(successes))
        if changes == 1 and 2 / math.comb(len(successes), sum(successes)) < SIGNIFICANT:
            policies.append(policy)
    return policies
