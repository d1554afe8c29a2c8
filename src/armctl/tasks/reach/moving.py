"""Reach a moving target: come within the tolerance quickly, and stay there.

The target moves along a smooth curve within reach of the arm: a sum of slow sines in each axis.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import NonNegative, Positive, options
from armctl.robot_description.joint_profiles import TICK
from armctl.tasks.reach.observation import FEATURES, HIDDEN, OBSERVATION, Bounds, rotated
from armctl.tasks.reach.options import ReachOptions, Terms
from armctl.tasks.reach.potentials import MinimumTimeToMovingTarget
from armctl.tasks.reach.reach import CONTROL_PERIOD, TICKS, ReachOutcome, ReachTask
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD, ReachState, Term
from armctl.tasks.task import EachStep, Ids, OneTimeTerm, Potential

WAVES = 2
"""Sines in each axis."""
RATES = (1.0, 3.5)
"""rad/s, range of the sines' angular frequencies."""
PROBES = np.linspace(0.0, 15.0, 76)
"""s: times in the episode at which the curve is checked to be within reach."""
ATTEMPTS = 1000
"""Positions of a curve that are tried, at most."""

TARGET_VELOCITY: Term = lambda state: state.target_velocity  # noqa: E731
VELOCITY_AHEAD: Term = lambda state: rotated(state.target_velocity, -state.base_yaw)  # noqa: E731
HELD_FOR: Term = lambda state: state.held_for[:, None]  # noqa: E731

MOVING_OBSERVATION: Mapping[str, Term] = {**OBSERVATION, "target_velocity": TARGET_VELOCITY}
MOVING_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": MOVING_OBSERVATION,
    "features": {**FEATURES, "velocity_ahead": VELOCITY_AHEAD},
    "full": {**MOVING_OBSERVATION, **HIDDEN, "held_for": HELD_FOR},
}
"""The parts of each named observation, in order."""

MOVING_REWARD: Mapping[str, Term] = {
    "away": EachStep(lambda state: np.where(state.within, 0.0, STEP_REWARD), (STEP_REWARD, 0.0)),
    "goal": OneTimeTerm(lambda state: GOAL_REWARD * state.held, (0.0, GOAL_REWARD)),
}
"""The terms of the reward, whose sum is the reward."""


@dataclass(frozen=True, eq=False)
class TargetTrajectory:
    """A target's curve: a sum of sines in each axis."""

    centre: Array
    """(3,) m"""
    amplitudes: Array
    """(3, WAVES) m"""
    rates: Array
    """(3, WAVES) rad/s"""
    phases: Array
    """(3, WAVES) rad"""

    def positions(self, times: ArrayLike) -> Array:
        """Return positions (..., 3) m at times (...) s since the episode's start."""
        angles = self.rates * np.asarray(times, dtype=float)[..., None, None] + self.phases
        return np.asarray(self.centre + (self.amplitudes * np.sin(angles)).sum(axis=-1))


@dataclass(frozen=True)
class MovingReachState(ReachState):
    """The state, and how well the target is tracked."""

    within: NDArray[np.bool_]
    """(n,) whether the end-effector is within the tolerance now."""
    held_for: Array
    """(n,) s since when it has been there."""
    held: NDArray[np.bool_]
    """(n,) whether it has stayed there for the whole hold time."""


@options
class ReachMovingOptions(ReachOptions):
    """Options of `armctl/ArmReachMoving-v0`. Raises `ConfigurationError` for invalid values."""

    hold_time: Positive = 4.0
    """s: the episode is a success after so long within the tolerance, without interruption."""
    amplitude: NonNegative = 0.12
    """m, largest amplitude of a sine."""
    target: Literal["reachable"] = "reachable"
    """A moving target is always sampled within reach."""
    reward: Terms = field(default_factory=lambda: MOVING_REWARD)

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = MOVING_OBSERVATIONS
    has_goals: ClassVar[bool] = False


class ReachMovingTask(ReachTask):
    """n arms, each with a moving target."""

    options: ReachMovingOptions
    options_type: ClassVar[type[Any]] = ReachMovingOptions
    possible_outcomes = (ReachOutcome.HELD, ReachOutcome.TIMEOUT)
    units: ClassVar[Mapping[str, str]] = {**ReachTask.units, "target_velocity": "m/s"}
    default_policies = ("reach_mpc", "reach_ik", "moving_forecast", "moving_dagger", "moving_ppo", "random")
    instruction = "Move the end-effector to the moving target."
    stops_at_target = False
    foresight = ("target",)
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        **ReachTask.potentials,
        "ik": MinimumTimeToMovingTarget,
    }

    def __init__(self, n: int, options: ReachMovingOptions, threads: int = 0) -> None:
        self._time = np.zeros(n)
        self._centres = np.zeros((n, 3))
        self._amplitudes, self._rates, self._phases = np.zeros((3, n, 3, WAVES))
        self._within_for = np.zeros(n)
        self._errors, self._steps = np.zeros(n), np.zeros(n)
        super().__init__(n, options, threads)
        self._target_query = self._target_query._replace(targets=np.zeros((TICKS, n, 3)))

    def preview(self, name: str, world: int) -> TargetTrajectory:
        """Return a copy of the curve of a world's target."""
        curve = (self._centres, self._amplitudes, self._rates, self._phases)
        return TargetTrajectory(*(values[world].copy() for values in curve))

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        super().advance(ids)
        worlds = slice(None) if ids is None else ids
        for distances in self._target_query.distances:
            within_for = np.where(distances <= self.options.tolerance, self._within_for + TICK, 0.0)
            self._within_for[worlds] = within_for[worlds]
        self._errors += np.where(self._steps > 0, self._distances(), 0.0)
        self._steps += (self._steps > 0) | (self._distances() <= self.options.tolerance)

    def outcome(self) -> NDArray[np.int8]:
        """Return `HELD`; `TIMEOUT` while the episode goes on."""
        return self.state.held * np.int8(ReachOutcome.HELD)

    def info(self) -> dict[str, NDArray[Any]]:
        """Return also `tracking_error`: mean distance (m) over all control steps since the target was first reached.

        `tracking` says whether there are such steps. Before them, the error is the present distance.
        """
        tracked = np.maximum(self._steps - 1, 0)
        error = np.divide(self._errors, tracked, out=self._distances(), where=tracked > 0)
        return super().info() | {"tracking": tracked > 0, "tracking_error": error}

    def min_time(self, world: int) -> float:
        """Return the hold time. The earliest time at which the moving target can be reached is unknown."""
        return self.options.hold_time

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        self._time[world] = self._within_for[world] = self._errors[world] = self._steps[world] = 0.0
        self._rates[world] = rng.uniform(*RATES, (3, WAVES))
        self._phases[world] = rng.uniform(-np.pi, np.pi, (3, WAVES))
        self._amplitudes[world] = self.options.amplitude * rng.uniform(0.5, 1.0, (3, WAVES)) / np.arange(1, WAVES + 1)
        self._centres[world] = self._centre_of_reach(world, rng)
        self._move_targets(self._time[None])

    def _centre_of_reach(self, world: int, rng: np.random.Generator) -> Array:
        for _ in range(ATTEMPTS):
            centre = self._workspace.sample(rng, clearance=self.options.tolerance)
            if self._within_reach(world, centre):
                return centre
        raise ConfigurationError(
            f"none of {ATTEMPTS} curves of amplitude {self.options.amplitude} m is within reach of "
            f"{self.arm.description.name}"
        )

    def _within_reach(self, world: int, centre: Array) -> bool:
        curve = TargetTrajectory(centre, self._amplitudes[world], self._rates[world], self._phases[world])
        points, model, clearance = curve.positions(PROBES), self._workspace.model, self.options.tolerance
        return all(
            point[2] >= clearance and model.base_distance(point) >= clearance and self._workspace.reachable(point)
            for point in points
        )

    def _place_targets(self, ids: Ids | None) -> None:
        times = np.empty((TICKS, self.n))
        for moment in times:
            self._time[slice(None) if ids is None else ids] += TICK
            np.copyto(moment, self._time)
        np.copyto(self._target_query.targets, self._move_targets(times))

    def _move_targets(self, times: Array) -> Array:
        """Return where targets are at `times` (k, n) s, (k, n, 3) m. They move to the last of these places."""
        angles = self._rates * times[..., None, None] + self._phases
        positions: Array = self._centres + (self._amplitudes * np.sin(angles)).sum(axis=-1)
        self._targets[:] = positions[-1]
        self._target_velocities[:] = (self._amplitudes * self._rates * np.cos(angles[-1])).sum(axis=-1)
        return positions

    def _update_state(self, action: Array) -> None:
        super()._update_state(action)
        within = self.state.distance <= self.options.tolerance
        held_for = self._within_for.copy()
        held = held_for >= self.options.hold_time - TICK / 2
        self.state: MovingReachState = MovingReachState(**vars(self.state), within=within, held_for=held_for, held=held)

    def _part_bounds(self) -> dict[Term, Bounds]:
        fastest = self.options.amplitude * RATES[1] * (1 / np.arange(1, WAVES + 1)).sum()
        return super()._part_bounds() | {
            TARGET_VELOCITY: (-fastest, fastest),
            VELOCITY_AHEAD: (-2 * fastest, 2 * fastest),
            HELD_FOR: (0.0, self.options.hold_time + CONTROL_PERIOD),
        }
