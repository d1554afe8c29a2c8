"""What `armctl export` refuses: files that nobody trusts, files that are none, and agents that act otherwise."""

import base64
import json
import os
import pickle
import re
import sys
import tracemalloc
import types
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from armctl.core.errors import AgentFileError
from armctl.rl.export import sb3_check, sb3_file
from armctl.rl.export.sb3 import export
from armctl.training.learners import ModelExport
from tests.command_line import armctl
from tests.rl.sb3_models import exported, make, normalised, register

register()


class Harmful:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def poisoned(path, witness):
    """A model whose pickled policy class would create the file `witness`."""
    make(PPO, "Pendulum-v1").save(path)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(files["data"])
    data["policy_class"][":serialized:"] = base64.b64encode(pickle.dumps(Harmful(witness))).decode()
    files["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("trust", [False, True])
def test_nothing_is_unpickled_without_trust(trust, tmp_path):
    poisoned(tmp_path / "model.zip", tmp_path / "from_model")
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(Harmful(tmp_path / "from_statistics")))
    arguments = ["export", "model.zip", "--env", "Pendulum-v1", *["--trust"][: int(trust)]]
    done = armctl(*arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert ("can run any code" in done.stderr) is not trust
    assert (tmp_path / "from_model").exists() is trust, "and with trust, the test would notice"
    assert not (tmp_path / "from_statistics").exists()
    assert not list(tmp_path.glob("*.onnx"))


def test_without_trust_nothing_is_read(tmp_path):
    os.mkfifo(tmp_path / "model.zip")  # who opens it waits for ever
    with pytest.raises(AgentFileError, match="can run any code"):
        export(ModelExport(tmp_path / "model.zip", env="Pendulum-v1", out=tmp_path / "agent.onnx"))


def zipped(path, files, compression=zipfile.ZIP_DEFLATED):
    """A zip file of contents, or of as many zeros as a number says."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in files.items():
            with archive.open(name, "w") as file:
                if isinstance(content, int):
                    for _ in range(content // 2**20):
                        file.write(bytes(2**20))
                else:
                    file.write(content)
    return path


MODEL = {"data": b'{"policy_class": {}}', sb3_file.VERSION: b"2.9.0", "policy.pth": b""}


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"data": 128 * 2**20}, "'data' in it has 134,217,728 bytes, more than the 67,108,864"),
        ({sb3_file.VERSION: 2 * 2**20}, "'_stable_baselines3_version' in it has 2,097,152 bytes, more than the 1,048"),
        ({"policy.pth": 3 * 2**20}, "its weights have 3,145,728 bytes, more than the 3,000,000"),
        ({"policy.pth": 2 * 2**20, "more.pth": 2 * 2**20}, "its weights have 4,194,304 bytes, more than the 3,000,000"),
    ],
)
def test_a_small_file_that_grows_is_not_unpacked(files, says, tmp_path, monkeypatch):
    monkeypatch.setattr(sb3_file, "LARGEST_WEIGHTS", 3_000_000)
    path = zipped(tmp_path / "model.zip", MODEL | files)
    assert path.stat().st_size < 200_000
    with pytest.raises(AgentFileError, match=re.escape(says)):
        sb3_file.read(path)


@pytest.mark.slow
def test_what_a_zip_file_claims_of_its_sizes_is_not_believed(sized, tmp_path):
    size = sized(128, 512) * 2**20
    path = zipped(tmp_path / "model.zip", {"data": size})
    content = path.read_bytes()
    start = content.rindex(b"PK\1\2") + 24  # where the directory at its end has the size of the first file
    assert content[start : start + 4] == size.to_bytes(4, "little")
    path.write_bytes(content[:start] + (2**20).to_bytes(4, "little") + content[start + 4 :])
    tracemalloc.start()
    with pytest.raises(AgentFileError, match="is damaged"):
        sb3_file.read(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 0.56 * size, most


def test_a_compression_that_is_unpacked_as_a_whole_is_refused(tmp_path):
    path = zipped(tmp_path / "model.zip", {"data": 2**20}, zipfile.ZIP_LZMA)
    with pytest.raises(AgentFileError, match="'data' in it is compressed otherwise than Stable-Baselines3 does"):
        sb3_file.read(path)


def test_a_pipe_as_a_model_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "model.zip")
    with pytest.raises(AgentFileError, match="not a regular file"):
        sb3_file.read(tmp_path / "model.zip")
    os.mkfifo(tmp_path / "statistics.pkl")
    with pytest.raises(AgentFileError, match="not a regular file"):
        sb3_file.load_normalisation(tmp_path / "statistics.pkl")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with models, and files that are none."""
    folder = tmp_path_factory.mktemp("saved")
    make(PPO, "Pendulum-v1").save(folder / "model.zip")
    make(PPO, "sb3/two-push-v0", "MultiInputPolicy").save(folder / "parts.zip")
    (folder / "empty.zip").touch()
    (folder / "cut.zip").write_bytes((folder / "model.zip").read_bytes()[:5000])
    for name, files in {"foreign": {"a": "b"}, "list": {"data": "[]"}, "json": {"data": "{"}}.items():
        with zipfile.ZipFile(folder / f"{name}.zip", "w") as archive:
            for file, content in files.items():
                archive.writestr(file, content)
    (folder / "junk.pkl").write_bytes(b"junk")
    (folder / "list.pkl").write_bytes(pickle.dumps([1]))
    (folder / "model.onnx").write_text("there")
    normalised("CartPole-v1", folder, "cartpole.pkl")
    normalised("sb3/two-push-v0", folder, "parts.pkl")
    return folder


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.zip"], "there is no model nowhere.zip"),
        (["empty.zip"], "empty.zip is not a zip file"),
        (["cut.zip"], "cut.zip is not a zip file"),
        (["foreign.zip"], "foreign.zip is not a model"),
        (["list.zip"], "list.zip is not a model"),
        (["json.zip"], "json.zip is not a zip file"),
        (["model.pt"], "model.pt cannot be exported: models are files .zip"),
        (["model.zip", "--out", "agent.json"], "an agent is a file .onnx"),
        (["model.zip", "--out", "model.onnx"], "--overwrite"),
        (["model.zip", "--env", "CartPole-v1"], "trained with actions Box"),
        (["model.zip", "--env", "armctl/ArmReach-v0"], "trained with actions Box"),
        (["model.zip", "--env", "MountainCarContinuous-v0"], "trained with actions Box"),
        (["parts.zip", "--env", "sb3/vector-push-v0"], "trained with observations Dict"),
        (["model.zip", "--env", "Pendulum-v11"], "no environment"),
        (["model.zip", "--vecnormalize", "none.pkl"], "none.pkl cannot be read: No such file"),
        (["model.zip", "--vecnormalize", "junk.pkl"], "junk.pkl cannot be loaded"),
        (["model.zip", "--vecnormalize", "list.pkl"], "list.pkl holds a list"),
        (["model.zip", "--vecnormalize", "cartpole.pkl"], "shape (4,)"),
        (["model.zip", "--vecnormalize", "parts.pkl"], "there is none"),
        (["model.zip", "--algorithm", "ppoo"], "Did you mean 'ppo'"),
        (["model.zip", "--algorithm", "sac"], "cannot be loaded as a model of sac"),
        (["model.zip", "--out", "/dev/null/agent.onnx"], "cannot be written"),
        pytest.param(["model.zip", "--out", "/proc/agent.onnx"], "cannot be written", marks=pytest.mark.slow),
    ],
)
def test_mistakes_get_one_clear_line_and_leave_nothing(arguments, says, saved):
    before = sorted(saved.rglob("*"))
    default = {"--env": "Pendulum-v1", "--out": "agent.onnx"}
    given = [
        *arguments,
        *(word for option, value in default.items() if option not in arguments for word in (option, value)),
    ]
    done = armctl("export", *given, "--trust", cwd=saved, check=False)
    assert done.returncode == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(saved.rglob("*")) == before


def test_a_network_whose_code_is_missing(tmp_path):
    module = types.ModuleType("gone")
    exec(
        "from stable_baselines3.common.torch_layers import FlattenExtractor\nclass Mine(FlattenExtractor): pass",
        vars(module),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "gone", module)
        model = make(PPO, "Pendulum-v1", policy_kwargs={"features_extractor_class": module.Mine})
        model.save(tmp_path / "model.zip")
    done = armctl("export", "model.zip", "--env", "Pendulum-v1", "--trust", cwd=tmp_path, check=False)
    assert "cannot be loaded as a model of ppo: ModuleNotFoundError: No module named 'gone'" in done.stderr


@pytest.mark.slow
def test_an_agent_is_replaced_if_told_so(tmp_path):
    model = make(PPO, "Pendulum-v1")
    exported(model, "Pendulum-v1", tmp_path)
    exported(model, "Pendulum-v1", tmp_path, "--overwrite")


@pytest.mark.slow
def test_an_agent_that_acts_otherwise_is_not_written(tmp_path, monkeypatch):
    model = make(PPO, "Pendulum-v1")
    model.save(tmp_path / "model.zip")
    predict = PPO.predict
    monkeypatch.setattr(PPO, "predict", lambda *a, **k: (predict(*a, **k)[0] + 0.01, None))
    with pytest.raises(AgentFileError, match=r"differ by 0\.00\d+ of the range"):
        export(
            ModelExport(tmp_path / "model.zip", env="Pendulum-v1", out=tmp_path / "agents" / "agent.onnx", trust=True)
        )
    assert [path.name for path in tmp_path.iterdir()] == ["model.zip"]


@pytest.mark.slow
def test_a_model_that_diverged_is_not_written(tmp_path):
    model = make(PPO, "Pendulum-v1")
    with torch.no_grad():
        model.policy.action_net.bias.fill_(np.nan)
    model.save(tmp_path / "model.zip")
    done = armctl("export", "model.zip", "--env", "Pendulum-v1", "--trust", cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"armctl: the model cannot act in this environment: ValueError: .*\n", done.stderr)
    assert not list(tmp_path.glob("*.onnx"))


def test_differences_are_shares_of_the_range():
    push = gymnasium.spaces.Box(np.array([-1.0, 0.0]), np.array([3.0, 1.0]), dtype=np.float64)
    wanted, found = np.array([[1.0, 3.0], [0.0, 0.0]]), np.array([[1.4, 3.0], [0.0, 0.5]])
    np.testing.assert_allclose(sb3_check._difference(push, wanted, found), [0.1, 0.5])
    choice = gymnasium.spaces.Discrete(3)
    np.testing.assert_array_equal(sb3_check._difference(choice, np.array([0, 2]), np.array([0, 1])), [0, 1])
    with pytest.raises(AgentFileError, match="shape"):
        sb3_check._difference(choice, np.array([0, 2]), np.array([[0], [1]]))
