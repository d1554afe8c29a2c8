import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch
from armctl.rl.bridge import ANGULAR, LINEAR, VelocityScale
from armctl.rl.ppo import RECIPES, PpoOptions, train
from armctl.rl.reach import LARGEST_MOVE, SHAPED_REWARD, ActionScale
from armctl.rl.vector import StableBaselinesVectorEnv

from armctl.agents import load_agent
from armctl.envs import ArmReachVectorEnv, BridgeCrossVectorEnv
from armctl.errors import AgentFileError, ConfigurationError
from armctl.evaluation import evaluate

SMALL = PpoOptions(
    steps=4096, worlds=32, rollout_length=32, batch_size=512, checkpoint_every=1024, evaluation_episodes=20
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "small"
    return out, train(out=out, options=SMALL, seed=3, progress=False)


def adapter(worlds, **options):
    env = ArmReachVectorEnv(worlds, autoreset_mode="same_step", **options)
    return StableBaselinesVectorEnv(env, ActionScale(env.task.interface["control"], env.single_action_space))


def test_training_leaves_a_runnable_agent_its_card_logs_and_checkpoints(trained):
    out, card = trained
    assert card == card.model_validate_json((out / "agent.json").read_bytes())
    assert card.training_steps == 4096
    assert card.training_seed == 3
    assert card.evaluation.episodes == 20
    assert list((out / "checkpoints").glob("*.zip"))
    assert list((out / "tensorboard").glob("events*"))
    assert len(evaluate(str(out / "agent.json"), episodes=3)) == 3


def test_exported_graph_is_the_network(trained):
    from stable_baselines3 import PPO

    out, _ = trained
    worlds = ArmReachVectorEnv(50)
    observations, _ = worlds.reset(seed=0)
    model = PPO.load(out / "checkpoints" / "ppo_4096_steps", device="cpu")
    raw = model.predict(observations, deterministic=True)[0]
    expected = observations[:, 3:9] + LARGEST_MOVE * np.clip(raw, -1, 1)
    np.testing.assert_allclose(load_agent(out / "agent.json", worlds).act(observations), expected, atol=1e-5)


def test_exported_graph_tells_nothing_of_the_machine(trained):
    for graph in (trained[0] / "agent.onnx", Path(str(resources.files("armctl.rl.agents"))) / "reach_ppo.onnx"):
        assert b".py" not in graph.read_bytes()
        assert str(Path.home()).encode() not in graph.read_bytes()


def test_training_is_reproducible(trained, tmp_path):
    out, card = trained
    again = train(out=tmp_path / "small", options=SMALL, seed=3, progress=False)
    worlds = ArmReachVectorEnv(20)
    observations, _ = worlds.reset(seed=1)
    actions = [load_agent(folder / "agent.json", worlds).act(observations) for folder in (out, tmp_path / "small")]
    np.testing.assert_allclose(actions[0], actions[1], atol=1e-4)
    assert again.evaluation == card.evaluation


def test_a_used_folder_is_not_overwritten_and_settings_must_match(trained):
    out, _ = trained
    with pytest.raises(ConfigurationError, match="--resume"):
        train(out=out, options=SMALL, seed=3)
    with pytest.raises(ConfigurationError, match="seed 3, not 4"):
        train(out=out, options=SMALL, seed=4, resume=True)
    with pytest.raises(ConfigurationError, match=r"gamma 0.97, not 0.5"):
        train(out=out, options=dataclasses.replace(SMALL, gamma=0.5), seed=3, resume=True)


def test_a_killed_training_resumes_and_a_finished_one_may_go_on(trained, tmp_path):
    out = shutil.copytree(trained[0], tmp_path / "small")
    (out / "clock.json").unlink()
    (out / "checkpoints" / "unfinished.zip").write_text("half a file")
    card = train(out=out, options=dataclasses.replace(SMALL, steps=6000), seed=3, resume=True, progress=False)
    assert card.training_steps == 6144


def test_an_unusable_option_leaves_no_folder(tmp_path):
    with pytest.raises(ConfigurationError, match="control"):
        train(out=tmp_path / "run", env_options={"control": "nope"}, options=SMALL)
    assert not (tmp_path / "run").exists()


def test_only_environments_with_a_recipe_are_trained(tmp_path):
    with pytest.raises(ConfigurationError, match="ArmReach"):
        train("CartPole-v1", out=tmp_path)


@pytest.mark.slow
def test_an_interrupted_training_resumes(tmp_path):
    armctl = str(Path(sys.executable).parent / "armctl")
    command = [armctl, "train", "ppo", "--steps", "60000", "--out", "run"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        for _ in range(600):
            time.sleep(0.1)
            if list((tmp_path / "run" / "tensorboard").glob("events*")):
                break
        time.sleep(3)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert "--resume" in output
    assert list((tmp_path / "run" / "checkpoints").glob("*.zip"))
    subprocess.run([*command, "--resume"], cwd=tmp_path, check=True, env=os.environ, capture_output=True)
    card = json.loads((tmp_path / "run" / "agent.json").read_text())
    assert 60_000 <= card["training_steps"] < 70_000


def test_adapter_tells_of_ended_episodes():
    venv = adapter(6, max_episode_steps=3)
    venv.seed(5)
    start = venv.reset()
    for _ in range(3):
        observations, rewards, done, infos = venv.step(np.zeros((6, 6), dtype=np.float32))
    assert done.all()
    assert (rewards == -1).all()
    for world, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert info["episode"] == {"r": -3.0, "l": 3}
        assert not info["is_success"]
        np.testing.assert_allclose(info["terminal_observation"][9:], start[world, 9:])
    assert not np.allclose(observations[:, 9:], start[:, 9:])


@pytest.mark.parametrize("control", ["position", "delta", "velocity", "torque"])
def test_scaled_actions_lie_in_the_action_space(control):
    env = ArmReachVectorEnv(40, control=control)
    observations, _ = env.reset(seed=0)
    scale = ActionScale(control, env.single_action_space)
    raw = torch.randn(40, 6) * 3
    for action in scale(torch.as_tensor(observations), raw).numpy():
        assert env.single_action_space.contains(action)


def test_shaped_reward_is_the_plain_one_and_progress():
    env = ArmReachVectorEnv(8, reward=SHAPED_REWARD)
    before, _ = env.reset(seed=0)
    after, rewards, *_ = env.step(np.zeros((8, 6)))
    distance = [np.linalg.norm(seen[:, :3] - seen[:, 9:], axis=1) for seen in (before, after)]
    np.testing.assert_allclose(rewards, -1 + 50 * (distance[0] - distance[1]), atol=1e-4)


CAMERA = {"resolution": (8, 6)}


@pytest.fixture(scope="module")
def trained_on_bridge(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "bridge"
    options = dataclasses.replace(
        RECIPES["armctl/BridgeCross-v0"].options, steps=1024, worlds=16, evaluation_episodes=4
    )
    return out, train("armctl/BridgeCross-v0", out=out, options=options, env_options=CAMERA, progress=False)


def test_a_camera_agent_is_trained_exported_and_loaded(trained_on_bridge):
    from stable_baselines3 import PPO

    out, card = trained_on_bridge
    assert card.observation_shape == {"image": [6, 8], "motion": [3]}
    assert card.interface["camera"] == "depth 8 x 6, 110 degrees, to 10 m"
    worlds = BridgeCrossVectorEnv(20, **CAMERA)
    observations, _ = worlds.reset(seed=0)
    model = PPO.load(out / "checkpoints" / "ppo_1024_steps", device="cpu")
    raw = np.clip(model.predict(observations, deterministic=True)[0], -1, 1)
    (slow, fast), (right, left) = LINEAR, ANGULAR
    expected = np.array((slow + fast, right + left)) / 2 + np.array((fast - slow, left - right)) / 2 * raw
    np.testing.assert_allclose(load_agent(out / "agent.json", worlds).act(observations), expected, atol=1e-5)
    for env in ("armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"):
        assert len(evaluate(str(out / "agent.json"), env, episodes=2, env_options=CAMERA)) == 2


@pytest.mark.parametrize(
    "options", [{}, {"camera": "classes", **CAMERA}, {"field_of_view": 80.0, **CAMERA}, {"observation": "state"}]
)
def test_a_camera_agent_refuses_another_camera(trained_on_bridge, options):
    with pytest.raises(AgentFileError):
        load_agent(trained_on_bridge[0] / "agent.json", BridgeCrossVectorEnv(1, **options))


def test_the_learner_sees_the_last_observation_of_an_episode_and_the_first_of_the_next():
    env = BridgeCrossVectorEnv(4, autoreset_mode="same_step", max_episode_steps=5, **CAMERA)
    venv = StableBaselinesVectorEnv(env, VelocityScale())
    venv.seed(0)
    first = venv.reset()
    for _ in range(5):
        observations, _, done, infos = venv.step(np.zeros((4, 2), dtype=np.float32))
    assert done.all()
    for world in range(4):
        last = infos[world]["terminal_observation"]
        assert infos[world]["TimeLimit.truncated"]
        assert last["image"].shape == (6, 8)
        assert last["motion"][0] > 0.1
        np.testing.assert_array_equal(observations["motion"][world], 0.0)
        assert not np.array_equal(last["image"], observations["image"][world])
    assert first["image"].shape == observations["image"].shape
