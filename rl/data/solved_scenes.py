"""Scenes like MotionBenchMaker's training problems, with a planned way each, made by kinematics alone.

A scene is a training problem of `armctl/ArmScenes-v0` that is turned about the arm's base and shifted as a whole, with
its target: its own variations differ in this, too. The test problems are not used.

A plan into a pose between things is near to things all the way, if one clearance holds for all of it. So its end is
found first, and the way is then planned from there: only what is near at its ends may be near in between.
"""

from typing import Any

import numpy as np
from ompl import geometric

from armctl.core.arrays import Array
from armctl.core.seeds import TRAINING_SEEDS
from armctl.disturbances import episode_entropy
from armctl.kernels.edges import NEAR_START
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, MinimumTimePose
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.planning.arm_planner import DETOUR, MAX_TIME_RATIO
from armctl.planning.arm_search import ArmSearch
from armctl.rl.data.solved_layouts import SolvedLayout
from armctl.robot_description import ArmDescription
from armctl.scene import TILTED_BOX_NUMBERS, Boxes
from armctl.scene.boxes import rotations_about_vertical
from armctl.tasks.reach import ReachScenesOptions, read_boxes
from armctl.tasks.reach.layout_pool import robot_digest
from armctl.tasks.reach.motion_bench_maker import MAX_BOXES, shipped_problems

LARGEST_TURN = 0.3
"""rad: scenes are turned by up to so much."""
SHIFT = 0.03, 0.03, 0.015
"""m: standard deviations of shifts."""
WIDE = 0.04, 0.02, 0.01
"""m, clearances of ways but for what is nearer at their ends, of which half the distance is kept: the next one is for
scenes that have no way with the one before it."""
SHORTCUTS = 200
"""Shortcuts tried on a way."""
CLEARANCES = 0.01, 0.005, 0.0025
"""m, of the first plans, whose ends are kept."""
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
        self._shapes = ArmShapes(self._model)
        self._planners = [
            ArmPlanner(self._model, ArmPlannerOptions(clearance=clearance, checks=CHECKS, stride=STRIDE), self._search)
            for clearance in CLEARANCES
        ]
        self.identity: dict[str, Any] = {
            "robot": robot_digest(arm), "tolerance": self._tolerance, "seed": seed, "scenes": options.scenes,
            "lever": options.lever, "turn": LARGEST_TURN, "shift": list(SHIFT),
            "clearances": [*CLEARANCES, *WIDE], "checks": CHECKS,
        }  # fmt: skip

    def solve(self, number: int) -> SolvedLayout | None:
        """Return a scene and its way; None if none was found, or none is needed."""
        rng = np.random.default_rng(np.random.SeedSequence(episode_entropy(self._seed, number)))
        start, target, boxes = self._draw(rng)
        if not self._model.within_limits(start):
            return None
        place, scene = self._search.centre(target[:3], target[3:]), read_boxes(boxes, TILTED_BOX_NUMBERS)
        plans = (planner.plan(start, place, self._tolerance, scene).path for planner in self._planners)
        plan = next((plan for plan in plans if len(plan) > 1), None)
        return None if plan is None else SolvedLayout(target, boxes, self._wide_way(plan, scene))

    def _wide_way(self, plan: Array, boxes: Boxes) -> Array:
        """Return a way (m, dof) from the first to the last corner of a plan with more clearance; the plan if none."""
        start, end = plan[0], plan[-1]
        search = ArmSearch(geometric.RRTConnect, 1, DETOUR, STRIDE, CHECKS // 4)
        for clearance in WIDE:
            edges = EdgeChecker(self._shapes, boxes, clearance, end)
            edges.relax(start, NEAR_START)
            way = search.path(edges, self._model.limits, end, start[None])
            if len(way) > 1:
                draws = np.random.default_rng(0).random((SHORTCUTS, 2))
                return edges.shortened(way, draws, MAX_TIME_RATIO)[::-1]
        return plan

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
