"""Options that tasks with an object on a table share."""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Strict

from armctl.core.options import Positive, options
from armctl.tasks.reach.options import ReachOptions, Terms
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.state import TABLETOP_REWARD


def _ordered(pair: "tuple[float, float]") -> "tuple[float, float]":
    if pair[0] > pair[1]:
        raise ValueError("a range is its lowest and its highest value")
    return pair


Range = Annotated[tuple[Positive, Positive], Strict(False), AfterValidator(_ordered)]


@options
class TabletopOptions(ReachOptions):
    """Options of a task with an object on a table. Raises `ConfigurationError` for invalid values."""

    friction: Range = (0.2, 0.6)
    """Lowest and highest coefficient of friction between object and table; each episode draws its own."""
    mass: Range = (0.2, 1.0)
    """kg: lowest and highest mass of the object; each episode draws its own."""
    target: Literal["reachable"] = "reachable"
    """Object and target are always sampled within reach."""
    reward: Terms = field(default_factory=lambda: TABLETOP_REWARD)

    observations: ClassVar[Mapping[str, Mapping[str, Term]]]
    has_goals: ClassVar[bool] = False
