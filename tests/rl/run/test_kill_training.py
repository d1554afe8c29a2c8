"""Trainings that are killed at any moment resume, and lose no checkpoint."""

import random
import subprocess
import time
import zipfile
from pathlib import Path

import pandas as pd
import pytest

from armctl.agents import read_card, sha256
from tests.command_line import ARMCTL, armctl

STEPS = 4096
COMMAND = [
    "train", "reach_ppo", "--shaping", "none", "--steps", str(STEPS), "--out", "run", "--option", "worlds=32",
    "--option", "evaluation_every=1024", "--option", "evaluation_episodes=4", "--option", "validation_episodes=4",
]  # fmt: skip


def checkpoints(run):
    return set((run / "checkpoints").glob("[0-9]*.zip"))


def wait_for(path, process):
    while not path.exists() and process.poll() is None:
        time.sleep(0.01)


@pytest.mark.slow
def test_a_training_that_is_killed_again_and_again(tmp_path):
    """Twice, soon after another checkpoint; then it may finish."""
    rng, run = random.Random(0), tmp_path / "run"
    kept: set[Path] = set()
    for _ in range(2):
        resume = ["--resume"] if kept else []
        with subprocess.Popen([ARMCTL, *COMMAND, *resume], cwd=tmp_path, stdout=-3, stderr=subprocess.PIPE) as process:
            while checkpoints(run) == kept and process.poll() is None:
                time.sleep(0.01)
            time.sleep(rng.uniform(0.0, 0.1))
            process.kill()
            complaint = process.stderr.read().decode()
        assert "Traceback" not in complaint, complaint
        assert process.returncode == -9, complaint
        assert kept < checkpoints(run)
        kept = checkpoints(run)
        assert all(zipfile.ZipFile(path).testzip() is None for path in kept)
    armctl(*COMMAND, "--resume", cwd=tmp_path)
    assert kept < checkpoints(run)
    curve = pd.read_csv(run / "curve.csv")
    assert curve.steps.is_monotonic_increasing
    assert curve.steps.is_unique
    assert curve.steps.iloc[-1] == STEPS
    assert read_card(run / "agent.json").sha256 == sha256(run / "agent.onnx")
    armctl("compare", "run/agent.json", "--episodes", "2", "--out", "results", cwd=tmp_path)


@pytest.mark.slow
def test_a_folder_has_one_training(tmp_path):
    with subprocess.Popen([ARMCTL, *COMMAND, "--steps", "1000000"], cwd=tmp_path, stdout=-3, stderr=-3) as process:
        wait_for(tmp_path / "run" / "curve.csv", process)
        second = armctl(*COMMAND, "--resume", cwd=tmp_path, check=False)
        process.kill()
    assert second.returncode == 2
    assert "another process writes to run" in second.stderr
