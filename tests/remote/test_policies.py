"""Policies in other processes play the same episodes, and whatever goes wrong there ends nothing here."""

import gc
import sys
import threading
import time

import numpy as np
import pandas as pd
import psutil
import pytest

from armctl.core.errors import ConfigurationError
from armctl.remote.connection import host_of
from armctl.remote.host import serve
from armctl.runtime.policy_server import serve_policy
from armctl.study import compare
from armctl.study.results import read_comparison

SHORT = {"max_episode_steps": 12}
DONE = {"armctl": 1, "identity": "fake"}
MINE = """
import os, sys, time
import numpy as np

class Counts:
    kind, training_steps, family = "learned", 500, 3
    def __init__(self):
        self.decisions = 0
    def reset(self):
        self.decisions = 0
    def act(self, observation):
        self.decisions += 1
        return np.full(6, 0.01 * self.decisions)

class Dies(Counts):
    def act(self, observation):
        if self.decisions == 5:
            os._exit(3)
        return super().act(observation)

class Errs(Counts):
    def act(self, observation):
        if self.decisions == 5:
            raise ValueError("five is enough")
        return super().act(observation)

def exits(observation):
    sys.exit("no more")

def sleeps(observation):
    time.sleep(60)
"""


class Fake:
    """A server's handler that answers what it is told to."""

    def __init__(self, answer, metadata=DONE):
        self.metadata, self._answer = metadata, answer

    def answer(self, message):
        return {} if message.get("armctl") == "begin" else self._answer(message)

    def close(self):
        pass


@pytest.fixture
def server():
    """Starts a server in this process, and returns its address."""

    def start(serve_on):
        ready, ports = threading.Event(), []

        def tell(port):
            ports.append(port)
            ready.set()

        threading.Thread(target=serve_on, args=(tell,), daemon=True).start()
        assert ready.wait(60)
        return f"ws://127.0.0.1:{ports[0]}"

    return start


@pytest.fixture
def fake(server):
    return lambda *arguments: server(lambda tell: serve(lambda: Fake(*arguments), "127.0.0.1", 0, tell))


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    return lambda name: f"python={sys.executable}:{tmp_path / 'mine.py'}:{name}"


def rows(comparison, policy):
    table = comparison.episodes
    return table[table.policy == policy].drop(columns=["policy"]).filter(regex="^(?!decision|first_call|reset_ms|run)")


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "worlds", "workers"), [("reach_ik", 3, 1), ("reach_ppo", 2, 2)])
def test_a_served_policy_plays_the_same_episodes(server, policy, worlds, workers):
    url = server(lambda tell: serve_policy(policy, "armctl/ArmReach-v0", {}, "127.0.0.1", 0, tell))
    both = compare([url, policy], episodes=6, worlds=worlds, workers=workers)
    assert not both.failures
    pd.testing.assert_frame_equal(rows(both, url).reset_index(drop=True), rows(both, policy).reset_index(drop=True))
    served, local = both.policies
    assert (served.sees, served.isolated, local.isolated) == (local.sees, True, False)
    assert workers > 1 or served.transport_ms > 0


def test_a_served_hybrid_is_one_here(server, tmp_path):
    (tmp_path / "both.py").write_text(
        "import armctl\n\n@armctl.sees('observation', kind='hybrid')\ndef act(observation):\n"
        "    return observation[3:9]\n"
    )
    name = f"{tmp_path / 'both.py'}:act"
    url = server(lambda tell: serve_policy(name, "armctl/ArmReach-v0", {}, "127.0.0.1", 0, tell))
    (policy,) = compare([url], episodes=1, env_options=SHORT).policies
    assert policy.side == "hybrid"


def test_a_server_of_openpi_sends_chunks(fake):
    asked = []

    def chunk(message):
        asked.append(message)
        return {"actions": np.full((5, 6), 0.1), "server_timing": {"infer_ms": 0.0625}}

    url = fake(chunk, {"model": "pi0"}) + "?observation=observation/state&prompt=reach"
    played = compare([url], episodes=1, env_options=SHORT)
    assert not played.failures
    assert len(asked) == 3  # for 12 steps
    assert set(asked[0]) == {"observation/state", "prompt"}
    assert asked[0]["prompt"] == "reach"
    assert asked[0]["observation/state"].dtype == np.float32
    assert played.episodes.decision_ms_max.item() == 0.0625


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (lambda message: {"actions": np.full((2, 6), np.nan)}, "nan"),
        (lambda message: {"actions": np.zeros((2, 7))}, r"actions of shape \(2, 7\)"),
        (lambda message: {"actions": "left"}, "'left'"),
        (lambda message: {}, "None"),
        (lambda message: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_a_server_that_always_answers_nonsense_cannot_play_and_others_do(fake, answer, says):
    url = fake(answer)
    both = compare([url, "random"], episodes=4, worlds=2, env_options=SHORT)
    assert [*both.failures] == [url]
    assert pd.Series(both.failures[url]).str.contains(says).all()
    assert len(rows(both, "random")) == 4


def test_a_server_that_hangs_ends_its_policy_and_what_was_played_is_kept(fake, tmp_path):
    decisions = 0

    def answer(message):
        nonlocal decisions
        decisions += 1
        if decisions > 30:
            time.sleep(2)
        return {"actions": np.full((1, 6), 0.1)}

    url = fake(answer)
    both = compare([url, "random"], episodes=4, env_options=SHORT, timeout=0.5, out=tmp_path / "kept")
    assert "has not answered for 0.5 s" in both.failures[url]
    assert len(rows(both, "random")) == 4
    kept = read_comparison(tmp_path / "kept").episodes
    assert (kept[kept.policy == url].outcome == "timeout").sum() == 2


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ws://127.0.0.1:9", "does not answer"),
        ("ws://127.0.0.1:99999", "is no address"),
        ("ws://", "is no address"),
        ("python=nowhere/python:mine:go", "No such file"),
        (f"python={sys.executable}:no_such_module:go", "No module named 'no_such_module'"),
        (f"python={sys.executable}:json:no_such_name", "no_such_name"),
    ],
)
def test_what_cannot_be_reached_is_told_before_anything_is_played(name, says):
    with pytest.raises(ConfigurationError, match=says):
        compare([name], episodes=1)


def test_another_version_or_environment_is_refused(fake):
    for metadata, says in [
        ({"armctl": 2}, "version 2"),
        (DONE | {"env": "armctl/BridgeCross-v0"}, "plays armctl/BridgeCross-v0"),
        (DONE | {"sees": "everything"}, "everything"),
    ]:
        with pytest.raises(ConfigurationError, match=says):
            compare([fake(lambda message: {}, metadata)], episodes=1)


@pytest.mark.parametrize("policy", ["bridge_ompl", "bridge_mpc"])
def test_who_sees_the_state_is_not_served(policy):
    with pytest.raises(ConfigurationError, match="stays with the simulator"):
        serve_policy(policy, "armctl/BridgeCross-v0", {}, "127.0.0.1", 0, print)


@pytest.mark.slow
def test_code_for_another_python(mine, tmp_path):
    counts, errs, dies, leaves = map(mine, ("Counts", "Errs", "Dies", "exits"))
    played = compare([counts, errs, dies, leaves], episodes=4, worlds=2, env_options=SHORT)
    assert "has closed the connection" in played.failures[dies]
    assert "no more" in played.failures[leaves]
    assert set(played.failures) == {dies, errs, leaves}
    agent = next(policy for policy in played.policies if policy.policy == counts)
    assert (agent.side, agent.training.steps, agent.family) == ("learned", 500, counts)
    assert "ValueError: five is enough" in played.failures[errs]
    outcomes = {name: set(rows(played, name).outcome) for name in (counts, errs)}
    assert outcomes == {counts: {"timeout"}, errs: {"error"}}
    gc.collect()  # an error's traceback may refer to a policy, and so to its process
    hosts = [child for child in psutil.Process().children(recursive=True) if str(tmp_path) in " ".join(child.cmdline())]
    _, left = psutil.wait_procs(hosts, timeout=60)
    assert not left


@pytest.mark.slow
def test_a_process_that_was_ended_is_replaced(mine):
    first = host_of(mine("Counts"), "policy")
    assert host_of(mine("Counts"), "policy") is first
    first.end()
    assert not first.is_running
    assert host_of(mine("Counts"), "policy").is_running


@pytest.mark.slow
def test_another_python_that_hangs(mine):
    sleeps = mine("sleeps")
    played = compare([sleeps, "random"], episodes=2, env_options=SHORT, timeout=0.5)
    assert "has not answered for 0.5 s" in played.failures[sleeps]
    assert len(rows(played, "random")) == 2


@pytest.mark.slow
def test_a_resumed_folder_takes_no_other_code(mine, tmp_path):
    counts = mine("Counts")
    compare([counts], episodes=2, env_options=SHORT, out=tmp_path / "results")
    file = tmp_path / "mine.py"
    file.write_text(file.read_text().replace("0.01", "0.02"))
    with pytest.raises(Exception, match="mine"):
        compare([counts], episodes=4, env_options=SHORT, out=tmp_path / "results")
