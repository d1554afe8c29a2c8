"""PPO, SAC or CrossQ of SBX, which is Stable-Baselines3 in JAX, on 16 worlds of the reach task.

Library: sbx-rl, through `armctl.integrations.sb3.VecEnv`: SBX takes the same environments as Stable-Baselines3.
Autoreset: `same_step`, as Stable-Baselines3 expects.
Options: normalized actions, relative to the current joint positions; features; rewards scaled to the order of one.
`Shaped` adds the minimum time to the target, by the joints' speed limits, as a potential.

EXPECTED: 78.5% of 200 episodes after 150,000 steps, in 2 minutes of one core

`python examples/sbx_ppo.py`, or `python examples/sbx_ppo.py --algorithm SAC --steps 50000`
"""

import os

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false"
)  # before JAX: small networks, one thread

import gymnasium
import sbx

from armctl.integrations.sb3 import VecEnv
from armctl.shaping import Shaped
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {
    "actions": "normalized",
    "control": "relative",
    "observation": "features",
}
GAMMA = 0.99
OFF_POLICY = {"gradient_steps": 8, "learning_starts": 1_000}
SETTINGS = {
    "PPO": {"n_steps": 128, "batch_size": 256},
    "SAC": OFF_POLICY,
    "CrossQ": OFF_POLICY,
}

given = arguments(__doc__, steps=150_000, algorithm=list(SETTINGS))
worlds = gymnasium.make_vec(
    ID, num_envs=16, autoreset_mode="same_step", reward_scale=0.02, **OPTIONS
)
shaped = Shaped(
    worlds, "ik", gamma=GAMMA, scale=150
)  # per second nearer to the target
learner, settings = getattr(sbx, given.algorithm), SETTINGS[given.algorithm]
model = learner(
    "MlpPolicy", VecEnv(shaped), gamma=GAMMA, seed=given.seed, **settings
)
model.learn(given.steps)
report(model, ID, given.episodes, **OPTIONS)
