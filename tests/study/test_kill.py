"""Comparisons and sweeps that are killed at any moment go on: nothing finished is lost, doubled or mixed."""

import functools
import os
import random
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import pandas as pd
import pytest

from armctl.episodes.stored import STORE, read_store

from ..command_line import ARMCTL, armctl
from ..stores import timeless

PLAYED = ["random", "reach_ik", "--out", "out", "--set", "max_episode_steps=12", "--policy-seed", "1"]
COMMANDS = {
    "compare": ["compare", *PLAYED, "--episodes", "30", "--worlds", "3"],
    "workers": ["compare", *PLAYED, "--episodes", "30", "--worlds", "3", "--workers", "2"],
    "until": ["compare", *PLAYED, "--until", "decided", "--at-most", "60", "--margin", "0.01"],
    "sweep": ["sweep", *PLAYED, "--episodes", "6", "--disturbance", "delay=1,2", "--disturbance", "noise=0.02"],
}
EPISODES = {"compare": 60, "workers": 60, "until": 40, "sweep": 48}
KILLS = {("compare", False): 2, ("sweep", False): 2, ("workers", False): 1, ("workers", True): 1, ("until", False): 1}
"""Kills of a run, or of its workers, before it may finish."""


def finished(out):
    """All columns of each finished episode, with those of time, by its comparison's folder, policy and number."""
    return {
        (name, result.policy, result.episode): tuple(map(str, result.row().values()))
        for name, cell in (read_store(out).cells if (out / STORE).exists() else {}).items()
        for result in cell.episodes
    }


def tables(out):
    """What the table of episodes says, without the columns of time."""
    return timeless(out).to_csv()


@functools.cache
def uninterrupted(verb):
    with tempfile.TemporaryDirectory() as folder:
        armctl(*COMMANDS[verb], cwd=folder)
        return tables(Path(folder) / "out")


def written(out):
    """About how many episodes are in stores, for the moment: each takes a page of the log, or more."""
    logs = (path.stat().st_size // 4_096 for path in out.rglob(f"{STORE}-wal"))
    return sum(logs)


def workers_of(process):
    """Ids of the processes that play for another."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(one) for one in children if b"LokyProcess" in Path(f"/proc/{one}/cmdline").read_bytes()]


def kill_at(moment, command, cwd, rng, of_worker):
    """Kill a run, or one of its workers, as soon as so many episodes are written, or a little later."""
    with subprocess.Popen([ARMCTL, *command], cwd=cwd, stdout=-1, stderr=-1, text=True) as process:
        while process.poll() is None and written(cwd / "out") < moment:
            time.sleep(0.002)
        time.sleep(rng.choice([0.0, rng.uniform(0.0, 0.1)]))
        workers = workers_of(process) if of_worker and process.poll() is None else []
        if process.poll() is None:
            os.kill(rng.choice(workers or [process.pid]), signal.SIGKILL)
        _, complaint = process.communicate()
    assert process.returncode in ((0, 1) if workers else (-9, 0)), complaint
    assert "Traceback" not in complaint


@pytest.mark.slow
@pytest.mark.parametrize("trial", [0, *(pytest.param(trial, marks=pytest.mark.thorough) for trial in range(1, 6))])
@pytest.mark.parametrize(("verb", "of_worker"), KILLS)
def test_what_is_killed_again_and_again(tmp_path, verb, of_worker, trial):
    out, kept, rng = tmp_path / "out", {}, random.Random(trial)
    for _ in range(3 if trial else KILLS[verb, of_worker]):
        kill_at(rng.randrange(max(1, EPISODES[verb] - len(kept))), COMMANDS[verb], tmp_path, rng, of_worker)
        now = finished(out)
        assert kept.items() <= now.items()
        kept = now
    armctl(*COMMANDS[verb], cwd=tmp_path)
    after = finished(out)
    assert kept.items() <= after.items()
    assert len(after) == EPISODES[verb]
    assert tables(out) == uninterrupted("compare" if verb == "workers" else verb)
    assert not list(out.rglob("*unfinished*"))


@pytest.mark.slow
def test_what_a_killed_run_left_unfinished_is_removed(tmp_path):
    armctl(*COMMANDS["compare"], cwd=tmp_path)
    out = tmp_path / "out"
    for name in (".armctl-unfinished-x1.csv", "unfinished-thesis.txt"):
        (out / name).write_text("half a")
    (out / ".armctl-unfinished-link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").touch()
    armctl(*COMMANDS["compare"], cwd=tmp_path)
    assert {path.name for path in out.glob("*unfinished*")} == {"unfinished-thesis.txt"}
    assert (tmp_path / "elsewhere").exists()


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["compare", "sweep"])
def test_a_second_run_is_refused_while_one_writes(tmp_path, verb):
    command, out = [verb, *PLAYED, "--episodes", "100000", "--overwrite"], tmp_path / "out"
    with subprocess.Popen([ARMCTL, *command, "--seed", "1"], cwd=tmp_path, stdout=-1, stderr=-1, text=True) as process:
        while process.poll() is None and written(out) < 50:
            time.sleep(0.01)
        second = armctl(*command, "--seed", "2", cwd=tmp_path, check=False)
        process.send_signal(signal.SIGINT)
        _, complaint = process.communicate()
    assert process.returncode == 130, complaint
    assert second.returncode == 2
    assert "another process writes to out" in second.stderr
    assert set(pd.read_csv(next(out.rglob("episodes.csv"))).seed) == {1}
    assert len(finished(out)) >= 5
