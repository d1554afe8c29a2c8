"""Bridges with small pictures: one, or several at once."""

import gymnasium

STATIC, MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
SMALL = {"resolution": (8, 6)}


def single(env=STATIC, **options):
    return gymnasium.make(env, **{**SMALL, **options})


def batch(n, env=STATIC, **options):
    return gymnasium.make_vec(env, num_envs=n, **{**SMALL, **options})
