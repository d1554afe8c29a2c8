"""Success and leaders under two disturbances at once, as maps and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from armctl.core.arrays import Array
from armctl.runtime.provenance import with_looks
from armctl.stats.leaders import Leader
from armctl.stats.robustness import FALSE_DISCOVERY_RATE
from armctl.study.grid import Grid
from armctl.verdict.summary_tables import SPARED
from armctl.verdict.tables import UNKNOWN, Cell, Column, Remark, Table

LEADER_COLUMNS = ("leader", "ties", "not_worse", "certain")
"""Columns of `pairs.csv` besides `PAIR_COLUMNS`: the cell's leader, policies with exactly the same success, those that
are not significantly worse, and whether the lead is certain."""
UNCERTAIN = "?"
"""Mark of a lead that is not certain."""
NO_LEADER = "equal"
LEGEND = (
    "Leads: highest success, or without success the higher return in most episodes; without a mark, each other policy "
    "is significantly worse there (false discovery rate 5 % over all pairs of policies and cells of all grids); "
    f"{UNCERTAIN}: not certain; {NO_LEADER}: several share the highest."
)


@dataclass(frozen=True)
class GridMap:
    """Results in the cells of a pair of disturbances."""

    grid: Grid
    policies: Sequence[str]
    by_success: bool
    """True if values are success rates; else they are mean returns."""
    values: Mapping[str, Array]
    """(row levels, column levels) value of each policy; NaN in cells that were not played."""
    worse: Mapping[str, Array]
    """Cells in which a policy is significantly worse than undisturbed."""
    spared: Mapping[str, Array]
    """Cells whose disturbances do not reach a policy."""
    leaders: Sequence[Sequence[Leader | None]]
    """Leader by row and column level; None without a test."""
    records: Sequence[Mapping[str, Any]]
    """Rows of `pairs.csv`."""

    @property
    def start(self) -> int:
        """Index of the first row and column that maps show: the neutral one if a disturbance was played alone."""
        has_value = np.asarray(np.isfinite(np.stack([*self.values.values()])).any(axis=0))
        return 0 if has_value[0, 1:].any() or has_value[1:, 0].any() else 1

    @property
    def row_levels(self) -> Sequence[float]:
        """Levels of the rows that maps show."""
        return self.grid.row_levels[self.start :]

    @property
    def column_levels(self) -> Sequence[float]:
        """Levels of the columns that maps show."""
        return self.grid.column_levels[self.start :]

    def texts(self, policy: str | None) -> list[list[str]]:
        """Return the values of a policy, or without one the leaders, as maps print them."""
        rows, columns = (range(self.start, len(at)) for at in (self.grid.row_levels, self.grid.column_levels))
        return [[self.leader_text(i, j) if policy is None else self.text(policy, i, j) for j in columns] for i in rows]

    def text(self, policy: str, row: int, column: int) -> str:
        """Return a value as maps print it: in percent if it is a success rate."""
        value = float(self.values[policy][row, column])
        if self.spared[policy][row, column]:
            return SPARED
        if np.isnan(value):
            return UNKNOWN
        return f"{100 * value:.0f}" if self.by_success else f"{value:.1f}"

    def leader_text(self, row: int, column: int) -> str:
        """Return the leader of a cell, with the mark of an uncertain lead."""
        leader = self.leaders[row][column]
        if leader is None:
            return UNKNOWN
        return NO_LEADER if leader.ties else leader.policy + f" {UNCERTAIN}" * (not leader.certain)


def grid_maps(
    grids: Sequence[Grid], rows: Sequence[Mapping[str, Any]], leader_of: Mapping[str, Leader]
) -> list[GridMap]:
    """Return the map of each grid from the rows of all cells, and the leaders by setting.

    A change from undisturbed is significant at a false discovery rate of 5 % over all policies and cells of all grids.
    """
    tested = {i: float(row["p"]) for i, row in enumerate(rows) if not np.isnan(row["p"]) and _is_disturbed(grids, row)}
    adjusted: Any = scipy.stats.false_discovery_control(list(tested.values())) if tested else []
    worse = {i for i, p in zip(tested, adjusted, strict=True) if p < FALSE_DISCOVERY_RATE and rows[i]["change"] < 0}
    played_grids = {(row["rows"], row["columns"]) for row in rows}
    return [_map(grid, rows, worse, leader_of) for grid in grids if (grid.rows, grid.columns) in played_grids]


def _is_disturbed(grids: Sequence[Grid], row: Mapping[str, Any]) -> bool:
    grid = next(grid for grid in grids if (grid.rows, grid.columns) == (row["rows"], row["columns"]))
    return (row["row_level"], row["column_level"]) != (grid.row_levels[0], grid.column_levels[0])


def _map(grid: Grid, rows: Sequence[Mapping[str, Any]], worse: set[int], leader_of: Mapping[str, Leader]) -> GridMap:
    cells = {i: row for i, row in enumerate(rows) if (row["rows"], row["columns"]) == (grid.rows, grid.columns)}
    policies = list(dict.fromkeys(row["policy"] for row in cells.values()))
    by_success = any(not np.isnan(row["success"]) for row in cells.values())
    shape = len(grid.row_levels), len(grid.column_levels)
    values = {name: np.full(shape, np.nan) for name in policies}
    is_worse, spared = ({name: np.zeros(shape, dtype=bool) for name in policies} for _ in range(2))
    records = []
    for i, row in cells.items():
        at = list(grid.row_levels).index(row["row_level"]), list(grid.column_levels).index(row["column_level"])
        values[row["policy"]][at] = row["success" if by_success else "return"]
        is_worse[row["policy"]][at], spared[row["policy"]][at] = i in worse, row["spared"]
        leader = leader_of.get(grid.setting(row["row_level"], row["column_level"]))
        about = (
            (leader.policy, " ".join(leader.ties), " ".join(leader.not_worse), leader.certain) if leader else ("",) * 4
        )
        records.append({**row, **dict(zip(LEADER_COLUMNS, about, strict=True))})
    by_cell = [[leader_of.get(grid.setting(row, column)) for column in grid.column_levels] for row in grid.row_levels]
    return GridMap(grid, policies, by_success, values, is_worse, spared, by_cell, records)


def grid_parts(maps: Sequence[GridMap], looks: Sequence[int] = ()) -> list[Table | Remark]:
    """Return a table for each grid and policy, and one of the leaders; `looks` are those of `Sweep.looks`."""
    parts: list[Table | Remark] = []
    for grid_map in maps:
        quantity = "success, %" if grid_map.by_success else "return"
        for name in grid_map.policies:
            undisturbed = f", undisturbed {grid_map.text(name, 0, 0)}" if grid_map.start else ""
            parts.append(_table(grid_map, name, f"{name}, {quantity}{undisturbed}", grid_map.records))
        if any(leader for row in grid_map.leaders for leader in row):
            parts.append(_table(grid_map, None, "leads", []))
    if maps:
        parts.append(Remark(with_looks(grid_summary(maps), looks)))
    if any(len(grid_map.policies) > 1 for grid_map in maps):
        parts.append(Remark(LEGEND))
    return parts


def _table(grid_map: GridMap, policy: str | None, title: str, records: Sequence[Mapping[str, Any]]) -> Table:
    """Return the values of a policy, or the leaders, by level of cells disturbances."""
    grid, texts = grid_map.grid, grid_map.texts(policy)
    return Table(
        "pairs",
        f"{grid.name}: {title}",
        [Column(f"{grid.rows} \\ {grid.columns}"), *(Column(f"{level:g}") for level in grid_map.column_levels)],
        [[Cell(f"{level:g}"), *map(Cell, row)] for level, row in zip(grid_map.row_levels, texts, strict=True)],
        [record for record in records if record["policy"] == policy],
    )


def grid_summary(maps: Sequence[GridMap]) -> str:
    """Return the number of cells in which each policy leads, and in which it is worse than undisturbed."""
    sentences = []
    for grid_map in maps:
        grid, cells = grid_map.grid, [(i + 1, j + 1) for i, j in np.ndindex(*_inner(grid_map.grid))]
        leaders = [leader for i, j in cells if (leader := grid_map.leaders[i][j]) is not None and not leader.ties]
        leads = [
            f"{name} leads in {len(of_policy)} ({sum(leader.certain for leader in of_policy)} certain)"
            for name in grid_map.policies
            if (of_policy := [leader for leader in leaders if leader.policy == name])
        ]
        worse = [
            f"{name} is worse than undisturbed in {count}"
            for name in grid_map.policies
            if (count := sum(bool(grid_map.worse[name][at]) for at in cells))
        ]
        unharmed = ["no policy is significantly worse than undisturbed"] if not worse else []
        sentences.append(f"{grid.name}, {len(cells)} cells: {'; '.join([*leads, *worse, *unharmed])}.")
    return " ".join(sentences)


def _inner(grid: Grid) -> tuple[int, int]:
    return len(grid.row_levels) - 1, len(grid.column_levels) - 1
