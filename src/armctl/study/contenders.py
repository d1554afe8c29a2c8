"""The policies that represent the kinds in a task of a suite, and whether it is decided between them."""

import itertools
import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from armctl.core.kinds import KINDS, Kind
from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import SELECTING, Choice, choose, pairwise_by_task
from armctl.stats.difference import MARGIN
from armctl.stats.intervals import FEWEST
from armctl.study.comparison import Comparison

if TYPE_CHECKING:
    import pandas as pd

    from armctl.rollout.seeding import SeedCheck
    from armctl.study.plan import Cell

Contenders = Mapping[Kind, Choice]
"""The choice that represents each kind that has played."""
OTHERS_EPISODES = 10
"""Episodes of a policy that represents no kind after the choice, where a setting stops when it is decided."""


@dataclass
class Task:
    """Values that the cells of a task share while they are played."""

    lower_bound_steps: dict[int, float] = field(default_factory=dict)
    """Lower bounds by episode, as in `rollouts`."""
    seeding: "SeedCheck | None" = None
    """None before the first cell is played."""
    contenders: Contenders = field(default_factory=dict)
    """Empty before the undisturbed cell of a suite was played, and where no cell stops when it is decided."""
    spent: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Decision times (ms) by policy, of all cells so far."""

    @property
    def obeys_seed(self) -> bool:
        """True if the episodes of a seed are the same for all policies, as far as is known."""
        return self.seeding is None or self.seeding.obeyed

    def is_decided(self, cell: "Cell", so_far: Comparison, num_verdicts: int) -> bool:
        """Return True if a suite's verdict on a cell `so_far`, one of so many, is no longer undecided.

        Of one kind alone there is no verdict, and nothing to wait for.
        """
        choices = self.contenders
        if cell.setting == UNDISTURBED:
            choices = contenders(so_far, any_number=True)
            if so_far.counted_rows.groupby("policy").size().min() >= SELECTING:
                self.contenders = choices
        pairs = list(itertools.combinations(choices.values(), 2))
        return bool(choices) and all(is_task_decided(so_far, *pair, num_verdicts * len(pairs)) for pair in pairs)

    def first_episode(self, cell: "Cell", at_most: int) -> int:
        """Return the number of a cell's first episode.

        Those by which the policies of several kinds were chosen do not count for them, disturbed or not: where enough
        others are left, they are not played again under a disturbance.
        """
        kinds = self.contenders.values()
        chosen = len(kinds) > 1 and any(choice.of_several for choice in kinds)
        is_disturbed = cell.setting != UNDISTURBED
        return SELECTING if is_disturbed and chosen and at_most >= SELECTING + FEWEST else 0

    def enough(self, cell: "Cell", policy: str) -> float:
        """Return the number of a cell's episodes after which a policy plays no more.

        It is infinite until those that represent the kinds are chosen, and for these.
        """
        chosen = {choice.policy for choice in self.contenders.values()}
        if not chosen or policy in chosen:
            return math.inf
        return OTHERS_EPISODES + (SELECTING if cell.setting == UNDISTURBED else 0)


def contenders(undisturbed: Comparison, any_number: bool) -> Contenders:
    """Return the choices of the best policy of each kind that has played; empty if success is unknown."""
    table = success_table(undisturbed)
    if table is None:
        return {}
    rows = undisturbed.counted_rows
    returns = rows.pivot(index="episode", columns="policy", values="return").reindex(table.index)
    players = undisturbed.players.items()
    members = {kind: [name for name, policy in players if policy.side == kind] for kind in KINDS}
    return {kind: choose(table, returns, names, any_number) for kind, names in members.items() if names}


def is_task_decided(cell: Comparison, first: Choice, second: Choice, num_verdicts: int) -> bool:
    """Return True if one choice is better in a cell, or both are equivalent, even as one of so many verdicts.

    Each of them has a test of success and one of steps.
    """
    if (table := success_table(cell)) is None:
        return False
    pair = pairwise_by_task({UNDISTURBED: table}, UNDISTURBED, first, second).get(UNDISTURBED)
    if pair is None or pair.episodes < FEWEST:
        return False
    corrected = replace(pair, p=2 * num_verdicts * pair.p, num_comparisons=num_verdicts)
    return bool(corrected.better) or corrected.equivalent(MARGIN)


def success_table(comparison: Comparison, with_spared: bool = False) -> "pd.DataFrame | None":
    """Return success by episode and policy; None if it is unknown. The episodes are those of `counted_results`.

    Policies that the disturbance does not reach are left out, unless the table is asked for `with_spared` ones.
    """
    players = comparison.players
    if not players or (None,) in comparison.results.counts("success"):
        return None
    success = comparison.counted_rows.pivot(index="episode", columns="policy", values="success").astype(float)
    return success.reindex(columns=[name for name in players if with_spared or not players[name].spared])
