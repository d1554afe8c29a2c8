"""A disturbance as an axis of the box in which a worst case is searched."""

import math
from dataclasses import dataclass

import numpy as np

from armctl.core.arrays import Array
from armctl.verdict.facts import Finite

DIGITS = 3
"""Significant digits of levels, so that what is printed is what was played."""
MAX_WHOLE_LEVELS = 1_000
"""Limit of the levels of a disturbance by whole numbers, each of which a search considers."""


@dataclass(frozen=True)
class Axis:
    """A disturbance of the box: shares of its range from 0, without effect, to 1, its end."""

    name: str
    neutral: Finite
    end: Finite
    whole: bool
    """True if levels are whole numbers."""
    unit: str

    @property
    def is_possible(self) -> bool:
        """True if its range has a length, and whole levels can be counted."""
        length = abs(self.end - self.neutral)
        return length > 0 and (not self.whole or length in range(MAX_WHOLE_LEVELS))

    def level(self, share: float) -> float:
        """Return the level at a share of the range."""
        level = self.neutral + share * (self.end - self.neutral)
        return float(round(level)) if self.whole else float(f"{level:.{DIGITS}g}")

    def share(self, level: float) -> float:
        """Return the share of the range at a level."""
        return (level - self.neutral) / (self.end - self.neutral)

    @property
    def whole_shares(self) -> Array:
        """Shares at whole levels."""
        steps = round(abs(self.end - self.neutral))
        return np.arange(steps + 1) / steps

    def levels_between(self, low: float, high: float) -> tuple[float, float]:
        """Return the lowest and highest level between two shares; whole ones contain them."""
        first, last = sorted((self.level(low), self.level(high)))
        if self.whole:
            ends = sorted(self.neutral + share * (self.end - self.neutral) for share in (low, high))
            first, last = float(math.floor(ends[0] + 1e-9)), float(math.ceil(ends[1] - 1e-9))
        return first, last
