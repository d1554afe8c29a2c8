"""Lift: grasp an object on a table with a hand of two fingers, and lift it to a height."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.tasks.lift.lift import LiftOutcome, LiftTask
    from armctl.tasks.lift.options import LiftOptions
    from armctl.tasks.lift.state import LiftState

__all__ = ["LiftOptions", "LiftOutcome", "LiftState", "LiftTask"]

__getattr__, __dir__ = on_first_use(__name__)
