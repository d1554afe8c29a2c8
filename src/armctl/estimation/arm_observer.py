"""Beliefs of an arm's controller: joints, links' lengths, target and delay, from noisy readings.

- Joints move as their drives do (`armctl.robot_description.joint_profiles`), whose commands are known; a Kalman filter
  corrects that by the readings. What remains between joints and drives is the load's: a slow disturbance, as in
  offset-free MPC (Pannocchia and Rawlings, "Disturbance models for offset-free model-predictive control", AIChE J. 49,
  2003), that commands are shifted by.
- The end-effector is where the links of other lengths bring it: its error is linear in their relative errors, which are
  estimated by recursive least squares (a Kalman filter of constants).
- Targets at rest are constants; moving ones have a slowly changing acceleration.
- Readings that follow the commands of some control steps ago show the delay: the drives under a delay are the undelayed
  ones of so long ago, so candidates cost a comparison each.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from armctl.control.streaming import follow
from armctl.core.arrays import Array
from armctl.core.options import Positive, options
from armctl.estimation.kalman import (
    EstimationOptions,
    KalmanFilter,
    LinearModel,
    constant_acceleration,
    constant_velocity,
)
from armctl.kinematics import ArmModel
from armctl.robot_description.joint_profiles import FOLLOWING_ERROR

WELL_KNOWN = 0.007
"""m: standard deviation of boxes at which an arm can set out."""
NEAR_HOME = 0.3
"""rad: an arm whose first readings are all so near to its home position is at home."""
AT_REST = 0.01
"""rad and rad/s, of such an arm: standard deviations."""
SERVO = 0.02
"""rad: by which joints are off their drives in motion."""
LARGEST_SIGMA = 3.0
"""Standard deviations by which a reading of the end-effector may be off."""
SETTLING = 0.3
"""s: while joints move relative to their drives, their offset so long ahead is as uncertain as their motion is far."""


class StandingObjects:
    """Means of readings of what stands still, such as boxes, and how well they are known."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        self.mean: Array = np.zeros(0)
        """(k,)."""
        self._readings = 0

    def read(self, numbers: Array) -> None:
        """Take the readings (k,) of a control step."""
        self._readings += 1
        self.mean = numbers if self._readings == 1 else self.mean + (numbers - self.mean) / self._readings

    def deviation(self, noise: float) -> float:
        """Return the standard deviation of the means, of readings with that of `noise`."""
        return noise / float(np.sqrt(self._readings))


class ArmReadings:
    """Readings of one arm, believed as they are: what `ArmObserver` is for controllers without estimation."""

    load_offset = 0.0

    def __init__(self, period: float) -> None:
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Forget the last readings."""
        self._last_velocity: Array | None = None

    def read(self, tip: Array, q: Array, target: Array, target_velocity: Array | None = None) -> None:
        """Take the readings of a control step, as `ArmObserver.read` does."""
        self.tip, self.joints, self.target, self._velocity = tip, q, target, target_velocity
        self.joints_ahead = q

    def send(self, goal: Array) -> None:
        """Do nothing: commands are not remembered."""

    def tip_offset(self, q: Array) -> Array:
        """Return zeros (3,): the model is believed."""
        return np.zeros(3)

    def target_ahead(self, times: ArrayLike) -> Array:
        """Return the target (..., 3) m at times (...) s from now, with its acceleration since the last control step."""
        velocity, times = self._velocity, np.asarray(times)[..., None]
        if velocity is None:
            return np.broadcast_to(self.target, (*times.shape[:-1], 3))
        last = velocity if self._last_velocity is None else self._last_velocity
        acceleration = (velocity - last) / self._period
        self._last_velocity = velocity
        return np.asarray(self.target + times * velocity + times**2 / 2 * acceleration)


@options
class ArmObserverOptions:
    """Options of `ArmObserver`: standard deviations that an engineer would know, and memories."""

    joint_noise: Positive = 0.05
    """rad, of readings: the most that is expected, since too much is soon corrected, and too little is not."""
    tip_noise: Positive = 0.05
    """m, of readings of the end-effector and the target: likewise."""
    servo_acceleration: Positive = 8.0
    """rad/s^2, of joints relative to their drives."""
    load_change: Positive = 0.003
    """rad, by which the offset of joints from resting drives changes in a control step."""
    link_error: Positive = 0.1
    """Relative error of the links' lengths."""
    target_jerk: Positive = 8.0
    """m/s^3, of a moving target."""
    noise_memory: Positive = 30.0
    """Control steps over which noise is identified."""
    max_delay: Annotated[int, Field(ge=0, le=100)] = 10
    """Control steps."""


class ArmObserver:
    """Estimates for one arm: in each control step `read`, then `send` what is commanded.

    `clock` returns the control steps of the episode so far, as `Interface.control_step` does; without one, each reading
    is one control step after the last. A command whose decision took longer acts from the next reading on.
    """

    def __init__(
        self,
        model: ArmModel,
        period: float,
        moving: bool = False,
        clock: Callable[[], int] | None = None,
        options: ArmObserverOptions | None = None,
    ) -> None:
        self._model, self._period, self._moving, self._clock = model, period, moving, clock
        self.options = options = options or ArmObserverOptions()
        dof, lengths, eye, memory = model.dof, model.num_segments, np.eye, options.noise_memory
        self._joints = KalmanFilter(
            constant_velocity(dof, period, options.servo_acceleration, options.joint_noise),
            options=EstimationOptions(noise_memory=memory, gate=1.0),
        )
        self._load = KalmanFilter(
            LinearModel(eye(dof), options.load_change**2 * eye(dof), eye(dof), SERVO**2 * eye(dof)),
            options=EstimationOptions(gate=1.0),
        )
        tip = options.tip_noise**2 * eye(3)
        self._links = KalmanFilter(
            LinearModel(eye(lengths), np.zeros((lengths, lengths)), np.zeros((3, lengths)), tip),
            options=EstimationOptions(gate=1.0),
        )
        tracked = constant_acceleration(3, period, options.target_jerk, options.tip_noise)
        if moving:  # its velocity is read too
            at_rest = LinearModel(tracked.transition, tracked.process_noise, eye(6, 9), options.tip_noise**2 * eye(6))
        else:
            at_rest = LinearModel(eye(3), np.zeros((3, 3)), eye(3), tip)
        self._targets = KalmanFilter(at_rest, options=EstimationOptions(noise_memory=memory, common_scale=not moving))
        self.reset()

    def reset(self) -> None:
        """Forget everything, for a new episode."""
        dof = self._model.dof
        for each in (self._joints, self._targets):
            each.reset()
        self._load.reset(np.zeros(dof), 1e-8 * np.eye(dof))
        lengths = self._model.num_segments
        variances = np.full(lengths, self.options.link_error**2)
        variances[0] = 0.0  # the first joint is where it is mounted
        self._links.reset(np.zeros(lengths), np.diag(variances))
        self.delay = 0
        """Control steps between a command and its effect."""
        self._errors = np.zeros(self.options.max_delay + 1)
        self._position: Array | None = None
        self._last_step = -1

    @property
    def joints(self) -> Array:
        """Joint positions (dof,) rad now."""
        return np.asarray(self._joints.mean[0, : self._model.dof])

    @property
    def load_offset(self) -> Array:
        """Offset (dof,) rad of resting joints from what is commanded."""
        return np.asarray(self._load.mean[0])

    @property
    def commanded(self) -> Array:
        """Position (dof,) rad of the joints when all commands under way have had their effect."""
        assert self._position is not None
        return np.asarray(self._position + self.load_offset)

    @property
    def joints_ahead(self) -> Array:
        """Joint positions (dof,) rad at the moment from which the next command acts: as far off the drives as now."""
        assert self._position is not None
        limits = self._model.limits
        ahead = self.joints + self._position - self._history[self.delay]
        return np.asarray(np.clip(ahead, limits.lower, limits.upper))

    @property
    def length_errors(self) -> Array:
        """Relative errors (joints + 1,) of the links' lengths, in the order of `ArmModel.segments`."""
        return np.asarray(self._links.mean[0])

    @property
    def noise(self) -> float:
        """Standard deviation (rad) of the joints' readings."""
        return self.options.joint_noise * float(np.sqrt(self._joints.measured_noise_scale[0]))

    @property
    def commanded_velocity(self) -> Array:
        """Velocity (dof,) rad/s of the drives at that time."""
        return self._velocity

    @property
    def tip(self) -> Array:
        """End-effector (3,) m now."""
        return self._model.position(self.joints) + self.tip_offset(self.joints)

    @property
    def target(self) -> Array:
        """Target (3,) m now."""
        return np.asarray(self._targets.mean[0, :3])

    def target_ahead(self, times: ArrayLike) -> Array:
        """Return the target (..., 3) m at times (...) s from the moment on from which the next command acts."""
        if not self._moving:
            return np.broadcast_to(self.target, (*np.shape(times), 3))
        t = (np.asarray(times) + self.delay * self._period)[..., None]
        position, velocity, acceleration = self._targets.mean[0].reshape(3, 3)
        return np.asarray(position + t * velocity + t**2 / 2 * acceleration)

    def target_velocity_ahead(self) -> Array:
        """Return the velocity (3,) m/s of a moving target at the moment from which the next command acts."""
        _, velocity, acceleration = self._targets.mean[0].reshape(3, 3)
        return np.asarray(velocity + self.delay * self._period * acceleration)

    def tip_offset(self, q: Array) -> Array:
        """Return by how much (3,) m the end-effector at `q` (dof,) is off the model's, for its links' lengths."""
        return np.asarray(self._links.mean[0] @ self._model.segments(q))

    def read(self, tip: Array, q: Array, target: Array, target_velocity: Array | None = None) -> None:
        """Take the readings of a control step: end-effector and target (3,) m, joints (dof,) rad, velocity (3,) m/s."""
        step = self._last_step + 1 if self._clock is None else self._clock()
        if self._position is None:
            self._begin(q)
        else:
            self._pass(step - self._last_step)
        self._last_step = step
        self._read_joints(q)
        self._targets.update([target if target_velocity is None else np.concatenate((target, target_velocity))])
        self._read_tip(tip, q)

    def _read_tip(self, tip: Array, q: Array) -> None:
        """Estimate the links' lengths: the end-effector is read as well as the target is, where the joints are read.

        Noise that was identified as too small, as in the first readings, counts as what makes this reading probable.
        """
        q = np.where(np.isfinite(q), q, self.joints)
        model, rows, unit = self._model, self._model.segments(q).T, self.options.tip_noise**2
        joint_noise = self.options.joint_noise**2 * self._joints.noise_scale[0]
        by_joints = joint_noise * np.square(model.jacobian(q)[:3]).sum() / 3
        offset = tip - model.position(q)
        innovation, expected = offset - rows @ self._links.mean[0], rows @ self._links.covariance[0] @ rows.T
        noise_scale = np.mean((innovation / LARGEST_SIGMA) ** 2 - np.diag(expected)) / unit
        deviation = np.sqrt(max(self._targets.noise_scale[0] + by_joints / unit, noise_scale))
        self._links.update([offset / deviation], rows / deviation)

    def _begin(self, q: Array) -> None:
        home = self._model.home
        q = np.where(np.isfinite(q), q, home)
        at_home = bool((np.abs(q - home) < NEAR_HOME).all())
        self._position, self._velocity = (home if at_home else q).astype(float), np.zeros(len(q))
        self._history = np.tile(self._position, (self.options.max_delay + 2, 1))
        self._sent = self._acting = self._position
        if at_home:
            self._joints.reset(np.append(home, np.zeros(len(q))), AT_REST**2 * np.eye(2 * len(q)))

    def _pass(self, steps: int) -> None:
        """Move on by control steps: of the last command, or of the one before if the last decision was late."""
        for unread in range(steps - 1, -1, -1):
            self._drive(self._sent if steps == 1 else self._acting)
            if unread:
                self._predict()
        self._acting = self._sent

    def _predict(self) -> None:
        driven, previous = self._history[self.delay], self._history[self.delay + 1]
        self._joints.predict([np.append(driven - previous, np.zeros(self._model.dof))])
        self._load.predict()
        self._targets.predict()

    def _read_joints(self, q: Array) -> None:
        self._identify_delay(q)
        self._predict()
        driven = self._history[self.delay]
        self._joints.update([q])
        motion = SETTLING * self._joints.mean[0, len(q) :]
        deviation = np.sqrt(1 + (4 * self._joints.covariance[0, 0, 0] + motion**2) / SERVO**2)
        self._load.update([(self.joints - driven) / deviation], np.diag(1 / deviation))

    def _identify_delay(self, q: Array) -> None:
        """Compare readings with the drives of so many control steps ago; the least delay wins unless it is worse."""
        scale = SERVO**2 + self.options.joint_noise**2 * self._joints.noise_scale[0]
        offset = q - self.load_offset
        self._errors += np.fmin(((self._history[:-1] - offset) ** 2).sum(axis=1) / scale, 9.0)  # 9 for missing readings
        best = int(self._errors.argmin())
        if self._errors[self.delay] > self._errors[best] + 9.0:
            self.delay = best
            self._load.reset(np.zeros(len(q)), 1e-8 * np.eye(len(q)))

    def send(self, goal: Array) -> None:
        """Take note of the joint positions (dof,) rad that are commanded now."""
        self._sent = goal

    def _drive(self, goal: Array) -> None:
        """Move the drives towards the commanded `goal` (dof,) for one control step."""
        assert self._position is not None
        limits = self._model.limits
        near = np.clip(self._position, self.joints - FOLLOWING_ERROR, self.joints + FOLLOWING_ERROR)
        start = near if self.delay == 0 else self._position
        self._position, self._velocity = follow(
            limits, start, self._velocity, np.clip(goal, limits.lower, limits.upper), self._period
        )
        self._history[1:] = self._history[:-1]
        self._history[0] = self._position
