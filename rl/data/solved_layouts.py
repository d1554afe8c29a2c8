"""Layouts among obstacles with a planned way each, made by kinematics alone: `python -m armctl.rl.data.solved_layouts`.

A `LayoutSolver` draws and plans them; those without a plan are left out. `ObstacleLayoutSolver` draws them as
`armctl/ArmReachObstacles-v0` does for episodes of a training's seed. They lie in a folder, in parts that are written
whole, with a card that has the checksum of each part: the same command goes on after an interrupt. Nothing is
simulated.
"""

import functools
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import Progress

from armctl.core.console import PlainConsole
from armctl.core.errors import ConfigurationError, ResultsError, os_errors_as, reason
from armctl.core.files import (
    bounded_bytes,
    bounded_text,
    one_writer,
    sealed,
    short_checksum,
    unsealed,
    write_atomically,
)
from armctl.core.seeds import TRAINING_SEEDS
from armctl.disturbances import episode_entropy
from armctl.kinematics import ArmModel, Workspace
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.robot_description import ArmDescription, load_arm
from armctl.runtime.folder import claim
from armctl.tasks.reach import ReachOptions
from armctl.tasks.reach.layout_pool import robot_digest
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES, sample_layout

FORMAT = "armctl-solved-layouts-1"
PART = 500
"""Number of layouts that are drawn for a part."""
CLEARANCES = 0.02, 0.01
"""Clearances of a way, m: the next one is for layouts that have no way with the one before it."""
LARGEST_PART = 2**24
"""Largest part that armctl reads, bytes."""
CARD = "card.json"


@dataclass(frozen=True, eq=False)
class SolvedLayouts:
    """k layouts and their ways. Raises `ConfigurationError` for arrays that do not fit together."""

    targets: NDArray[np.float32]
    """Target positions (k, 3), m, or poses (k, 9): with their first two axes."""
    boxes: NDArray[np.float32]
    """Boxes (k, most, numbers), as the task observes them; zeros for absent ones."""
    corners: NDArray[np.int64]
    """Number (k,) of corners of each way, from the start to the target; at least 2."""
    ways: NDArray[np.float32]
    """Corners (sum of `corners`, dof) rad, one way after the other."""

    def __post_init__(self) -> None:
        k, numbers = len(self.targets), self.targets.shape[1] if self.targets.ndim > 1 else 0
        shapes = {"targets": (k, 9 if numbers == 9 else 3), "boxes": (k, *self.boxes.shape[1:][:2]), "corners": (k,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape or not np.isfinite(getattr(self, name)).all():
                raise ConfigurationError(f"{name} should be finite numbers {shape}, not {getattr(self, name).shape}")
        if (self.corners < 2).any() or self.ways.ndim != 2 or len(self.ways) != self.corners.sum():
            raise ConfigurationError("ways should have two corners or more each")
        if not np.isfinite(self.ways).all():
            raise ConfigurationError("ways should be finite numbers")

    def __len__(self) -> int:
        return len(self.targets)

    def way(self, row: int) -> NDArray[np.float64]:
        """Return the corners (m, dof) of a layout's way, rad."""
        end = int(self._ends[row])
        return self.ways[end - int(self.corners[row]) : end].astype(float)

    @functools.cached_property
    def _ends(self) -> NDArray[np.int64]:
        return np.cumsum(self.corners)


class SolvedLayout(NamedTuple):
    """A layout and its way."""

    target: NDArray[np.float64]
    """(3,) m, or (9,) with axes."""
    boxes: NDArray[np.float64]
    """(k, numbers)"""
    way: NDArray[np.float64]
    """(m, dof) rad"""


class LayoutSolver(Protocol):
    """Draws layouts and plans in them."""

    max_boxes: int

    @property
    def identity(self) -> dict[str, Any]:
        """JSON values on which the layouts depend."""

    def solve(self, number: int) -> SolvedLayout | None:
        """Return the layout of a number with its way; None if none was found, or none is needed."""


def make(folder: Path, count: int, solver: LayoutSolver, progress: bool = True) -> None:
    """Let `solver` draw `count` layouts and plan in each, or go on with that.

    Raises `ResultsError` if the folder holds others, is damaged or cannot be written.
    """
    identity: dict[str, Any] = {"format": FORMAT, **solver.identity, "count": count, "part": PART}
    with one_writer(folder):
        card = claim(folder / CARD, identity, "other layouts", "choose another folder", format_number=FORMAT)
        card = card or {**identity, "parts": {}}
        with Progress(console=PlainConsole(stderr=True), disable=not progress) as bars:
            bar = bars.add_task("layouts", total=count)
            for start in range(0, count, PART):
                numbers = range(start, min(start + PART, count))
                name = f"part_{start}.npz"
                if name not in card["parts"]:
                    content = _packed(map(solver.solve, numbers), solver.max_boxes)
                    with os_errors_as(f"layouts cannot be written to {folder}"):
                        write_atomically(folder / name, content)
                        card["parts"][name] = short_checksum(content)
                        write_atomically(folder / CARD, sealed(card))
                bars.advance(bar, len(numbers))


def read(folder: Path) -> SolvedLayouts:
    """Return all layouts of a folder. Raises `ResultsError` if it is missing, unfinished or damaged."""
    card = _read_card(folder)
    missing = {f"part_{start}.npz" for start in range(0, card["count"], card["part"])} - set(card["parts"])
    if missing:
        raise ResultsError(f"{folder} lacks {min(missing)}: make the layouts to the end")
    parts = [_read_part(folder / name, checksum) for name, checksum in card["parts"].items()]
    try:
        return SolvedLayouts(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    except (ConfigurationError, KeyError, TypeError, ValueError) as error:
        raise ResultsError(f"the layouts in {folder} do not fit together: {error}") from error


class ObstacleLayoutSolver:
    """Layouts of a training seed of `armctl/ArmReachObstacles-v0`, with ways into spheres of `tolerance` (m)."""

    max_boxes = MAX_OBSTACLES

    def __init__(self, arm: ArmDescription, tolerance: float, seed: int) -> None:
        self.identity: dict[str, Any] = {
            "robot": robot_digest(arm), "tolerance": tolerance, "seed": seed, "clearances": list(CLEARANCES),
        }  # fmt: skip
        self._model = ArmModel(arm)
        self._workspace = Workspace(self._model)
        self._planners = [ArmPlanner(self._model, ArmPlannerOptions(clearance=clearance)) for clearance in CLEARANCES]
        self._tolerance, self._seed = tolerance, (seed + 1) * TRAINING_SEEDS

    def solve(self, number: int) -> SolvedLayout | None:
        """Return a layout and its way; None if none was found, or none is needed."""
        rng = np.random.default_rng(np.random.SeedSequence(episode_entropy(self._seed, number)))
        layout = sample_layout(rng, self._workspace, self._tolerance)
        for planner in self._planners:
            plan = planner.plan(self._model.home, layout.target, self._tolerance, layout.boxes)
            if plan.solved:
                return SolvedLayout(layout.target, layout.boxes.numbers, plan.path) if len(plan.path) > 1 else None
        return None


def _packed(solved: Iterator[SolvedLayout | None], max_boxes: int) -> bytes:
    """Return the bytes of a part. Raises `ConfigurationError` if no layout of it is solved."""
    layouts = [layout for layout in solved if layout is not None]
    if not layouts:
        raise ConfigurationError("no way was found in any layout of a part")
    boxes = np.zeros((len(layouts), max_boxes, layouts[0].boxes.shape[1]), np.float32)
    for row, layout in zip(boxes, layouts, strict=True):
        row[: len(layout.boxes)] = layout.boxes
    content = io.BytesIO()
    np.savez_compressed(
        content,
        allow_pickle=False,
        targets=np.array([layout.target for layout in layouts], np.float32),
        boxes=boxes,
        corners=np.array([len(layout.way) for layout in layouts], np.int64),
        ways=np.concatenate([layout.way for layout in layouts], dtype=np.float32),
    )
    return content.getvalue()


def _read_card(folder: Path) -> dict[str, Any]:
    try:
        with os_errors_as(f"there are no layouts in {folder}"):
            return unsealed(bounded_text(folder / CARD), FORMAT)
    except ValueError as error:
        raise ResultsError(f"{folder / CARD} cannot be read, or is damaged: {error}") from error


def _read_part(path: Path, checksum: str) -> dict[str, NDArray[Any]]:
    try:
        content = bounded_bytes(path, LARGEST_PART)
    except (OSError, ValueError) as error:
        raise ResultsError(f"the layouts {path} cannot be read: {reason(error)}") from error
    if short_checksum(content) != checksum:
        raise ResultsError(f"{path} does not have the checksum on its card: it was changed, or damaged")
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)


def main(
    folder: Path,
    count: Annotated[int, typer.Option(min=1)] = 20_000,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    robot: str = "ur5",
) -> None:
    """Draw layouts of a training seed, plan a way in each by kinematics, and keep both in a folder."""
    make(folder, count, ObstacleLayoutSolver(load_arm(robot), ReachOptions().tolerance, seed))
    print(f"{folder}: {len(read(folder)):,} of {count:,} layouts have a way")


if __name__ == "__main__":
    typer.run(main)
