"""`VecEnv`: what Stable-Baselines3's learners and wrappers get of armctl's vector environments."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.integrations.sb3 import GoalFeatures, VecEnv
from armctl.shaping import Shaped

REACH, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
LEARNER = {"actions": "normalized", "control": "relative", "observation": "features"}
CAMERA = {"image_format": "uint8", "actions": "normalized"}


def worlds(env=REACH, n=3, **options):
    return gymnasium.make_vec(env, num_envs=n, autoreset_mode="same_step", threads=1, **options)


def test_its_steps_are_the_vector_environments():
    venv, plain = VecEnv(worlds(max_episode_steps=4)), worlds(max_episode_steps=4)
    venv.seed(7)
    np.testing.assert_array_equal(venv.reset(), plain.reset(seed=7)[0])
    rng = np.random.default_rng(0)
    for _ in range(9):
        actions = rng.uniform(-2, 2, (3, 6))
        seen, rewards, done, infos = venv.step(actions)
        expected, earned, terminated, truncated, told = plain.step(actions)
        np.testing.assert_array_equal(seen, expected)
        np.testing.assert_allclose(rewards, earned)
        np.testing.assert_array_equal(done, terminated | truncated)
        for i in np.flatnonzero(done):
            np.testing.assert_array_equal(infos[i]["terminal_observation"], told["final_obs"][i])
            assert infos[i]["episode"]["l"] == 4
        assert all((info == {}) == (not ended) for info, ended in zip(infos, done, strict=True))


def test_returns_are_the_tasks_without_shaping_and_scale():
    shaped = Shaped(worlds(max_episode_steps=5, reward_scale=0.1), "distance", gamma=0.9, scale=30.0)
    venv = VecEnv(shaped)
    venv.reset()
    for _ in range(5):
        _, rewards, _, infos = venv.step(np.zeros((3, 6)))
    assert [info["episode"]["r"] for info in infos] == [-5.0] * 3
    assert (rewards != -0.1).any()


def test_seeds_and_options_hold_for_one_reset():
    venv = VecEnv(worlds())
    venv.seed(3)
    venv.set_options({"episode": 5})
    first = venv.reset()
    np.testing.assert_array_equal(first, worlds().reset(seed=3, options={"episode": 5})[0])
    assert (venv.reset() != first).any()


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (lambda: gymnasium.make_vec(REACH, num_envs=2), "same_step"),
        (lambda: gymnasium.make_vec(REACH, num_envs=2, vectorization_mode="sync"), "make_vec"),
        (lambda: gymnasium.make_vec("Pendulum-v1", num_envs=2), "make_vec"),
        (lambda: worlds(flat_infos=True), "flat_infos"),
    ],
)
def test_other_environments_are_refused(env, message):
    with pytest.raises(ConfigurationError, match=message):
        VecEnv(env())


def test_attributes_and_methods_are_the_environments():
    venv = VecEnv(worlds(goal=True))
    assert venv.get_attr("max_episode_steps") == [100] * 3
    assert venv.get_attr("spec", indices=[1])[0].id == REACH
    goals = np.zeros((2, 3)), np.ones((2, 3))
    assert venv.env_method("compute_reward", *goals, [{}, {}], indices=[0])[0].tolist() == [-1, -1]
    with pytest.raises(AttributeError):
        venv.get_attr("no_such_thing")


def test_frames_are_stacked_behind_each_other():
    stacked = VecFrameStack(VecEnv(worlds(BRIDGE, 2, **CAMERA)), 3)
    assert stacked.observation_space["image"].shape == (36, 48, 3)
    assert stacked.observation_space["motion"].shape == (9,)
    stacked.reset()
    plain = VecEnv(worlds(BRIDGE, 2, **CAMERA))
    stacked.seed(1)
    plain.seed(1)
    before, seen = plain.reset(), stacked.reset()
    np.testing.assert_array_equal(seen["image"][..., 2:], before["image"])
    actions = np.ones((2, 2))
    seen, after = stacked.step(actions)[0], plain.step(actions)[0]
    np.testing.assert_array_equal(seen["image"][..., 1:2], before["image"])
    np.testing.assert_array_equal(seen["image"][..., 2:], after["image"])


@pytest.mark.slow
def test_wrappers_and_evaluation_of_stable_baselines_work():
    venv = VecNormalize(VecMonitor(VecEnv(worlds(max_episode_steps=5, **LEARNER))))
    model = PPO("MlpPolicy", venv, n_steps=8, batch_size=8, device="cpu").learn(48)
    mean, _ = evaluate_policy(model, VecEnv(worlds(max_episode_steps=5, **LEARNER)), n_eval_episodes=3, warn=True)
    assert -5 <= mean <= 99


@pytest.mark.slow
def test_hindsight_runs_unmodified():
    venv = VecEnv(worlds(goal=True, max_episode_steps=10, **LEARNER))
    model = SAC(
        "MultiInputPolicy",
        venv,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=60,
        batch_size=16,
        policy_kwargs={"features_extractor_class": GoalFeatures},
        device="cpu",
    )
    model.learn(150)
    assert model.replay_buffer.size() * venv.num_envs >= 120


def test_features_of_goals_are_those_of_the_environment():
    apart, together = VecEnv(worlds(goal=True, **LEARNER)), VecEnv(worlds(**LEARNER))
    extractor = GoalFeatures(apart.observation_space)
    for venv in (apart, together):
        venv.seed(5)
    seen, expected = apart.reset(), together.reset()
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 3, 6)):
        given = {name: torch.as_tensor(part, dtype=torch.float32) for name, part in seen.items()}
        features = extractor(given)
        assert features.shape[1] == extractor.features_dim
        np.testing.assert_allclose(features[:, :-6], expected, atol=1e-5)
        np.testing.assert_allclose(features[:, -6:], apart.env.task.arm.joint_velocities, atol=1e-5)
        seen, expected = apart.step(action)[0], together.step(action)[0]


@pytest.mark.parametrize("options", [LEARNER, {"goal": True}, {"goal": True, "observation": "full"}])
def test_features_of_goals_need_goals_and_features(options):
    with pytest.raises(ConfigurationError, match="goal=True, observation='features'"):
        GoalFeatures(VecEnv(worlds(**options)).observation_space)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["MultiInputPolicy", "CnnPolicy"])
def test_networks_see_a_picture(policy):
    seen = {"observation": "image"} if policy == "CnnPolicy" else {}
    venv = VecEnv(worlds(BRIDGE, 2, max_episode_steps=4, **CAMERA, **seen))
    model = PPO(policy, venv, n_steps=4, batch_size=8, device="cpu").learn(8)
    assert "Conv2d" in str(model.policy.features_extractor)


@pytest.mark.slow
def test_an_agent_brings_the_interface_that_it_was_trained_with(tmp_path, monkeypatch):
    import armctl
    from armctl.policies import WorldsByInterface
    from armctl.rl.export.sb3 import export
    from armctl.training.learners import ModelExport

    monkeypatch.chdir(tmp_path)
    model = PPO("MlpPolicy", VecEnv(worlds(**LEARNER)), device="cpu", seed=0)
    model.save(tmp_path / "model.zip")
    agent = tmp_path / "agent.onnx"
    export(
        ModelExport(
            tmp_path / "model.zip", env=REACH, out=agent, env_options={**LEARNER, "tolerance": 0.06}, trust=True
        )
    )
    players = {"mine": agent.with_suffix(".json"), "ik": "reach_ik", "ppo": "reach_ppo"}
    alone = armctl.evaluate(players["mine"], episodes=4, env_options={**LEARNER, "tolerance": 0.05})
    for workers in (1, 2):
        found = armctl.compare(players, episodes=4, workers=workers, env_options={"reward_scale": 0.5})
        assert not found.failures
        rows = found.episodes.set_index(["policy", "episode"])
        assert rows.loc["ik"].success.all()
        assert rows.loc["mine"]["return"].tolist() == alone["return"].tolist()
    asked = WorldsByInterface(
        REACH, 1, {"observation": "full", "tolerance": 0.07, "reward_scale": 2.0, "reward_weights": {"goal": 0.0}}
    )
    assert asked.of("reach_ppo").single_observation_space.shape == (12,)
    assert asked.of("reach_ppo").task.options.tolerance == 0.07
    assert asked.of("reach_ik").single_observation_space.shape == (12,)
    assert asked.of("random") is asked.requested
    actions: Any = asked.of(players["mine"]).single_action_space
    assert actions.high.max() == 1.0
    assert asked.of(players["mine"]).task.options.tolerance == 0.07
    with pytest.raises(armctl.core.errors.AgentFileError):
        armctl.make_policy(players["mine"], make_worlds(REACH, 1))


def test_experts_act_in_physical_units_whatever_is_asked_for():
    import armctl

    options = {**LEARNER, "max_episode_steps": 60}
    found = armctl.evaluate("reach_ik", episodes=5, worlds=5, env_options=options)
    assert found.success.all()
    with pytest.raises(ConfigurationError, match="physical units"):
        armctl.make_policy("reach_ik", gymnasium.make(REACH, actions="normalized"))
    followed = armctl.evaluate("reach_ik", episodes=2, env_options={"control": "velocity"})
    assert followed.success.all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "options", "sees"),
    [
        (REACH, {"actions": "normalized"}, "observation"),
        (REACH, {"actions": "normalized", "observation": "full"}, "observation + velocities"),
        (BRIDGE, {"actions": "normalized", "observation": "full"}, "state"),
    ],
)
def test_tables_say_what_an_agent_sees_and_other_units_are_refused(env, options, sees, tmp_path):
    import armctl
    from armctl.rl.export.sb3 import export
    from armctl.training.learners import ModelExport

    PPO("MlpPolicy", VecEnv(worlds(env, **options)), device="cpu").save(tmp_path / "model.zip")
    export(ModelExport(tmp_path / "model.zip", env=env, out=tmp_path / "agent.onnx", env_options=options, trust=True))
    found = armctl.compare({"mine": tmp_path / "agent.json", "random": "random"}, env, episodes=2)
    assert {one.policy: one.sees for one in found.policies} == {"mine": sees, "random": "observation"}
    plain = make_worlds(env, 1, {**options, "actions": "physical"})
    with pytest.raises(armctl.core.errors.AgentFileError, match="units"):
        armctl.make_policy(tmp_path / "agent.json", plain)
