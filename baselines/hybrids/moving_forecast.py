"""Two hybrids that reach a moving target where a trained network foresees it: an IK expert, and a learned agent.

Both act on the estimates of `armctl.baselines.hybrids.target_forecast`. The agent, which was trained without delay,
noise and loads, observes the arm and the target as they will be when its command acts, and its command is corrected for
the load: a learned agent behind a Smith predictor.
"""

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from armctl.agents import OnnxPolicy
from armctl.agents.costs import total_cost
from armctl.baselines.hybrids.target_forecast import ForecastingObserver, TargetForecast
from armctl.baselines.reach_ik import PreparedReachIkTracking, ReachIkOptions
from armctl.baselines.reach_task import checked_options
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface, Sees
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.policies import PerWorld, made_for, make_policy, sees
from armctl.tasks import ReachMovingOptions
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.moving import MOVING_OBSERVATION

ENV = "armctl/ArmReachMoving-v0"
Seed = Literal[0, 1, 2]


@options
class ForecastOptions:
    """Options of `moving_forecast`."""

    forecast: Seed = 0
    """Training seed of the network that foresees the target."""


@options
class EstimatedOptions(ForecastOptions):
    """Options of `moving_estimated`."""

    agent: str = "moving_dagger"
    """Name of the agent, or path of its card."""


@made_for("armctl/ArmReachMoving-v0", controls="arms: position")
@sees("model", family="forecast", kind="hybrid")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> "ForecastPolicy":
    """`reach_ik`, which meets the target where a trained network foresees it."""
    choice = changed_options(ForecastOptions(), options, "option of moving_forecast")
    return ForecastPolicy(env, TargetForecast(choice.forecast))


@made_for("armctl/ArmReachMoving-v0", controls="ur5: position")
@sees("model", family="forecast", kind="hybrid")
def make_estimated(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> "EstimatedPolicy":
    """`moving_dagger` on estimates: of the arm as it will be, and of the target as a trained network foresees it."""
    choice = changed_options(EstimatedOptions(), options, "option of moving_estimated")
    agent = make_policy(choice.agent, env)
    assert isinstance(agent, OnnxPolicy)
    return EstimatedPolicy(agent, env, TargetForecast(choice.forecast))


def beliefs_of(env: ModelInterface, forecast: TargetForecast) -> list[ForecastingObserver]:
    """Return an observer for each arm. Raises `ConfigurationError` for another task."""
    checked_options("the forecast", env, ReachMovingOptions, ENV, MOVING_OBSERVATION, ["position"])
    clocks = (functools.partial(env.control_step, i) for i in range(env.num_envs))
    return [ForecastingObserver(forecast, ArmModel(env.robot), CONTROL_PERIOD, clock) for clock in clocks]


class ForecastPolicy(PerWorld):
    """IK experts that track the targets by forecasts."""

    def __init__(self, env: ModelInterface, forecast: TargetForecast) -> None:
        beliefs, tolerance = beliefs_of(env, forecast), env.options.tolerance
        setting = MinimumTimeReach(ArmModel(env.robot)), tolerance, ReachIkOptions().margin * tolerance
        super().__init__([PreparedReachIkTracking(*setting, belief) for belief in beliefs])
        self.training_steps, self.training_cost = forecast.cost.steps, forecast.cost


class EstimatedPolicy:
    """n agents, each of which acts in its own world by estimates instead of observations."""

    sees: Sees = "model"

    def __init__(self, agent: OnnxPolicy, env: ModelInterface, forecast: TargetForecast) -> None:
        self._agent, self._model, self._beliefs = agent, ArmModel(env.robot), beliefs_of(env, forecast)
        self.training_cost = total_cost([agent.training_cost.total, forecast.cost])
        self.card, self.training_steps = agent.card, self.training_cost.steps

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._agent.reset(ids)
        for i in ids:
            self._beliefs[i].reset()

    def act(self, observations: Any) -> Array:
        """Return joint positions (n, dof), rad, to move to, for observations (n, k)."""
        dof = self._model.dof
        for belief, row in zip(self._beliefs, observations, strict=True):
            belief.read(*np.split(row.astype(float), (3, 3 + dof, 6 + dof)))
        estimates = np.array([self._estimates(belief) for belief in self._beliefs], dtype=np.float32)
        commands = np.asarray(self._agent.act(estimates), dtype=float)
        commands -= [belief.load_offset for belief in self._beliefs]
        for belief, command in zip(self._beliefs, commands, strict=True):
            belief.send(command)
        return commands

    def _estimates(self, belief: ForecastingObserver) -> Array:
        """Return the observation of the moment from which the next command acts."""
        joints = belief.joints_ahead
        tip = self._model.position(joints) + belief.tip_offset(joints)
        return np.concatenate((tip, joints, belief.target_ahead(0.0), belief.target_velocity_ahead()))
