"""The robustness of policies: the cells of one task, undisturbed and at each level of each disturbance."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydantic import InstanceOf

from armctl.episodes.stored import SLOW_DOWN_NAME, UNDISTURBED
from armctl.policies import isolation
from armctl.stats.difference import Difference
from armctl.stats.intervals import Estimate
from armctl.stats.leaders import leaders
from armctl.stats.robustness import NEUTRAL, PairKey, change_between
from armctl.study.axis import Axis
from armctl.study.comparison import Comparison
from armctl.study.grid import Grid
from armctl.study.grid_tables import GridMap, grid_maps, grid_parts
from armctl.study.names import setting_name
from armctl.verdict.facts import Finite
from armctl.verdict.notebook import Displayed
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import sweep_parts
from armctl.verdict.tables import Document, Remark

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    "disturbance", "level", "policy", "episodes", "success", "low", "high", "return", "return_low", "return_high",
    "steps_to_goal", "steps_low", "steps_high", "p", "change", "unit", "sees",
    "spared",
)  # fmt: skip
"""Columns of `sweep.csv`: one row per disturbance, level and policy, with 95 % intervals.

`p` is McNemar's p-value for equal success in the same episodes without the disturbance, or the sign test's for equal
return if success is unknown; for a group of trainings, that of random weights of trainings and of episodes; where the
environment does not obey its seed, that of `unconditional`; and where cells stop when they are decided, that of
`armctl.stats.sequential`. `change` is
the tested statistic: success minus that without the disturbance, or the share of episodes with a higher return minus
the share with a lower one. `spared` is True where the disturbance does not reach the policy, which is in no test then:
`p` and `change` are NaN."""
PAIR_COLUMNS = ("rows", "row_level", "columns", "column_level", *COLUMNS[2:])
"""Columns of a cell of a grid and a policy: as `COLUMNS`, with a level of each of two disturbances."""


@dataclass(repr=False)
class Sweep(Displayed):
    """The results of one task. After an interrupt or a failure, they cover the finished episodes."""

    env: str
    seed: int
    levels: Mapping[str, Sequence[Finite]]
    """The levels of each disturbance, beginning with the one that changes nothing."""
    units: Mapping[str, str]
    """Units of each disturbance's levels."""
    recorded: str
    """Source of the decision times of the slow-down levels; empty without such levels."""
    comparisons: InstanceOf[dict[str, Comparison]]
    """Comparisons by setting: `none`, `payload-2.0` and so on."""
    failures: dict[str, str]
    """Error messages: by setting and policy, or under `results` if results could not be written."""
    interrupted: bool
    grids: Sequence[Grid] = ()
    """Pairs of disturbances."""
    axes: Sequence[Axis] = ()
    """Box of disturbances in which worst cases are searched; its comparisons are one for each policy."""

    def document(self) -> Document:
        """Return a table for each disturbance, and the level from which each policy gets worse; then those of pairs."""
        parts = sweep_parts(self.points, self.pairs, self.looks, self.paired) if self.levels else []
        parts += grid_parts(self.maps, self.looks)
        waiting = (comparison for comparison in self.comparisons.values() if comparison.facts.real_time is None)
        notes = itertools.chain.from_iterable(comparison.notes for comparison in waiting)
        parts += [Remark(note, "note") for note in dict.fromkeys(notes)]
        if self.undisturbed is not None:
            apart = isolation({policy.policy: policy.isolated for policy in self.undisturbed.policies})
            parts += [Remark(apart)] if apart else []
        if self.recorded:
            times = f"with the decision times of {self.recorded}"
            parts.append(Remark(f"{SLOW_DOWN_NAME}: in real time, {times}; at level 0, the world waits."))
        parts += [Remark(f"{name}: {why}", "problem") for name, why in self.failures.items()]
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        return Document(parts, {"env": self.env, "seed": self.seed})

    @property
    def undisturbed(self) -> Comparison | None:
        """The comparison without a disturbance; None before it has any episode."""
        return self.comparisons.get(UNDISTURBED)

    @property
    def settings(self) -> dict[str, tuple[str, float]]:
        """The disturbance and level of each disturbed setting, by its name."""
        return {setting_name(name, level): (name, level) for name, at in self.levels.items() for level in at[1:]}

    @cached_property
    def points(self) -> "pd.DataFrame":
        """The rows of `sweep.csv`; worked out once, when all is played."""
        import pandas as pd

        undisturbed = self.undisturbed
        if undisturbed is None:
            return pd.DataFrame(columns=list(COLUMNS))
        rows = []
        for name, levels in self.levels.items():
            for level in levels:
                first = level == levels[0]
                comparison = undisturbed if first else self.comparisons.get(setting_name(name, level))
                if comparison is None:
                    continue
                for policy in comparison.policies:
                    change = (1.0, 0.0) if first else self._change(undisturbed, comparison, policy)
                    values = (name, level, *_point(policy, change, self.units[name]))
                    rows.append(dict(zip(COLUMNS, values, strict=True)))
        return pd.DataFrame(rows, columns=list(COLUMNS))

    @cached_property
    def maps(self) -> list[GridMap]:
        """Success and leaders in the cells of each pair of disturbances; worked out once, when all is played."""
        undisturbed = self.undisturbed
        if undisturbed is None or not self.grids:
            return []
        rows = []
        for grid in self.grids:
            for row, column in itertools.product(grid.row_levels, grid.column_levels):
                setting = grid.setting(row, column)
                if (comparison := self.comparisons.get(setting)) is None:
                    continue
                for policy in comparison.policies:
                    is_first = setting == UNDISTURBED
                    change = (1.0, 0.0) if is_first else self._change(undisturbed, comparison, policy)
                    unit = f"{self.units[grid.rows]}; {self.units[grid.columns]}"
                    values = (grid.rows, row, grid.columns, column, *_point(policy, change, unit))
                    rows.append(dict(zip(PAIR_COLUMNS, values, strict=True)))
        tests = {name: cell.differences for name, cell in self.comparisons.items() if name in self._settings_of_grids}
        return grid_maps(self.grids, rows, leaders(tests))

    @property
    def _settings_of_grids(self) -> set[str]:
        return {
            grid.setting(*levels)
            for grid in self.grids
            for levels in itertools.product(grid.row_levels, grid.column_levels)
        }

    @property
    def paired(self) -> bool:
        """True if episodes of the same number are the same ones, whoever plays them."""
        return all(comparison.facts.paired for comparison in self.comparisons.values())

    @property
    def any_number(self) -> bool:
        """True if cells stop when they are decided, so that tests have to hold at any number of episodes."""
        return self.paired and any(cell.facts.at_most is not None for cell in self.comparisons.values())

    @property
    def pairs(self) -> dict[PairKey, Difference]:
        """The tests of each two policies at each level."""
        where = self.settings | {UNDISTURBED: NEUTRAL}
        return {
            (*where[name], frozenset((pair.a, pair.b))): pair
            for name, comparison in self.comparisons.items()
            if name in where
            for pair in comparison.differences
        }

    @property
    def looks(self) -> list[int]:
        """Numbers of episodes after which earlier runs of any comparison printed a verdict.

        None where tests hold at any number.
        """
        if self.any_number:
            return []
        return sorted({episodes for comparison in self.comparisons.values() for episodes in comparison.looks})

    def _change(self, undisturbed: Comparison, disturbed: Comparison, policy: PolicySummary) -> tuple[float, float]:
        """Return the p-value for no change, and the change: see `COLUMNS`."""
        if policy.spared:
            return math.nan, math.nan
        names = policy.trainings or [policy.policy]
        tables = (undisturbed.counted_rows, disturbed.counted_rows)
        first, second = (rows[rows.policy.isin(names)] for rows in tables)
        score = "return" if policy.success is None else "success"
        return change_between(first, second, score, self.paired, self.any_number)

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(self.points.policy)) or "no policy"
        swept = ", ".join(f"{name} at {len(levels)} levels" for name, levels in self.levels.items())
        return f"<Sweep of {names} in {self.env}, seed {self.seed}: {swept}>"


def _point(policy: PolicySummary, change: tuple[float, float], unit: str) -> tuple[Any, ...]:
    """Return a policy's columns in `sweep.csv` and `pairs.csv` after those of the levels."""
    return (
        policy.policy, policy.episodes, *_numbers(policy.success), *_numbers(policy.episode_return),
        *_numbers(policy.steps_to_goal), *change, unit, policy.sees, bool(policy.spared),
    )  # fmt: skip


def _numbers(estimate: Estimate | None) -> tuple[float, float, float]:
    """Value and bounds; NaN where unknown."""
    if estimate is None:
        return math.nan, math.nan, math.nan
    return estimate.value, *estimate.bounds
