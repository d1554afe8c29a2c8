from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import declared_sees, make_policy
from armctl.rollout import evaluate

from ..stores import timeless
from .driving import MOVING, STATIC

NAME = "bridge_lidar_ompl"


@pytest.mark.slow
@pytest.mark.parametrize(("env", "least"), [(STATIC, 0.9), (MOVING, 0.8)])
def test_it_crosses_by_its_sensors(env, least, sized):
    results = evaluate(NAME, env, episodes=sized(2, 6), seed=101, worlds=sized(2, 6))
    assert results.success.mean() >= least
    assert results.length[results.success].mean() < 140


@pytest.mark.slow
@pytest.mark.parametrize(("disturbances", "least"), [({"noise": 0.1}, 0.9), ({"dropout": 0.25}, 0.8)])
def test_noise_and_lost_pictures_are_survived(disturbances, least):
    results = evaluate(NAME, STATIC, episodes=5, seed=130, worlds=5, env_options={"disturbances": disturbances})
    assert results.success.mean() >= least


@pytest.mark.slow
def test_it_is_the_same_in_every_run_and_with_any_number_of_worlds():
    short = {"deck_length": 11.0, "blocks": 2, "walkers": 2}
    runs = [evaluate(NAME, MOVING, episodes=2, seed=2, worlds=worlds, env_options=short) for worlds in (2, 1)]
    first, second = (timeless(run) for run in runs)
    assert first.equals(second)


def test_it_sees_neither_map_nor_state_nor_future():
    assert declared_sees(NAME) == "model"
    env = make_worlds(MOVING, 1)
    policy = make_policy(NAME, env)
    assert (policy.sees, getattr(policy, "foresight", ())) == ("model", ())


def observation(image=0.0):
    return {"image": np.full((32, 48), image, dtype=np.float32), "motion": np.array((1.0, 0.0, 0.2), dtype=np.float32)}


@pytest.fixture
def navigator():
    policy: Any = make_policy(NAME, make_worlds(STATIC, 1))
    policy.reset(np.arange(1, dtype=np.int32))
    return policy.controllers[0]


def test_black_pictures_tell_nothing_and_readings_that_are_no_numbers_are_ignored(navigator):
    for _ in range(3):
        action = navigator.act(observation())
    assert np.isfinite(action).all()
    assert not len(navigator.bridge.blocks)
    assert navigator.localization.pose[0] > 1.1
    navigator.act({"image": np.full((32, 48), np.nan), "motion": np.full(3, np.nan)})
    assert np.isfinite(navigator.localization.pose).all()


def test_a_reset_forgets_the_bridge(navigator):
    before = navigator.localization.pose.copy()
    first = navigator.act(observation(10.0))
    navigator.act(observation())
    navigator.reset()
    np.testing.assert_array_equal(navigator.localization.pose, before)
    np.testing.assert_array_equal(navigator.act(observation(10.0)), first)


def test_plans_are_shown(navigator):
    navigator.act(observation(10.0))
    assert {name: line.shape[1] for name, line in navigator.plans().items()} == {"path": 3, "horizon": 3}


def test_it_refuses_other_tasks_and_other_pictures():
    with pytest.raises(ConfigurationError, match="BridgeCross"):
        make_policy(NAME, gymnasium.make("armctl/ArmReach-v0"))
    with pytest.raises(ConfigurationError, match="depth image in m"):
        make_policy(NAME, gymnasium.make(STATIC, observation="features"))
