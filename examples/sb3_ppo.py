"""PPO of Stable-Baselines3, unmodified, on 16 worlds of the reach task that are stepped at once.

Library: stable-baselines3, through `armctl.integrations.sb3.VecEnv`.
Autoreset: `same_step`, as Stable-Baselines3 expects.
Options: normalized actions, each a motion until the next control step; features instead of raw positions; rewards
scaled to the order of one. `Shaped` adds the minimum time to the target as a potential, and changes no optimal policy.

EXPECTED: 100.0%, 100.0%, 99.5% of 200 episodes after 150,000 steps, in 2 minutes of one core

`python examples/sb3_ppo.py`, then `armctl export runs/sb3_ppo.zip ...` as in docs/your_own_learner.md.
"""

import gymnasium
from stable_baselines3 import PPO

from armctl.integrations.sb3 import VecEnv
from armctl.shaping import Shaped
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {
    "actions": "normalized",
    "control": "delta",
    "observation": "features",
}
GAMMA = 0.99

given = arguments(__doc__, steps=150_000, settings=["tuned", "defaults"])
worlds = gymnasium.make_vec(
    ID, num_envs=16, autoreset_mode="same_step", reward_scale=0.02, **OPTIONS
)
# 150 for each second nearer to the target:
shaped = Shaped(worlds, "ik", gamma=GAMMA, scale=150)
tuned = {
    "n_steps": 128,
    "batch_size": 256,
    "learning_rate": 5e-4,
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -0.5},
}
settings = tuned if given.settings == "tuned" else {}
model = PPO(
    "MlpPolicy",
    VecEnv(shaped),
    gamma=GAMMA,
    seed=given.seed,
    device="cpu",
    **settings,
)
model.learn(given.steps)
model.save("runs/sb3_ppo.zip")
report(model, ID, given.episodes, **OPTIONS)
