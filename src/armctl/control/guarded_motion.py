"""A jerk-limited motion that can always be stopped: behind each state of it lies a stop that was checked beforehand.

A state is commanded only if the earliest stop from it, within the limits of acceleration and jerk, keeps the limits of
position, the workspace, and a margin from the arm itself, the floor and boxes. Otherwise the joints execute the stop of
the state before. By induction there is always such a stop, whatever the goals are: the braking back-up of a predictive
safety filter (Wabersich and Zeilinger, Automatica 129, 2021), for set-points instead of drives.
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from ruckig import RuckigError

from armctl.control.trajectory import JerkLimitedMotion
from armctl.core.arrays import Array
from armctl.kinematics.clearance import Clearance
from armctl.kinematics.model import ArmModel
from armctl.robot_description import JointLimits

SPACING = 0.05
"""rad: largest distance between the configurations of a motion that are checked."""
SLACK = 1e-6
"""rad, and m: round-off by which a commanded position may exceed its limit."""
AT_REST = 1e-6
"""rad/s and rad/s^2."""

Workspace = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner of a box that the end-effector stays in, m."""


class GuardedMotion:
    """The commanded motion of one arm, a period (s) at a time.

    Its links keep `margin` (m) from each other and everything else, as `Clearance` measures it, or as much as they have
    where the motion begins.
    """

    def __init__(
        self,
        model: ArmModel,
        limits: JointLimits,
        period: float,
        workspace: Workspace | None = None,
        margin: float = 0.0,
    ) -> None:
        self.model, self.limits, self.period, self.workspace = model, limits, period, workspace
        self._clearance, self._margin = Clearance(model, margin), margin
        self._motion = JerkLimitedMotion(limits, period, model.home)
        self.restart(model.home)

    def restart(self, position: ArrayLike) -> None:
        """Begin anew, at rest at `position` (dof,) rad."""
        self._motion.restart(position)
        distance = float(self._clearance.min_distances(np.array(position, dtype=float)[None])[0])
        self.margin = min(self._margin, distance - SLACK)
        """m; below 0 where links touch by the model: they may come no nearer."""
        self._stop, self._since = self._motion.stop(), 0.0

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Position rad, velocity rad/s and acceleration rad/s^2 that are commanded, (dof,) each."""
        return self._motion.position, self._motion.velocity, self._motion.acceleration

    @property
    def is_at_rest(self) -> bool:
        """True if nothing moves."""
        return bool(max(np.abs(self._motion.velocity).max(), np.abs(self._motion.acceleration).max()) < AT_REST)

    def towards(self, goal: Array) -> bool:
        """Go on by a period towards rest at `goal` (dof,); return False if that is not safe, and it brakes instead."""
        motion, previous = self._motion, self.state
        try:
            motion.step(goal)
            stop = motion.stop()
            steps = math.ceil(np.abs(stop.at_time(stop.duration)[0] - motion.position).max() / SPACING)
            times = np.linspace(0.0, stop.duration, 2 + steps)
            is_safe = self.is_allowed(np.array([stop.at_time(time)[0] for time in times]))
        except RuckigError:
            is_safe = False
        if is_safe:
            self._stop, self._since = stop, 0.0
            return True
        motion.position, motion.velocity, motion.acceleration = previous
        self.brake()
        return False

    def brake(self) -> None:
        """Go on by a period of the checked stop."""
        self._since += self.period
        state = self._stop.at_time(self._since)
        self._motion.position, self._motion.velocity, self._motion.acceleration = map(np.array, state)

    def is_allowed(self, q: Array) -> bool:
        """Return True if the arm may be at all of q (m, dof)."""
        inside = (q >= self.limits.lower - SLACK) & (q <= self.limits.upper + SLACK)
        is_clear = (self._clearance.min_distances(q) >= self.margin).all()
        if not (inside.all() and is_clear and (self.margin < 0 or self.model.are_free(q).all())):
            return False
        return self.workspace is None or self.is_in_workspace(self.model.positions(q))

    def is_in_workspace(self, points: Array) -> bool:
        """Return True if the end-effector may be at all of these points (..., 3) m, as far as the workspace goes."""
        low, high = self.workspace or (-np.inf, np.inf)
        return bool(((points >= low) & (points <= high)).all())

    def preview(self, state: tuple[Array, Array, Array], goal: Array) -> Array:
        """Return the positions (m, dof) of the whole motion from a state to rest at `goal` (dof,), near each other."""
        motion = JerkLimitedMotion(self.limits, self.period, state[0])
        motion.position, motion.velocity, motion.acceleration = state
        return motion.preview(goal, SPACING / float(self.limits.velocity.max()))
