"""Joint trajectories within limits of velocity, acceleration and jerk.

From point to point, Ruckig finds the minimum-time trajectory (Berscheid and Kroeger, "Jerk-limited real-time trajectory
generation with arbitrary target states", RSS 2021). Along a path of many points, two moving averages smooth a motion
from corner to corner at full speed. The first bounds its acceleration, the second its jerk, and both round the corners
(Biagiotti and Melchiorri, "FIR filters for online trajectory planning with time- and frequency-domain specifications",
Control Engineering Practice 20, 2012).
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from ruckig import ControlInterface, InputParameter, OutputParameter, Ruckig, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.robot_description import JointLimits

SAMPLE = 0.002
"""s: time between two points of a trajectory"""
GOAL_SPEED = 0.9
"""Largest speed of a moving goal, relative to the limit: joints have to be faster to come beside it."""
PACES = (1.0, 0.7, 0.5, 0.3)
"""Fractions of the full speed to try, the highest first: slower motions cut corners less."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint positions every `SAMPLE` seconds from time 0; the joints rest at the last."""

    positions: Array
    """(m, dof) rad."""

    @property
    def duration(self) -> float:
        """Seconds until all joints are at rest."""
        return SAMPLE * (len(self.positions) - 1)

    def at(self, times: ArrayLike) -> Array:
        """Return positions (..., dof) rad at `times` (...), s."""
        samples = np.asarray(times, dtype=float) / SAMPLE
        first = np.clip(np.floor(samples).astype(int), 0, len(self.positions) - 1)
        second = np.minimum(first + 1, len(self.positions) - 1)
        share = np.clip(samples - first, 0.0, 1.0)[..., None]
        return np.asarray((1 - share) * self.positions[first] + share * self.positions[second])

    def velocity_at(self, time: float) -> Array:
        """Return velocities (dof,) rad/s at a time, s: means over a sample."""
        return np.asarray((self.at(time + SAMPLE / 2) - self.at(time - SAMPLE / 2)) / SAMPLE)


class JerkLimitedMotion:
    """The commanded motion of joints that goes on by a period at a time, to a goal that may change at each of them.

    Ruckig plans the rest of the motion anew from the commanded state. Each joint moves in its own minimum time. If the
    goal moves, so does the frame of the plan, at a constant velocity: limits of acceleration and jerk are the same in
    it, those of velocity are shifted, and the plan ends at rest.
    """

    def __init__(self, limits: JointLimits, period: float, position: ArrayLike) -> None:
        self.limits, self.period, self._dof = limits, period, len(limits.lower)
        self._otg, self._next = Ruckig(self._dof, period), OutputParameter(self._dof)
        self.restart(position)

    def restart(self, position: ArrayLike) -> None:
        """Begin anew, at rest at `position` (dof,) rad."""
        self.position: Array = np.array(position, dtype=float)
        """(dof,) rad: the commanded position."""
        self.velocity: Array = np.zeros(self._dof)
        """(dof,) rad/s."""
        self.acceleration: Array = np.zeros(self._dof)
        """(dof,) rad/s^2."""

    def step(self, goal: Array, velocity: Array | None = None) -> None:
        """Go on by a period, to be at rest at `goal` (dof,) rad, or beside it if it moves at `velocity` (dof,) rad/s.

        A moving goal is where it will be after the period.
        """
        top = GOAL_SPEED * self.limits.velocity
        frame = np.zeros(self._dof) if velocity is None else np.clip(velocity, -top, top)
        goal = np.clip(goal, self.limits.lower, self.limits.upper)
        self._otg.update(self._problem(goal - self.period * frame, frame), self._next)
        self.position = goal + self._next.new_position
        self.velocity = frame + self._next.new_velocity
        self.acceleration = np.array(self._next.new_acceleration)

    def preview(self, goal: Array, step: float) -> Array:
        """Return the positions (m, dof) every `step` (s) from now until the joints would rest at `goal` (dof,)."""
        goal, trajectory = np.clip(goal, self.limits.lower, self.limits.upper), RuckigTrajectory(self._dof)
        self._otg.calculate(self._problem(goal, np.zeros(self._dof)), trajectory)
        return goal + _sampled(trajectory, step)

    def stop(self) -> RuckigTrajectory:
        """Return the earliest stop of each joint from the commanded state, wherever that is."""
        problem, trajectory = self._problem(np.zeros(self._dof), np.zeros(self._dof)), RuckigTrajectory(self._dof)
        problem.control_interface = ControlInterface.Velocity
        self._otg.calculate(problem, trajectory)
        return trajectory

    def _problem(self, origin: Array, frame: Array) -> InputParameter:
        """Return the problem to come to rest at the `origin` (dof,) of a frame that moves at a velocity (dof,)."""
        problem = _problem(self.limits, Synchronization.No)
        problem.current_position = (self.position - origin).tolist()
        problem.current_velocity = (self.velocity - frame).tolist()
        problem.current_acceleration = self.acceleration.tolist()
        problem.max_velocity = (self.limits.velocity - frame).tolist()
        problem.min_velocity = (-self.limits.velocity - frame).tolist()
        return problem


def point_to_point(limits: JointLimits, start: ArrayLike, goal: ArrayLike, straight: bool = False) -> Trajectory:
    """Return the minimum-time motion from rest at `start` to rest at `goal`, (dof,) each; `straight` keeps to the line.

    Raises `ConfigurationError` for configurations outside the limits.
    """
    ends = _checked(limits, np.array([start, goal], dtype=float))
    problem = _problem(limits, Synchronization.Phase if straight else Synchronization.Time)
    problem.current_position, problem.target_position = ends.tolist()
    trajectory = RuckigTrajectory(ends.shape[1])
    Ruckig(ends.shape[1]).calculate(problem, trajectory)
    return Trajectory(_sampled(trajectory, SAMPLE))


def along(limits: JointLimits, path: ArrayLike, pace: float = 1.0, stops: bool = False) -> Trajectory:
    """Return a smooth motion from rest to rest along the corners of a path (m, dof) rad.

    It cuts corners: less at a lower `pace`, which is a fraction of the full speed, and not at all with `stops`.

    Raises `ConfigurationError` for an invalid path, and for one outside the limits.
    """
    from scipy.ndimage import uniform_filter1d  # a fifth of a second that point-to-point motions do not need

    corners = _checked(limits, np.asarray(path, dtype=float))
    if stops:
        corners = np.repeat(corners, [1, *[2] * (len(corners) - 2), 1], axis=0)
    steps = np.diff(corners, axis=0)
    durations = np.maximum((np.abs(steps) / limits.velocity).max(axis=1) / pace, SAMPLE)
    spread = np.ptp(np.vstack((steps / durations[:, None], np.zeros(len(limits.lower)))), axis=0)
    smooth_velocity = float((spread / limits.acceleration).max())
    smooth_acceleration = float((2 * limits.acceleration / limits.jerk).max())
    durations[~steps.any(axis=1)] = smooth_velocity + smooth_acceleration
    knots = np.concatenate(([0.0], np.cumsum(durations)))
    widths = [1 + 2 * int(np.ceil(span / SAMPLE / 2)) for span in (smooth_velocity, smooth_acceleration)]
    rest = SAMPLE * sum(width // 2 + 1 for width in widths)
    clock = np.arange(-rest, knots[-1] + rest + SAMPLE, SAMPLE)
    positions = np.column_stack([np.interp(clock, knots, joint) for joint in corners.T])
    for width in widths:
        positions = uniform_filter1d(positions, width, axis=0, mode="nearest")
    return Trajectory(positions)


def smooth(limits: JointLimits, path: ArrayLike, is_free: Callable[[Trajectory], bool]) -> Trajectory:
    """Return the fastest collision-free trajectory along a path (m, dof): at a slower pace or with stops if needed.

    The path itself is assumed to be free, and so is the motion with stops.
    """
    corners = np.asarray(path, dtype=float)
    if len(corners) == 2:
        candidates = (
            point_to_point(scaled(limits, pace, pace**2, pace**3), corners[0], corners[1], straight=True)
            for pace in PACES
        )
    else:
        candidates = (along(limits, corners, pace) for pace in PACES)
    last = along(limits, corners, PACES[-1], stops=True)
    faster = itertools.takewhile(lambda trajectory: trajectory.duration < last.duration, candidates)
    return next(filter(is_free, faster), last)


def _problem(limits: JointLimits, synchronization: Synchronization) -> InputParameter:
    """Return a problem for Ruckig with these limits, from rest at zero."""
    problem = InputParameter(len(limits.lower))
    problem.max_velocity, problem.max_acceleration = limits.velocity.tolist(), limits.acceleration.tolist()
    problem.max_jerk, problem.synchronization = limits.jerk.tolist(), synchronization
    return problem


def _sampled(trajectory: RuckigTrajectory, step: float) -> Array:
    """Return the positions (m, dof) every `step` (s), at rest at the last."""
    times = np.arange(0.0, trajectory.duration + step, step)
    return np.array([trajectory.at_time(float(time))[0] for time in times])


def scaled(limits: JointLimits, velocity: float, acceleration: float, jerk: float) -> JointLimits:
    """Return fractions of the limits of velocity, acceleration and jerk."""
    return replace(
        limits,
        velocity=velocity * limits.velocity,
        acceleration=acceleration * limits.acceleration,
        jerk=jerk * limits.jerk,
    )


def _checked(limits: JointLimits, path: Array) -> Array:
    if path.ndim != 2 or len(path) < 2 or path.shape[1] != len(limits.lower):
        raise ConfigurationError(
            f"path should be an array (m, {len(limits.lower)}) with at least two rows, not of shape {path.shape}"
        )
    if not ((path >= limits.lower - 1e-9) & (path <= limits.upper + 1e-9)).all():
        raise ConfigurationError(f"the path leaves the joint limits {limits.lower} to {limits.upper}: {path}")
    return path
