"""Compensation for a constant delay of actions that nobody has measured: identify it, and predict beyond it.

A bank of models, one for each candidate delay, predicts each reading from the previous one and the action that the
candidate believes to have acted in between (multiple-model identification: Magill, Optimal adaptive estimation of
sampled stochastic processes, IEEE TAC 10(4), 1965). The candidate with the smallest sum of errors wins. Then the law of
motion is rolled forward over the actions under way, and the controller acts from the state there, as in a Smith
predictor (Smith, Closer control of loops with dead time, Chem. Eng. Progress 53, 1957).

In each control step: `read` the states, `predict` those in which the next actions will act, and `send` these actions.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from armctl.core.arrays import Array, checked_array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.kernels import delay_bank as kernel

Law = Callable[[Array, Array], Array]
"""Law of motion: states (..., s) and actions (..., a) -> the states one control step later, (..., s)."""


@options
class DelayOptions:
    """Options of `DelayPredictor`."""

    max_delay: Annotated[int, Field(ge=0, le=100)] = 5
    """Control steps: the largest candidate."""
    nominal: Annotated[int, Field(ge=0, le=100)] = 0
    """Control steps: the delay before anything is identified."""
    threshold: Positive = 3.0
    """Evidence for another candidate at which the belief changes: a sum of errors, in units of their mean, plus 1."""
    memory: Positive = 100.0
    """Control steps after which evidence counts for 1 / e."""


class DelayPredictor:
    """Delays of n robots with the same law of motion, each identified on line.

    `idle` (a,) is the action that acts before the first one arrives. `scale` (s,) is the accuracy of the law for each
    number of a state: a deviation of a few times as much is evidence. It is infinite for numbers that do not count.

    Errors grow linearly beyond the scale, so a push counts little. Noise raises the mean error, and with it the
    evidence that a change needs.

    Raises `ConfigurationError`.
    """

    def __init__(
        self, law: Law, n: int, idle: ArrayLike, scale: ArrayLike, options: DelayOptions | None = None
    ) -> None:
        self.options = options or DelayOptions()
        if self.options.nominal > self.options.max_delay:
            raise ConfigurationError(
                f"nominal delay should be at most max_delay ({self.options.max_delay}), not {self.options.nominal}"
            )
        self._law, self._idle = law, checked_array("idle", idle, np.shape(idle))
        if not (np.asarray(scale, dtype=float) > 0).all():
            raise ConfigurationError(f"scale should be numbers above 0, not {scale!r}")
        self._precision = 1 / np.asarray(scale, dtype=float)
        candidates = self.options.max_delay + 1
        self.delay: NDArray[np.intp] = np.full(n, self.options.nominal, dtype=np.intp)
        """(n,) control steps: the delays now believed."""
        self.sent: Array = np.tile(self._idle, (candidates, n, 1))
        """Actions (candidates, n, a) that act now if the delay is that of the candidate."""
        self._previous = np.full((n, len(self._precision)), np.nan)
        self._errors, self._readings = np.zeros((candidates, n)), np.zeros(n)
        self._forget = float(np.exp(-1 / self.options.memory))

    def reset(self, ids: NDArray[np.integer]) -> None:
        """Forget the delays and actions of robots `ids`, which begin anew."""
        self.delay[ids] = self.options.nominal
        self.sent[:, ids] = self._idle
        self._previous[ids] = np.nan
        self._errors[:, ids] = self._readings[ids] = 0.0

    def read(self, states: Array) -> None:
        """Compare the states (n, s) with all candidates' predictions. States that are not finite tell nothing."""
        states = np.array(states, dtype=float)
        predictions = np.ascontiguousarray(self._law(self._previous, self.sent), dtype=float)
        kernel.weigh(
            predictions, states, self._precision, self._forget, self.options.threshold,
            self._errors, self._readings, self.delay,
        )  # fmt: skip
        self._previous = states

    def predict(self, states: Array, law: Law | None = None) -> Array:
        """Return the states (n, s) after all actions under way, from `states` (n, s): readings or estimates.

        `law` is the one of the believed candidates, if each has its own.
        """
        law, states = law or self._law, np.array(states, dtype=float)
        for steps in range(int(self.delay.max(initial=0)), 0, -1):
            waiting = (self.delay >= steps)[:, None]
            states = np.where(waiting, law(states, self.sent[steps - 1]), states)
        return states

    def send(self, actions: Array) -> None:
        """Remember the actions (n, a) that are sent now."""
        self.sent = np.concatenate((actions[None], self.sent[:-1]))

    def acting(self) -> Array:
        """Return the actions (n, a) believed to have acted between the last two readings."""
        return np.asarray(self.sent[self.delay, np.arange(len(self.delay))])
