"""An agent's way to a hub and back, and what on that way may go wrong."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from armctl.agents import load_agent, read_card
from armctl.core.errors import AgentFileError, ConfigurationError, HubError, ResultsError
from armctl.envs import make_worlds
from armctl.integrations.hub import model_card, pull, push
from armctl.integrations.hub.download import LARGEST
from armctl.policies.trainings import card_path

from ...command_line import armctl, program
from .fake_hub import FILES, NAME, contents, published


def edit(folder, **changes):
    card = folder / "agent.json"
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


@pytest.mark.parametrize("lfs", [False, True])
def test_what_is_pulled_is_what_was_pushed(hub, agent, lfs):
    hub.lfs = lfs
    assert push(agent, NAME) == f"{hub.address}/{NAME}"
    assert sorted(hub.files(NAME)) == sorted([*FILES, "README.md"])
    card = pull(NAME)
    assert card == Path("agents/owner/reach/agent.json")
    assert contents(card.parent) == contents(agent)
    worlds = make_worlds("armctl/ArmReach-v0", 3)
    observations, _ = worlds.reset(seed=0)
    pushed, pulled = (load_agent(path, worlds) for path in (agent / "agent.json", card))
    np.testing.assert_array_equal(pulled.act(observations), pushed.act(observations))


def test_the_model_card_is_on_the_hub(hub, agent):
    push(agent, NAME, licence="mit")
    text = hub.files(NAME)["README.md"].decode()
    assert text == model_card(read_card(agent / "agent.json"), NAME, "mit")


@pytest.mark.parametrize("name", ["reach_ppo", "trained/agent.json", "trained/agent.onnx", "reach_ppo[1]"])
def test_an_agent_may_be_named_in_several_ways(hub, agent, name):
    push(name, NAME)
    assert hub.files(NAME)["agent.onnx"] == (agent / "agent.onnx").read_bytes()
    assert "curve.csv" in hub.files(NAME)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("reach_pppo", "Did you mean 'reach_ppo'"),
        ("reach_ik", "not a learned agent"),
        ("missing.json", "there is no agent"),
        ("empty", "has no agent.json"),
    ],
)
def test_what_is_no_agent_is_not_pushed(hub, tmp_path, name, says):
    (tmp_path / "empty").mkdir()
    with pytest.raises((ConfigurationError, AgentFileError), match=says):
        push(name, NAME)
    assert hub.asked == []


def test_what_pull_would_refuse_is_not_pushed(hub, agent):
    (agent / "curve.csv").write_text("steps\nmany\n")
    with pytest.raises(ResultsError, match=r"curve\.csv"):
        push(agent, NAME)
    edit(agent, sha256="0" * 64)
    with pytest.raises(AgentFileError, match="changed, or damaged"):
        push(agent, NAME)
    assert hub.asked == []


def test_pushing_again_replaces_the_curve_too(hub, agent):
    push(agent, NAME, message="first")
    (agent / "curve.csv").unlink()
    push(agent, NAME)
    assert "curve.csv" not in hub.files(NAME)
    commits = list(hub.repositories[NAME]["commits"])
    first = pull(f"{NAME}@{commits[1]}", Path("first"))
    assert (first.parent / "curve.csv").exists()
    pull(NAME, Path("first"), overwrite=True)
    assert not (first.parent / "curve.csv").exists()


def test_a_private_agent_stays_private(hub, agent, monkeypatch, nothing_written):
    push(agent, NAME, private=True)
    assert hub.repositories[NAME]["private"]
    push(agent, NAME, private=True)
    monkeypatch.delenv("HF_TOKEN")
    with pytest.raises(HubError, match=r"has no owner/reach, or it is not for you: `hf auth login`"):
        pull(NAME)


def test_a_private_agent_is_not_pushed_into_a_public_repository(hub, agent):
    hub.put(NAME, {})
    with pytest.raises(ConfigurationError, match="is public: nothing was uploaded"):
        push(agent, NAME, private=True)
    assert hub.files(NAME) == {}


def test_a_licence_that_the_hub_does_not_know(hub, agent):
    with pytest.raises(HubError, match=r"must be one of \[apache-2.0, mit\]"):
        push(agent, NAME, licence="mine")
    assert hub.files(NAME) == {}


@pytest.mark.parametrize("token", ["", "hf_of_another"])
def test_without_the_right_token(hub, agent, monkeypatch, token):
    monkeypatch.setenv("HF_TOKEN", token)
    with pytest.raises(HubError, match=r"status 401.*HF_TOKEN") as raised:
        push(agent, NAME)
    assert not token or token not in str(raised.value)


def test_what_is_others_is_not_written_to(hub, agent):
    with pytest.raises(HubError, match="status 403: You don't have the rights"):
        push(agent, "somebody/reach")


def test_nothing_else_is_downloaded(hub, agent):
    commit = published(hub, agent, **{"model.pkl": b"\x80", "evil.py": b"", "README.md": b"", "agent.onnx.data": b""})
    folder = pull(NAME).parent
    assert sorted(contents(folder)) == sorted(path.name for path in folder.iterdir() if path.name != ".lock")
    assert hub.asked == [
        f"GET /api/models/{NAME}", *(f"GET /{NAME}/resolve/{commit}/{file}" for file in LARGEST)
    ]  # fmt: skip


def test_another_agent_is_not_overwritten(hub, agent, tmp_path):
    published(hub, agent)
    pull(NAME, agent)  # the same
    other = tmp_path / "other"
    other.mkdir()
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_bc").with_suffix(suffix), other / f"agent{suffix}")
    before = contents(other)
    with pytest.raises(ConfigurationError, match=r"agent\.json is there already, and differs: --overwrite"):
        pull(NAME, other)
    assert contents(other) == before
    pull(NAME, other, overwrite=True)
    assert contents(other) == contents(agent)


def test_nothing_is_written_through_a_link(hub, agent, tmp_path):
    published(hub, agent)
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "agent.onnx").symlink_to(tmp_path / "mine.txt")
    with pytest.raises(ConfigurationError, match="is there already"):
        pull(NAME, tmp_path / "out")
    pull(NAME, tmp_path / "out", overwrite=True)
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_folder_that_cannot_be_written_to(hub, agent, tmp_path):
    published(hub, agent)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/agents"), tmp_path / ("x" * 300)):
        with pytest.raises(ResultsError):
            pull(NAME, out)
    if os.geteuid():  # root may write anywhere
        (tmp_path / "closed").mkdir(mode=0o500)
        with pytest.raises(ResultsError, match="Permission denied"):
            pull(NAME, tmp_path / "closed")


@pytest.mark.slow
def test_on_a_full_disk_nothing_is_written(hub, agent, tmp_path):
    published(hub, agent)
    done = program("pull", NAME, cwd=tmp_path, check=False, disk=100_000)
    assert done.returncode == 2
    assert "cannot be written to agents/owner/reach: File too large" in done.stderr
    assert not (tmp_path / "agents").exists()


@pytest.mark.slow
def test_the_verbs(hub, agent, tmp_path):
    done = program("push", agent, NAME, "--licence", "mit", "--message", "An agent", cwd=tmp_path)
    assert done.stdout == f"{agent} is at {hub.address}/{NAME}. To get it: armctl pull {NAME}\n"
    done = program("pull", NAME, "--out", "here", cwd=tmp_path)
    command = "armctl compare reach_ik here/agent.json --env armctl/ArmReach-v0"
    assert done.stdout == f"The agent is here/agent.json: {command}\n"
    armctl(*command.split()[1:], "--episodes", "2", "--out", "results", cwd=tmp_path)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"env": "evil:Maze"}, "names the code evil:Maze, and a file never runs code"),
        ({"env": "evil.py:Maze"}, "names the code evil.py:Maze"),
        ({"env": "Nowhere-v7"}, "there is no environment 'Nowhere-v7'"),
        ({"env": "armctl/\x1b[2J-v0"}, "\\x1b[2J"),
        ({"env_options": {"robot": "$(touch ran); 'x"}}, """--set 'robot=$(touch ran); '"'"'x'"""),
    ],
)
def test_what_is_said_of_a_strangers_card(hub, agent, tmp_path, changes, says):
    edit(agent, **changes)
    published(hub, agent)
    (tmp_path / "evil.py").write_text("from pathlib import Path\nPath('ran').touch()\n")
    done = armctl("pull", NAME, cwd=tmp_path)
    assert says in done.stdout
    assert "\x1b" not in done.stdout
    assert not (tmp_path / "ran").exists()


@pytest.mark.slow
def test_without_the_extra_one_line_says_what_to_install(tmp_path):
    code = """
import sys
class NoHub:
    def find_spec(name, path, target=None):
        if name.startswith("huggingface_hub"):
            raise ModuleNotFoundError("No module named 'huggingface_hub'", name="huggingface_hub")
sys.meta_path.insert(0, NoHub)
from armctl.cli import main
main()
"""
    for words in (("push", "reach_ppo", NAME), ("pull", NAME)):
        command = [sys.executable, "-c", code, *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith("armctl: sharing agents needs huggingface_hub: pip install 'armctl-suite[hub]'")
        assert done.stderr.count("\n") == 1
