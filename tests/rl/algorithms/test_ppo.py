import json
import shutil
import signal
import subprocess
import time
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import PPO

from armctl.agents import load_agent
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.rl.algorithms.ppo import train
from armctl.rl.networks.actor import tensors
from armctl.rl.networks.frames import FeatureHistory
from armctl.rl.networks.view import view_of
from armctl.robots.arm import LARGEST_RELATIVE_MOVE
from armctl.rollout import evaluate
from armctl.tasks import BridgeTask, ReachTask
from armctl.tasks.bridge.bridge import LEARNER_VELOCITY
from armctl.training.learners import load_recipe

from ...command_line import ARMCTL, armctl

SMALL = {
    "steps": 1024,
    "worlds": 8,
    "rollout_length": 32,
    "batch_size": 128,
    "evaluation_every": 256,
    "validation_episodes": 10,
    "evaluation_episodes": 20,
}


def small(**options):
    return load_recipe("reach_ppo").changed(
        shaping="distance", shaping_scale=50.0, options={**SMALL, **options}, env_options={"max_episode_steps": 40}
    )


def shown_features(worlds, observations):
    """What the model sees of observations."""
    features = FeatureHistory(view_of(worlds), worlds.single_observation_space)
    return features(tensors(observations))[0].numpy()


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "small"
    return out, train(small(), out=out, seed=3, progress=False)


@pytest.mark.slow
def test_training_leaves_a_runnable_agent_its_card_logs_curve_and_checkpoints(trained):
    out, card = trained
    assert card == card.model_validate_json((out / "agent.json").read_bytes())
    assert (card.recipe, card.learner, card.shaping, card.teacher) == ("reach_ppo", "ppo", "distance", None)
    assert (card.training_steps, card.training_seed, card.evaluation.episodes) == (1024, 3, 20)
    assert pd.read_csv(out / "curve.csv").steps.tolist() == [0, 256, 512, 768, 1024]
    assert card.best_after in range(0, 1025, 256)
    assert (out / "checkpoints" / "1024.zip").is_file()
    assert list((out / "tensorboard").glob("events*"))
    assert len(evaluate(str(out / "agent.json"), episodes=3)) == 3


@pytest.mark.slow
def test_exported_graph_is_the_network(trained):
    out, card = trained
    worlds = TaskVectorEnv(50, task=ReachTask)
    observations, _ = worlds.reset(seed=0)
    model = PPO.load(out / "checkpoints" / f"{card.best_after}.zip", device="cpu")
    raw = model.predict(shown_features(worlds, observations), deterministic=True)[0]
    expected = observations[:, 3:9] + LARGEST_RELATIVE_MOVE * np.clip(raw, -1, 1)
    np.testing.assert_allclose(load_agent(out / "agent.json", worlds).act(observations), expected, atol=1e-5)


@pytest.mark.slow
def test_exported_graph_tells_nothing_of_the_machine(trained):
    for graph in (trained[0] / "agent.onnx", Path(str(resources.files("armctl.rl.agents"))) / "reach_ppo.onnx"):
        assert b".py" not in graph.read_bytes()
        assert str(Path.home()).encode() not in graph.read_bytes()


@pytest.mark.slow
def test_training_is_reproducible(trained, tmp_path):
    out, card = trained
    again = train(small(), out=tmp_path / "small", seed=3, progress=False)
    worlds = TaskVectorEnv(20, task=ReachTask)
    observations, _ = worlds.reset(seed=1)
    actions = [load_agent(folder / "agent.json", worlds).act(observations) for folder in (out, tmp_path / "small")]
    np.testing.assert_allclose(actions[0], actions[1], atol=1e-4)
    assert again.evaluation == card.evaluation
    assert again.best_after == card.best_after


@pytest.mark.slow
def test_a_killed_training_resumes_and_a_finished_one_may_go_on(trained, tmp_path, unexported):
    out = shutil.copytree(trained[0], tmp_path / "small")
    (out / "checkpoints" / "unfinished-9999.zip").write_text("half a file")
    card = train(small(steps=1500), out=out, seed=3, resume=True, progress=False)
    assert card.training_steps == 1536
    assert pd.read_csv(out / "curve.csv").steps.tolist() == [0, 256, 512, 768, 1024, 1280, 1536]


def test_another_gamma_is_another_training(trained):
    with pytest.raises(ConfigurationError, match=r"gamma 0.97, not 0.5"):
        train(small(gamma=0.5), out=trained[0], seed=3, resume=True)


@pytest.mark.slow
def test_an_interrupted_training_leaves_a_checkpoint_and_resumes(tmp_path):
    options = (
        "evaluation_every=20000",
        "validation_episodes=4",
        "evaluation_episodes=4",
        "worlds=16",
        "rollout_length=32",
        "batch_size=128",
    )
    command = ["train", "reach_ppo", "--shaping", "none", "--out", "run"]
    command += [word for option in options for word in ("--option", option)]
    begun = [ARMCTL, *command, "--steps", "1000000"]
    with subprocess.Popen(begun, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        for _ in range(900):
            time.sleep(0.1)
            if (tmp_path / "run" / "curve.csv").exists():
                break
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=600)
    assert process.returncode == 130, output
    assert "--resume" in output
    at = max(int(path.stem) for path in (tmp_path / "run" / "checkpoints").glob("[0-9]*.zip"))
    assert at > 0
    before = (tmp_path / "run" / "curve.csv").read_text()
    armctl(*command, "--resume", "--steps", str(at + 600), cwd=tmp_path)
    assert (tmp_path / "run" / "curve.csv").read_text().startswith(before)
    card = json.loads((tmp_path / "run" / "agent.json").read_text())
    assert at + 600 <= card["training_steps"] < at + 600 + 16 * 32


CAMERA: dict[str, Any] = {"resolution": [8, 6], "max_episode_steps": 40}


@pytest.fixture(scope="module")
def trained_on_bridge(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "bridge"
    options = {"steps": 512, "worlds": 16, "validation_episodes": 2, "evaluation_episodes": 2, "batch_size": 256}
    recipe = load_recipe("bridge_depth_ppo").changed(env_options=CAMERA, options=options)
    return out, train(recipe, out=out, seed=0, progress=False)


@pytest.mark.slow
def test_a_camera_agent_is_trained_exported_and_loaded(trained_on_bridge):
    out, card = trained_on_bridge
    assert card.observation_shape == {"image": [6, 8], "motion": [3]}
    assert card.interface["camera"] == "depth 8 x 6, 110 degrees, to 10 m"
    assert card.reward_weights == {"collision": 0.2, "fall": 0.2}
    worlds = TaskVectorEnv(20, task=BridgeTask, **CAMERA)
    observations, _ = worlds.reset(seed=0)
    model = PPO.load(out / "checkpoints" / f"{card.best_after}.zip", device="cpu")
    raw = np.clip(model.predict(shown_features(worlds, observations), deterministic=True)[0], -1, 1)
    (slow, fast), (right, left) = LEARNER_VELOCITY.T
    expected = np.array((slow + fast, right + left)) / 2 + np.array((fast - slow, left - right)) / 2 * raw
    np.testing.assert_allclose(load_agent(out / "agent.json", worlds).act(observations), expected, atol=1e-5)
    for env in ("armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"):
        assert len(evaluate(str(out / "agent.json"), env, episodes=2, env_options=CAMERA)) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{}, {"camera": "classes", **CAMERA}, {"field_of_view": 80.0, **CAMERA}, {"observation": "state"}]
)
def test_a_camera_agent_refuses_another_camera(trained_on_bridge, options):
    with pytest.raises(AgentFileError):
        load_agent(trained_on_bridge[0] / "agent.json", TaskVectorEnv(1, task=BridgeTask, **options))
