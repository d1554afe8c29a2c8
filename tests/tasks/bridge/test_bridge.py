import os
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_stable_baselines

from armctl.core.errors import ConfigurationError, InvalidAction
from armctl.envs import task_of
from armctl.robots.rover import PARTS, RADIUS
from armctl.tasks.bridge import bridge
from armctl.tasks.bridge.layout import CLEARANCE, sample_layout
from armctl.tasks.bridge.observation import PIXEL_CLASSES
from armctl.tasks.bridge.world import CONTACT_CLASSES

from .worlds import MOVING, STATIC, batch, single


def same(a, b):
    """Whether two observations are equal, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)
    return np.array_equal(a, b)


@pytest.mark.one_case
@pytest.mark.parametrize("env", [STATIC, MOVING])
@pytest.mark.parametrize("options", [{}, {"camera": "classes"}, {"observation": "state"}])
def test_checkers_pass(env, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        warnings.filterwarnings("ignore", message=".*infinity.*")
        warnings.filterwarnings("ignore", message=".*image.*")  # depth is no picture of bytes
        check_env(single(env, **options).unwrapped, skip_render_check=True)
        check_env_for_stable_baselines(single(env, **options))


def test_spaces_are_as_promised():
    env: Any = gymnasium.make(STATIC)
    assert env.observation_space["image"].shape == (32, 48)
    assert env.observation_space["motion"].shape == (3,)
    np.testing.assert_allclose(env.action_space.high, (2.0, 3.0))
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert 0 < observation["image"].min() < 2
    assert observation["image"].max() == 10
    assert list(info["contacts"]) == list(PARTS)
    assert list(info["contacts"]["base"]) == list(CONTACT_CLASSES)
    classes, _ = gymnasium.make(STATIC, camera="classes").reset(seed=0)
    assert {"floor", "barrier"} <= {PIXEL_CLASSES[i] for i in np.unique(classes["image"])}
    state, _ = gymnasium.make(MOVING, observation="state").reset(seed=0)
    assert state.shape == (6 + 3 * 5 + 3 * 4,)


def test_the_state_can_be_had_of_worlds_that_show_a_camera():
    seen, shown = batch(3, MOVING), batch(3, MOVING, observation="state")
    task, (states, _) = seen.unwrapped.task, shown.reset(seed=1)
    seen.reset(seed=1)
    for _ in range(3):
        assert np.array_equal(task.state_observation(), states)
        assert np.array_equal(task.state_observation(np.array([2])), states[[2]])
        assert all(task.state_space.contains(state) for state in states)
        seen.step(np.tile((0.5, 0.4), (3, 1)))
        states = shown.step(np.tile((0.5, 0.4), (3, 1)))[0]
    worlds: Any = gymnasium.make_vec("armctl/ArmReach-v0", num_envs=1)
    arm = worlds.unwrapped.task
    assert arm.state_space is None
    with pytest.raises(ConfigurationError, match="state_observation"):
        arm.state_observation()


def test_the_state_is_the_truth():
    env = batch(5, MOVING, observation="state")
    env.reset(seed=1)
    task = env.unwrapped.task
    for _ in range(30):
        seen, *_ = env.step(np.tile((0.5, 0.4), (5, 1)))
    poses = task.rover.poses
    np.testing.assert_allclose(seen[:, :2], poses[:, :2], atol=1e-5)
    np.testing.assert_allclose(np.arctan2(seen[:, 3], seen[:, 2]), poses[:, 2], atol=1e-5)
    for world in range(5):
        drawn = task.map(world)
        np.testing.assert_allclose(seen[world, 6:21].reshape(3, 5), drawn.blocks, atol=1e-5)
        walkers = seen[world, 21:].reshape(3, 4)
        time = task.state.time[world]
        np.testing.assert_allclose(walkers[:, :2], drawn.pedestrians.positions(time), atol=1e-5)
        data = task.simulation.data(world)
        there = [data.body(f"walker_{i}").xpos[:2] for i in range(3)]
        np.testing.assert_allclose(walkers[:, :2], there, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(walkers[:, 2:], axis=1), drawn.pedestrians.speed, rtol=1e-5)


@pytest.mark.one_case
@pytest.mark.parametrize("env", [STATIC, MOVING])
@pytest.mark.parametrize("options", [{}, {"camera": "classes"}, {"observation": "state"}])
def test_every_world_is_the_single_environment_of_its_seed_bit_for_bit(env, options):
    rng = np.random.default_rng(0)
    actions = rng.uniform((0.2, -1), (2, 1), (40, 5, 2)).astype(np.float32)
    worlds = batch(5, env, max_episode_steps=25, **options)
    first, _ = worlds.reset(seed=5)
    batched = [(first, None)] + [worlds.step(action)[:4] for action in actions]
    for world in (0, 3):
        alone = single(env, max_episode_steps=25, **options)
        observation, _ = alone.reset(seed=5 + world)
        over = False
        for step, action in enumerate(actions[:, world]):
            seen = batched[step][0]
            row = {name: seen[name][world] for name in seen} if isinstance(seen, dict) else seen[world]
            assert same(row, observation)
            if over:
                observation, _ = alone.reset()
                over = False
                continue
            observation, reward, terminated, truncated, _ = alone.step(action)
            assert (reward, terminated, truncated) == tuple(column[world] for column in batched[step + 1][1:])
            over = terminated or truncated


@pytest.mark.slow
@pytest.mark.parametrize("env", [STATIC, MOVING])
def test_a_reset_after_violence_is_exact(env):
    worlds = batch(4, env, autoreset_mode="disabled")
    worlds.reset(seed=3)
    rng = np.random.default_rng(0)
    reference = [worlds.step(np.tile((0.7, 0.2), (4, 1))) for _ in range(15)]
    simulation = worlds.unwrapped.task.simulation
    for _ in range(5):
        simulation.array("qvel")[:] = rng.uniform(-30, 30, (4, 10))
        simulation.array("qpos")[:, :3] += rng.uniform(-5, 5, (4, 3))
        simulation.array("xfrc_applied")[:] = 0.0
        for _ in range(3):
            worlds.step(rng.uniform(-3, 3, (4, 2)))
        worlds.reset(seed=3)
        for expected in reference:
            again = worlds.step(np.tile((0.7, 0.2), (4, 1)))
            assert same(again[0], expected[0])
            np.testing.assert_array_equal(again[1], expected[1])


@pytest.mark.slow
def test_a_thousand_resets_leave_the_rover_standing_on_the_deck():
    worlds = batch(64, MOVING, observation="state", autoreset_mode="same_step", max_episode_steps=5)
    worlds.reset(seed=0)
    task = worlds.unwrapped.task
    simulation = task.simulation
    start, still = simulation.array("qpos")[0].copy(), np.zeros(10)
    rng = np.random.default_rng(0)
    for _ in range(16 * 5):
        *_, terminated, truncated, infos = worlds.step(rng.uniform((-2, -3), (2, 3), (64, 2)))
        for world in np.flatnonzero(terminated | truncated):
            np.testing.assert_array_equal(simulation.array("qpos")[world], start)
            np.testing.assert_array_equal(simulation.array("qvel")[world], still)
            assert all(infos["contacts"][part]["floor"][world] == (part != "base") for part in PARTS)
            assert not any(infos["contacts"][part]["obstacle"][world] for part in PARTS)
    assert worlds.unwrapped.episodes.sum() >= 1000
    worlds.reset(seed=1)
    for _ in range(3):
        worlds.step(np.zeros((64, 2)))
    np.testing.assert_allclose(simulation.array("qpos")[:, :3], np.tile(start[:3], (64, 1)), atol=1e-3)


@pytest.mark.parametrize(("blocks", "walkers"), [(7, 0), (3, 3), (5, 1), (0, 4)])
def test_layouts_vary_and_can_be_crossed(blocks, walkers):
    rng = np.random.default_rng(0)
    layouts = [sample_layout(rng, 20.0, 4.0, blocks, walkers, 1) for _ in range(100)]
    assert all(layout.map.crossable(CLEARANCE) for layout in layouts)
    assert all(len(layout.missing) == 1 for layout in layouts)
    if blocks:
        assert np.std([layout.map.blocks[0, 1] for layout in layouts]) > 0.4
    for layout in layouts:
        pedestrians = layout.map.pedestrians
        assert ((pedestrians.speed >= 0.3) & (pedestrians.speed <= 1.2)).all()
        if walkers:
            walked = pedestrians.positions(np.linspace(0, 60, 600))
            assert (np.hypot(walked[..., 0] - 1.0, walked[..., 1]) > RADIUS + pedestrians.radius).all()
            assert np.abs(walked[..., 1]).max() + pedestrians.radius < layout.map.half_width
            assert layout.map.clearance(pedestrians.start).min() > 0 or not blocks


def test_an_episode_depends_on_seed_and_number_alone():
    env = single(MOVING)
    first = env.reset(seed=4, options={"episode": 2})[0]
    for _ in range(3):
        env.step((1.0, 0.5))
    env.reset()
    assert same(env.reset(seed=4, options={"episode": 2})[0], first)
    assert not same(env.reset(seed=4, options={"episode": 3})[0], first)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": "deph"}, "'deph'.*depth"),
        ({"observation": "vector"}, "observation"),
        ({"resolution": (48,)}, "resolution"),
        ({"resolution": (0, 32)}, "resolution"),
        ({"resolution": 48}, "resolution"),
        ({"field_of_view": 180}, "field_of_view"),
        ({"blocks": -1}, "blocks"),
        ({"blocks": 2.5}, "blocks"),
        ({"walkers": "3"}, "walkers"),
        ({"timestep": 0.003}, "timestep"),
        ({"timestep": float("nan")}, "timestep"),
        ({"deck_length": 2}, "deck_length"),
        ({"camera_range": 0}, "camera_range"),
        ({"reward": 3}, "reward"),
        ({"reward": {"scalar": lambda state: 1.0}}, "scalar"),
        ({"blocks": 40}, "none of .* can be crossed"),
        ({"progress": "much"}, "progress"),
        ({"walker": 3}, "walker.*walkers"),
    ],
)
def test_unusable_options_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        batch(1, **options)


@pytest.mark.parametrize("action", [[np.nan, 0], [0], [0, 0, 0], "left", None, [np.inf, 0]])
def test_unusable_actions_are_refused_and_change_nothing(action):
    env, twin = single(), single()
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(InvalidAction):
        env.step(action)
    assert same(env.step((1.0, 0.0))[0], twin.step((1.0, 0.0))[0])


def test_actions_are_clipped():
    env, twin = single(), single()
    env.reset(seed=0)
    twin.reset(seed=0)
    assert same(env.step((1e9, -1e9))[0], twin.step((2.0, -3.0))[0])


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["depth", "classes", pytest.param("rgb", marks=pytest.mark.opengl)])
def test_cameras_see_the_same_world(camera):
    env = gymnasium.make(STATIC, camera=camera)
    a, b = env.reset(seed=0)[0]["image"], env.reset(seed=0)[0]["image"]
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, env.reset(seed=1)[0]["image"])
    assert env.observation_space["image"].contains(a)


@pytest.mark.slow
def test_without_graphics_rgb_says_what_works_and_depth_works():
    code = (
        "import gymnasium, armctl\n"
        "gymnasium.make('armctl/BridgeCross-v0').reset(seed=0)\n"
        "gymnasium.make('armctl/BridgeCross-v0', camera='rgb')"
    )
    environment = {**os.environ, "MUJOCO_GL": "disabled"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    assert "ConfigurationError" in done.stderr
    assert "libegl1" in done.stderr
    assert "camera='depth'" in done.stderr


def test_policies_see_what_they_need():
    assert task_of(STATIC).default_policies == ("bridge_ompl", "bridge_distil", "random")


def test_one_layout_is_enough_to_make_worlds(monkeypatch):
    drawn = []
    monkeypatch.setattr(bridge, "sample_layout", lambda *given: drawn.append(given) or sample_layout(*given))
    worlds = batch(16)
    assert len(drawn) == 1
    worlds.reset(seed=0)
    assert len(drawn) == 17
