import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from joblib.externals.loky import get_reusable_executor

from armctl.core.errors import ConfigurationError
from armctl.policies import make_policy
from armctl.rollout.parallel import _blocks, play_in_workers
from armctl.runtime.engines import Local
from armctl.study import cell, compare

from ..stores import timeless, wait_for_episodes

MINE = """
import os
import armctl

@armctl.sees("state")
def failing(env):
    policy = armctl.make_policy("random", env)
    act = policy.act
    def act_until_the_third(observations):
        if env.episodes.max() >= 2:
            raise RuntimeError("out of ideas")
        return act(observations)
    policy.act = act_until_the_third
    return policy

def dying(env):
    policy = armctl.make_policy("random", env)
    policy.act = lambda observations: os._exit(1)
    return policy
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    (tmp_path / "mine_for_workers.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    get_reusable_executor().shutdown(wait=True)  # workers of an earlier test are in another folder


@pytest.mark.slow
def test_workers_and_worlds_change_no_episode(tmp_path):
    told = []
    parallel: dict[str, Any] = {"workers": 2, "worlds": 2, "progress": told.append}
    for name, arguments in (("one", {}), ("two", parallel)):
        compare(["random", "reach_ppo"], episodes=5, seed=3, out=tmp_path / name, **arguments)
    assert timeless(tmp_path / "one").equals(timeless(tmp_path / "two"))
    assert len(told) == 10


@pytest.mark.slow
def test_a_policy_that_fails_in_a_worker_spoils_no_other(mine):
    comparison = compare(["mine_for_workers:failing", "random"], episodes=4, workers=2)
    assert "out of ideas" in comparison.failures["mine_for_workers:failing"]
    assert comparison.episodes.groupby("policy").size().to_dict() == {"mine_for_workers:failing": 4, "random": 4}
    assert comparison.policies[0].outcomes["error"] == 2


@pytest.mark.slow
def test_a_worker_that_dies_is_told(mine, tmp_path):
    comparison = compare(["mine_for_workers:dying"], episodes=2, workers=2, out=tmp_path / "out")
    assert "a worker process died" in comparison.failures["workers"]
    assert (tmp_path / "out" / "summary.json").is_file()


@pytest.mark.slow
def test_functions_can_be_sent_and_what_cannot_is_told_before_anything_runs(tmp_path):
    lock = threading.Lock()

    def still(env):
        policy = make_policy("random", env)
        policy.act = lambda observations: observations[:, 3:9]
        return policy

    def holding_a_lock(env):
        with lock:
            return make_policy("random", env)

    assert len(compare([still], episodes=2, workers=2, env_options={"max_episode_steps": 3}).episodes) == 2
    with pytest.raises(ConfigurationError, match="holding_a_lock cannot be sent to worker processes"):
        compare([holding_a_lock], episodes=2, workers=2, out=tmp_path / "results")
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_who_has_taken_longest_begins_first(monkeypatch):
    orders = []

    def noted(setting, actors, worlds, waiting, *others):
        orders.append([*waiting])
        return play_in_workers(setting, actors, worlds, waiting, *others)

    def late(env):
        policy = make_policy("random", env)
        act = policy.act
        policy.act = lambda observations: time.sleep(0.5) or act(observations)
        return policy

    monkeypatch.setattr(cell, "play_in_workers", noted)
    compare(["random", late], until="decided", episodes=20, workers=2, env_options={"max_episode_steps": 2})
    assert orders[:2] == [["random", "late"], ["late", "random"]]


def test_no_workers_are_refused():
    with pytest.raises(ConfigurationError, match="at least 1"):
        compare(["random"], episodes=1, workers=0)


@pytest.mark.parametrize(("episodes", "worlds", "workers"), [(7, 1, 2), (100, 8, 2), (10, 64, 3), (0, 4, 2)])
def test_blocks_hold_every_episode_once_and_keep_all_workers_busy(episodes, worlds, workers):
    blocks = list(_blocks(range(episodes), worlds, Local(workers), num_policies=2))
    assert [episode for block in blocks for episode in block] == list(range(episodes))
    assert len(blocks) >= min(workers, episodes)


def test_many_policies_keep_all_workers_busy_without_being_divided():
    for num_policies, sizes in ((5, [5, 5]), (6, [10])):
        assert [len(block) for block in _blocks(range(10), 10, Local(2), num_policies)] == sizes


@pytest.mark.slow
def test_ctrl_c_keeps_what_workers_have_finished_and_the_same_command_goes_on(tmp_path):
    program = str(Path(sys.executable).parent / "armctl")
    common = [program, "compare", "random", "--out", "here", "--workers", "2", "--set", "max_episode_steps=20"]
    command = [*common, "--episodes", "100000"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        wait_for_episodes(tmp_path / "here")
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes
        output, errors = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "resumes from there" in output
    assert "Traceback" not in errors
    csv = tmp_path / "here" / "episodes.csv"
    kept = pd.read_csv(csv)
    assert len(kept) >= 5
    assert kept.episode.is_monotonic_increasing
    episodes = str(int(kept.episode.max()) + 2)
    options = {"max_episode_steps": 20}
    assert compare(["random"], episodes=int(episodes), out=tmp_path / "here", env_options=options).resumed == len(kept)
    assert pd.read_csv(csv).episode.tolist() == list(range(int(episodes)))


IDLE = """
import time
import armctl
armctl.compare(["random"], episodes=8, workers=2, env_options={"max_episode_steps": 3})
print("idle", flush=True)
time.sleep(600)
"""
WORKING = IDLE.replace("episodes=8", "episodes=100_000, progress=lambda result: print('working', flush=True)")


def family(session):
    """Ids of the living processes of a session."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, its_session = status.read_text().rpartition(")")[2].split()[:4]
            found += [int(status.parent.name)] if int(its_session) == session and state != "Z" else []
    return found


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("moment", ["starting", "working", "idle"])
def test_workers_end_with_a_parent_that_is_killed(tmp_path, moment):
    code = WORKING if moment == "working" else IDLE
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            if moment == "starting":
                while len(family(process.pid)) < 3:  # itself, loky's tracker, and a worker that loads its modules
                    assert process.poll() is None
                    time.sleep(0.01)
            else:
                assert process.stdout.readline() == f"{moment}\n"
                assert len(family(process.pid)) >= 3
        finally:
            process.kill()
        until = time.monotonic() + 300  # they look every second, but on a busy machine their imports take long
        while (left := family(process.pid)) and time.monotonic() < until:
            time.sleep(0.1)
    for orphan in left:
        os.kill(orphan, signal.SIGKILL)
    assert left == []
