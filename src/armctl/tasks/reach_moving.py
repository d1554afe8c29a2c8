"""Reach a target that moves: come within the tolerance soon, and stay there.

The target goes along a smooth curve, a sum of slow sines about each axis, all of it within reach.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.drives import TICK
from armctl.errors import ConfigurationError
from armctl.tasks.reach import OBSERVATION, ReachOptions, ReachState, ReachTask, Worlds
from armctl.tasks.task import Outcome

Array = NDArray[np.float64]

WAVES = 2
"""Sines about each axis."""
RATES = (1.0, 3.5)
"""rad/s, the slowest and the quickest sine."""
PROBES = np.linspace(0.0, 15.0, 76)
"""s into the episode, when the curve is checked to be within reach."""
ATTEMPTS = 1000
"""Places for a curve, of which one is to be within reach."""

MOVING_OBSERVATION: Mapping[str, Any] = {
    **OBSERVATION,
    "target_velocity": lambda state: state.target_velocity,
}
"""The parts of an observation, in order."""

MOVING_REWARD: Mapping[str, Any] = {
    "away": lambda state: np.where(state.within, 0.0, -1.0),
    "goal": lambda state: 100.0 * state.held,
}
"""The terms of the reward, whose sum is the reward."""


@dataclass(frozen=True)
class MovingReachState(ReachState):
    """What terms may use besides."""

    within: NDArray[np.bool_]
    """(n,) whether the end-effector is within the tolerance now."""
    held: NDArray[np.bool_]
    """(n,) whether it has stayed there for the whole hold time."""


@dataclass(frozen=True)
class ReachMovingOptions(ReachOptions):
    """Options of `armctl/ArmReachMoving-v0`; raises `ConfigurationError` for values it cannot take."""

    hold_time: float = 4.0
    """s within the tolerance without a break, after which the episode is won."""
    amplitude: float = 0.12
    """m, of the largest sine about an axis."""
    reward: Mapping[str, Any] = field(default_factory=lambda: MOVING_REWARD)
    observation: Mapping[str, Any] = field(default_factory=lambda: MOVING_OBSERVATION)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, allowed in (("hold_time", self.hold_time > 0), ("amplitude", self.amplitude >= 0)):
            if not (allowed and np.isfinite(getattr(self, name))):
                raise ConfigurationError(f"{name} is a finite number from 0 on, not {getattr(self, name)!r}")
        if self.target != "reachable":
            raise ConfigurationError("a target that moves is drawn within reach: target is 'reachable'")


class ReachMovingTask(ReachTask):
    """n arms, each with a target that moves."""

    options: ReachMovingOptions

    def __init__(self, n: int, options: ReachMovingOptions, threads: int = 0) -> None:
        self._time = np.zeros(n)
        self._centres = np.zeros((n, 3))
        self._amplitudes, self._rates, self._phases = np.zeros((3, n, 3, WAVES))
        self._within_for = np.zeros(n)
        self._errors, self._decisions = np.zeros(n), np.zeros(n)
        super().__init__(n, options, threads)

    def advance(self, ids: NDArray[np.int32] | None) -> None:
        """Let time go on until the next decision, in worlds `ids` or in all."""
        super().advance(ids)
        self._errors += np.where(self._decisions > 0, self._distances(), 0.0)
        self._decisions += (self._decisions > 0) | (self._distances() <= self.options.tolerance)

    def outcome(self) -> NDArray[np.int8]:
        """`HELD`, or `TIMEOUT` as long as it is not."""
        return self.state.held * np.int8(Outcome.HELD)

    def details(self) -> dict[str, NDArray[Any]]:
        """`tracking_error` besides: mean distance (m) at all decisions since the first within the tolerance."""
        tracked = np.maximum(self._decisions - 1, 0)
        error = np.divide(self._errors, tracked, out=np.full(len(tracked), np.nan), where=tracked > 0)
        return super().details() | {"tracking_error": error}

    def least_time(self, world: int) -> float:
        """The hold time; how soon the target can be met is not known."""
        return self.options.hold_time

    def _draw(self, world: int, rng: np.random.Generator) -> None:
        self._time[world] = self._within_for[world] = self._errors[world] = self._decisions[world] = 0.0
        self._rates[world] = rng.uniform(*RATES, (3, WAVES))
        self._phases[world] = rng.uniform(-np.pi, np.pi, (3, WAVES))
        self._amplitudes[world] = self.options.amplitude * rng.uniform(0.5, 1.0, (3, WAVES)) / np.arange(1, WAVES + 1)
        self._centres[world] = self._centre_of_reach(world, rng)
        self._move_targets()

    def _centre_of_reach(self, world: int, rng: np.random.Generator) -> Array:
        for _ in range(ATTEMPTS):
            centre = self._workspace.sample(rng, clearance=self.options.tolerance)
            if self._within_reach(world, centre):
                return centre
        raise ConfigurationError(
            f"no curve of amplitude {self.options.amplitude} m is within reach of {self.arm.description.name}: "
            f"{ATTEMPTS} were tried"
        )

    def _within_reach(self, world: int, centre: Array) -> bool:
        angles = self._rates[world] * PROBES[:, None, None] + self._phases[world]
        points = centre + (self._amplitudes[world] * np.sin(angles)).sum(axis=-1)
        model, clearance = self._workspace.model, self.options.tolerance
        return all(
            point[2] >= clearance and model.base_distance(point) >= clearance and self._workspace.reachable(point)
            for point in points
        )

    def _tick(self, worlds: Worlds) -> None:
        self._time[worlds] += TICK
        self._move_targets()
        super()._tick(worlds)
        within = self._distances() <= self.options.tolerance
        self._within_for[worlds] = np.where(within, self._within_for + TICK, 0.0)[worlds]

    def _move_targets(self) -> None:
        angles = self._rates * self._time[:, None, None] + self._phases
        self._targets[:] = self._centres + (self._amplitudes * np.sin(angles)).sum(axis=-1)
        self._target_velocities[:] = (self._amplitudes * self._rates * np.cos(angles)).sum(axis=-1)

    def _look(self, action: Array) -> None:
        super()._look(action)
        within = self.state.distance <= self.options.tolerance
        held = self._within_for >= self.options.hold_time - TICK / 2
        self.state: MovingReachState = MovingReachState(**vars(self.state), within=within, held=held)
