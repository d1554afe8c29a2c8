from typing import Any, cast

import gymnasium
import numpy as np
import pytest

import armctl.shaping.wrappers
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.planning import Lattice
from armctl.policies import make_policy
from armctl.shaping import Potential, Shaped, ShapedEnv, make_potential
from armctl.shaping.wrappers import difference
from armctl.tasks.bridge.layout import sample_layout

GAMMA = 0.97
PAIRS = [
    ("armctl/ArmPose-v0", "ik", "reach_ik"),
    pytest.param("armctl/ArmLift-v0", "lift", "lift_grasp", marks=pytest.mark.slow),
    ("armctl/ArmPush-v0", "push", "push_line"),
    ("armctl/ArmReach-v0", "distance", "reach_ik"),
    ("armctl/ArmReach-v0", "ik", "reach_ik"),
    ("armctl/ArmReach-v0", "mpc", "reach_ik"),
    ("armctl/ArmReachMoving-v0", "ik", "reach_ik"),
    pytest.param("armctl/ArmScenes-v0", "ik", "reach_ompl", marks=pytest.mark.slow),
    pytest.param("armctl/ArmReachObstacles-v0", "ik", "reach_ompl", marks=pytest.mark.slow),
    ("armctl/ArmReachObstacles-v0", "ompl", "reach_ompl:prepared=false"),  # it has the potential's own path
    ("armctl/BridgeCross-v0", "distance", "bridge_ompl"),
    pytest.param("armctl/BarnCross-v0", "ompl", "bridge_ompl", marks=pytest.mark.slow),
    ("armctl/BridgeCross-v0", "ompl", "bridge_ompl"),
    ("armctl/BridgeCrossMoving-v0", "ompl", "bridge_ompl"),
    ("armctl/BridgeCrossMoving-v0", "people", "bridge_ompl"),
]
OPTIONS: dict[str, dict[str, Any]] = {
    "armctl/BridgeCross-v0": {"observation": "state", "deck_length": 8.0, "blocks": 1, "missing_barriers": 0}
}


def make(env, n=4, mode="disabled", **options):
    return gymnasium.make_vec(env, num_envs=n, autoreset_mode=mode, **OPTIONS.get(env, {}), **options)


def play(env, actor, steps):
    """Rewards (steps, n), terminated and truncated of worlds that stand still after an episode."""
    observations, _ = env.reset(seed=3)
    actor.reset(np.arange(env.num_envs, dtype=np.int32))
    rows = []
    for _ in range(steps):
        observations, rewards, terminated, truncated, _ = env.step(actor.act(observations))
        rows.append((rewards, terminated, truncated))
    return [np.array(column) for column in zip(*rows, strict=True)]


def assert_telescopes(env, potential, policy, limit, steps):
    plain, worlds = make(env, max_episode_steps=limit), make(env, max_episode_steps=limit)
    shaped, witness = Shaped(worlds, potential, gamma=GAMMA, scale=2.0), make_potential(potential, plain)
    plain.reset(seed=3)
    everywhere = np.arange(plain.num_envs, dtype=np.int32)
    witness.begin(everywhere)
    start = 2.0 * witness.potentials(everywhere)
    earned, terminated, truncated = play(plain, make_policy(policy, plain), steps)
    end = 2.0 * witness.potentials(everywhere)
    shaped_earned, *_ = play(shaped, make_policy(policy, worlds), steps)
    assert (terminated.any(axis=0) ^ truncated.any(axis=0)).all(), "every episode ends, one way"
    lengths = (terminated | truncated).argmax(axis=0) + 1
    discounts = GAMMA ** np.arange(steps)[:, None]
    gained = (discounts * (shaped_earned - earned)).sum(axis=0)
    expected = GAMMA**lengths * np.where(terminated.any(axis=0), 0.0, end) - start
    np.testing.assert_allclose(gained, expected, rtol=0, atol=1e-9)
    return terminated.any(axis=0)


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "potential", "expert"), PAIRS)
def test_shaping_telescopes_over_truncated_random_episodes(env, potential, expert):
    assert not assert_telescopes(env, potential, "random", 6, 9).any()


@pytest.mark.slow
@pytest.mark.parametrize(("env", "potential", "expert"), [pair for pair in PAIRS if "Moving" not in pair[0]])
def test_shaping_telescopes_over_expert_episodes_that_terminate(env, potential, expert):
    slow = "Push" in env or "Lift" in env or "Scenes" in env
    steps = 40 if "Reach-" in env else 150 if "Bridge" in env else 240 if slow else 90
    won = assert_telescopes(env, potential, expert, steps, steps)
    assert won.mean() >= (0.75 if "Obstacles" in env else 1.0)


WRONG = {
    "kept at termination": lambda gamma, before, after, terminated: gamma * after - before,
    "another gamma": lambda gamma, before, after, terminated: np.where(terminated, 0.0, after) - before,
    "forgotten at truncation": lambda gamma, before, after, terminated: -before,
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_wrappers_are_found_out(wrong, monkeypatch):
    monkeypatch.setattr(armctl.shaping.wrappers, "difference", WRONG[wrong])
    expert = wrong == "kept at termination"
    with pytest.raises(AssertionError, match="Not equal"):
        assert_telescopes("armctl/ArmReach-v0", "distance", "reach_ik" if expert else "random", 60 if expert else 6, 60)


def test_a_potential_that_is_stale_after_a_reset_is_found_out(monkeypatch):
    class Stale(armctl.shaping.wrappers._Difference):
        def began(self, ids):
            if np.isnan(self._latest[ids]).any():
                super().began(ids)

    def second_episode(shaped):
        shaped.reset(seed=3)
        for _ in range(6):
            shaped.step(shaped.action_space.sample())
        shaped.reset(seed=3)
        return shaped.step(np.zeros(shaped.action_space.shape))[1]

    def fresh(shaped):
        shaped.reset(seed=3)
        return shaped.step(np.zeros(shaped.action_space.shape))[1]

    def shaped():
        return Shaped(make("armctl/ArmReach-v0"), "distance", gamma=GAMMA)

    np.testing.assert_array_equal(second_episode(shaped()), fresh(shaped()))
    monkeypatch.setattr(armctl.shaping.wrappers, "_Difference", Stale)
    assert not np.allclose(second_episode(shaped()), fresh(shaped()))


@pytest.mark.one_case
@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/BridgeCross-v0"])
@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_autoreset_hides_nothing_from_the_shaping(env, mode):
    potential, limit = "distance" if "Arm" in env else "ompl", 5
    worlds = Shaped(make(env, mode=mode, max_episode_steps=limit), potential, gamma=GAMMA)
    worlds.reset(seed=8)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (2 * limit + 1, *worlds.action_space.shape))
    terms = []
    for action in actions:
        _, rewards, *_, infos = worlds.step(action)
        terms.append(infos["reward_terms"]["shaping"])
        np.testing.assert_allclose(sum(infos["reward_terms"].values()), rewards, rtol=0, atol=1e-12)
    pause = mode == "next_step"
    if pause:
        np.testing.assert_array_equal(terms[limit], 0.0)
    played = [(0, range(limit)), (1, range(limit + pause, 2 * limit + pause))]
    for episode, steps in played:
        alone = Shaped(make(env, max_episode_steps=limit), potential, gamma=GAMMA)
        alone.reset(seed=8, options={"episode": episode})
        for step in steps:
            infos = alone.step(actions[step])[4]
            np.testing.assert_array_equal(infos["reward_terms"]["shaping"], terms[step])


def test_one_world_is_shaped_like_many():
    worlds = Shaped(make("armctl/ArmReach-v0", 3), "ik", gamma=GAMMA)
    one = ShapedEnv(gymnasium.make("armctl/ArmReach-v0", max_episode_steps=7), "ik", gamma=GAMMA)
    worlds.reset(seed=5)
    one.reset(seed=6)
    for action in np.random.default_rng(1).uniform(-1, 1, (7, 6)):
        _, rewards, *_ = worlds.step(np.tile(action, (3, 1)))
        _, reward, _, truncated, info = one.step(action)
        assert reward == rewards[1]
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-12)
    assert truncated


def test_worlds_that_stand_still_earn_nothing():
    shaped = Shaped(make("armctl/ArmReach-v0", max_episode_steps=2), "distance", gamma=GAMMA)
    shaped.reset(seed=0)
    rewards = [shaped.step(np.zeros(shaped.action_space.shape))[1] for _ in range(4)]
    assert (np.array(rewards[:2]) != 0).all()
    np.testing.assert_array_equal(rewards[2:], 0.0)


def test_what_cannot_be_shaped_is_refused():
    with pytest.raises(ConfigurationError, match=r"'distnace'.*distance"):
        Shaped(make("armctl/ArmReach-v0"), "distnace", gamma=GAMMA)
    with pytest.raises(ConfigurationError, match=r"BridgeCross-v0.*'ik'"):
        Shaped(make("armctl/BridgeCross-v0"), "ik", gamma=GAMMA)
    with pytest.raises(ConfigurationError, match="own environments"):
        ShapedEnv(gymnasium.make("CartPole-v1"), "distance", gamma=GAMMA)
    for gamma in (-0.1, 1.5, np.nan, cast(float, "0.9")):
        with pytest.raises(ConfigurationError, match="gamma"):
            Shaped(make("armctl/ArmReach-v0"), "distance", gamma=gamma)
    for scale in (np.nan, np.inf, cast(float, "1")):
        with pytest.raises(ConfigurationError, match="scale"):
            Shaped(make("armctl/ArmReach-v0"), "distance", gamma=GAMMA, scale=scale)
    with pytest.raises(ConfigurationError, match="already"):
        Shaped(Shaped(make("armctl/ArmReach-v0"), "distance", gamma=GAMMA), "distance", gamma=GAMMA)
    with pytest.raises(gymnasium.error.ResetNeeded):
        Shaped(make("armctl/ArmReach-v0"), "distance", gamma=GAMMA).step(np.zeros((4, 6)))


def test_an_oracle_of_ones_own_shapes():
    class Constant(Potential):
        def __init__(self, worlds):
            assert isinstance(worlds, TaskVectorEnv)

        def begin(self, ids):
            pass

        def potentials(self, ids):
            return np.full(len(ids), 10.0)

    shaped = Shaped(make("armctl/ArmReach-v0"), Constant, gamma=0.5)
    shaped.reset(seed=0)
    infos = shaped.step(np.zeros(shaped.action_space.shape))[4]
    np.testing.assert_array_equal(infos["reward_terms"]["shaping"], 0.5 * 10 - 10)


def best_actions(shaping, offset=0.0, scale=1.0):
    """Which of four moves are best in each cell of a bridge in squares, by value iteration: bool (nx, ny, 4)."""
    bridge = sample_layout(np.random.default_rng(4), 12.0, 4.0, 3, 0, 0).map
    lattice = Lattice(bridge.length, bridge.half_width, 0.25)
    potential = offset - scale * lattice.lengths(bridge, 10.0, 0.36)
    x, y = (axis for axis in lattice.axes)
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    hit = bridge.clearance(cells.reshape(-1, 2)).reshape(lattice.shape) < 0.21
    crossed = (cells[..., 0] >= 10.0) & ~hit
    ended = hit | crossed
    i, j = np.meshgrid(*map(np.arange, lattice.shape), indexing="ij")
    nexts = [
        (np.clip(i + di, 0, len(x) - 1), np.clip(j + dj, 0, len(y) - 1))
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    rewards = np.stack(
        [
            -0.1 + 100.0 * crossed[to] - 100.0 * hit[to] + shaping(GAMMA, potential, potential[to], ended[to])
            for to in nexts
        ],
        axis=-1,
    )
    values = np.zeros(lattice.shape)
    for _ in range(2000):
        returns = rewards + GAMMA * np.stack([np.where(ended[to], 0.0, values[to]) for to in nexts], axis=-1)
        values, last = returns.max(axis=-1), values
        if np.abs(values - last).max() < 1e-12:
            break
    best = returns > returns.max(axis=-1, keepdims=True) - 1e-6
    return best[~ended]


def test_the_best_policy_is_the_same_with_and_without_shaping():
    plain = best_actions(lambda gamma, before, after, terminated: 0.0)
    assert 0.2 < plain.mean() < 0.6, "there is something to decide"
    for offset, scale in ((0.0, 1.0), (0.0, 50.0), (-1000.0, 1.0), (1000.0, 5.0)):
        np.testing.assert_array_equal(best_actions(difference, offset, scale), plain)


def test_a_potential_kept_at_termination_changes_the_best_policy():
    plain = best_actions(lambda gamma, before, after, terminated: 0.0)
    assert (best_actions(WRONG["kept at termination"], -1000.0) != plain).any()


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_the_autoreset_mode_is_shown(mode):
    """TorchRL asks for it, and Gymnasium's wrappers hand no attributes on."""
    worlds = make("armctl/ArmReach-v0", mode=mode)
    assert Shaped(worlds, "distance", gamma=GAMMA).autoreset_mode is worlds.autoreset_mode
