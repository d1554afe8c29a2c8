"""The layouts among obstacles that come with armctl, each with its certificate: resets need not search for paths.

The pool is for one arm and one tolerance. Seeds for different uses draw from different parts of it, which share no
layout: no agent is judged on layouts that it was trained on. The sealed test, and the seed by which trainings judge
themselves, have layouts of their own in each episode, as drawn without a pool. All other development seeds draw from
the same 2,000 layouts: their episodes are no independent ones. `tools/make_layout_pool.py` makes the file.
"""

import functools
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.errors import ConfigurationError
from armctl.core.files import digest
from armctl.core.seeds import DEVELOPMENT_SEED, TEST_SEED, TRAINING_SEEDS, VALIDATION_SEED
from armctl.core.shipped import check_arrays, read_shipped, write_shipped
from armctl.robot_description import ArmDescription
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES

POOL_FILE = Path(__file__).with_name("layout_pool.npz")
FORMAT = 2
"""Format number of the file."""
PARTS = ("development", "validation", "training")
"""The parts that many seeds draw from, in the order in which they lie in the pool, after those of single seeds."""
SEEDS_WITH_LAYOUTS = (DEVELOPMENT_SEED, TEST_SEED)
"""Seeds with a layout of its own in each episode: of the first ones, in the pool."""
DECIMALS = 6
"""Decimals of m and rad: arms that differ by less are the same."""


@dataclass(frozen=True, eq=False)
class LayoutPool:
    """k layouts for one arm, in read-only arrays. Raises `ConfigurationError` for arrays that do not fit together."""

    robot: str
    """The arm's `robot_digest`."""
    tolerance: float
    """m."""
    seeds: NDArray[np.int64]
    """(s,) seeds with a part of their own."""
    sizes: NDArray[np.int64]
    """(s + `PARTS`,) number of layouts in each part."""
    targets: NDArray[np.float32]
    """(k, 3) m."""
    counts: NDArray[np.uint8]
    """(k,) number of boxes."""
    packed: NDArray[np.float32]
    """(sum of `counts`, `BOX_NUMBERS`) the boxes of all layouts, one after the other."""
    feasible: NDArray[np.bool_]
    """(k,) whether a layout is certified to have a path."""

    def __post_init__(self) -> None:
        k = len(self.feasible)
        check_arrays(
            self,
            seeds=(np.int64, (len(self.seeds),)), sizes=(np.int64, (len(self.names),)), targets=(np.float32, (k, 3)),
            counts=(np.uint8, (k,)), packed=(np.float32, (self.counts.sum(), BOX_NUMBERS)), feasible=(np.bool_, (k,)),
        )  # fmt: skip
        if (self.sizes < 0).any() or self.sizes.sum() != k or self.counts.max(initial=0) > MAX_OBSTACLES:
            raise ConfigurationError(f"parts of {self.sizes} are not {k} layouts of up to {MAX_OBSTACLES} boxes")
        if (self.packed[:, 3:6] <= 0).any():
            raise ConfigurationError("boxes should have half sizes above 0")
        if not all(self.feasible[rows].any() for rows in self.parts.values()):
            raise ConfigurationError("each part should have a feasible layout")

    @functools.cached_property
    def boxes(self) -> NDArray[np.float32]:
        """(k, `MAX_OBSTACLES`, `BOX_NUMBERS`); zeros for absent boxes."""
        return unpacked(self.counts, self.packed, MAX_OBSTACLES)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all parts, in the order in which they lie in the pool; of a seed's own, the seed."""
        return (*map(str, self.seeds.tolist()), *PARTS)

    @functools.cached_property
    def parts(self) -> dict[str, NDArray[np.intp]]:
        """The rows of each part's layouts."""
        return dict(zip(self.names, np.split(np.arange(len(self.feasible)), self.sizes.cumsum()[:-1]), strict=True))

    @functools.cached_property
    def _certified(self) -> dict[str, NDArray[np.intp]]:
        return {name: rows[self.feasible[rows]] for name, rows in self.parts.items()}

    def row(self, seed: int, episode: int, solvable: bool) -> int:
        """Return the row of an episode's layout, among those of the seed's part, or the feasible ones if `solvable`.

        Each seed goes through them in an order of its own, and starts again after the last. `SEEDS_WITH_LAYOUTS` have a
        layout of their own in each episode: -1 for those that are not in the pool.
        """
        part = part_of(seed)
        if part == str(seed):
            rows = self._certified.get(part, ())
            return int(rows[episode]) if solvable and episode < len(rows) else -1
        rows = (self._certified if solvable else self.parts)[part]
        return int(rows[place_in_order(seed, episode, len(rows))])


def unpacked(counts: NDArray[np.uint8], packed: NDArray[np.float32], max_boxes: int) -> NDArray[np.float32]:
    """Return boxes (k, max_boxes, numbers), read-only, zeros for absent ones, from `counts` (k,) and all in a row."""
    boxes = np.zeros((len(counts), max_boxes, packed.shape[1]), dtype=np.float32)
    boxes[np.arange(max_boxes) < counts[:, None]] = packed
    boxes.setflags(write=False)
    return boxes


def place_in_order(seed: int, episode: int, count: int) -> int:
    """Return which of `count` things an episode gets: a seed has an order of its own, and starts again after all."""
    first, stride = np.random.SeedSequence(seed).generate_state(2).tolist()
    while math.gcd(stride, count) > 1:
        stride += 1
    return int((first + stride * episode) % count)


def part_of(seed: int) -> str:
    """Return the name of the part that a seed's episodes draw from; the seed, if it has layouts of its own."""
    if seed in SEEDS_WITH_LAYOUTS:
        return str(seed)
    if seed < VALIDATION_SEED:
        return "development"
    return "validation" if seed < TRAINING_SEEDS else "training"


def pool_for(arm: ArmDescription, tolerance: float) -> LayoutPool | None:
    """Return the pool that comes with armctl; None if it is for another arm or tolerance.

    Raises `ConfigurationError` if its file is missing or damaged.
    """
    pool = _shipped_pool()
    return pool if (pool.robot, pool.tolerance) == (robot_digest(arm), tolerance) else None


def robot_digest(arm: ArmDescription) -> str:
    """Return a checksum of all of an arm except its meshes, the same on machines whose arithmetic rounds otherwise."""
    limits = {field.name: _rounded(getattr(arm.limits, field.name)) for field in fields(arm.limits)}
    capsules = [
        (part.link, sorted((_rounded(part.start), _rounded(part.end))), _rounded(part.radius)) for part in arm.capsules
    ]
    return digest((arm.urdf, arm.joints, arm.tip, _rounded(arm.home), limits, capsules, arm.collision_pairs))


def _rounded(numbers: ArrayLike) -> list[float]:
    return [round(number, DECIMALS) + 0.0 for number in np.ravel(numbers).tolist()]  # + 0.0: without the sign of 0


def write_pool(pool: LayoutPool, path: Path) -> None:
    """Write a pool's file: the same bytes for the same pool."""
    write_shipped(pool, FORMAT, path, compressed=False)


def read_pool(path: Path) -> LayoutPool:
    """Read a pool's file. Raises `ConfigurationError` if it is missing or damaged."""

    def pool_of(values: dict[str, Any]) -> LayoutPool:
        return LayoutPool(**values | {"robot": str(values["robot"]), "tolerance": float(values["tolerance"])})

    return read_shipped(path, FORMAT, pool_of)


@functools.cache
def _shipped_pool() -> LayoutPool:
    return read_pool(POOL_FILE)
