"""Tables that people lay out otherwise: a column for each policy, or counts of successes and of trials."""

import re
from dataclasses import replace

from armctl.judging.columns import plain
from armctl.judging.rows import Rows
from armctl.judging.values import is_empty, truth

SUCCESSES = ("successes", "num_successes", "n_success", "n_successes", "success_count", "wins")
TRIALS = ("trials", "episodes", "num_trials", "num_episodes", "n_trials", "n_episodes", "n", "total", "attempts")

WHOLE = re.compile(r"(\d+)(\.0)?", re.ASCII)


def with_counts(rows: Rows) -> Rows:
    """Return rows whose two columns of successes and of trials are one, such as `17/20`; others as they are."""
    headings = [plain(heading) for heading in rows.headings]
    places = [next((headings.index(name) for name in names if name in headings), None) for names in (SUCCESSES, TRIALS)]
    won, trials = places
    if won is None or trials is None:
        return rows
    values = [
        [*row, f"{_count(rows, i, row[won])}/{_count(rows, i, row[trials])}"] for i, row in enumerate(rows.values)
    ]
    return replace(rows, headings=[*rows.headings, "success"], values=values)


def _count(rows: Rows, i: int, cell: object) -> int:
    match = WHOLE.fullmatch(str(cell).strip())
    return int(match[1]) if match else rows.refuse(i, f"{str(cell)!r:.60} is no number of episodes")


def one_column_per_policy(rows: Rows, used: set[int]) -> Rows:
    """Return a row for each cell if all columns besides those that are `used` are yes or no; else as they are."""
    policies = [i for i, name in enumerate(rows.headings) if name and i not in used]
    kept = [i for i in used if i < len(rows.headings)]
    if len(policies) < 2 or not all(_is_truth(row[i]) for row in rows.values for i in policies):
        return rows
    names = [rows.headings[i] for i in policies]
    return replace(
        rows,
        headings=[*(rows.headings[i] for i in kept), "policy", "success"],
        values=[[*(row[i] for i in kept), rows.headings[p], row[p]] for row in rows.values for p in policies],
        places=[place for place in rows.places for _ in policies],
        notes=[*rows.notes, f"a column for each policy: {', '.join(names)}."],
    )


def _is_truth(cell: object) -> bool:
    try:
        return not is_empty(cell) and truth(cell) in (True, False)
    except ValueError:
        return False
