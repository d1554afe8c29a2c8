"""Kalman filters: the best linear estimates of states from noisy readings, many at once.

    x_k+1 = F x_k + B u_k + w,  w ~ N(0, Q)        z_k = H x_k + v,  v ~ N(0, s R)

Kalman, "A new approach to linear filtering and prediction problems", J. Basic Engineering 82, 1960. Readings whose
innovation is too large for chance (chi-square of its Mahalanobis distance) are left out as outliers; missing readings
are NaN. The scale s of the noise is identified from the innovations (Mehra, "On the identification of variances and
adaptive Kalman filtering", IEEE Trans. Automatic Control 15, 1970), or is 1.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.special import gammaincinv

from armctl.core.arrays import Array, checked_array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.kernels import kalman


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A linear system of k states, m inputs and l readings, with white Gaussian noise.

    Raises `ConfigurationError` for matrices whose shapes do not fit together.
    """

    transition: Array
    """F (k, k)."""
    process_noise: Array
    """Q (k, k), covariance for each period."""
    observation: Array
    """H (l, k)."""
    reading_noise: Array
    """R (l, l), covariance."""
    control: Array | None = None
    """B (k, m). None: k inputs that are added to the state."""

    def __post_init__(self) -> None:
        states, readings = np.shape(self.transition)[0], np.shape(self.observation)[0]
        shapes = {
            "transition": (states, states), "process_noise": (states, states),
            "observation": (readings, states), "reading_noise": (readings, readings),
        }  # fmt: skip
        for name, shape in shapes.items():
            object.__setattr__(self, name, checked_array(name, getattr(self, name), shape))
        if (np.diag(self.reading_noise) <= 0).any():
            raise ConfigurationError(f"reading_noise needs a positive diagonal, not {self.reading_noise!r}")
        if self.control is not None:
            shape = states, *np.shape(self.control)[1:]
            object.__setattr__(self, "control", checked_array("control", self.control, shape))


def constant_velocity(axes: int, period: float, acceleration: float, noise: float) -> LinearModel:
    """Return the model of positions that are read, and velocities that white accelerations change.

    The states are all positions, then all velocities. `acceleration` is the standard deviation in a period, `noise`
    that of a reading.
    """
    return _integrators(axes, 2, period, acceleration, noise)


def constant_acceleration(axes: int, period: float, jerk: float, noise: float) -> LinearModel:
    """Return the model of positions that are read, velocities, and accelerations that white jerks change."""
    return _integrators(axes, 3, period, jerk, noise)


def _integrators(axes: int, order: int, period: float, change: float, noise: float) -> LinearModel:
    """Return the model of chains of integrators, whose last derivative is constant within a period."""
    powers = np.arange(order)[None, :] - np.arange(order)[:, None]
    factorials = np.cumprod([1.0, *range(1, order + 1)])
    transition = np.triu(period ** np.abs(powers) / factorials[np.abs(powers)])
    gain = period ** np.arange(order, 0, -1) / factorials[order:0:-1]
    eye = np.eye(axes)
    process_noise = np.asarray(change**2 * np.kron(np.outer(gain, gain), eye), dtype=float)
    return LinearModel(np.kron(transition, eye), process_noise, np.eye(axes, axes * order), noise**2 * eye)


@options
class EstimationOptions:
    """Options of `KalmanFilter`."""

    initial_deviation: Positive = 1e3
    """Standard deviation of states of which nothing is known yet."""
    gate: Annotated[float, Field(gt=0.5, le=1)] = 0.9999
    """Probability of innovations that are no outliers. 1: all."""
    max_rejections: Annotated[int, Field(ge=0)] = 4
    """Outliers in succession after which the filter starts again, from the next reading."""
    noise_memory: Annotated[float, Field(ge=0)] = 0.0
    """Readings over which the scale of the noise is identified. 0: it is 1."""
    common_scale: bool = False
    """Take the scale for that of Q and of the initial covariance too. Gains are then as without it, and constants are
    estimated by least squares, however large the noise is."""
    prior_readings: Positive = 0.1
    """Weight of the model's own noise at the beginning, in readings. Larger: more belief in it."""
    min_scale: Positive = 1e-8
    """Least scale of the noise's variance that is identified."""


class KalmanFilter:
    """Filters of n states of one model: `predict` once for each period, then `update` with what was read."""

    def __init__(self, model: LinearModel, count: int = 1, options: EstimationOptions | None = None) -> None:
        self.model, self.count = model, count
        self.options = options = options or EstimationOptions()
        readings, states = model.observation.shape
        self._initial = options.initial_deviation**2 * np.eye(states)
        gates = [0.0, *(2 * gammaincinv(np.arange(1, readings + 1) / 2, options.gate))]
        memory = options.noise_memory
        forgetting = 1 - 1 / max(memory, 1.0)
        self._tuning = kalman.Tuning(
            np.array(gates), options.max_rejections, forgetting, memory > 0, options.common_scale, options.min_scale
        )
        self._beliefs = kalman.Beliefs(
            np.zeros((count, states)), np.empty((count, states, states)),
            np.empty((count, 2)), np.zeros(count, dtype=np.int64),
        )  # fmt: skip
        self._shifts, self._accepted = np.zeros((count, states)), np.empty(count, dtype=bool)
        self.reset()

    @property
    def mean(self) -> Array:
        """Estimates (n, k), a live view."""
        return self._beliefs.means

    @property
    def covariance(self) -> Array:
        """Covariances (n, k, k) of the estimates' errors, a live view."""
        return self._beliefs.covariances

    @property
    def noise_scale(self) -> Array:
        """Variance (n,) of the readings' noise, in units of the model's."""
        sums = self._beliefs.noise_sums
        scale = np.maximum(sums[:, 0] / sums[:, 1], self._tuning.min_noise)
        return scale if self._tuning.identifies else np.ones(self.count)

    @property
    def measured_noise_scale(self) -> Array:
        """The same (n,) from readings alone, without `EstimationOptions.prior_readings`; 0 without readings."""
        sums, prior = self._beliefs.noise_sums, self.options.prior_readings
        readings = np.maximum(sums[:, 1] - prior, 1e-9)
        return np.asarray(np.maximum(sums[:, 0] - prior, 0.0) / readings)

    def reset(
        self, mean: ArrayLike = 0.0, covariance: ArrayLike | None = None, ids: NDArray[np.integer] | slice = slice(None)
    ) -> None:
        """Begin again in filters `ids` with a mean (k,) and a covariance (k, k); without one, of an unknown state."""
        self.mean[ids] = mean
        self.covariance[ids] = self._initial if covariance is None else covariance
        self._beliefs.noise_sums[ids] = self.options.prior_readings
        self._beliefs.rejections[ids] = 0

    def predict(self, u: ArrayLike | None = None) -> Array:
        """Move on by a period, with control inputs `u` (n, m); return the means. Raises `ConfigurationError`."""
        self._shifts[:] = 0.0
        if u is not None:
            control = self.model.control
            size = self.mean.shape[1] if control is None else control.shape[1]
            inputs = checked_array("u", u, (self.count, size))
            self._shifts[:] = inputs if control is None else inputs @ control.T
        kalman.predict(self.model.transition, self.model.process_noise, self._shifts, self.mean, self.covariance)
        return self.mean

    def update(self, z: ArrayLike, observation: Array | None = None) -> NDArray[np.bool_]:
        """Correct the estimates by readings (n, l), NaN where missing; `observation` (l, k) is H of this period.

        Return (n,) which filters had readings that were no outliers.
        """
        readings = np.ascontiguousarray(z, dtype=float)
        shape = self.count, len(self.model.observation)
        if readings.shape != shape:
            raise ConfigurationError(f"z should be an array {shape}, not of shape {readings.shape}")
        observation = self.model.observation if observation is None else np.ascontiguousarray(observation)
        noise, accepted = self.model.reading_noise, self._accepted
        kalman.update(observation, noise, readings, self._initial, self._tuning, self._beliefs, accepted)
        return accepted.copy()
