"""The options of `armctl/ArmLift-v0`."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.robot_description import ArmDescription
from armctl.scene import lift_table
from armctl.tasks.lift.state import LIFT_OBSERVATIONS
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.options import Range, TabletopOptions


@options
class LiftOptions(TabletopOptions):
    """Options of `armctl/ArmLift-v0`. Raises `ConfigurationError` for invalid values."""

    robot: str | Path | ArmDescription = "panda"
    """`panda`, or the result of `armctl.load_arm` for it: an arm with the Panda's hand."""
    tolerance: Positive = 0.02
    """m, of the object's centre from the target's height."""
    friction: Range = (0.4, 1.0)
    """Lowest and highest coefficient of friction of the object on table and fingers; each episode draws its own."""
    mass: Range = (0.1, 0.5)
    """kg: lowest and highest mass of the object; each episode draws its own."""
    size: Range = (0.04, 0.06)
    """m: shortest and longest edge of the object; each episode draws its own three."""

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = LIFT_OBSERVATIONS

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size[1] > lift_table.LARGEST:
            raise ConfigurationError(f"size: an edge is at most {lift_table.LARGEST} m, not {self.size[1]}")
