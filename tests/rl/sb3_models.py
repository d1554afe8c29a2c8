"""Models of Stable-Baselines3 with random weights, and environments to export them for."""

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3

IMAGE = spaces.Box(0, 255, (36, 36, 3), np.uint8)
VECTOR = spaces.Box(-np.inf, np.inf, (3,), np.float32)
PUSH = spaces.Box(np.array([-1.0, 0.0], np.float32), np.array([1.0, 5.0], np.float32))
PARTS = spaces.Dict({"speed": VECTOR, "grip": spaces.Discrete(3), "image": IMAGE})


class Anything(gymnasium.Env):
    """Random observations of any space; episodes of ten steps."""

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(self, observed, commanded, render_mode=None):
        self.observation_space, self.action_space, self.render_mode = observed, commanded, render_mode

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action):
        self.steps += 1
        return self.observation_space.sample(), 0.0, False, self.steps == 10, {}


OBSERVED = {
    "image": IMAGE,
    "parts": PARTS,
    "number": spaces.Discrete(5),
    "numbers": spaces.MultiDiscrete([3, 4]),
    "bits": spaces.MultiBinary(4),
    "double": spaces.Box(-np.inf, np.inf, (3,), np.float64),
    "vector": VECTOR,
    "two": spaces.Dict({"speed": VECTOR, "place": spaces.Box(-50, 50, (2,), np.float32)}),
}
COMMANDED = {
    "push": PUSH,
    "choice": spaces.Discrete(3),
    "choices": spaces.MultiDiscrete([2, 3]),
    "switches": spaces.MultiBinary(3),
    "table": spaces.Box(-9.0, 4.0, (2, 2), np.float32),
    "exact": spaces.Box(-2.0, 3.0, (2,), np.float64),
}


def register():
    """Make `sb3/OBSERVED-COMMANDED-v0` an environment for each pair."""
    for seen, observed in OBSERVED.items():
        for done, commanded in COMMANDED.items():
            gymnasium.register(f"sb3/{seen}-{done}-v0", Anything, kwargs={"observed": observed, "commanded": commanded})


def make(kind, env, policy="MlpPolicy", **options):
    """A model of an algorithm, whose random weights are large enough for its actions to differ."""
    model = kind(policy, env, seed=0, device="cpu", **options)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for name, parameter in model.policy.named_parameters():
            if "bias" in name:
                parameter.zero_()
            elif parameter.ndim > 1:
                parameter.copy_(torch.randn(parameter.shape, generator=generator) * 1.5 / parameter[0].numel() ** 0.5)
    return model


__all__ = ["A2C", "DDPG", "DQN", "PPO", "SAC", "TD3", "TQC", "RecurrentPPO", "make", "register"]
