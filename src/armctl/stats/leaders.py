"""The policy that leads in each cell of a grid, and whether that is certain."""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import scipy

from armctl.stats.robustness import FALSE_DISCOVERY_RATE


class PairTest(Protocol):
    """The test of two policies, such as `armctl.stats.difference.Difference`."""

    @property
    def a(self) -> str:
        """One policy."""

    @property
    def b(self) -> str:
        """The other."""

    @property
    def p(self) -> float:
        """Two-sided p-value of the lead."""

    def lead_of(self, policy: str) -> float:
        """Return the lead of one policy over the other."""


@dataclass(frozen=True)
class Leader:
    """The policy with the largest mean lead over the others in a cell."""

    policy: str
    ties: Sequence[str]
    """Policies with exactly the same mean lead."""
    not_worse: Sequence[str]
    """Policies that are not significantly worse."""

    @property
    def certain(self) -> bool:
        """True if all others are significantly worse."""
        return not self.not_worse


Cell = TypeVar("Cell", bound=Hashable)


def leaders(tests: Mapping[Cell, Iterable[PairTest]]) -> dict[Cell, Leader]:
    """Return the leader of each cell with a test, from the tests of each two policies in it.

    Which policy leads is observed, so the lead is *certain* only if its tests against all others are significant, at a
    false discovery rate of 5 % over all tests of all cells (Benjamini and Hochberg 1995).
    """
    listed = [(cell, test) for cell, in_cell in tests.items() for test in in_cell]
    adjusted: Any = scipy.stats.false_discovery_control([test.p for _, test in listed]) if listed else []
    by_cell: dict[Cell, list[tuple[PairTest, bool]]] = {}
    for (cell, test), p in zip(listed, adjusted, strict=True):
        by_cell.setdefault(cell, []).append((test, bool(p < FALSE_DISCOVERY_RATE)))
    return {cell: _leader(in_cell) for cell, in_cell in by_cell.items()}


def _leader(tests: Sequence[tuple[PairTest, bool]]) -> Leader:
    names = list(dict.fromkeys(name for test, _ in tests for name in (test.a, test.b)))

    def lead(name: str) -> float:
        return round(sum(test.lead_of(name) for test, _ in tests if name in (test.a, test.b)), 9)

    first = max(names, key=lead)
    beaten = {
        test.b if test.a == first else test.a
        for test, is_significant in tests
        if is_significant and first in (test.a, test.b) and test.lead_of(first) > 0
    }
    others = [name for name in names if name != first]
    return Leader(
        first,
        [name for name in others if lead(name) == lead(first)],
        [name for name in others if name not in beaten],
    )
