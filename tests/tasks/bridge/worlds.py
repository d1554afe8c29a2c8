"""Bridges with small pictures: one, or several at once."""

from typing import Any

import gymnasium

STATIC, MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
SMALL: dict[str, Any] = {"resolution": (8, 6)}


def single(env=STATIC, **options):
    return gymnasium.make(env, **{**SMALL, **options})


def batch(n, env=STATIC, **options):
    return gymnasium.make_vec(env, num_envs=n, **{**SMALL, **options})
