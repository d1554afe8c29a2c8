"""The moving fields of the BARN challenge, on a wide deck: 20 m to the goal line, among discs that stop for nobody.

In armctl, discs move straight from corner to corner and go back at the ends of their routes, and the goal is a line. In
the challenge, they move on splines and jump back to their starts.
"""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from armctl.core.options import options
from armctl.scene import BridgeMap
from armctl.tasks.bridge.bridge import BridgeTask
from armctl.tasks.bridge.dynabarn import AHEAD, FASTEST, MAX_DISCS, RADIUS, SIDE, Level, sample_routes
from armctl.tasks.bridge.layout import Layout
from armctl.tasks.bridge.options import BridgeOptions
from armctl.tasks.bridge.world import JERSEY_PROFILE, START_X
from armctl.tasks.task import Task

DECK_LENGTH = START_X + AHEAD + SIDE
DECK_WIDTH = SIDE + 4 * JERSEY_PROFILE[0][0]
"""m, barriers included."""


@options
class BarnMovingOptions(BridgeOptions):
    """Options of `armctl/BarnCrossMoving-v0`."""

    deck_length: Annotated[float, Field(ge=DECK_LENGTH, le=DECK_LENGTH)] = DECK_LENGTH
    """m; the goal line is 1 m before the end, 20 m from the start."""
    deck_width: Annotated[float, Field(ge=DECK_WIDTH, le=DECK_WIDTH)] = DECK_WIDTH
    """m; the barriers take 1.22 m of it."""
    blocks: Annotated[int, Field(ge=0, le=0)] = 0
    """None."""
    walkers: Annotated[int, Field(ge=MAX_DISCS, le=MAX_DISCS)] = MAX_DISCS
    """Discs of a field, at most."""
    pedestrians: Literal["scripted"] = "scripted"
    """Discs give way to nobody."""
    missing_barriers: Annotated[int, Field(ge=0, le=0)] = 0
    """None."""
    level: Level | Literal["all"] = "all"
    """Level of the fields, by number and speed of the discs: 5 to 14 at 0.5 to 0.9 m/s, 15 to 19 at 1.0 to 1.4 m/s, or
    20 to 24 at 1.5 to 1.9 m/s. With `all`, each episode has one of the three."""
    fields: Literal["new", "challenge"] = "new"
    """`challenge`: each episode has one of the challenge's 60 fields, some time after its beginning. `new`: discs on
    some of the challenge's routes, each mirrored or not, and anywhere on it."""

    walker_radius: ClassVar[float] = RADIUS
    fastest_walker: ClassVar[float] = FASTEST


class BarnMovingTask(BridgeTask):
    """n fields of moving discs, each with a rover."""

    options: BarnMovingOptions
    options_type: ClassVar[type[Any]] = BarnMovingOptions
    instruction = "Drive to the goal line, and avoid the moving obstacles."
    foresight = ("pedestrians",)
    default_policies = ("bridge_mpc", "barn_moving_state_ppo", "random")
    potentials = Task.potentials

    def _sample_episode(self, rng: np.random.Generator) -> Layout:
        options = self.options
        routes = sample_routes(rng, options.level, START_X, challenge=options.fields == "challenge")
        field = BridgeMap(options.deck_length, SIDE / 2, np.zeros((0, 5)), routes)
        return Layout(field, np.zeros(0, dtype=np.intp))
