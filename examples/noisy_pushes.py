"""Bad pushes: `push_line:memory=false`, with noise on its actions in half of the control steps.

    armctl collect examples/noisy_pushes.py:make --env armctl/ArmPush-v0 \
        --episodes 200 --policy-seed 0 --out data/noisy_pushes

Most of these episodes fail. docs/learned_agents.md has what `iql` and `bc`
learned from them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines import push_line
from armctl.envs import ModelInterface
from armctl.policies import made_for, sees

NOISE = 0.05
"""Standard deviation of the noise on each joint's command, rad."""
SHARE = 0.5
"""Share of the control steps with noise."""


class NoisyPushes:
    """Pushes in n worlds, each with noise of its own."""

    sees = "model"
    training_steps = 0

    def __init__(self, env: ModelInterface) -> None:
        self._expert = push_line.make(env, {"memory": False})
        self._rngs = [env.rng(i) for i in range(env.num_envs)]

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`; armctl has seeded their generators."""
        self._expert.reset(ids)

    def act(self, observations: Any) -> NDArray[np.float64]:
        """Return actions (n, k)."""
        actions = self._expert.act(observations)
        for action, rng in zip(actions, self._rngs, strict=True):
            if rng.random() < SHARE:
                action += rng.normal(0, NOISE, action.shape)
        return actions


@made_for("armctl/ArmPush-v0", controls="arms: position")
@sees("model", family="scripted")
def make(env: ModelInterface) -> NoisyPushes:
    """Return the policy."""
    return NoisyPushes(env)
