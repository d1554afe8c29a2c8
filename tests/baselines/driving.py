"""Drives over the moving bridge."""

from typing import Any

import gymnasium
import numpy as np

from armctl.policies import make_policy

STATIC, MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
FAST: dict[str, Any] = {"observation": "state"}
"""Drivers look at the state anyhow, and cameras take time."""


def check_distances(driver, n, decisions, to_obstacles, to_people):
    """Check that a driver stays so far from all that stands and walks, m, and comes to an end in each of n worlds."""
    env: Any = gymnasium.make_vec(MOVING, num_envs=n, autoreset_mode="disabled", **FAST)
    policy = make_policy(driver, env)
    observations, _ = env.reset(seed=7)
    policy.reset(np.arange(n, dtype=np.int32))
    task, running = env.unwrapped.task, np.ones(n, dtype=bool)
    for _ in range(decisions):
        observations, _, terminated, truncated, _ = env.step(policy.act(observations))
        running &= ~(terminated | truncated)
        for world in np.flatnonzero(running):
            pose, bridge = task.state.poses[world], task.map(world)
            assert bridge.clearance(pose[None, :2])[0] > to_obstacles
            people = bridge.pedestrians.positions(task.state.time[world])
            assert np.linalg.norm(people - pose[:2], axis=1).min() > to_people + bridge.pedestrians.radius
        if not running.any():
            break
    assert not running.any()
