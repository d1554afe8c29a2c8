"""The sampling expert: model predictive path integral control (MPPI) of the arm's drives.

At each control step it draws goals of the drives around the last plan, rolls all candidates out by the drives' law and
the distances of the arm's links, and commands the first goal of their weighted mean (`armctl.control.sampling`). While
no plan arrives, configurations at the target are candidates too, and among boxes it looks up a way of one or two
straight motions, along which the rest of the time is measured. It does not observe the drives, and takes them to be
where its own commands have brought them.
"""

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options
from armctl.control.sampling import NO_GUESSES, SamplingMpc, SamplingOptions
from armctl.control.sampling_rollouts import PASSING, ArmRollouts, ArmState, ReachCosts
from armctl.control.streaming import follow
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, ArmShapes, ReachabilityMap
from armctl.policies import PerWorld, made_for, sees
from armctl.scene import NO_BOXES
from armctl.tasks import OBSERVATION, ReachMovingOptions, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD, read_boxes

MARGIN = 0.9
"""Share of the tolerance to aim at, as a reserve for servo errors."""
GOALS = 16
"""Configurations at the target, from a table, that are candidates too while the plan does not arrive: sampling around
the last plan alone stays where it is if the arm is folded the wrong way."""
LOST = 0.1
"""rad: beyond, the joints do not follow this expert's commands."""


@options
class ReachMppiOptions:
    """Options of `reach_mppi`."""

    sampling: SamplingOptions = field(
        default_factory=lambda: SamplingOptions(
            samples=64, horizon=20, knots=3, noise=1.0, finest=0.03, temperature=0.02
        )
    )
    """Sampling; noise is in rad."""
    costs: ReachCosts = field(default_factory=ReachCosts)


STATIC = ReachMppiOptions()
MOVING = ReachMppiOptions(
    sampling=SamplingOptions(samples=32, horizon=8, knots=3, noise=0.1, finest=0.03, temperature=0.2, iterations=4),
    costs=ReachCosts(distance=20.0),
)
"""Less far ahead, since a moving target is predicted by its velocity and acceleration only, and more finely,
with less noise in more iterations."""


@made_for("armctl/ArmReach*", controls="arms: position")
@sees("model", family="sampling")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """MPPI: samples goals of the drives, rolled out by their law and the links' distances."""
    task = checked_options("reach_mppi", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, ["position"])
    usual = MOVING if isinstance(task, ReachMovingOptions) else STATIC
    configurations, chosen = (
        ReachabilityMap(ArmModel(env.robot)),
        changed_options(usual, options, "option of reach_mppi"),
    )
    return PerWorld([ReachMppi(configurations, task, chosen, env.rng(i)) for i in range(env.num_envs)])


class ReachMppi:
    """Reaches with one arm."""

    def __init__(
        self, reachability_map: ReachabilityMap, task: ReachOptions, options: ReachMppiOptions, rng: np.random.Generator
    ) -> None:
        self._map, self._model, self._rng = reachability_map, reachability_map.model, rng
        self._moving, self._boxed = isinstance(task, ReachMovingOptions), "boxes" in task.parts
        self._rollouts = ArmRollouts(
            ArmShapes(self._model), options.costs, MARGIN * task.tolerance, self._moving, CONTROL_PERIOD
        )
        limits = self._model.limits
        self._mpc = SamplingMpc(self._rollouts, limits.lower, limits.upper, options.sampling)
        self._ahead = CONTROL_PERIOD * np.arange(1, options.sampling.horizon + 1)[:, None]
        self.reset()

    @property
    def failures(self) -> int:
        """Plans for which no candidate had a finite cost."""
        return self._mpc.failures

    def reset(self) -> None:
        """Forget the plan, and the own commands."""
        self._drives: tuple[Array, Array] | None = None
        self._target_velocity: Array | None = None
        self._cost, self._boxes, self._way = np.inf, NO_BOXES, np.zeros((0, self._model.dof))

    def plans(self) -> dict[str, Array]:
        """Return the planned goals as end-effector positions, (horizon, 3) m."""
        return {} if self._drives is None else {"horizon": self._model.positions(self._mpc.actions)}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation (6 + dof + k,)."""
        dof = self._model.dof
        _, q, target, extra = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if self._drives is None:
            self._mpc.reset(q)
            self._boxes = read_boxes(extra) if self._boxed else NO_BOXES
            self._rollouts.surround(self._boxes)
        position, velocity = self._driven(q)
        guesses = self._guesses(position, target) if self._cost >= len(self._ahead) else NO_GUESSES
        targets = self._predicted(target, extra[:3] if self._moving else np.zeros(3))
        plan = self._mpc.plan(ArmState(position, velocity, targets, self._way), self._rng, guesses)
        command = np.asarray(plan.actions[0])
        self._drives, self._cost = follow(self._model.limits, position, velocity, command, CONTROL_PERIOD), plan.cost
        return command

    def _predicted(self, target: Array, velocity: Array) -> Array:
        """Return target positions (horizon, 3), with the acceleration since the last control step."""
        last, self._target_velocity = self._target_velocity, velocity
        acceleration = np.zeros(3) if last is None else (velocity - last) / CONTROL_PERIOD
        return target + self._ahead * velocity + self._ahead**2 / 2 * acceleration

    def _driven(self, q: Array) -> tuple[Array, Array]:
        """Return position and velocity (dof,) of the drives: those that follow own commands, unless `q` is far off."""
        if self._drives is None or np.abs(self._drives[0] - q).max() > LOST:
            return q, np.zeros_like(q)
        return self._drives

    def _guesses(self, position: Array, target: Array) -> Array:
        """Return goals (k, 1 or horizon, dof) to try while the plan does not arrive.

        Among boxes, if the first plan does not, it is a way of straight motions, which is kept.
        """
        if self._boxed and np.isfinite(self._cost) and not len(self._way):
            self._way = self._map.way(target, position, self._boxes)
        if not len(self._way):
            return self._map.goals(target, position, GOALS)[:, None]
        if len(self._way) > 1 and np.abs(position - self._way[0]).max() < PASSING:
            self._way = self._way[1:]
        times = np.cumsum(self._model.cruise_time(np.vstack((position, self._way[:-1])), self._way))
        return np.asarray(self._way[np.minimum(np.searchsorted(times, self._ahead[:, 0]), len(self._way) - 1)][None])
