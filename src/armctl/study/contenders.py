"""The policies that represent the two kinds in a task of a suite, and whether it is decided between them."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import Choice, choose, pairwise_by_task
from armctl.stats.difference import MARGIN
from armctl.stats.intervals import FEWEST
from armctl.study.comparison import Comparison
from armctl.verdict.summary import counted_rows

if TYPE_CHECKING:
    import pandas as pd

    from armctl.rollout.seeding import SeedCheck
    from armctl.study.plan import Cell


@dataclass
class Task:
    """Values that the cells of a task share while they are played."""

    lower_bound_steps: dict[int, float] = field(default_factory=dict)
    """Lower bounds by episode, as in `rollouts`."""
    seeding: "SeedCheck | None" = None
    """None before the first cell is played."""
    contenders: tuple[Choice | None, Choice | None] = None, None
    """The choices that represent the kinds, after the undisturbed cell of a suite."""

    def is_decided(self, cell: "Cell", so_far: Comparison, num_verdicts: int) -> bool:
        """Return True if a suite's verdict on a cell `so_far`, one of so many, is no longer undecided."""
        undisturbed = cell.setting == UNDISTURBED
        classical, learned = contenders(so_far, any_number=True) if undisturbed else self.contenders
        if classical is None or learned is None:
            return False
        return is_task_decided(so_far, classical, learned, num_verdicts)


def contenders(undisturbed: Comparison, any_number: bool) -> tuple[Choice | None, Choice | None]:
    """Return the choices of the best classical and of the best learned policy; None of a kind that has not played."""
    table = success_table(undisturbed)
    if table is None:
        return None, None
    rows = counted_rows(undisturbed.results)
    returns = rows.pivot(index="episode", columns="policy", values="return").reindex(table.index)
    kinds: list[Choice | None] = []
    for learned in (False, True):
        names = [policy.policy for policy in undisturbed.policies if policy.learned == learned]
        kinds.append(choose(table, returns, names, any_number) if names else None)
    return kinds[0], kinds[1]


def is_task_decided(cell: Comparison, classical: Choice, learned: Choice, num_verdicts: int) -> bool:
    """Return True if one choice is better in a cell, or both are equivalent, even as one of so many verdicts.

    Each of them has a test of success and one of steps.
    """
    if (table := success_table(cell)) is None:
        return False
    pair = pairwise_by_task({UNDISTURBED: table}, UNDISTURBED, classical, learned).get(UNDISTURBED)
    if pair is None or pair.episodes < FEWEST:
        return False
    corrected = replace(pair, p=2 * num_verdicts * pair.p, num_comparisons=num_verdicts)
    return bool(corrected.better) or corrected.equivalent(MARGIN)


def success_table(comparison: Comparison) -> "pd.DataFrame | None":
    """Return success by episode and policy; None if it is unknown. The episodes are those of `counted_results`.

    Policies that the disturbance does not reach are left out.
    """
    episodes = comparison.episodes
    if not len(episodes) or not comparison.policies or episodes.success.isna().any():
        return None
    success = counted_rows(comparison.results).pivot(index="episode", columns="policy", values="success").astype(float)
    return success.reindex(columns=[policy.policy for policy in comparison.policies if not policy.spared])
