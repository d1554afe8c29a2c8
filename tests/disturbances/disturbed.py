"""Disturbed environments for tests."""

from typing import Any

import gymnasium
import numpy as np

REACH, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
SMALL: dict[str, Any] = {"resolution": (12, 8)}


def worlds(env=REACH, n=1, disturbances=None, seed=0, **options):
    options = (SMALL if env == BRIDGE else {}) | options
    given = {} if disturbances is None else {"disturbances": disturbances}
    made = gymnasium.make_vec(env, num_envs=n, threads=1, **given, **options)
    made.reset(seed=seed)
    return made


def fields(env, name):
    return env.unwrapped.task.simulation.per_world(name)


def arrays(observations):
    return observations if isinstance(observations, dict) else {"": observations}


def check_single_environments(env, disturbances, decisions):
    """Check that each of three worlds is the single environment of its seed, in an episode."""
    together = worlds(env, 3, disturbances, autoreset_mode="disabled")  # after another episode
    seen, _ = together.reset(seed=5, options={"episode": 2})
    apart = [gymnasium.make(env, disturbances=disturbances, **(SMALL if env == BRIDGE else {})) for _ in range(3)]
    alone = [one.reset(seed=5 + i, options={"episode": 2})[0] for i, one in enumerate(apart)]
    rng, space = np.random.default_rng(0), together.single_action_space
    for _ in range(decisions):
        for i, one in enumerate(alone):
            assert all(np.array_equal(arrays(seen)[part][i], values) for part, values in arrays(one).items())
        actions = rng.uniform(space.low, space.high, together.action_space.shape)
        seen, _, terminated, *_ = together.step(actions)
        assert not terminated.any()
        alone = [one.step(action)[0] for one, action in zip(apart, actions, strict=True)]


def played(env, decisions=25, seed=3):
    """Everything that comes of the same random actions."""
    rng, told = np.random.default_rng(0), []
    observations, _ = env.reset(seed=seed)
    for _ in range(decisions):
        told += [np.copy(values) for values in arrays(observations).values()]
        action = rng.uniform(env.single_action_space.low, env.single_action_space.high)
        observations, rewards, *_ = env.step(np.tile(action, (env.num_envs, 1)))
        told.append(rewards)
    return told
