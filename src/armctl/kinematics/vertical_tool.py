"""A straight tool at an arm's end-effector that points down: its configurations at points and along lines.

The tool lies on the axis of the last joint, as flanges do. Unless it is told how to turn, its orientation turns with
the direction of the point as seen from the base, so that the wrist hardly moves.
"""

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.kinematics.ik import Ik, IkOptions, IkResult
from armctl.kinematics.model import ArmModel
from armctl.scene import NO_BOXES, Boxes

LARGEST_JUMP = 0.6
"""rad: a joint moves by less from one point of a line to the next; a larger move changes the branch."""
DOWN = np.array((0.0, 0.0, -1.0))


def tool_axis(model: ArmModel) -> Array:
    """Return the last joint's axis (3,) in the end-effector's frame, pointing away from the arm."""
    placement = model.pinocchio.frames[model.tip].placement
    axis = placement.rotation.T @ model.axes[-1]
    outward = placement.rotation.T @ placement.translation
    return np.asarray(-axis if axis @ outward < -1e-6 else axis)


class VerticalTool:
    """A tool of `length` (m) from the end-effector, among boxes. Points are where it ends, (3,) m."""

    def __init__(self, model: ArmModel, length: float, boxes: Boxes = NO_BOXES) -> None:
        self._ik, self.model = Ik(model, IkOptions(starts=1)), model.among(boxes)
        axis, home = tool_axis(model), model.pose(model.home)
        self._offset = length * axis
        down = pinocchio.Quaternion.FromTwoVectors(home[:3, :3] @ axis, DOWN).toRotationMatrix()
        self._rotation, self._azimuth = down @ home[:3, :3], np.arctan2(home[1, 3], home[0, 3])

    def point(self, q: Array) -> Array:
        """Return where the tool ends at q (dof,), in whichever direction it points."""
        pose = self.model.pose(q)
        return np.asarray(pose[:3, 3] + pose[:3, :3] @ self._offset)

    def turn(self, point: Array) -> float:
        """Return the turn (rad) about the vertical since home with which the wrist hardly moves."""
        return float(np.arctan2(point[1], point[0]) - self._azimuth)

    def pose(self, point: Array, turn: float | None = None) -> Array:
        """Return the end-effector's pose (4, 4) with the tool down at a point, turned by `turn`."""
        pose = np.eye(4)
        pose[:3, :3] = pinocchio.utils.rotate("z", self.turn(point) if turn is None else turn) @ self._rotation
        pose[:3, 3] = point - pose[:3, :3] @ self._offset
        return pose

    def configuration(self, point: Array, seed: Array, turn: float | None = None) -> Array:
        """Return the configuration (dof,) nearest to `seed` (dof,) with the tool down at a point; `seed` for none."""
        result = self._solve(self.pose(point, turn), seed)
        return result.q if result.reachable else seed

    def line(self, points: Array, seed: Array, turns: Array | None = None) -> Array | None:
        """Return free configurations (k, dof) at points (k, 3), one following from the other; None if there are none.

        The first is any that is near `seed` (dof,). The tool is turned by `turns` (k,).
        """
        configurations: list[Array] = []
        for i, point in enumerate(points):
            result = self._solve(self.pose(point, None if turns is None else turns[i]), seed)
            jumps = bool(configurations) and result.reachable and np.abs(result.q - seed).max() > LARGEST_JUMP
            if not result.reachable or jumps or not self.model.is_free(result.q):
                return None
            configurations.append(seed := result.q)
        return np.array(configurations)

    def _solve(self, pose: Array, seed: Array) -> IkResult:
        """Return the nearest of all branches, or the one that `seed` leads to if there are infinitely many."""
        return self._ik.follow(pose, seed) if self.model.dof > 6 else self._ik.pose(pose, seed, 1)
