"""A grid of the levels of two disturbances."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from armctl.episodes.stored import UNDISTURBED
from armctl.study.names import setting_name
from armctl.verdict.facts import Finite


@dataclass(frozen=True)
class Grid:
    """Two disturbances, each at several levels, the first of which changes nothing."""

    rows: str
    columns: str
    row_levels: Sequence[Finite]
    column_levels: Sequence[Finite]

    @property
    def name(self) -> str:
        """Name in tables and figures."""
        return f"{self.rows} x {self.columns}"

    @property
    def cells(self) -> Iterator[tuple[float, float]]:
        """Levels of all cells with both disturbances."""
        return itertools.product(self.row_levels[1:], self.column_levels[1:])

    def setting(self, row: float, column: float) -> str:
        """Return the name of a cell: of one disturbance alone, it is that of a sweep of this one."""
        disturbed = [
            setting_name(name, level)
            for name, level, neutral in (
                (self.rows, row, self.row_levels[0]),
                (self.columns, column, self.column_levels[0]),
            )
            if level != neutral
        ]
        return "+".join(disturbed) or UNDISTURBED
