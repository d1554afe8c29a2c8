"""MotionBenchMaker's problems for two arms: seven scenes, in 100 variations each, which come with armctl.

Chamzas et al., "MotionBenchMaker: a tool to generate and benchmark motion planning datasets", RA-L 7(2), 2022; as in
VAMP's repository (Thomason, Kingston and Kavraki, "Motions in microseconds via vectorized sampling-based planning",
ICRA 2024), Apache-2.0. `tools/make_motion_bench_maker.py` converts and certifies them.
"""

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.shipped import check_arrays, read_shipped
from armctl.scene import TILTED_BOX_NUMBERS
from armctl.tasks.reach.layout_pool import unpacked

ROBOTS = "ur5_robotiq85", "panda_open"
"""The arms of the problems, with open grippers."""
SCENES = (
    "bookshelf_small", "bookshelf_tall", "bookshelf_thin", "box", "cage", "table_pick", "table_under_pick",
)  # fmt: skip
MAX_BOXES = 21
FORMAT = 1
"""Format number of the file."""
Part = Literal["all", "training", "test"]
LAST_OF_TRAINING = 80
"""Number of the last variation of each scene that is for training, if an environment splits them."""


@dataclass(frozen=True, eq=False)
class Problems:
    """k problems, in read-only arrays. Raises `ConfigurationError` for arrays that do not fit together."""

    scenes: NDArray[np.uint8]
    """(k,) places in `SCENES`."""
    numbers: NDArray[np.uint8]
    """(k,) numbers of the variations, from 1 on, as their files have them."""
    starts: NDArray[np.float32]
    """(k, dof) rad: joint positions in which episodes begin."""
    goals: NDArray[np.float32]
    """(k, dof) rad: joint positions with the tool in the target's pose, which no policy is told."""
    counts: NDArray[np.uint8]
    """(k,) number of boxes."""
    packed: NDArray[np.float32]
    """(sum of `counts`, `TILTED_BOX_NUMBERS`) the boxes of all problems, one after the other."""
    feasible: NDArray[np.bool_]
    """(k,) whether a path to the target's pose is certified."""

    def __post_init__(self) -> None:
        k, dof = len(self.feasible), self.starts.shape[-1]
        check_arrays(
            self,
            scenes=(np.uint8, (k,)), numbers=(np.uint8, (k,)), starts=(np.float32, (k, dof)),
            goals=(np.float32, (k, dof)), counts=(np.uint8, (k,)),
            packed=(np.float32, (self.counts.sum(), TILTED_BOX_NUMBERS)), feasible=(np.bool_, (k,)),
        )  # fmt: skip
        if self.scenes.max(initial=0) >= len(SCENES) or self.counts.max(initial=0) > MAX_BOXES:
            raise ConfigurationError(f"problems should be of {len(SCENES)} scenes, with up to {MAX_BOXES} boxes")
        if (self.packed[:, 3:6] <= 0).any():
            raise ConfigurationError("boxes should have half sizes above 0")

    @functools.cached_property
    def boxes(self) -> NDArray[np.float32]:
        """(k, `MAX_BOXES`, `TILTED_BOX_NUMBERS`); zeros for absent boxes."""
        return unpacked(self.counts, self.packed, MAX_BOXES)

    def rows(self, scenes: str, part: Part, solvable: bool) -> NDArray[np.intp]:
        """Return the problems of some scenes (see `scene_names`) in a part; only the feasible ones if `solvable`.

        Raises `ConfigurationError` for an unknown scene, and if there are none.
        """
        chosen = np.isin(self.scenes, [SCENES.index(name) for name in scene_names(scenes)])
        for_training = self.numbers <= LAST_OF_TRAINING
        rows = np.flatnonzero(
            chosen
            & {"all": np.ones_like(chosen), "training": for_training, "test": ~for_training}[part]
            & (self.feasible | (not solvable))
        )
        if not len(rows):
            raise ConfigurationError(f"there is no solvable problem of the scenes {scenes!r}, part {part!r}")
        return rows


def scene_names(scenes: str) -> tuple[str, ...]:
    """Return names of scenes from text: `all`, or names with commas. Raises `ConfigurationError` for unknown ones."""
    if scenes == "all":
        return SCENES
    names = tuple(name.strip() for name in scenes.split(","))
    for name in names:
        if name not in SCENES:
            raise unknown_name("scene", name, [*SCENES, "all"])
    return names


def problems_file(robot: str) -> Path:
    """Return the file of the problems for one of `ROBOTS`."""
    return Path(__file__).with_name(f"motion_bench_maker_{robot}.npz")


@functools.cache
def shipped_problems(robot: str) -> Problems:
    """Return the problems for a robot that come with armctl.

    Raises `ConfigurationError` for a robot without problems, and if their file is missing or damaged.
    """
    if robot not in ROBOTS:
        raise ConfigurationError(f"there are problems for the robots {' and '.join(ROBOTS)}, not for {robot!r}")
    return read_shipped(problems_file(robot), FORMAT, lambda values: Problems(**values))
