"""The fields of the BARN challenge, on the bridge's deck: 10 m from start to goal line, through a field of cylinders.

In armctl, cylinders that stand beside each other are one block, and the goal is a line. A Jackal drives the challenge,
whose size the rover has.
"""

from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.scene import BridgeMap
from armctl.tasks.bridge.bridge import BridgeTask
from armctl.tasks.bridge.fields import CELL, CELLS, HALF_WIDTH, PASSAGE, blocks_of, read_blocks, sample_cells, worlds_in
from armctl.tasks.bridge.layout import ATTEMPTS, Layout
from armctl.tasks.bridge.options import BridgeOptions
from armctl.tasks.bridge.world import JERSEY_PROFILE
from armctl.tasks.learner_view import FeatureSpec, LearnerView

DECK_WIDTH = 2 * HALF_WIDTH + 4 * JERSEY_PROFILE[0][0]
"""m, barriers included."""


@options
class BarnOptions(BridgeOptions):
    """Options of `armctl/BarnCross-v0`."""

    deck_length: Annotated[float, Field(ge=12, le=200)] = 12.0
    """m; the goal line is 1 m before the end, 10 m from the start."""
    deck_width: Annotated[float, Field(ge=DECK_WIDTH, le=DECK_WIDTH)] = DECK_WIDTH
    """m; the barriers take 1.22 m of it."""
    blocks: Annotated[int, Field(ge=1, le=400)] = 88
    """Blocks of a field, at most; the challenge's have up to 85. Fields with more are not drawn."""
    missing_barriers: Annotated[int, Field(ge=0, le=0)] = 0
    """None."""
    fields: str | None = None
    """Folder of the challenge's static worlds, `worlds/BARN` of github.com/Daffan/the-barn-challenge, of which each
    episode draws one. Without it, each episode has a new field, by a cellular automaton like the challenge's."""

    largest_block: ClassVar[tuple[float, float]] = (CELL * CELLS / 2, HALF_WIDTH)
    blocks_vary: ClassVar[bool] = True


class BarnTask(BridgeTask):
    """n fields, each with a rover."""

    options: BarnOptions
    options_type: ClassVar[type[Any]] = BarnOptions
    instruction = "Drive through the field to the goal line without touching anything."
    default_policies = ("bridge_ompl", "barn_ppo", "random")

    @property
    def learner_view(self) -> LearnerView:
        """The bridge's view, with features of the shortest ways if the state is observed."""
        view = super().learner_view
        if self.options.view != "state" or view.features is None:
            return view
        return replace(view, model_features=FeatureSpec("routes", view.features.options))

    def _sample_episode(self, rng: np.random.Generator) -> Layout:
        options = self.options
        for _ in range(ATTEMPTS):
            if options.fields:
                worlds = worlds_in(options.fields)
                blocks = read_blocks(worlds[rng.integers(len(worlds))])
            else:
                blocks = blocks_of(sample_cells(rng))
            absent = options.blocks - len(blocks)
            field = BridgeMap(options.deck_length, HALF_WIDTH, blocks)
            if absent >= 0 and field.crossable(PASSAGE):
                padded = np.pad(blocks, ((0, absent), (0, 0)))
                return Layout(BridgeMap(options.deck_length, HALF_WIDTH, padded), np.zeros(0, dtype=np.intp))
        raise ConfigurationError(f"none of {ATTEMPTS} fields has at most {options.blocks} blocks and can be crossed")
