from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import ndimage

from armctl.core.errors import ConfigurationError
from armctl.policies import make_policy
from armctl.rollout import evaluate

from ..stores import timeless
from .driving import FAST, MOVING, STATIC, check_distances


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "least"), [(STATIC, 0.99), (MOVING, 0.97)])
def test_it_crosses_nearly_always(env, least, sized):
    results = evaluate("bridge_ompl", env, episodes=sized(4, 12), seed=0, worlds=sized(4, 12), env_options=FAST)
    assert results.success.mean() >= least
    assert results.length[results.success].mean() < 150


@pytest.mark.slow
@pytest.mark.parametrize("env", [STATIC, MOVING])
def test_it_crosses_other_bridges(env, sized):
    options, n = {**FAST, "deck_length": 26.0, "deck_width": 4.6, "blocks": 5, "walkers": 2}, sized(3, 6)
    results = evaluate("bridge_ompl", env, episodes=n, seed=5, worlds=n, env_options=options)
    assert results.success.all()


@pytest.mark.slow
def test_it_is_the_same_in_every_run_and_needs_no_camera():
    short = {"deck_length": 12.0, "blocks": 2, "walkers": 2}
    runs = [
        evaluate("bridge_ompl", MOVING, episodes=4, seed=2, worlds=worlds, env_options=short | options)
        for worlds, options in ((4, FAST), (1, {"resolution": (6, 4)}))
    ]
    first, second = (timeless(run) for run in runs)
    assert first.equals(second)


def test_it_keeps_its_distance_from_all_that_walks_and_stands(sized):
    check_distances("bridge_ompl", n=sized(2, 4), decisions=400, to_obstacles=0.28, to_people=0.22)


def test_it_refuses_other_tasks():
    with pytest.raises(ConfigurationError, match="BridgeCross"):
        make_policy("bridge_ompl", gymnasium.make("armctl/ArmReach-v0"))


def crossing_time(bridge, radius, speed=1.0, limit=60.0, cell=0.1):
    """When a disc that may wait, and knows where everybody will be, is over the goal line, s; None if never.

    It floods places that can be reached, one cell further each `cell / speed` seconds, but for those near walkers.
    """
    x, y = np.arange(cell, bridge.length, cell), np.arange(-bridge.half_width, bridge.half_width, cell)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    stands = bridge.clearance(grid.reshape(-1, 2)).reshape(grid.shape[:2]) >= radius
    reached = np.hypot(grid[..., 0] - 1.0, grid[..., 1]) < cell
    for time in np.arange(0.0, limit, cell / speed):
        people = bridge.pedestrians.positions(time)
        away = np.linalg.norm(grid[:, :, None] - people, axis=-1).min(axis=-1) >= radius + bridge.pedestrians.radius
        reached = ndimage.binary_dilation(reached) & stands & away
        if reached[x > 19.0 - cell].any():
            return time
    return None


@pytest.mark.slow
def test_a_patient_driver_always_gets_through(sized):
    n = sized(6, 12)
    env: Any = gymnasium.make_vec(MOVING, num_envs=n, **FAST)
    env.reset(seed=11)
    times = [crossing_time(env.unwrapped.task.map(world), radius=0.35) for world in range(n)]
    assert all(time is not None for time in times)
    assert max(times) > min(times) + 1  # somebody had to wait
