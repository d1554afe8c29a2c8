"""Scenes like MotionBenchMaker's training problems, with a planned way each, made by kinematics alone.

A scene is a training problem of `armctl/ArmScenes-v0` that is turned about the arm's base and shifted as a whole, with
its target: its own variations differ in this, too. The test problems are not used. Of several plans, the way is the
fastest: random ones would teach their mean.
"""

from typing import Any

import numpy as np

from armctl.core.arrays import Array
from armctl.core.seeds import TRAINING_SEEDS
from armctl.disturbances import episode_entropy
from armctl.kinematics import ArmModel, MinimumTimePose
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.rl.data.solved_layouts import SolvedLayout
from armctl.robot_description import ArmDescription
from armctl.scene import TILTED_BOX_NUMBERS
from armctl.scene.boxes import rotations_about_vertical
from armctl.tasks.reach import ReachScenesOptions, read_boxes
from armctl.tasks.reach.layout_pool import robot_digest
from armctl.tasks.reach.motion_bench_maker import MAX_BOXES, shipped_problems

LARGEST_TURN = 0.3
"""rad: scenes are turned by up to so much."""
SHIFT = 0.03, 0.03, 0.015
"""m: standard deviations of shifts."""
PLANS = 2
"""Number of plans, of which the fastest is the way."""
CLEARANCES = 0.01, 0.005, 0.0025
"""m, of ways: the next one is for scenes that have no way with the one before it."""
CHECKS, STRIDE = 20_000, 0.5
"""Collision checks after which a search gives up; longest edge of its trees, rad."""
INSIDE = 0.5
"""Share of the task's tolerance in which ways end: a network misses them by some."""


class SceneSolver:
    """Scenes of a training seed, with ways to their targets."""

    max_boxes = MAX_BOXES

    def __init__(self, arm: ArmDescription, options: ReachScenesOptions, seed: int) -> None:
        self._model, self._problems = ArmModel(arm), shipped_problems()
        self._search = MinimumTimePose(self._model, options.lever)
        self._rows = self._problems.rows(options.scenes, "training", solvable=True)
        self._tolerance, self._seed = INSIDE * options.tolerance, (seed + 1) * TRAINING_SEEDS
        self._planners = [[self._planner(clearance, 1 + i) for clearance in CLEARANCES] for i in range(PLANS)]
        self.identity: dict[str, Any] = {
            "robot": robot_digest(arm), "tolerance": self._tolerance, "seed": seed, "scenes": options.scenes,
            "lever": options.lever, "turn": LARGEST_TURN, "shift": list(SHIFT), "plans": PLANS,
            "clearances": list(CLEARANCES),
        }  # fmt: skip

    def solve(self, number: int) -> SolvedLayout | None:
        """Return a scene and its way; None if none was found, or none is needed."""
        rng = np.random.default_rng(np.random.SeedSequence(episode_entropy(self._seed, number)))
        start, target, boxes = self._draw(rng)
        if not self._model.within_limits(start):
            return None
        place, scene = self._search.centre(target[:3], target[3:]), read_boxes(boxes, TILTED_BOX_NUMBERS)
        plans = []
        for planners in self._planners:
            attempts = (planner.plan(start, place, self._tolerance, scene) for planner in planners)
            if (plan := next((plan for plan in attempts if plan.solved), None)) is None:
                break  # rarely solved with another seed
            plans.append(plan)
            if not plan.searched:
                break  # a straight motion is the same for all seeds
        way = min(plans, key=lambda plan: plan.time).path if plans else ()
        return SolvedLayout(target, boxes, way) if len(way) > 1 else None

    def _planner(self, clearance: float, seed: int) -> ArmPlanner:
        options = ArmPlannerOptions(clearance=clearance, seed=seed, checks=CHECKS, stride=STRIDE)
        return ArmPlanner(self._model, options, self._search)

    def _draw(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Return start (dof,), target (9,) and boxes (k, `TILTED_BOX_NUMBERS`)."""
        problems, row = self._problems, self._rows[rng.integers(len(self._rows))]
        turn, shift = rng.uniform(-LARGEST_TURN, LARGEST_TURN), rng.normal(scale=SHIFT)
        rotation = rotations_about_vertical(np.array(turn))
        start, boxes = problems.starts[row].astype(float), problems.boxes[row, : problems.counts[row]].astype(float)
        if abs(start - self._model.home).max() > 1e-3:
            start[0] += turn  # begins somewhere in its scene
        boxes[:, :3] = boxes[:, :3] @ rotation.T + shift
        boxes[:, 6] += turn
        pose = self._model.pose(problems.goals[row].astype(float))
        position, axes = rotation @ pose[:3, 3] + shift, rotation @ pose[:3, :2]
        return start, np.concatenate((position, *axes.T)), boxes
