"""Motion of a vertical tool from point to point, as commands for an arm's drives.

The tool is believed to be where it is commanded to, with the mean offset of observed positions from the arm's model:
the error of the links' lengths. A command is where drives stop that pass the next configuration at the plan's speed.
"""

import numpy as np

from armctl.control.streaming import CommandStream
from armctl.core.arrays import Array
from armctl.kinematics.vertical_tool import VerticalTool

LONGEST_MEAN = 20
"""Readings over which the mean offset of the tool from the arm's model is taken: it changes with the configuration."""


class ToolMotion:
    """Moves a tool, which starts at joint positions q (dof,) and is observed at a point (3,) m then."""

    def __init__(self, tool: VerticalTool, period: float, q: Array, point: Array) -> None:
        self._tool, self._period, self._readings = tool, period, 0
        self._stream = CommandStream(tool.model.limits, period, q)
        self._q, self._offset = q, point - tool.point(q)
        self.at = point
        """(3,) m: where the tool is to be next."""

    def read(self, q: Array, point: Array) -> Array:
        """Return where the tool is (3,) m, after a reading of joint positions (dof,) and of the tool (3,)."""
        self._readings += 1
        self._offset += (point - self._tool.point(q) - self._offset) / min(self._readings, LONGEST_MEAN)
        return np.asarray(self._tool.point(self._stream.position) + self._offset)

    def move(self, point: Array, speed: float) -> None:
        """Move the tool's next place towards a point (3,) m at a speed (m/s)."""
        step = point - self.at
        self.at = self.at + step * min(1.0, speed * self._period / max(float(np.linalg.norm(step)), 1e-9))

    def goal(self, turn: float | None = None) -> Array:
        """Return the command (dof,) rad that brings the tool to its next place, turned as `VerticalTool` does."""
        q = self._tool.configuration(self.at - self._offset, self._q, turn)
        velocity, self._q = self._velocity(q), q
        return np.asarray(self._stream.goal_through(q, velocity))

    def _velocity(self, q: Array) -> Array:
        """Return the velocity (dof,) of the way to `q` (dof,), rad/s."""
        return np.asarray((q - self._q) / self._period)


class MotionWithoutMemory(ToolMotion):
    """Motion of a tool that begins anew at each control step."""

    def move(self, point: Array, speed: float) -> None:
        """Move the tool's next place towards a point (3,) m at a speed (m/s), or to it from beyond the arm's reach."""
        super().move(point, speed)
        if self._tool.configuration(self.at - self._offset, self._q) is self._q:
            self.at = point

    def _velocity(self, q: Array) -> Array:
        velocity = super()._velocity(q)
        is_fast = (np.abs(velocity) > self._tool.model.limits.velocity).any()
        return np.zeros_like(velocity) if is_fast else velocity  # it is to stop in a posture that is far away
