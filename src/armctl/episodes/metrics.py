"""Metrics of an episode's motion: path length, smoothness, effort, clearance, decision times."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from armctl.core.arrays import Array

if TYPE_CHECKING:
    from armctl.tasks import MotionSample


@dataclass(frozen=True)
class Metrics:
    """Metrics of one episode; each is a column of `episodes.csv`."""

    path_length: float
    """m, path length of the end-effector or the rover, by straight lines between control steps."""
    smoothness: float
    """Log dimensionless jerk (see `smoothness`): smoother motions are nearer to 0; NaN for too short an episode."""
    joint_jerk_max: float
    """rad/s^3, largest jerk of a joint or wheel; NaN if joints are not sampled, like the next one."""
    joint_jerk_rms: float
    """rad/s^3, root mean square of all joints' or wheels' jerk."""
    tip_jerk_max: float
    """m/s^3, largest jerk of the end-effector; NaN for a rover, like the next one."""
    tip_jerk_rms: float
    """m/s^3, root mean square of the end-effector's jerk."""
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
    """Median of warm decisions: all but the policy's first in its process, unless there is no other; like the next two.
    """
    decision_ms_p99: float
    decision_ms_max: float
    first_call_ms: float
    """Time of the policy's first decision in its process; NaN if that was in another episode."""
    intervention_share: float = math.nan
    """Share of the control steps in which a safety filter changed the action; NaN without a filter."""
    intervention_size: float = math.nan
    """Mean change in these steps: the largest of an action's numbers, relative to its range; NaN without any."""


class EpisodeTimes(NamedTuple):
    """Decision times of an episode."""

    decision_ms: Array
    """(steps,) NaN in control steps in which no decision began."""
    reset_ms: float
    """Time of the reset before the first decision."""
    first_call: bool
    """True if the first decision was the policy's first in its process."""
    slow_down: float | None
    """Factor by which decisions take longer than they were measured; None if times are not latencies."""


def metrics(
    task: Any,
    world: int,
    start: Array,
    motions: "Sequence[MotionSample]",
    times: EpisodeTimes,
    solver_failures: int,
    interventions: tuple[float, float],
) -> Metrics:
    """Return metrics of the episode that has just ended in a world; it may have no step, if the policy failed before.

    `interventions` are the number of a safety filter's, NaN without one, and the sum of their sizes.

    `start` (3,) m is the robot's initial position, `motions` are those of its control steps.
    """
    period = task.control_period
    decision_ms, reset_ms, first_call, slow_down = times
    reports_contacts = task.motion().contact is not None
    contacts = sum(bool(motion.contact[world]) for motion in motions if motion.contact is not None)
    positions = np.array([start, *(motion.position[world] for motion in motions)])
    configurations = np.array([motion.configuration[world] for motion in motions])
    use = _joint_use(task, world, motions, configurations)
    warm = warm_times(decision_ms, first_call)
    waits = warm_times(np.concatenate((decision_ms[:1] + reset_ms, decision_ms[1:])), first_call)
    p50, p99, longest = np.quantile(warm, (0.5, 0.99, 1.0)) if len(warm) else [math.nan] * 3
    return Metrics(
        path_length(positions),
        math.nan if period is None else smoothness(positions, period),
        *_jerks(task, world, start, motions),
        *use,
        task.min_clearance(world, configurations) if motions else math.nan,
        contacts if reports_contacts else None,
        solver_failures,
        None if slow_down is None or period is None else int((slow_down * waits > 1e3 * period).sum()),
        round(float(p50), 4),
        round(float(p99), 4),
        round(float(longest), 4),
        float(decision_ms[0]) if first_call and motions else math.nan,
        interventions[0] / len(motions) if motions else math.nan,
        interventions[1] / interventions[0] if interventions[0] > 0 else math.nan,
    )


def warm_times(decision_ms: Array, first_call: bool) -> Array:
    """Return the times of an episode's decisions, without the first one if that was a `first_call` and has others.

    `decision_ms` (steps,) is NaN in steps in which none began.
    """
    times = decision_ms[~np.isnan(decision_ms)]
    return times[1:] if first_call and len(times) > 1 else times


def _jerks(task: Any, world: int, start: Array, motions: "Sequence[MotionSample]") -> tuple[float, float, float, float]:
    """Return the largest and the rms jerk of joints and end-effector, from rest at `start`; NaN if not sampled."""
    speeds = [motion.joints[0, :, world] for motion in motions if motion.joints is not None]
    places = [motion.path[:, world] for motion in motions if motion.path is not None]
    if not speeds:
        return (math.nan,) * 4
    joint_speeds, interval = np.concatenate(speeds), task.joints.interval
    moving = np.flatnonzero(np.diff(joint_speeds, axis=0).any(axis=1))
    samples = int(moving[-1]) + 2 if len(moving) else 0  # at a target, a world stands still at the speed that it had
    joints = jerks(np.vstack((np.zeros((2, joint_speeds.shape[1])), joint_speeds[:samples])), 2, interval)
    if not places:
        return *largest_and_rms(joints), math.nan, math.nan
    tip = jerks(np.vstack((np.tile(start, (3, 1)), np.concatenate(places)[:samples])), 3, interval)
    return *largest_and_rms(joints), *largest_and_rms(np.linalg.norm(tip, axis=1))


def jerks(samples: Array, order: int, interval: float) -> Array:
    """Return the derivatives of an `order` of samples (m, k), an `interval` (s) apart, by differences, (m - order, k).

    Jerk is the second derivative of speeds, and the third one of positions.
    """
    return np.asarray(np.diff(samples, n=order, axis=0) / interval**order)


def largest_and_rms(jerk: Array) -> tuple[float, float]:
    """Return the largest magnitude of jerks, and their root mean square, which does not grow with the duration.

    The latter is the root of the mean squared jerk (Hogan and Sternad, "Sensitivity of smoothness measures to movement
    duration, amplitude, and arrests", J. Motor Behavior 41(6), 2009). 0 without motion.
    """
    return float(np.abs(jerk).max(initial=0.0)), math.sqrt(float((jerk * jerk).mean())) if jerk.size else 0.0


def _joint_use(
    task: Any, world: int, motions: "Sequence[MotionSample]", configurations: Array
) -> tuple[float, float, float, float]:
    """Return use of range, speed and torque, and energy; NaN without a step, and if joints are not sampled."""
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
    """Return the largest distance of joint positions (m, k) from mid-range: 0 in the middle, 1 at a limit."""
    return float(np.abs(2 * (positions - lowest) / (highest - lowest) - 1).max())


def path_length(positions: Array) -> float:
    """Return the length of the polyline through positions (m, 3), m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def smoothness(positions: Array, period: float) -> float:
    """Return the log dimensionless jerk of a motion through positions (m, 3), one `period` (s) apart.

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
