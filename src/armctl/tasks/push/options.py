"""The options of `armctl/ArmPush-v0`."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from armctl.core.options import Positive, options
from armctl.tasks.goals import Goals
from armctl.tasks.push.state import PUSH_OBSERVATIONS
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.options import TabletopOptions


@options
class PushOptions(TabletopOptions):
    """Options of `armctl/ArmPush-v0`. Raises `ConfigurationError` for invalid values."""

    tolerance: Positive = 0.03
    """m, of the object's centre from the target."""

    @property
    def goals(self) -> Goals:
        """Object and target for hindsight, (n, 3): x, y, m, and whether the object is, or has to be, at rest (1)."""
        return Goals(
            achieved=lambda state: np.column_stack((state.object_position[:, :2], state.at_rest & ~state.fell)),
            desired=lambda state: np.column_stack((state.target_position[:, :2], np.ones(len(state.fell)))),
            reached=lambda achieved, desired: (
                (np.hypot(*(achieved - desired)[:, :2].T) <= self.tolerance) & (achieved[:, 2] > 0)
            ),
            part="target_position",
            size=2,
        )

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = PUSH_OBSERVATIONS
