"""CleanRL's own `ppo_continuous_action.py`, unmodified, on the reach task.

Library: cleanrl, `pip install --no-deps --ignore-requires-python cleanrl==1.2.0`. The file was written for Gymnasium
0.28, so this script restores the former interfaces while it runs; all hyperparameters are CleanRL's defaults.
Autoreset: `same_step`, as everywhere in Gymnasium 0.28; with today's default, CleanRL would learn from the steps that
only reset.
Options: normalized actions, relative to the current joint positions; features. `ShapedEnv` adds the minimum time to the
target as a potential. CleanRL takes an id without options, so this script registers the environment with its options
under a new id.

EXPECTED: 52.5% of 200 episodes after 40,960 steps (`--steps 40960`), in 1 minute of one core

`python examples/cleanrl_unmodified.py`
"""

import functools
import runpy
import sys
from importlib.util import find_spec

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TransformObservation

from armctl.shaping import ShapedEnv
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {
    "actions": "normalized",
    "control": "relative",
    "observation": "features",
}
GAMMA = 0.99  # CleanRL's default


class FormerVectorEnv(SyncVectorEnv):
    """Gymnasium 0.28's: it resets in the same step, and `final_info` has an entry for each world."""

    def __init__(self, makers):
        super().__init__(makers, autoreset_mode=AutoresetMode.SAME_STEP)

    def step(self, actions):
        """Step all worlds."""
        *step, infos = super().step(actions)
        if "final_info" in infos:
            ended, episode = (
                infos["_final_info"],
                infos["final_info"]["episode"],
            )
            former = [
                {name: episode[name][i] for name in ("r", "l")}
                for i in range(self.num_envs)
            ]
            infos["final_info"] = [
                {"episode": former[i]} if ended[i] else None
                for i in range(self.num_envs)
            ]
        return *step, infos


def make(**options):
    """The environment, with its options and shaping."""
    return ShapedEnv(
        gymnasium.make(ID, **OPTIONS, **options), "ik", gamma=GAMMA, scale=150
    )


given = arguments(__doc__, steps=150_000)
gymnasium.register("ReachOfCleanRL-v0", entry_point=make)
gymnasium.vector.SyncVectorEnv = FormerVectorEnv
gymnasium.wrappers.TransformObservation = functools.partial(
    TransformObservation, observation_space=None
)
sys.argv = [
    "ppo_continuous_action.py",
    "--env-id=ReachOfCleanRL-v0",
    "--cuda=False",
]
sys.argv += [f"--total-timesteps={given.steps}", f"--seed={given.seed}"]
trained = runpy.run_path(
    find_spec("cleanrl.ppo_continuous_action").origin, run_name="__main__"
)
seen = trained["envs"].envs[0].get_wrapper_attr("obs_rms")


def policy(observation):
    """The mean action, for the observation as CleanRL normalises and clips it."""
    normalised = np.clip(
        (observation - seen.mean) / np.sqrt(seen.var + 1e-8), -10, 10
    )
    with torch.no_grad():
        return (
            trained["agent"]
            .actor_mean(torch.as_tensor(normalised, dtype=torch.float32))
            .numpy()
            .clip(-1, 1)
        )


report(policy, ID, given.episodes, **OPTIONS)
