"""Behaviour cloning by imitation's `BC`, from a Minari dataset of 500 episodes of the IK expert.

Library: minari and imitation. imitation requires Gymnasium 0.29, but its `BC` works with the installed version:
`pip install --no-deps imitation==1.0.1`.
Autoreset: none; `--steps` are gradient steps.
Options: actions relative to the current joint positions; the observation is the task's default, which the expert
reads, followed by the features, from which networks learn more easily.

`minari.DataCollector(gymnasium.make(ID), record_infos=True)` records your own policy.

EXPECTED: 64.5% of 200 episodes after 10,000 steps, in 2 minutes of one core

`python examples/minari_imitation_bc.py`
"""

from pathlib import Path

import gymnasium
import minari
import numpy as np
from imitation.algorithms.bc import BC
from imitation.data.rollout import flatten_trajectories
from imitation.data.types import Trajectory
from stable_baselines3.common.policies import ActorCriticPolicy

from armctl.datasets.collect import collect
from armctl.tasks.reach.observation import FEATURES, OBSERVATION
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {"control": "relative", "observation": {**OBSERVATION, **FEATURES}}

given = arguments(__doc__, steps=10_000)
folder = Path(f"runs/reach_ik-{given.seed}-v0")
collect(
    "reach_ik",
    ID,
    episodes=500,
    worlds=50,
    seed=given.seed,
    env_options=OPTIONS,
    out=folder,
    overwrite=True,
)
env = gymnasium.make(ID, **OPTIONS)
low, high = env.action_space.low, env.action_space.high
episodes = [
    Trajectory(
        episode.observations,
        np.clip(episode.actions, low, high),
        infos=None,
        terminal=True,
    )
    for episode in minari.MinariDataset(folder / "data")
]
network = ActorCriticPolicy(
    env.observation_space, env.action_space, lambda _: 1e-3, net_arch=[256, 256]
)
learner = BC(
    policy=network,
    observation_space=env.observation_space,
    action_space=env.action_space,
    demonstrations=flatten_trajectories(episodes),
    rng=np.random.default_rng(given.seed),
    batch_size=256,
    device="cpu",
)
learner.train(n_batches=given.steps, log_interval=10**9, progress_bar=False)
report(learner.policy, ID, given.episodes, **OPTIONS)
