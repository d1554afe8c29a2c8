"""Observer of robots that drive by velocity commands: their response, delay and offsets, and where they will be.

Each velocity follows its command within a period, as far as acceleration and turn rate reach; x, y and yaw follow:

    v' = v + clip(k (u - d) - v, -a T, a T)      |turn rate| <= c      x' = x + T (0.3 v + 0.7 v') cos yaw  ...

Accelerations a and the turn rate c are learned from steps in which the response falls short of the command, and raised
in those in which they are reached. The offsets d are a disturbance observer's, as in offset-free model predictive
control (Pannocchia and Rawlings, AIChE Journal 49(2), 2003): commands are corrected by them. So weak or slippery
drives, a load, and wheels of other radii need no model of their own. `DelayPredictor` identifies the delay: each of its
candidates learns a response of its own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, Share, options
from armctl.estimation.delay import DelayOptions, DelayPredictor
from armctl.estimation.kalman import EstimationOptions, KalmanFilter, LinearModel
from armctl.kernels import drive_law as kernel

NEW_SHARE = 0.7
"""Weight of the new speed in the distance of a period: speeds are reached soon."""
NOISE_MEMORY = 100.0
"""Control steps over which the noise is identified."""
VELOCITY_DEVIATIONS, POSE_DEVIATIONS = np.array((0.03, 0.06)), (0.006, 0.003, 0.0)
"""m/s and rad/s, m and rad: deviations from the nominal law in a period, for the filter: of velocities, which move the
pose, and of the pose itself."""
CHANGE_DEVIATION = 0.2
"""Deviation from the law in a period, as a share of a velocity's change: wheels that begin to turn the rover skid."""
DELAY_OPTIONS = DelayOptions(threshold=8.0)
"""Options of the delay's identification: slow drives are similar to late ones, which takes more evidence."""
SLOW_TURN_RATE, WEAK_GAIN = 0.6, 3.0
"""rad/s, below which drives hardly turn, and ratio of their commands to the turn rates that they reach: those that skid
with all their force need no more, which would slow them down."""
REMAINING = 0.3
"""Share of a velocity's error that remains after a period."""
YAW = np.array((0.0, 0.0, 1.0, 0.0, 0.0))
"""Unit vector of the yaw among the numbers of a state."""


@options
class DriveObserverOptions:
    """Options of `DriveObserver`."""

    period: Positive = 0.1
    """s: control period."""
    gain: tuple[Positive, Positive] = (0.97, 1.0)
    """Nominal ratios of linear and angular velocity to their commands: wheels skid."""
    acceleration: tuple[Positive, Positive] = (6.0, 20.0)
    """Nominal accelerations, m/s^2 and rad/s^2."""
    max_command: tuple[Positive, Positive] = (2.0, 3.0)
    """Largest commands, m/s and rad/s."""
    accuracy: tuple[Positive, Positive] = (0.05, 0.15)
    """Accuracy of the nominal law, m/s and rad/s."""
    shortfall: tuple[Positive, Positive] = (0.04, 0.25)
    """Shortfalls of a response, m/s and rad/s, that are ascribed to a limit."""
    noisy_shortfall: tuple[Positive, Positive] = (0.15, 0.4)
    """The same for readings with noise."""
    clear_gap: tuple[tuple[NonNegative, NonNegative], tuple[NonNegative, NonNegative]] = ((0.12, 0.3), (0.3, 0.6))
    """Gaps between velocities and commands that no offset explains: if accelerations are low, and at most."""
    slow: tuple[Share, Share] = (0.95, 0.7)
    """Share of the expected change below which an acceleration is a new sample: straight ahead, and in a turn."""
    turning: NonNegative = 0.5
    """rad/s: turn rate above which a robot is in a turn."""
    learning: Share = 0.8
    """Weight of a new sample of an acceleration."""
    stalled: NonNegative = 0.2
    """Share of the expected change below which a turn rate is taken to be at its limit."""
    stall_command: NonNegative = 0.45
    """rad/s: least command of a stall."""
    stall_share: Share = 0.25
    """Share of the aim that is missing in a stall."""
    stall_drop: Share = 0.03
    """Share that remains of a largest velocity when a stall is seen, or more."""
    min_change: Share = 0.05
    """Share of the expected change below which an acceleration is not to be seen."""
    min_acceleration: tuple[Positive, Positive] = (0.7, 1.0)
    """Lowest accelerations, m/s^2 and rad/s^2."""
    recovery: NonNegative = 0.1
    """Growth of a limit in each step in which it is reached."""
    offset_gain: Share = 0.2
    """Share of each deviation that goes into the offsets."""
    max_deviation: tuple[NonNegative, NonNegative] = (0.15, 0.25)
    """Deviations, m/s and rad/s, beyond which they are no offsets."""
    max_offset: tuple[NonNegative, NonNegative] = (0.4, 0.3)
    """Largest offsets, m/s and rad/s."""


class DriveResponse:
    """Responses of drives to velocity commands, arrays (..., 2): linear and angular."""

    def __init__(self, options: DriveObserverOptions, parts: Sequence[Array]) -> None:
        self.options = options
        self.acceleration, self.speed, self.offset, self._stalled, self._slow = parts
        """m/s^2 and rad/s^2; largest velocities, m/s and rad/s; what commands need in addition, m/s and rad/s."""
        self._rows = kernel.Response(*(part.reshape(-1, 2) for part in parts))
        fields = (getattr(options, name) for name in kernel.Nominal._fields)
        values: Any = [field if isinstance(field, float) else np.array(field, dtype=float) for field in fields]
        self._nominal = kernel.Nominal(*values)

    @classmethod
    def nominal(cls, shape: tuple[int, ...], options: DriveObserverOptions) -> "DriveResponse":
        """Return the nominal response of drives (shape)."""
        response = cls(options, [np.zeros((*shape, 2)) for _ in kernel.Response._fields])
        response.reset(slice(None))
        return response

    def reset(self, ids: NDArray[np.integer] | slice) -> None:
        """Go back to the nominal response in columns `ids`."""
        self.acceleration[..., ids, :] = self.options.acceleration
        self.speed[..., ids, :] = self.options.max_command
        self.offset[..., ids, :] = self._stalled[..., ids, :] = self._slow[..., ids, :] = 0.0

    def choose(self, which: NDArray[np.integer], chosen: "DriveResponse") -> None:
        """Write the response of row `which` (n,) in each of n columns into `chosen`."""
        columns = len(which)
        rows = which * columns + np.arange(columns)
        for source, target in zip(self._rows, chosen._rows, strict=True):
            np.take(source, rows, axis=0, out=target)

    def law(self, states: Array, commands: Array) -> Array:
        """Return the states (..., n, 5) a period after `states` (n, 5), with commands (..., n, 2).

        They are x, y, yaw, linear and angular velocity.
        """
        ahead = np.empty((*commands.shape[:-1], 5))
        kernel.predict(self._nominal, self._rows, NEW_SHARE, states, commands.reshape(-1, 2), ahead.reshape(-1, 5))
        return ahead

    def learn(self, velocities: Array, commands: Array, responses: Array, noisy: bool = False) -> None:
        """Learn from `responses` (n, 2), a period after `velocities` (n, 2), with commands (..., n, 2)."""
        nominal = self._nominal
        if noisy:
            nominal = nominal._replace(shortfall=np.array(self.options.noisy_shortfall))
        kernel.learn(nominal, self._rows, velocities, commands.reshape(-1, 2), responses)


class DriveObserver:
    """Observer of n robots, all with the same nominal response.

    In each control step: `observe`, decide, `command`.
    """

    def __init__(
        self, n: int, options: DriveObserverOptions | None = None, delay_options: DelayOptions | None = None
    ) -> None:
        self.options, delay_options = options or DriveObserverOptions(), delay_options or DELAY_OPTIONS
        candidates = delay_options.max_delay + 1
        self._responses = DriveResponse.nominal((candidates, n), self.options)
        scale = (np.inf, np.inf, np.inf, *self.options.accuracy)
        self._predictor = DelayPredictor(self._responses.law, n, np.zeros(2), scale, delay_options)
        self._velocities = np.full((n, 2), np.nan)
        self.response = DriveResponse.nominal((n,), self.options)
        """The responses (n,) of the robots."""
        self._filter = KalmanFilter(MODEL, n, EstimationOptions(noise_memory=NOISE_MEMORY))

    @property
    def delay(self) -> NDArray[np.intp]:
        """(n,) control steps: the delays of commands."""
        return self._predictor.delay

    def reset(self, ids: NDArray[np.integer]) -> None:
        """Forget robots `ids`, which begin anew."""
        self._responses.reset(ids)
        self.response.reset(ids)
        self._predictor.reset(ids)
        self._velocities[ids] = np.nan
        self._filter.reset(ids=ids)

    def observe(self, states: Array, noisy: bool = False) -> Array:
        """Take in states (n, 5): x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s).

        Noisy ones are filtered. Return the states in which the next commands will act.
        """
        previous_delay = self.delay.copy()
        self._predictor.read(states)
        estimates = states
        if noisy:
            self._forget_estimates(np.flatnonzero(self.delay != previous_delay))
            estimates = self._filtered(states)
        velocities = estimates[:, 3:].copy()
        self._responses.learn(self._velocities, self._predictor.sent, velocities, noisy)
        self._velocities = velocities
        self._responses.choose(self.delay, self.response)
        return self._predictor.predict(estimates, self.response.law)

    def command(self, velocities: Array) -> Array:
        """Return the commands (n, 2) that lead to `velocities` (n, 2), which are sent now."""
        commands = velocities + self.response.offset
        weak = self.response.speed[:, 1] < SLOW_TURN_RATE
        commands[weak, 1] = WEAK_GAIN * velocities[weak, 1]
        limits = np.asarray(self.options.max_command)
        commands = np.clip(commands, -limits, limits)
        self._predictor.send(commands)
        return commands

    def _forget_estimates(self, ids: NDArray[np.integer]) -> None:
        """Forget what robots `ids` have learned from estimates that went by another delay."""
        self._responses.reset(ids)
        self._filter.reset(ids=ids)

    def _filtered(self, states: Array) -> Array:
        """Return the estimates of an extended Kalman filter, whose model is the law."""
        kalman, period = self._filter, self.options.period
        mean, commands = kalman.mean.copy(), self._predictor.acting()
        kalman.mean[:] = ahead = self.response.law(mean, commands)
        distance = (ahead[:, :2] - mean[:, :2])[..., None]
        along = np.column_stack((np.cos(mean[:, 2]), np.sin(mean[:, 2])))
        transition = np.tile(np.diag((1.0, 1.0, 1.0, REMAINING, REMAINING)), (len(mean), 1, 1))
        transition[:, :2, 2] = np.concatenate((-distance[:, 1], distance[:, 0]), axis=1)
        transition[:, :2, 3] = period * (1 - NEW_SHARE + NEW_SHARE * REMAINING) * along
        transition[:, 2, 4] = period * REMAINING
        inputs = np.zeros((len(mean), 5, 2))
        inputs[:, :2, 0], inputs[:, 2, 1] = period * NEW_SHARE * along, period
        inputs[:, 3, 0] = inputs[:, 4, 1] = 1.0
        inputs *= (VELOCITY_DEVIATIONS + CHANGE_DEVIATION * np.abs(ahead[:, 3:] - mean[:, 3:]))[:, None]
        noise = np.diag(np.square(np.repeat(POSE_DEVIATIONS, (2, 1, 2))))
        kalman.covariance[:] = (
            transition @ kalman.covariance @ transition.transpose(0, 2, 1) + inputs @ inputs.transpose(0, 2, 1) + noise
        )
        turns = 2 * np.pi * np.round((ahead[:, 2] - states[:, 2]) / (2 * np.pi))
        kalman.update(states + np.outer(turns, YAW))
        return kalman.mean.copy()


MODEL = LinearModel(np.eye(5), np.zeros((5, 5)), np.eye(5), 0.05**2 * np.eye(5))
"""Model of the filter: all numbers are read, with noise that is identified. The rest is linearised in each step."""
