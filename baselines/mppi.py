"""The sampling expert in environments of others: MPPI on copies of the environment itself.

At each control step it draws actions around the last plan, plays all candidates in a copy of the environment, and
executes the first action of their weighted mean (`armctl.control.sampling`). What a candidate costs is minus the
environment's own rewards. It needs the true state to copy, and simulates: both are privileges.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.control.sampling import SamplingMpc, SamplingOptions
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import changed_options
from armctl.envs import Sees, ThirdPartyVectorEnv
from armctl.envs.imagined import Imagined
from armctl.policies import made_for, sees

OPTIONS = SamplingOptions(samples=16, horizon=12, knots=4, noise=0.5, finest=0.1, temperature=0.02)
"""Noise is in units of half the range of actions."""


@made_for("*-v5", controls="continuous actions")
@sees("state", family="sampling", foresight="simulator")
def make(env: ThirdPartyVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> "Mppi":
    """MPPI: samples actions, and plays them in copies of the environment; for Gymnasium's MuJoCo environments."""
    return Mppi(env, changed_options(OPTIONS, options, "option of mppi"))


class Mppi:
    """Plans in n environments. Its random numbers are the same in each episode.

    Raises `ConfigurationError` for armctl's own tasks, which have no copies, and for actions that are no bounded box.
    """

    sees: Sees = "state"
    training_steps = 0

    def __init__(self, env: ThirdPartyVectorEnv, options: SamplingOptions) -> None:
        if not isinstance(env, ThirdPartyVectorEnv):
            raise ConfigurationError(
                "mppi plans in environments of others, such as Reacher-v5; armctl's have reach_mppi and bridge_mppi"
            )
        space = env.single_action_space
        if not (isinstance(space, spaces.Box) and space.is_bounded() and len(space.shape) == 1):
            raise ConfigurationError(f"mppi needs actions (k,) between bounds, not {space}")
        unit = (space.high - space.low) / 2
        self._env, self._idle = env, env.idle_action
        self._mpcs = [SamplingMpc(_costs, space.low, space.high, options, unit) for _ in range(env.num_envs)]
        self._rngs = [np.random.default_rng(0) for _ in self._mpcs]

    @property
    def failures(self) -> NDArray[np.int64]:
        """Count (n,) of plans for which no candidate had a finite cost."""
        return np.array([mpc.failures for mpc in self._mpcs], dtype=np.int64)

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget the plans of worlds `ids`."""
        for i in ids:
            self._mpcs[i].reset(self._idle)
            self._rngs[i] = np.random.default_rng(0)

    def act(self, observations: Any) -> Array:
        """Return actions (n, k)."""
        worlds = enumerate(zip(self._mpcs, self._rngs, strict=True))
        return np.array([mpc.plan(self._env.imagined(i), rng).actions[0] for i, (mpc, rng) in worlds])


def _costs(imagined: Imagined, actions: Array) -> Array:
    return -imagined.returns(actions)
