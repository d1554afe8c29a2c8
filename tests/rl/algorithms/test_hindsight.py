import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from armctl import make_policy
from armctl.envs import TaskVectorEnv
from armctl.rl.algorithms.hindsight import GoalFeatures, GoalVectorEnv, HindsightBuffer
from armctl.rl.networks.frames import FrameFeatures, History
from armctl.rl.networks.view import view_of
from armctl.rl.run.vector import EncodedVectorEnv
from armctl.tasks import ReachTask
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD

TOLERANCE, SCALE = 0.05, 0.1


@pytest.fixture(scope="module", params=[1, 2])
def model(request):
    """SAC in 4 worlds that show 1 or 2 frames, with some episodes in its buffer, before any learning."""
    made = SAC(
        "MultiInputPolicy",
        goal_worlds(4, request.param),
        learning_starts=10**6,
        buffer_size=2000,
        replay_buffer_class=HindsightBuffer,
        seed=0,
    )
    made.learn(400)
    return made


def worlds_that_show(kind, n, frames):
    env = TaskVectorEnv(n, task=ReachTask, autoreset_mode="same_step", max_episode_steps=30, reward_scale=SCALE)
    view = view_of(env)
    venv = kind(History(view, env.single_observation_space, frames), env, view)
    venv.seed(0)
    return venv


def goal_worlds(n, frames=1):
    return worlds_that_show(GoalVectorEnv, n, frames)


@pytest.mark.parametrize("frames", [1, 3])
def test_worlds_with_goals_are_the_same_worlds(frames):
    goals, plain = goal_worlds(3, frames), worlds_that_show(EncodedVectorEnv, 3, frames)
    shown, expected = goals.reset(), plain.reset()
    for _ in range(5):
        assert goals.observation_space.contains({name: values[0] for name, values in shown.items()})
        np.testing.assert_array_equal(shown["observation"], expected)
        state = goals.env.task.state
        np.testing.assert_array_equal(shown["achieved_goal"], state.end_effector_position)
        np.testing.assert_array_equal(shown["desired_goal"], state.target_position)
        action = np.full((3, 6), 0.3, dtype=np.float32)
        shown, expected = goals.step(action)[0], plain.step(action)[0]


def test_the_last_observation_of_an_episode_has_goals_too():
    venv = goal_worlds(2)
    first = venv.reset()
    for _ in range(30):
        *_, done, infos = venv.step(np.zeros((2, 6), dtype=np.float32))
    assert done.all()
    for world in range(2):
        last = infos[world]["terminal_observation"]
        np.testing.assert_array_equal(last["desired_goal"], first["desired_goal"][world])


@pytest.mark.parametrize(("off", "expected"), [(0.049, STEP_REWARD + GOAL_REWARD), (0.051, STEP_REWARD)])
def test_a_relabelled_reward_is_that_of_being_within_the_tolerance(off, expected):
    achieved = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    targets = achieved + np.array([[0, 0, off]], np.float32)
    (rewards,) = goal_worlds(1).env_method("compute_reward", achieved, targets, [{}] * 5)
    np.testing.assert_allclose(rewards, SCALE * expected)


def test_the_tasks_reward_is_that_of_the_goals():
    worlds = TaskVectorEnv(1, task=ReachTask, max_episode_steps=100)
    observations, _ = worlds.reset(seed=0)
    expert, terminated = make_policy("reach_ik", worlds), np.zeros(1, dtype=bool)
    expert.reset(np.zeros(1, dtype=np.int32))
    earned = []
    while not terminated[0]:
        observations, rewards, terminated, *_ = worlds.step(expert.act(observations))
        earned.append(rewards[0])
    assert set(earned[:-1]) == {STEP_REWARD}
    assert earned[-1] == STEP_REWARD + GOAL_REWARD


def test_a_relabelled_success_ends_its_episode_and_nothing_is_bootstrapped(model):
    buffer = model.replay_buffer
    assert not buffer.dones[buffer.rewards < 0][buffer.timeouts[buffer.rewards < 0] == 0].any()
    samples = buffer.sample(4000)
    offset = samples.next_observations["achieved_goal"] - samples.next_observations["desired_goal"]
    reached = offset.norm(dim=1, keepdim=True) <= TOLERANCE
    virtual = slice(4000 - int(buffer.her_ratio * 4000), None)
    assert 0.05 < reached[virtual].float().mean() < 0.95
    torch.testing.assert_close(samples.dones[virtual], reached[virtual].float())
    torch.testing.assert_close(samples.rewards[virtual], SCALE * (STEP_REWARD + GOAL_REWARD * reached[virtual].float()))
    for name in ("achieved_goal", "desired_goal", "observation"):
        assert samples.observations[name].shape == samples.next_observations[name].shape
    torch.testing.assert_close(samples.observations["desired_goal"], samples.next_observations["desired_goal"])


def test_the_critic_learns_that_nothing_comes_after_a_relabelled_success(model, monkeypatch):
    """However much the target network promises, the target of a relabelled success is its reward alone."""
    promise, targets = 1000.0, []
    samples = model.replay_buffer.sample(4000)
    monkeypatch.setattr(model.replay_buffer, "sample", lambda *_, **__: samples)
    monkeypatch.setattr(model.critic_target, "forward", lambda *_: (torch.full((4000, 1), promise),) * 2)
    squared_error = torch.nn.functional.mse_loss
    monkeypatch.setattr(
        torch.nn.functional, "mse_loss", lambda q, target: targets.append(target) or squared_error(q, target)
    )
    model.train(gradient_steps=1, batch_size=4000)
    success, going_on = samples.rewards[:, 0] > 0, samples.dones[:, 0] == 0
    assert success.any()
    assert going_on.any()
    torch.testing.assert_close(targets[0][success], samples.rewards[success])
    assert (targets[0][going_on] > 0.9 * promise).all()


@pytest.mark.parametrize("frames", [1, 2])
def test_features_of_goals_are_those_of_stacks_with_another_target(frames):
    venv = goal_worlds(7, frames)
    venv.reset()
    shown = venv.step(np.full((7, 6), 0.5, dtype=np.float32))[0]
    view = view_of(venv.env)
    goals, plain = (kind(space, view) for kind, space in (
        (GoalFeatures, venv.observation_space), (FrameFeatures, venv.encoder.space)
    ))  # fmt: skip
    shown = {name: torch.as_tensor(part) for name, part in shown.items()}
    elsewhere = shown | {"desired_goal": shown["desired_goal"].flip(0)}
    elsewhere["observation"] = shown["observation"].clone()
    venv.show(elsewhere)
    stacks = elsewhere["observation"]
    assert (stacks[:, :, -3:] == shown["desired_goal"].flip(0)[:, None].float()).all()
    assert (stacks[:, :, :-3] == shown["observation"][:, :, :-3]).all()
    torch.testing.assert_close(goals(elsewhere), plain(stacks))
    assert not torch.allclose(goals(elsewhere), goals(shown))
