"""SAC with hindsight experience replay, both of Stable-Baselines3 and unmodified, on the task's own sparse reward.

Library: stable-baselines3, through `armctl.sb3.VecEnv`.
Autoreset: `same_step`, as Stable-Baselines3 expects.
Options: `goal=True` observes `achieved_goal` and `desired_goal` beside the rest, and offers `compute_reward`, so that
what was reached can count as what was wanted. Hindsight does not know that success ends an episode, and with
`goal_reward=1` it need not: success is worth 0 then, every other step -1. No shaping: it is no function of the goal.

EXPECTED: not measured to the end yet; with twice the gradient steps, 42 % of 200 episodes after 80,000 steps

`python examples/sb3_sac_her.py`
"""

import gymnasium
from held_out import arguments, report
from stable_baselines3 import SAC, HerReplayBuffer

import armctl.sb3

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {"actions": "normalized", "control": "relative", "observation": "features", "goal": True}

given = arguments(__doc__, steps=100_000)
rewards = {"goal_reward": 1, "reward_scale": 0.1}
worlds = gymnasium.make_vec(ID, num_envs=16, autoreset_mode="same_step", **rewards, **OPTIONS)
model = SAC(
    "MultiInputPolicy",
    armctl.sb3.VecEnv(worlds),
    replay_buffer_class=HerReplayBuffer,
    replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    learning_starts=2_000,  # hindsight needs an episode that has ended: 16 worlds, at most 100 steps each
    gradient_steps=8,
    learning_rate=1e-3,
    gamma=0.98,
    tau=0.01,
    seed=given.seed,
    device="cpu",
)
model.learn(given.steps)
report(model, ID, given.episodes, **OPTIONS)
