"""Positions that an arm's end-effector can reach."""

import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kinematics.ik import Ik, random_orientations
from armctl.kinematics.model import ArmModel

RANK = 1e-4
"""m/rad: a direction in which no joint moves the end-effector faster is not commanded."""


class Workspace:
    """The positions that an arm reaches without touching itself or the floor."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        self.ik = Ik(model)
        samples = model.random_configurations(np.random.default_rng(0), 4096)
        self.centre = model.shoulder
        reach = np.linalg.norm(model.positions(samples) - self.centre, axis=-1).max()
        self.radius = 1.05 * float(reach)
        """Radius (m) of a ball around `centre` that contains the workspace."""
        self.is_thin = max(np.linalg.matrix_rank(model.jacobian(q)[:3], RANK) for q in samples[:16]) < 3
        """True if the workspace is a curve or a surface, which no random position of a ball lies on."""

    def sample(self, rng: np.random.Generator, clearance: float, attempts: int = 1000) -> Array:
        """Draw a reachable position (3,) uniformly, at least `clearance` (m) from floor and base.

        If that fails in `attempts` draws, or the workspace is thin, it is one of a random configuration instead.
        Raises `ConfigurationError` if that fails too.
        """
        low, high = self.centre - self.radius, self.centre + self.radius
        low[2] = min(clearance, high[2])
        for _ in range(0 if self.is_thin else attempts):
            position = rng.uniform(low, high)
            if self.reachable(position) and self.model.base_distance(position) >= clearance:
                return np.asarray(position)
        configurations = self.model.random_configurations(rng, attempts)
        for position in self.model.positions(configurations[self.model.are_free(configurations)]):
            if position[2] >= low[2] and self.model.base_distance(position) >= clearance:
                return np.asarray(position)
        raise ConfigurationError(
            f"{self.model.description.name} reaches none of {attempts} positions at {clearance} m from floor and base"
        )

    def sample_pose(self, rng: np.random.Generator, clearance: float, attempts: int = 1000) -> tuple[Array, Array]:
        """Draw a reachable pose (4, 4) at least `clearance` (m) from floor and base, and a free configuration in it.

        Position and orientation are uniform over what is reachable. If that fails in `attempts` draws, or the arm has
        no closed form, it is the pose of a random configuration. Raises `ConfigurationError` if that fails too.
        """
        low, high = self.centre - self.radius, self.centre + self.radius
        low[2] = min(clearance, high[2])
        pose = np.eye(4)
        for _ in range(attempts):
            pose[:3, 3], pose[:3, :3] = rng.uniform(low, high), random_orientations(1, rng)[0]
            if (q := self.ik.exact(pose)) is None:
                break
            q = q[self.model.are_usable(q)]
            if len(q) and self.model.base_distance(pose[:3, 3]) >= clearance:
                return pose, q[0]
        configurations = self.model.random_configurations(rng, attempts)
        for q in configurations[self.model.are_free(configurations)]:
            position = self.model.position(q)
            if position[2] >= low[2] and self.model.base_distance(position) >= clearance:
                return self.model.pose(q), q
        raise ConfigurationError(
            f"{self.model.description.name} reaches none of {attempts} poses at {clearance} m from floor and base"
        )

    def reachable(self, position: Array, tolerance: float = 0.0) -> bool:
        """Return True if the end-effector can reach `position` (3,), or a point within `tolerance` (m) of it.

        True is certain. False is wrong for about 1 % of reachable positions: almost all of them lie within 2 cm of the
        workspace boundary, where the arm is stretched out and few of the orientations tried are feasible.
        """
        offset = position - self.centre
        if offset @ offset > (self.radius + tolerance) ** 2:
            return False
        if self._is_free(position):
            return True
        if self.is_thin:
            nearest = self.ik.position(position)
            allowed = self.model.within_limits(nearest.closest) and self.model.is_free(nearest.closest)
            return bool(nearest.closest_residual <= tolerance and allowed)
        near = position + 0.999 * tolerance * _DIRECTIONS
        return tolerance > 0 and any(self._is_free(point) for point in near)

    def _is_free(self, position: Array) -> bool:
        return next(self.ik.free_configurations(position), None) is not None


_CUBE = np.array([corner for corner in np.ndindex(3, 3, 3) if corner != (1, 1, 1)]) - 1.0
_DIRECTIONS = _CUBE / np.linalg.norm(_CUBE, axis=1, keepdims=True)
"""26 unit vectors, towards a cube's corners, edges and faces: sample points on a sphere."""
