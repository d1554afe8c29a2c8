"""RecurrentPPO of sb3-contrib: an LSTM, whose memory replaces the velocity that the default observation hides.

Library: sb3-contrib, through `armctl.integrations.sb3.VecEnv`.
Autoreset: `same_step`, as Stable-Baselines3 expects.
Options: normalized actions, relative to the current joint positions; the observation is the task's default (`paper`).

EXPECTED: 4.5% of 200 episodes after 150,000 steps, in 10 minutes of one core

`python examples/sb3_contrib_recurrent_ppo.py`
"""

import gymnasium
from sb3_contrib import RecurrentPPO

from armctl.integrations.sb3 import VecEnv
from armctl.shaping import Shaped
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {"actions": "normalized", "control": "relative"}
GAMMA = 0.99

given = arguments(__doc__, steps=150_000)
worlds = gymnasium.make_vec(
    ID, num_envs=16, autoreset_mode="same_step", reward_scale=0.02, **OPTIONS
)
shaped = Shaped(
    worlds, "ik", gamma=GAMMA, scale=150
)  # per second nearer to the target
model = RecurrentPPO(
    "MlpLstmPolicy",
    VecEnv(shaped),
    n_steps=128,
    batch_size=256,
    gamma=GAMMA,
    learning_rate=5e-4,
    policy_kwargs={"lstm_hidden_size": 64, "log_std_init": -0.5},
    seed=given.seed,
    device="cpu",
)
model.learn(given.steps)
report(model, ID, given.episodes, **OPTIONS)
