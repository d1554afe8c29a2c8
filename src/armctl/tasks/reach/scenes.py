"""Reach a pose in the scenes of MotionBenchMaker: bookshelves, a box, a cage, a table.

An episode is one of its problems: boxes, the joint positions to begin in, and the pose of the tool in others. A
contact of the arm with a box, the floor or itself ends the episode.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.disturbances import episode_of
from armctl.robot_description import ArmDescription
from armctl.robots.arm import build_arm_world
from armctl.scene import TILTED_BOX_NUMBERS
from armctl.tasks.reach.layout_pool import place_in_order
from armctl.tasks.reach.motion_bench_maker import MAX_BOXES, ROBOTS, SCENES, Part, scene_names, shipped_problems
from armctl.tasks.reach.observation import HIDDEN
from armctl.tasks.reach.obstacles import (
    BOXES,
    OBSTACLES_REWARD,
    ObstaclesReachState,
    ReachObstaclesOptions,
    ReachObstaclesTask,
    boxes_ahead,
    furnish,
)
from armctl.tasks.reach.options import Terms
from armctl.tasks.reach.pose import (
    POSE_FEATURES,
    POSE_OBSERVATION,
    PoseReachState,
    ReachPoseOptions,
    ReachPoseTask,
    draw_axes,
)
from armctl.tasks.reach.state import Term
from armctl.tasks.task import Ids

SCENES_OBSERVATION: Mapping[str, Term] = {**POSE_OBSERVATION, "boxes": BOXES}
SCENES_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": SCENES_OBSERVATION,
    "features": {**POSE_FEATURES, "boxes_ahead": boxes_ahead},
    "full": {**SCENES_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""


@dataclass(frozen=True)
class ScenesReachState(PoseReachState, ObstaclesReachState):
    """The state, orientations, obstacles and contacts."""


@options
class ReachScenesOptions(ReachPoseOptions, ReachObstaclesOptions):
    """Options of `armctl/ArmScenes-v0`. Raises `ConfigurationError` for invalid values."""

    robot: str | Path | ArmDescription = ROBOTS[0]
    """`ur5_robotiq85` or `panda_open`, the arms of the problems, or the result of `armctl.load_arm` for one of them."""
    scenes: str = "all"
    """Names of scenes, with commas: bookshelf_small, bookshelf_tall, bookshelf_thin, box, cage, table_pick,
    table_under_pick; or all."""
    problems: Part = "all"
    """`training`: variations 1 to 80 of each scene; `test`: the others. Seeds alone do not keep problems apart."""
    solvable: bool = True
    """Only problems with a certified path. If False, all, and `info["feasible"]` says which have one."""
    tolerance: Positive = 0.02
    """m, of the position."""
    reward: Terms = field(default_factory=lambda: OBSTACLES_REWARD)

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = SCENES_OBSERVATIONS
    max_boxes: ClassVar[int] = MAX_BOXES
    box_numbers: ClassVar[int] = TILTED_BOX_NUMBERS

    def __post_init__(self) -> None:
        super().__post_init__()
        scene_names(self.scenes)
        if self.home is not None:
            raise ConfigurationError("home: an episode begins where its problem does")


def _furnish_scene(spec: Any, description: ArmDescription) -> None:
    furnish(spec, description, MAX_BOXES)
    draw_axes(spec, description)


class ReachScenesTask(ReachPoseTask, ReachObstaclesTask):
    """n arms, each with a target pose in a scene."""

    options: ReachScenesOptions
    options_type: ClassVar[type[Any]] = ReachScenesOptions
    state_type: ClassVar[type[Any]] = ScenesReachState
    state: ScenesReachState
    units: ClassVar[Mapping[str, str]] = {
        **ReachPoseTask.units, "boxes": "centres and half sizes, m; yaws and tilts, rad"
    }  # fmt: skip
    instruction = "Move the end-effector to the target's pose without touching the obstacles."
    default_policies: ClassVar[tuple[str, ...]] = (
        "reach_ompl", "reach_mpc", "reach_ik", "scenes_imagined", "scenes_plan_bc", "random",
    )  # fmt: skip

    geometry_features = "distances_among_boxes"
    points_apart = 0.08

    def __init__(self, n: int, options: ReachScenesOptions, threads: int = 0) -> None:
        super().__init__(n, options, threads)
        self.simulation.model.camera(self.camera).pos[2] += self._workspace.centre[2]
        self._problems = shipped_problems(self.arm.description.name)
        self._rows = self._problems.rows(options.scenes, options.problems, options.solvable)
        self._episode_rows = np.zeros(n, dtype=np.intp)

    def problem(self, world: int) -> tuple[str, int]:
        """Return the scene of a world's problem, and the number of the variation."""
        row = self._episode_rows[world]
        return SCENES[self._problems.scenes[row]], int(self._problems.numbers[row])

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, _furnish_scene)

    def _sample_episodes(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        self._contacts.forget(ids)
        for i, rng in zip(ids, rngs, strict=True):
            self._sample_episode(int(i), rng)
        self._place(ids)

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        episode, count = episode_of(rng), len(self._rows)
        row = self._rows[rng.integers(count) if episode is None else place_in_order(*episode, count)]
        problems, goal = self._problems, self._problems.goals[row].astype(float)
        self.arm.place(world, problems.starts[row])
        self._set_target(world, self._workspace.model.pose(goal))
        self._boxes[world], self._feasible[world] = problems.boxes[row], problems.feasible[row]
        self.certificates[world], self._episode_rows[world] = goal, row
