"""The options of `armctl/ArmPush-v0`."""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Strict

from armctl.core.options import Positive, options
from armctl.tasks.push.state import PUSH_OBSERVATIONS, PUSH_REWARD
from armctl.tasks.reach.options import ReachOptions, Terms
from armctl.tasks.reach.state import Term


def _ordered(pair: "tuple[float, float]") -> "tuple[float, float]":
    if pair[0] > pair[1]:
        raise ValueError("a range is its lowest and its highest value")
    return pair


Range = Annotated[tuple[Positive, Positive], Strict(False), AfterValidator(_ordered)]


@options
class PushOptions(ReachOptions):
    """Options of `armctl/ArmPush-v0`. Raises `ConfigurationError` for invalid values."""

    tolerance: Positive = 0.03
    """m, of the object's centre from the target."""
    friction: Range = (0.2, 0.6)
    """Lowest and highest coefficient of friction between object and table; each episode draws its own."""
    mass: Range = (0.2, 1.0)
    """kg: lowest and highest mass of the object; each episode draws its own."""
    target: Literal["reachable"] = "reachable"
    """Object and target are always sampled within reach."""
    reward: Terms = field(default_factory=lambda: PUSH_REWARD)

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = PUSH_OBSERVATIONS
    has_goals: ClassVar[bool] = False
