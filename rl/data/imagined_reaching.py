"""Arms that a student moves to targets in imagination, and what inverse kinematics commands in the states they get to.

A label is the configuration at the target, over all branches of inverse kinematics, that is nearest in time and to
which a straight joint motion is free. Nothing is simulated (`armctl.kinematics.imagined`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kinematics import ArmModel, ArmShapes, ImaginedArms, MinimumTimePose, MinimumTimeReach
from armctl.kinematics.imagined import MOVING
from armctl.rl.data.demonstrations import slices_of_parts
from armctl.rl.networks.actor import Actor
from armctl.scene import BOX_NUMBERS
from armctl.tasks import ReachPoseTask, ReachTask
from armctl.tasks.reach import CONTROL_PERIOD

BRANCHES = 16
"""Configurations at a target, at most: a UR has 8 for a pose, and many for a position."""
ARRIVED = 0.5
"""Share of the tolerance within which an episode ends: the student also learns what to do in the rest of it."""


@dataclass(frozen=True, kw_only=True)
class Imagining:
    """Options of arms that are imagined."""

    arms: int
    """Number of arms that move at once."""
    memory: int
    """Number of the latest states to learn from."""
    max_steps: int
    """Control steps of an episode."""
    margin: float
    """Distance kept by the straight motions of labels, m."""
    noise: float
    """Standard deviation of what is added to commands, rad."""
    noise_share: float
    """Probability that it is added in a control step."""


class ImaginedReaching:
    """Examples from states that a student visits in episodes of a task: the latest of them, with their labels.

    `observations` (m, k) are those with which episodes begin, each with its target; all begin at the arm's home.
    """

    def __init__(self, task: ReachTask, observations: NDArray[np.float32], how: Imagining) -> None:
        model = ArmModel(task.robot)
        self._how, self._model, self._parts = how, model, slices_of_parts(task)
        self._begins, self._tolerance = observations, task.options.tolerance
        targets = observations[:, self._parts["target_position"]].astype(float)
        self._search = MinimumTimeReach(model)
        if isinstance(task, ReachPoseTask):
            self._search = MinimumTimePose(model, task.lever)
            targets = self._search.centre(targets, observations[:, self._parts["target_axes"]].astype(float))
        self._targets = targets
        self._goals = np.full((len(targets), BRANCHES, model.dof), np.nan)
        for goals, target in zip(self._goals, targets, strict=True):
            branches = self._search.at_centre(model.home, target)[:BRANCHES]
            goals[: len(branches)] = branches
        self._solved = np.flatnonzero(np.isfinite(self._goals[:, 0, 0]))
        self._arms = ImaginedArms(ArmShapes(model), how.arms, 0, tolerance=0.0, period=CONTROL_PERIOD)
        self._places = self._search.places(self._arms.positions)
        self._rows, self._ages = np.zeros(how.arms, dtype=int), np.full(how.arms, how.max_steps)
        self._observations = np.empty((how.memory, observations.shape[1]), dtype=np.float32)
        self._labels = np.empty((how.memory, model.dof), dtype=np.float32)
        self._count = 0

    def advance(self, actor: Actor, rng: np.random.Generator) -> int:
        """Label the present states and let the student move on. Returns how many states were labelled."""
        how, arms = self._how, self._arms
        offsets = np.linalg.norm(self._places - self._targets[self._rows], axis=1)
        is_over = (arms.states != MOVING) | (self._ages >= how.max_steps) | (offsets < ARRIVED * self._tolerance)
        self._begin(np.flatnonzero(is_over), rng)
        observations = self._observe()
        slots = (self._count + np.arange(how.arms)) % how.memory
        self._observations[slots], self._labels[slots] = observations, self._commands()
        self._count += how.arms
        is_disturbed = rng.random((how.arms, 1)) < how.noise_share
        arms.move(actor.act(observations) + is_disturbed * rng.normal(scale=how.noise, size=arms.positions.shape))
        self._places = self._search.places(arms.positions)
        self._ages += 1
        return how.arms

    def draw(self, rng: np.random.Generator, size: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return a random batch of observations and actions (size, ...)."""
        samples = rng.integers(min(self._count, self._how.memory), size=size)
        return torch.as_tensor(self._observations[samples]), torch.as_tensor(self._labels[samples])

    def _begin(self, ids: NDArray[np.intp], rng: np.random.Generator) -> None:
        """Begin new episodes; the first ones begin at different ages, so that later ones do not begin all at once."""
        self._ages[ids] = rng.integers(self._how.max_steps, size=len(ids)) if not self._count else 0
        self._rows[ids] = rng.choice(self._solved, len(ids))
        self._places[ids] = self._search.place(self._model.home)
        positions = np.tile(self._model.home, (len(ids), 1))
        self._arms.begin(ids, positions, 0.0, self._targets[self._rows[ids], :3], np.zeros((len(ids), 0, BOX_NUMBERS)))

    def _observe(self) -> NDArray[np.float32]:
        """Return what the student would observe (arms, k)."""
        observations, places = self._begins[self._rows], self._places
        observations[:, self._parts["end_effector_position"]] = places[:, :3]
        observations[:, self._parts["joint_positions"]] = self._arms.positions
        if axes := self._parts.get("end_effector_axes"):
            observations[:, axes] = places[:, 3:9] / np.linalg.norm(places[:, 3:6], axis=1, keepdims=True)
        return observations

    def _commands(self) -> Array:
        """Return the joint positions (arms, dof) that inverse kinematics commands."""
        positions, rows = self._arms.positions, np.arange(self._how.arms)
        goals = self._model.nearest_turn(self._goals[self._rows], positions[:, None])
        times = self._model.cruise_time(positions[:, None], goals)
        order = np.argsort(-np.nan_to_num(times, nan=-np.inf), axis=1)  # the earliest of those there are is the last
        counts = np.isfinite(times).sum(axis=1)
        ways = np.concatenate((goals[rows, order[rows, counts - 1]][:, None], goals[rows[:, None], order]), axis=1)
        chosen = np.zeros(self._how.arms, dtype=np.int64)  # the earliest, if no straight motion is free
        self._arms.next_waypoints(ways, counts + 1, self._how.margin, chosen)
        return ways[rows, chosen]
