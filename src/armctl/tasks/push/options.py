"""The options of `armctl/ArmPush-v0`."""

from collections.abc import Mapping
from typing import ClassVar

from armctl.core.options import Positive, options
from armctl.tasks.push.state import PUSH_OBSERVATIONS
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.options import TabletopOptions


@options
class PushOptions(TabletopOptions):
    """Options of `armctl/ArmPush-v0`. Raises `ConfigurationError` for invalid values."""

    tolerance: Positive = 0.03
    """m, of the object's centre from the target."""

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = PUSH_OBSERVATIONS
