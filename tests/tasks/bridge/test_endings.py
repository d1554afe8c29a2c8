"""How episodes on the bridge end, and what is paid for it."""

import numpy as np
import pytest

from armctl.robots.rover import PARTS

from .worlds import MOVING, STATIC, batch, single


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [
        ((5, 0, 0.2), (0, 1, 0, 0)),
        ((5, 0, 0.3), (0.707, 0.707, 0, 0)),
        ((5, 2.5, 1), (1, 0, 0, 0)),
        ((-0.5, 0, 1), (1, 0, 0, 0)),
    ],
    ids=["on its back", "on its side", "over the side", "over the end"],
)
def test_a_rover_that_lies_or_has_left_the_deck_has_fallen(position, quaternion):
    env = batch(2, autoreset_mode="disabled")
    env.reset(seed=0)
    env.task.simulation.array("qpos")[1, :7] = *position, *quaternion
    _, _, terminated, _, infos = env.step(np.zeros((2, 2)))
    assert terminated.tolist() == [False, True]
    assert env.outcomes[infos["outcome_id"][1]] == "fell"
    assert infos["reward_terms"]["fall"].tolist() == [0, -100]


def drive(env, action, limit=200):
    """Repeat an action until the episode ends."""
    env.reset(seed=0)
    for _ in range(limit):
        _, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return reward, terminated, info
    raise AssertionError("the episode did not end")


def test_driving_on_ends_in_a_collision_with_a_barrier():
    env = single(blocks=0)
    env.reset(seed=0)
    for _ in range(5):
        env.step((0.0, 2.0))
    for _ in range(50):
        _, reward, terminated, _, info = env.step((1.5, 0.0))
        if terminated:
            break
    assert info["outcome"] == "collided"
    assert not info["is_success"]
    assert any(info["contacts"][part]["barrier"] for part in PARTS)
    assert reward == pytest.approx(-100.1)


def test_driving_ahead_on_an_empty_bridge_crosses_it():
    reward, terminated, info = drive(single(blocks=0), (1.5, 0.0))
    assert (info["outcome"], info["is_success"], terminated) == ("crossed", True, True)
    assert any(info["contacts"][part]["goal"] for part in PARTS)
    assert reward == pytest.approx(99.9)
    assert info["reward_terms"] == {"time": -0.1, "goal": 100.0, "collision": 0.0, "fall": 0.0}


def test_driving_back_falls_off_the_end():
    reward, _, info = drive(single(), (-1.0, 0.0))
    assert info["outcome"] == "fell"
    assert reward == pytest.approx(-100.1)


def test_where_a_barrier_is_missing_the_rover_falls():
    env = batch(1, blocks=0, missing_barriers=100)
    env.reset(seed=0)
    world = env.unwrapped
    for _ in range(25):
        env.step([(2.0, 0.0)])
    while abs(world.task.rover.poses[0, 2]) < 1.2:
        env.step([(0.0, 1.0)])
    for _ in range(40):
        _, _, terminated, _, infos = env.step([(0.7, 0.0)])
        if terminated[0]:
            break
    assert env.outcomes[infos["outcome_id"][0]] == "fell"


def test_standing_still_times_out():
    env = single(max_episode_steps=20)
    reward, terminated, info = drive(env, (0.0, 0.0))
    assert not terminated
    assert info["outcome"] == "running"
    assert reward == pytest.approx(-0.1)


@pytest.mark.slow
@pytest.mark.parametrize("env", [STATIC, MOVING])
def test_the_reward_is_its_ledger_and_progress_is_exact(env):
    worlds = batch(16, env, progress=2.0, autoreset_mode="disabled")
    worlds.reset(seed=0)
    worlds.action_space.seed(0)
    start = worlds.unwrapped.task.state.distance.copy()
    earned, running = np.zeros(16), np.ones(16, dtype=bool)
    last = start.copy()
    for _ in range(40):
        actions = worlds.action_space.sample() * (0.4, 0.3) + (0.6, 0)
        _, rewards, terminated, _, infos = worlds.step(actions)
        np.testing.assert_allclose(rewards, sum(infos["reward_terms"].values()))
        earned += infos["reward_terms"]["progress"]
        last[running] = worlds.unwrapped.task.state.distance[running]
        running &= ~terminated
    np.testing.assert_allclose(earned, 2.0 * (start - last), atol=1e-9)
    assert not running.all()


def test_reward_is_replaceable():
    env = batch(3, reward={"near": lambda state: -state.distance, "turning": lambda state: -np.abs(state.action[:, 1])})
    env.reset(seed=0)
    _, rewards, _, _, infos = env.step(np.tile((0.0, 1.0), (3, 1)))
    np.testing.assert_allclose(infos["reward_terms"]["turning"], -1.0)
    np.testing.assert_allclose(rewards, -19.0 + 1.0 + 0.0 - 1.0, atol=0.1)
