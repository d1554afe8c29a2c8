"""SAC of Stable-Baselines3 by the settings of RL Zoo, in whatever Python has the environment.

    python zoo_sac.py Reacher-v5 runs/reacher-0 --steps 50000 --seed 0
    python zoo_sac.py gymnasium_robotics:FetchReach-v4 runs/fetch-0 --steps 20000

Settings are those of `hyperparams/sac.yml` in DLR-RM/rl-baselines3-zoo: of its MuJoCo tasks, or for observations with
goals, of FetchReach. The folder gets `model.zip`, and with goals `vecnormalize.pkl`.
"""

import argparse
from pathlib import Path

import gymnasium
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

GAMMA = 0.95
"""Discount of tasks with goals."""
GOALS = {
    "policy": "MultiInputPolicy",
    "batch_size": 256,
    "gamma": GAMMA,
    "learning_rate": 1e-3,
    "learning_starts": 1_000,
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {
        "goal_selection_strategy": "future",
        "n_sampled_goal": 4,
    },
    "policy_kwargs": {"net_arch": [64, 64]},
}
MUJOCO = {"policy": "MlpPolicy", "learning_starts": 10_000}


def train(name: str, folder: Path, steps: int, seed: int) -> None:
    """Train an agent on one core, and save it in a folder."""
    torch.set_num_threads(1)
    env = DummyVecEnv([lambda: Monitor(gymnasium.make(name))])
    has_goals = isinstance(env.observation_space, gymnasium.spaces.Dict)
    if has_goals:
        env = VecNormalize(env, gamma=GAMMA)
    settings = GOALS if has_goals else MUJOCO
    model = SAC(env=env, seed=seed, device="cpu", verbose=1, **settings)
    model.learn(steps, log_interval=50)
    folder.mkdir(parents=True, exist_ok=True)
    if has_goals:
        env.save(folder / "vecnormalize.pkl")
    model.save(folder / "model.zip")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("env")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    train(given.env, given.folder, given.steps, given.seed)
