"""The soonest way to touch a sphere: over all configurations whose end-effector is in it, the least time to get there.

    min over q of  max_j |q_j - start_j| / velocity_j   subject to  |position(q) - centre| <= radius

From several starts: Levenberg-Marquardt into the sphere, then sequential quadratic steps along its constraint, in which
iteratively reweighted squares stand for the maximum (Burrus, "Iterative reweighted least squares", 2012).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.kinematics.ik import Ik
from armctl.kinematics.model import ArmModel

Array = NDArray[np.float64]

SHARPNESS = 4
"""Power of a joint's time that weights its square: the higher, the nearer to the maximum, and the less stable."""
LEAST_WEIGHT = 0.02
"""Weight of a joint that does not move, beside 1 for the slowest."""
RELAXATION = 0.3
"""Part of a step along the sphere that is taken, for the weights change with it."""


@dataclass(frozen=True)
class TouchOptions:
    """Effort of the search."""

    starts: int = 32
    approach_iterations: int = 10
    """Steps from a start into the sphere."""
    refine_iterations: int = 8
    """Steps towards less time."""
    largest_step: float = 0.5
    """rad, in any joint and iteration."""
    path_spacing: float = 0.05
    """rad between the points at which a path is tested for collisions."""
    rng_seed: int = 0


@dataclass(frozen=True)
class Touch:
    """A way to touch the sphere."""

    q: Array
    """(dof,) where to command the joints to, rad."""
    time: float
    """Seconds until the slowest joint is there, each at its velocity limit."""
    free: bool
    """Whether the way there avoids the floor and the arm itself, all joints moving at full speed."""


class SoonestTouch:
    """Finds ways to touch a sphere with one arm."""

    def __init__(self, model: ArmModel, options: TouchOptions | None = None) -> None:
        self.model = model
        self.options = options or TouchOptions()
        self.ik = Ik(model)
        rng = np.random.default_rng(self.options.rng_seed)
        limits = model.limits
        low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
        self._starts = rng.uniform(low, high, (self.options.starts, model.dof))

    def find(self, start: Array, centre: Array, radius: float) -> Touch | None:
        """The soonest collision-free way found from `start` (dof,) into the sphere; if none is free, the soonest.

        `centre` (3,) and `radius` are in m. None if the sphere was not reached from any start.
        """
        soonest = self._by_time(start, self._candidates(start, centre, radius))
        touch = self._first_free(start, soonest)
        if touch is None:
            at_centre = np.array(list(self.ik.free_configurations(centre))).reshape(-1, self.model.dof)
            touch = self._first_free(start, self._by_time(start, self.ik.nearest_turn(at_centre, start)))
        if touch is None and len(soonest):
            return Touch(soonest[0], float(self.model.least_time(start, soonest[0])), free=False)
        return touch

    def _by_time(self, start: Array, goals: Array) -> Array:
        return np.asarray(goals[np.argsort(self.model.least_time(start, goals), kind="stable")])

    def _first_free(self, start: Array, goals: Array) -> Touch | None:
        for goal in goals:
            if self._is_free(start, goal):
                return Touch(goal, float(self.model.least_time(start, goal)), free=True)
        return None

    def _candidates(self, start: Array, centre: Array, radius: float) -> Array:
        """Configurations (k, dof) in the sphere, one from each start that got there, as soon as it could be made."""
        if np.linalg.norm(self.model.position(start) - centre) <= radius:
            return start[None]
        q = self._approach(np.vstack([start, self._starts]), centre)
        q = self.ik.nearest_turn(q, start)
        q = np.clip(q, self.model.limits.lower, self.model.limits.upper)
        best, best_time = q, np.full(len(q), np.inf)
        for _ in range(self.options.refine_iterations):
            position, jacobian = self.model.positions_and_jacobians(q)
            error = centre - position
            time = self.model.least_time(start, q)
            better = (np.linalg.norm(error, axis=-1) <= radius) & (time < best_time)
            best, best_time = np.where(better[:, None], q, best), np.where(better, time, best_time)
            q = q + self._limited(self._sooner(q - start, error, jacobian, radius))
            q = np.clip(q, self.model.limits.lower, self.model.limits.upper)
        return np.asarray(best[np.isfinite(best_time)])

    def _approach(self, q: Array, centre: Array) -> Array:
        for _ in range(self.options.approach_iterations):
            position, jacobian = self.model.positions_and_jacobians(q)
            error = centre - position
            damping = 0.5 * (error * error).sum(axis=-1) + 1e-6
            q = q + self._limited(_pull(jacobian, error, damping))
        return q

    def _sooner(self, travel: Array, error: Array, jacobian: Array, radius: float) -> Array:
        """Step (n, dof) that keeps to the sphere, and evens out the times that the joints need for their `travel`."""
        velocity = self.model.limits.velocity
        load = np.abs(travel) / velocity
        weights = (load / (load.max(axis=-1, keepdims=True) + 1e-9)) ** SHARPNESS + LEAST_WEIGHT
        scale = velocity / np.sqrt(weights)
        scaled = jacobian * scale[:, None, :]
        wanted = error + np.einsum("nij,nj->ni", jacobian, travel)
        slack = np.zeros(len(travel))
        for _ in range(4):  # the multiplier of |wanted - J travel| <= radius, by fixed point
            multiplier = np.linalg.solve(_gram(scaled, slack), wanted[..., None])[..., 0]
            length = np.linalg.norm(multiplier, axis=-1) + 1e-12
            slack = np.minimum(radius / length, 1e6)
        least_travel = scale * np.einsum("nij,ni->nj", scaled, multiplier)
        onto_sphere = scale * _pull(scaled, error - radius * multiplier / length[:, None], np.zeros(len(travel)))
        along_sphere = least_travel - travel - onto_sphere
        return np.asarray(onto_sphere + RELAXATION * along_sphere)

    def _limited(self, step: Array) -> Array:
        largest = np.abs(step).max(axis=-1, keepdims=True)
        return np.asarray(step * np.minimum(1.0, self.options.largest_step / (largest + 1e-12)))

    def _is_free(self, start: Array, goal: Array) -> bool:
        velocity = self.model.limits.velocity
        time = float(self.model.least_time(start, goal))
        points = 1 + math.ceil(time * velocity.max() / self.options.path_spacing)
        for elapsed in np.linspace(time, 0, points, endpoint=False):
            if not self.model.is_free(start + np.clip(goal - start, -velocity * elapsed, velocity * elapsed)):
                return False
        return True


def _gram(jacobian: Array, damping: Array) -> Array:
    """J J^T + damping, (n, 3, 3)."""
    return np.asarray(jacobian @ jacobian.swapaxes(-1, -2) + (damping + 1e-9)[:, None, None] * np.eye(3))


def _pull(jacobian: Array, error: Array, damping: Array) -> Array:
    """Damped least-squares step J^T (J J^T + damping)^-1 error, (n, dof)."""
    return np.asarray((jacobian.swapaxes(-1, -2) @ np.linalg.solve(_gram(jacobian, damping), error[..., None]))[..., 0])
