"""Metrics of an episode's motion: path length, smoothness, effort, clearance, decision times."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.tasks import MotionSample

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Metrics:
    """Metrics of one episode; each is a column of `episodes.csv`."""

    path_length: float
    """m, path length of the end-effector or the rover, by straight lines between control steps."""
    smoothness: float
    """Log dimensionless jerk (see `smoothness`): smoother motions are nearer to 0; NaN for too short an episode."""
    range_use: float
    """Largest distance of a joint from the middle of its range, relative to half the range; NaN for a rover."""
    speed_use: float
    """Largest ratio of a joint's or wheel's speed to its limit; above 1 if it overshot."""
    torque_use: float
    """Largest ratio of a joint's or wheel's torque to its limit."""
    energy: float
    """J, time integral of |torque * speed| over all joints or wheels."""
    clearance: float
    """m, least distance to anything that must not be touched, over all control steps; NaN if unknown."""
    contacts: int | None
    """Control steps with a forbidden contact; None if the environment does not say."""
    solver_failures: int
    """Control steps in which the controller's solver failed, if it counts them."""
    missed_deadlines: int | None
    """Warm decisions that took longer than the control period, the first one together with the reset before it; None
    if the period or latencies are unknown."""
    decision_ms_p50: float
    """Of warm decisions, like the next two: of all but the policy's first in its process, unless there is no other."""
    decision_ms_p99: float
    decision_ms_max: float
    decision_ms_cold: float
    """Time of the policy's first decision in its process; NaN if that was in another episode."""


def metrics(
    task: Any,
    world: int,
    start: Array,
    motions: Sequence[MotionSample],
    decision_ms: Array,
    solver_failures: int,
    *,
    reset_ms: float,
    cold: bool,
    slow_down: float | None,
) -> Metrics:
    """Metrics of the episode that has just ended in a world; it may have no step, if the policy failed before.

    `start` (3,) m is the robot's initial position, `motions` and `decision_ms` (steps,) are those of its control steps.
    `decision_ms` is NaN in steps in which none began; `reset_ms`, before the first, is apart. `cold` says whether the
    first decision was the policy's first in its process; `slow_down` by how much decisions take longer, None if times
    are no latencies.
    """
    period = task.control_period
    known = task.motion().contact is not None
    contacts = sum(bool(motion.contact[world]) for motion in motions if motion.contact is not None)
    positions = np.array([start, *(motion.position[world] for motion in motions)])
    configurations = np.array([motion.configuration[world] for motion in motions])
    use = _joint_use(task, world, motions, configurations)
    warm = warm_times(decision_ms, cold)
    waits = warm_times(np.concatenate((decision_ms[:1] + reset_ms, decision_ms[1:])), cold)
    p50, p99, most = np.quantile(warm, (0.5, 0.99, 1.0)) if len(warm) else [math.nan] * 3
    return Metrics(
        path_length(positions),
        math.nan if period is None else smoothness(positions, period),
        *use,
        task.least_clearance(world, configurations) if motions else math.nan,
        contacts if known else None,
        solver_failures,
        None if slow_down is None or period is None else int((slow_down * waits > 1e3 * period).sum()),
        round(float(p50), 4),
        round(float(p99), 4),
        round(float(most), 4),
        float(decision_ms[0]) if cold and motions else math.nan,
    )


def warm_times(decision_ms: Array, cold: bool) -> Array:
    """The times of an episode's decisions without the first one if that was `cold`, unless it is the only one.

    `decision_ms` (steps,) is NaN in steps in which none began.
    """
    times = decision_ms[~np.isnan(decision_ms)]
    return times[1:] if cold and len(times) > 1 else times


def _joint_use(
    task: Any, world: int, motions: Sequence[MotionSample], configurations: Array
) -> tuple[float, float, float, float]:
    """Use of range, speed and torque, and energy; NaN without a step, and if the task does not sample its joints."""
    if task.joints is None or not motions:
        return math.nan, math.nan, math.nan, math.nan
    samples = [motion.joints[:, :, world] for motion in motions if motion.joints is not None]
    (speeds, torques), limits = np.array(samples).swapaxes(0, 1), task.joints.limits
    return (
        range_use(configurations, *limits.position) if limits.position else math.nan,
        float((np.abs(speeds) / limits.speed).max()),
        float((np.abs(torques) / limits.torque).max()),
        float(np.abs(torques * speeds).sum() * task.joints.interval),
    )


def range_use(positions: Array, lowest: Array, highest: Array) -> float:
    """Largest distance of joint positions (m, k) from the middle of their range: 0 in the middle, 1 at a limit."""
    return float(np.abs(2 * (positions - lowest) / (highest - lowest) - 1).max())


def path_length(positions: Array) -> float:
    """Length of the polyline through positions (m, 3), m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def smoothness(positions: Array, period: float) -> float:
    """Log dimensionless jerk of a motion through positions (m, 3), one `period` (s) apart.

    -ln(duration^3 / peak speed^2 * integral of jerk^2) does not depend on size and duration, and is -ln 204.8 = -5.3
    for the smoothest motion from rest to rest (Balasubramanian, Melendez-Calderon, Roby-Brami and Burdet, "On the
    analysis of movement smoothness", J. NeuroEngineering and Rehabilitation 12:112, 2015). Derivatives are finite
    differences: compare values only between policies with the same period. NaN for less than four positions, and
    without motion.
    """
    if len(positions) < 4:
        return math.nan
    duration = period * (len(positions) - 1)
    peak_speed = np.linalg.norm(np.diff(positions, axis=0), axis=1).max() / period
    jerk = np.diff(positions, n=3, axis=0) / period**3
    squared = float((jerk * jerk).sum()) * period
    if not (peak_speed > 0 and squared > 0):
        return math.nan
    return float(-np.log(duration**3 / peak_speed**2 * squared))
