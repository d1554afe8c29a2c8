"""Scenes like MotionBenchMaker's training problems, with a planned way each, made by kinematics alone.

A scene is a training problem of `armctl/ArmScenes-v0` that is turned about the arm's base and shifted as a whole, with
its target: its own variations differ in this, too. The test problems are not used.

Ways are such that a network can learn them. They end in the free posture that is nearest to home, wherever that has
a way: the mean of two postures is none. And they keep a clearance from all that is not nearer at
their ends: with one clearance for all, that of a grasp would hold all the way.
"""

from typing import Any

import numpy as np
import torch
from ompl import geometric

from armctl.core.arrays import Array
from armctl.core.seeds import TRAINING_SEEDS
from armctl.disturbances import episode_entropy
from armctl.kernels.edges import NEAR_START
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, MinimumTimePose
from armctl.planning.arm_planner import DETOUR, MAX_TIME_RATIO
from armctl.planning.arm_search import ArmSearch
from armctl.rl.data.solved_layouts import SolvedLayout
from armctl.rl.networks.postures import Postures
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
ATTEMPTS = (0.04, 3_000), (0.015, 3_000), (0.005, 15_000)
"""Clearances of ways, m, and collision checks of a search: the next is for postures to which there is no way with the
one before it. Of what is nearer at the ends, half the distance is kept."""
FREE = 0.0025
"""m, clearance of the ends."""
STRIDE, SHORTCUTS = 0.5, 200
"""Longest edge of a search's trees, rad; shortcuts tried on a way."""
INSIDE = 0.5
"""Share of the task's tolerance in which ways end: a network misses them by some."""


class SceneSolver:
    """Scenes of a training seed, with ways to their targets."""

    max_boxes = MAX_BOXES

    def __init__(self, arm: ArmDescription, options: ReachScenesOptions, seed: int) -> None:
        self._model, self._problems = ArmModel(arm), shipped_problems(arm.name)
        self._search = MinimumTimePose(self._model, options.lever)
        self._rows = self._problems.rows(options.scenes, "training", solvable=True)
        self._tolerance, self._seed = INSIDE * options.tolerance, (seed + 1) * TRAINING_SEEDS
        self._shapes, self._postures = ArmShapes(self._model), Postures.of(self._model.geometry())
        self.identity: dict[str, Any] = {
            "robot": robot_digest(arm), "tolerance": self._tolerance, "seed": seed, "scenes": options.scenes,
            "lever": options.lever, "turn": LARGEST_TURN, "shift": list(SHIFT),
            "attempts": [list(attempt) for attempt in ATTEMPTS], "postures": self._postures is not None,
        }  # fmt: skip

    def solve(self, number: int) -> SolvedLayout | None:
        """Return a scene and its way; None if none was found, or none is needed."""
        rng = np.random.default_rng(np.random.SeedSequence(episode_entropy(self._seed, number)))
        start, target, boxes = self._draw(rng)
        if not self._model.within_limits(start):
            return None
        place, scene = self._search.centre(target[:3], target[3:]), read_boxes(boxes, TILTED_BOX_NUMBERS)
        ways = (self._way(start, goal, scene) for goal in self._goals(start, place, scene))
        way = next((way for way in ways if len(way) > 1), None)
        return None if way is None else SolvedLayout(target, boxes, way)

    def _goals(self, start: Array, place: Array, boxes: Boxes) -> list[Array]:
        """Return free configurations (dof,) in the pose, or else beside it, the nearest to home first."""
        edges = EdgeChecker(self._shapes, boxes, FREE, start)
        if not edges.start_is_free:
            return []
        for centre in (place, *self._search.around(place, self._tolerance)):
            candidates = self._configurations(start, centre)
            goals = [q for q in candidates if self._model.within_limits(q) and edges.is_free(q)]
            if goals:
                return sorted(goals, key=lambda q: float(np.linalg.norm(q - self._model.home)))
        return []

    def _configurations(self, start: Array, centre: Array) -> Array:
        """Return configurations (k, dof) in the pose, free or not."""
        if self._postures is None:
            return self._search.configurations(start, centre)
        pose = torch.as_tensor(self._search.pose(centre), dtype=torch.float32)
        postures, exist = self._postures(pose[None, :3, 3], pose[None, :3, :3].transpose(1, 2))
        return np.asarray(postures[exist], dtype=float)

    def _way(self, start: Array, goal: Array, boxes: Boxes) -> Array:
        """Return a way (m, dof) with as much clearance as possible; (0, dof) if none was found."""
        way = np.zeros((0, self._model.dof))
        for clearance, checks in ATTEMPTS:
            search = ArmSearch(geometric.RRTConnect, 1, DETOUR, STRIDE, checks)
            edges = EdgeChecker(self._shapes, boxes, clearance, goal)
            edges.relax(start, NEAR_START)
            way = search.path(edges, self._model.limits, goal, start[None])
            if len(way) > 1:
                return edges.shortened(way, np.random.default_rng(0).random((SHORTCUTS, 2)), MAX_TIME_RATIO)[::-1]
        return way

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
