"""Speeds and torques of the joints of n robots since the last control step, and their limits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.control_step import Samples
from armctl.simulation import Simulation


@dataclass(frozen=True)
class ActuatorLimits:
    """Limits of k joints or wheels, (k,) each."""

    speed: Array
    """rad/s."""
    torque: Array
    """N m."""
    position: tuple[Array, Array] | None = None
    """Lowest and highest, rad; None for wheels."""


class JointSamples:
    """Speeds and torques at `samples` evenly spaced instants per control period (s): the ticks of a control step.

    `dofs` are the joints' columns among the model's degrees of freedom.
    """

    def __init__(
        self,
        simulation: Simulation,
        dofs: slice | NDArray[np.intp],
        limits: ActuatorLimits,
        samples: int,
        period: float,
    ) -> None:
        self._velocities, self._dofs = simulation.array("qvel"), dofs
        self.limits = limits
        self.interval = period / samples
        """s: time between two samples"""
        self._samples = np.zeros((2, samples, simulation.n, len(limits.speed)))
        columns = np.arange(simulation.model.nv, dtype=np.intp)[dofs]
        self.part = Samples(columns, *self._samples)
        """What `Simulation.control_step` fills."""

    @property
    def speeds(self) -> Array:
        """Present joint speeds, (n, k) rad/s."""
        return self._velocities[:, self._dofs]

    def since_last_step(self) -> Array:
        """Return joint speeds (rad/s) and motor torques at the joints (N m), (2, samples, n, k)."""
        return self._samples.copy()
