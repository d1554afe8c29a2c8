"""Which algorithm a model is of, by its own class or values, and models whose spaces another version pickled."""

import base64
import json
import pickle
import zipfile

import pytest
from sb3_contrib import ARS, QRDQN, TQC, TRPO, CrossQ, MaskablePPO, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.policies import ActorCriticPolicy

from armctl.core.errors import AgentFileError
from armctl.rl.export import sb3_file
from tests.command_line import armctl
from tests.rl.sb3_models import SMALL, make, register

ALGORITHMS = {
    "a2c": (A2C, "Pendulum-v1", {}), "ppo": (PPO, "Pendulum-v1", {}), "ddpg": (DDPG, "Pendulum-v1", SMALL),
    "td3": (TD3, "Pendulum-v1", SMALL), "sac": (SAC, "Pendulum-v1", SMALL), "dqn": (DQN, "CartPole-v1", SMALL),
    "tqc": (TQC, "Pendulum-v1", SMALL), "recurrent_ppo": (RecurrentPPO, "Pendulum-v1", {}),
}  # fmt: skip
OTHERS = {
    "qrdqn": (QRDQN, "CartPole-v1", SMALL), "trpo": (TRPO, "Pendulum-v1", {}), "ars": (ARS, "Pendulum-v1", {}),
    "crossq": (CrossQ, "Pendulum-v1", SMALL), "maskable_ppo": (MaskablePPO, "CartPole-v1", {}),
}  # fmt: skip


@pytest.fixture(autouse=True)
def environments():
    register()


def file_of(kind, env, options, folder):
    kind("MlpLstmPolicy" if kind is RecurrentPPO else "MlpPolicy", env, device="cpu", **options).save(folder / "m.zip")
    return sb3_file.read(folder / "m.zip")


@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_algorithm_is_told(name, tmp_path):
    assert file_of(*ALGORITHMS[name], tmp_path).algorithm() == name


@pytest.mark.parametrize("name", OTHERS)
def test_another_algorithm_is_not_taken_for_its_neighbour(name, tmp_path):
    with pytest.raises(AgentFileError, match=f"is a model of {name}; armctl exports those of a2c, ddpg"):
        file_of(*OTHERS[name], tmp_path).algorithm()


class Mine(ActorCriticPolicy):
    pass


@pytest.mark.parametrize(("kind", "name"), [(PPO, "ppo"), (A2C, "a2c"), (TRPO, None)])
def test_a_policy_of_ones_own_is_told_by_its_values(kind, name, tmp_path):
    kind(Mine, "Pendulum-v1", device="cpu").save(tmp_path / "m.zip")
    file = sb3_file.read(tmp_path / "m.zip")
    if name is None:
        with pytest.raises(AgentFileError, match="is a model of trpo"):
            file.algorithm()
    else:
        assert file.algorithm() == name


UNREADABLE = {
    "of a package that is missing": b"cgym.spaces.box\nBox\n.", "junk": b"\x80\x04junk.", "empty": b"",
    "something else": pickle.dumps([1]), "of an attribute that is missing": b"cgymnasium.spaces\nBoxes\n.",
}  # fmt: skip


def with_spaces(path, content):
    """Replaces the pickled spaces of a model."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    values = json.loads(parts["data"])
    for name in sb3_file.SPACES:
        values[name][":serialized:"] = base64.b64encode(content).decode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, part in (parts | {"data": json.dumps(values)}).items():
            archive.writestr(name, part)


@pytest.mark.slow
@pytest.mark.parametrize("content", UNREADABLE.values(), ids=UNREADABLE)
def test_spaces_that_cannot_be_read_are_those_of_the_environment(content, tmp_path):
    model = make(PPO, "Pendulum-v1")
    model.save(tmp_path / "model.zip")
    with_spaces(tmp_path / "model.zip", content)
    done = armctl("export", "model.zip", "--env", "Pendulum-v1", "--out", "agent.onnx", "--trust", cwd=tmp_path)
    assert "act alike" in done.stdout
    assert not done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "policy"), [("sb3/image-push-v0", "CnnPolicy"), ("sb3/parts-push-v0", "MultiInputPolicy")]
)
def test_images_had_their_channels_first(env, policy, tmp_path):
    make(PPO, env, policy).save(tmp_path / "model.zip")
    with_spaces(tmp_path / "model.zip", b"junk")
    armctl("export", "model.zip", "--env", env, "--out", "agent.onnx", "--trust", cwd=tmp_path)


def test_an_environment_of_another_size_does_not_stand_in(tmp_path):
    make(PPO, "Pendulum-v1").save(tmp_path / "model.zip")
    with_spaces(tmp_path / "model.zip", b"junk")
    words = ("export", "model.zip", "--env", "MountainCarContinuous-v0", "--out", "agent.onnx", "--trust")
    done = armctl(*words, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "cannot be loaded as a model of ppo" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["model.zip"]
