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

import armctl
from armctl.core.errors import ConfigurationError, InvalidAction
from armctl.envs import TaskVectorEnv
from armctl.tasks import ReachTask

ENV = "armctl/ArmReach-v0"


def single(**options):
    return gymnasium.make(ENV, **options)


def batch(n, **options):
    return gymnasium.make_vec(ENV, num_envs=n, **options)


def armctl_can_draw():
    code = "import armctl, mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>')).render()"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def play(env, actions):
    """All that a single environment gives for a list of actions."""
    return [env.step(action) for action in actions]


@pytest.mark.parametrize("control", ["position", "delta", "velocity", "torque"])
def test_checkers_pass(control):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Joint limits are what they are, and replaceable observations have no known bounds.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(single(control=control).unwrapped, skip_render_check=True)
        check_env_for_stable_baselines(single(control=control))


def test_spaces_are_as_promised():
    env = single()
    assert env.observation_space.shape == (12,)
    assert env.action_space.shape == (6,)
    np.testing.assert_allclose(env.action_space.high, [2 * np.pi] * 2 + [np.pi] + [2 * np.pi] * 3, rtol=1e-6)
    observation, _ = env.reset(seed=0)
    task = env.unwrapped.task
    np.testing.assert_allclose(observation[:3], task.arm.end_effector_positions[0], atol=1e-6)
    np.testing.assert_allclose(observation[3:9], armctl.load_arm("ur5").home, atol=1e-6)
    np.testing.assert_allclose(observation[9:], task.state.target_position[0], atol=1e-6)


@pytest.mark.parametrize("worlds", [1, 3, 40])
def test_every_world_is_the_single_environment_of_its_seed_bit_for_bit(worlds):
    rng = np.random.default_rng(0)
    env = batch(worlds, max_episode_steps=7)
    actions = rng.uniform(-np.pi, np.pi, (20, worlds, 6))
    batched = [env.reset(seed=5)[0]] + [env.step(action)[0] for action in actions]
    for world in {0, worlds - 1, worlds // 2}:
        alone = single(max_episode_steps=7)
        observations, finished = [alone.reset(seed=5 + world)[0]], False
        for action in actions[:, world]:
            if finished:
                observation, finished = alone.reset()[0], False
            else:
                observation, _, terminated, truncated, _ = alone.step(action)
                finished = terminated or truncated
            observations.append(observation)
        np.testing.assert_array_equal(np.array(batched)[:, world], observations)


def test_an_episode_does_not_depend_on_those_before_it():
    env = single()
    actions = np.random.default_rng(1).uniform(-6, 6, (30, 6))
    env.reset(seed=9, options={"episode": 4})
    first = play(env, actions)
    for episode in range(4):
        env.reset(seed=9 if episode == 0 else None)
        play(env, np.random.default_rng(episode).uniform(-6, 6, (50, 6)))
    env.reset()
    assert env.unwrapped.worlds.episodes[0] == 4
    for a, b in zip(first, play(env, actions), strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]


def test_seeds_and_episodes_differ():
    env = single()
    targets = [env.reset(seed=seed, options={"episode": k})[0][9:] for seed in range(4) for k in range(4)]
    assert len(np.unique(targets, axis=0)) == 16


def test_thread_count_changes_nothing():
    actions = np.random.default_rng(0).uniform(-3, 3, (10, 32, 6))
    runs = []
    for threads in (1, 2, 5):
        env = batch(32, threads=threads)
        env.reset(seed=0)
        runs.append([env.step(action)[0] for action in actions])
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])


@pytest.mark.parametrize(
    ("action", "says"),
    [
        (np.zeros(5), "shape"),
        (np.zeros((6, 1)), "shape"),
        (0.0, "shape"),
        (["up"] * 6, "array of numbers"),
        (None, "shape|not finite"),
        (np.array([0, 0, np.nan, 0, 0, 0]), "not finite"),
        (np.array([0, np.inf, 0, 0, 0, 0]), "not finite"),
    ],
)
def test_hostile_actions_raise_and_leave_the_world_as_it_was(action, says):
    env = single()
    env.reset(seed=0)
    env.step(np.ones(6))
    before = env.unwrapped.task.simulation._batch.state.copy()
    with pytest.raises(InvalidAction, match=says):
        env.step(action)
    np.testing.assert_array_equal(env.unwrapped.task.simulation._batch.state, before)
    twin = single()
    twin.reset(seed=0)
    twin.step(np.ones(6))
    np.testing.assert_array_equal(env.step(np.zeros(6))[0], twin.step(np.zeros(6))[0])


def test_one_bad_action_of_many_steps_no_world():
    env = batch(4)
    env.reset(seed=0)
    before = env.task.simulation._batch.state.copy()
    actions = np.zeros((4, 6))
    actions[2, 3] = np.nan
    with pytest.raises(InvalidAction, match="world 2"):
        env.step(actions)
    np.testing.assert_array_equal(env.task.simulation._batch.state, before)


def test_the_callers_action_is_left_alone():
    env = single(max_episode_steps=1)
    env.reset(seed=0)
    action = np.ones(6)
    env.step(action)
    env.reset()
    assert action.tolist() == [1.0] * 6


def test_actions_beyond_the_bounds_are_clipped():
    far, edge = single(), single()
    for env, scale in ((far, 1e6), (edge, 1.0)):
        env.reset(seed=0)
        for _ in range(5):
            env.step(scale * env.action_space.high.astype(float))
    np.testing.assert_array_equal(far.unwrapped.task.state.joint_positions, edge.unwrapped.task.state.joint_positions)


def test_step_before_reset_and_after_the_end_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded):
        single(disable_env_checker=True).unwrapped.step(np.zeros(6))
    at_home = (0.487, 0.109, 0.432)
    env = single(target="box", target_box=(at_home, at_home))
    env.reset(seed=0)
    assert env.step(np.zeros(6))[2]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(6))


@pytest.mark.parametrize("limit", [1, 30, 140])
def test_truncation_comes_at_the_limit_and_is_called_timeout(limit):
    env, worlds = single(max_episode_steps=limit), TaskVectorEnv(1, task=ReachTask, max_episode_steps=limit)
    env.reset(seed=0)
    worlds.reset(seed=0)
    home = armctl.load_arm("ur5").home
    for k, step in enumerate(play(env, [home] * limit), start=1):
        last, infos = k == limit, worlds.step(home[None])[4]
        assert step[2:4] == (False, last)
        assert not step[4]["is_success"]
        assert worlds.outcomes[infos["outcome_id"][0]] == ("timeout" if last else "running")
        assert step[4]["outcome"] == "running"  # the limit is Gymnasium's wrapper, outside


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"robot": "ur55"}, "Did you mean 'ur5'"),
        ({"control": "positon"}, "Did you mean 'position'"),
        ({"target": "boxes"}, "Did you mean 'box'"),
        ({"tolerence": 0.1}, "Did you mean 'tolerance'"),
        ({"tolerance": -1.0}, "greater than 0, not -1.0"),
        ({"tolerance": float("nan")}, "finite number, not nan"),
        ({"target_box": ((0, 0, 0), (1, 1))}, "target_box"),
        ({"target_box": ((0, 0, 1), (1, 1, 0))}, "lowest and highest"),
        ({"render_mode": "rgb_arrays"}, "Did you mean 'rgb_array'"),
        ({"reward": {}}, "at least 1 item"),
        ({"reward": {"odd": lambda state: state.joint_positions}}, "'odd' must have shape"),
        ({"observation": {"odd": lambda state: state.distance}}, "'odd' has shape"),
    ],
)
def test_bad_options_say_what_is_allowed(options, says):
    with pytest.raises(ConfigurationError, match=says), warnings.catch_warnings(action="ignore"):
        single(**options)


@pytest.mark.parametrize("number", [0, -1, 2.5])
def test_bad_number_of_worlds(number):
    with pytest.raises(ConfigurationError, match="num_envs"):
        batch(number)


@pytest.mark.parametrize("seed", [-1, [1, 2], 0.5, "one"])
def test_bad_seeds(seed):
    with pytest.raises(ConfigurationError, match="seed is a whole number"):
        batch(3).reset(seed=seed)


@pytest.mark.parametrize("episode", [-1, 1.5, "x", [0, 1], float("nan")])
def test_a_bad_episode_number_changes_nothing(episode):
    env = batch(3)
    env.reset(seed=5)
    with pytest.raises(ConfigurationError, match="episode is a whole number"):
        env.reset(seed=9, options={"episode": episode})
    assert env.seeds.tolist() == [5, 6, 7]


def test_a_reward_term_cannot_change_the_state():
    env = batch(4, reward={"distance": lambda state: state.distance}, max_episode_steps=2)
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros((4, 6)))
        assert (env.task.state.distance > 0).all()


def test_same_step_autoreset_gives_the_final_observation():
    env, twin = batch(3, autoreset_mode="same_step", max_episode_steps=4), single(max_episode_steps=4)
    env.reset(seed=0)
    twin.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 6))
    for action in actions:
        observations, _, _, truncated, infos = env.step(np.tile(action, (3, 1)))
        last = twin.step(action)[0]
    assert truncated.all()
    np.testing.assert_array_equal(infos["final_obs"][1], last)
    np.testing.assert_array_equal(observations[1], twin.reset()[0])
    assert list(infos["final_info"]["outcome_id"]) == [0] * 3
    for mask in (infos["_final_obs"], infos["_final_info"], infos["final_info"]["_outcome_id"]):
        assert mask.all()  # also after the next episodes have begun


def test_disabled_autoreset_freezes_finished_worlds_until_they_are_picked():
    env = batch(2, autoreset_mode="disabled", max_episode_steps=3)
    env.reset(seed=[4, 4], options={"episode": [0, 1]})
    for _ in range(3):
        observations = env.step(np.ones((2, 6)))[0]
    later, rewards, terminated, truncated, _ = env.step(np.zeros((2, 6)))
    np.testing.assert_array_equal(later, observations)
    assert not rewards.any()
    assert not (terminated | truncated).any()
    env.reset(options={"reset_mask": np.array([False, True])})
    observations, rewards, *_ = env.step(np.zeros((2, 6)))
    np.testing.assert_array_equal(observations[0], later[0])
    assert rewards.tolist() == [0.0, -1.0]
    assert env.episodes.tolist() == [0, 2]


@pytest.mark.slow
def test_picture_shows_the_green_target_or_says_what_is_missing():
    env = single(render_mode="rgb_array")
    env.reset(seed=3)
    if not armctl_can_draw():
        with pytest.raises(ConfigurationError, match="libegl1"):
            env.render()
        return
    picture = env.render()
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    assert picture.shape == (480, 640, 3)
    assert 200 < ((green > red + 60) & (green > blue + 60)).sum() < 20_000
    assert picture.std() > 20
    env.close()


@pytest.mark.slow
def test_human_mode_without_a_screen_says_so():
    code = f"import gymnasium, armctl; gymnasium.make({ENV!r}, render_mode='human').reset()"
    blind = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([sys.executable, "-c", code], env=blind, capture_output=True, text=True)
    assert "ConfigurationError" in done.stderr
    assert "--video" in done.stderr


@pytest.mark.parametrize("env", [ENV, "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"])
def test_a_reset_of_no_world_changes_nothing(env):
    worlds: Any = gymnasium.make_vec(env, num_envs=2)
    worlds.reset(seed=0)
    arrays = {name: np.copy(array) for name, array in worlds.unwrapped.task.simulation.live_arrays.items()}
    worlds.reset(options={"reset_mask": np.zeros(2, dtype=bool)})
    for name, array in worlds.unwrapped.task.simulation.live_arrays.items():
        np.testing.assert_array_equal(array, arrays[name])
