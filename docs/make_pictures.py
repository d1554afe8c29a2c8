"""The README's pictures: python docs/make_pictures.py."""

from pathlib import Path

import gymnasium
import imageio.v3 as imageio
import numpy as np

import armctl

env = gymnasium.make("armctl/ArmReach-v0", render_mode="rgb_array")
policy = armctl.make_policy("reach_ik", env)
observation, _ = env.reset(seed=3)
policy.reset(np.zeros(1, dtype=np.int32))
for _ in range(4):
    observation, *_ = env.step(policy.act(observation[None])[0])
imageio.imwrite(Path(__file__).parent / "arm_reach.png", env.render())
