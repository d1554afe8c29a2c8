import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import imageio.v3 as imageio
import pandas as pd
import pytest

ARMCTL = str(Path(sys.executable).parent / "armctl")


def armctl(*arguments, cwd, check=True):
    environment = os.environ | {"COLUMNS": "100", "NO_COLOR": "1"}
    done = subprocess.run([ARMCTL, *arguments], capture_output=True, text=True, cwd=cwd, env=environment)
    assert not check or done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize("verb", ["list", "compare", "run", "train"])
def test_help_teaches_each_verb(verb, tmp_path):
    assert verb in armctl("--help", cwd=tmp_path).stdout
    assert "Usage: armctl" in armctl(verb, "--help", cwd=tmp_path).stdout


def test_help_loads_no_simulator():
    code = (
        "import sys; from armctl.cli import app; from typer.testing import CliRunner\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print([m for m in ('mujoco', 'pinocchio', 'pandas', 'scipy', 'onnxruntime', 'torch') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_comparing_needs_no_torch():
    code = (
        "import sys, armctl; assert len(armctl.compare(['reach_ppo', 'reach_ik'], episodes=2).episodes) == 4\n"
        "print([m for m in ('torch', 'stable_baselines3', 'onnx') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_training_without_the_extra_says_what_to_install(tmp_path):
    code = "import sys; sys.modules['torch'] = None; from armctl.cli import main; main()"
    command = [sys.executable, "-c", code, "train", "ppo"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert "armctl[rl]" in done.stderr


def test_list_shows_what_there_is(tmp_path):
    text = armctl("list", cwd=tmp_path).stdout
    for name in ("armctl/ArmReach-v0", "reach_ik", "reach_ppo", "random", "ur3", "ur5", "ur10", "ppo"):
        assert name in text


def test_compare_prints_and_writes(tmp_path):
    text = armctl("compare", "--episodes", "3", "--seed", "4", "--out", "here", cwd=tmp_path).stdout
    for word in ("reach_ik", "reach_ppo", "random", "Paired differences", "episodes.csv"):
        assert word in text
    assert (tmp_path / "here" / "summary.json").is_file()
    again = armctl("compare", "--episodes", "3", "--out", "here", cwd=tmp_path, check=False)
    assert again.returncode == 2
    assert "--overwrite" in again.stderr


def test_ctrl_c_keeps_finished_episodes(tmp_path):
    command = [ARMCTL, "compare", "random", "--episodes", "100000", "--out", "here"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        csv = tmp_path / "here" / "episodes.csv"
        for _ in range(600):
            time.sleep(0.1)
            if csv.exists() and csv.read_text().count("\n") > 10:
                break
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Interrupted" in output
    assert len(pd.read_csv(csv)) >= 10
    assert (tmp_path / "here" / "summary.json").is_file()


def test_run_prints_states_actions_and_rewards(tmp_path):
    text = armctl("run", "random", "--episodes", "2", "--steps", "3", cwd=tmp_path).stdout
    assert len(re.findall(r"^step \d", text, re.MULTILINE)) == 6
    for word in ("end_effector_position", "joint_positions", "target_position", "action", "reward", "return -3"):
        assert word in text


def test_run_records_a_video_or_says_what_is_missing(tmp_path):
    done = armctl("run", "reach_ik", "--steps", "5", "--video", "films/reach.mp4", cwd=tmp_path, check=False)
    if done.returncode:
        assert "libegl1" in done.stderr
        return
    frames = imageio.imread(tmp_path / "films" / "reach.mp4")
    assert frames.shape[1:] == (480, 640, 3)
    assert len(frames) >= 5
    assert frames.std() > 20


def test_a_policy_in_the_current_folder_is_found(tmp_path):
    (tmp_path / "mine.py").write_text("def still(env):\n    import armctl; return armctl.make_policy('random', env)\n")
    assert "mine:still" in armctl("compare", "mine:still", "--episodes", "2", cwd=tmp_path).stdout
    done = subprocess.run([sys.executable, "-m", "armctl", "list"], capture_output=True, text=True, cwd=tmp_path)
    assert "reach_ik" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["compare", "reach_ki"], "Did you mean 'reach_ik'"),
        (["compare", "random", "--set", "robto=ur3"], "Did you mean 'robot'"),
        (["compare", "random", "--set", "robot"], "NAME=VALUE"),
        (["compare", "none.json"], "cannot be read"),
        (["run", "random", "--env", "armctl/Reach-v0"], "ArmReach"),
        (["run", "random", "--set", "control=torqe"], "Did you mean 'torque'"),
        (["train", "pppo"], "Did you mean 'ppo'"),
        (["train", "ppo", "--env", "armctl/Nothing-v0"], "armctl/ArmReach-v0"),
        (["train", "ppo", "--resume", "--out", "nowhere"], "no training to resume"),
        (["run", "random", "--video", "/dev/null/film.mp4"], "cannot be written|libegl1"),
        (["run", "random", "--video", "film.xyz"], "cannot be written|libegl1"),
        (["run", "random", "--video", "film.mp4", "--watch"], "exclude each other"),
        (["run", "random", "--set", "max_episode_steps=abc"], "max_episode_steps"),
        (["train", "ppo", "--set", "control=nope", "--out", "fresh"], "control"),
    ],
)
def test_mistakes_get_one_clear_line(arguments, says, tmp_path):
    done = armctl(*arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert re.search(says, done.stderr)
    assert "Traceback" not in done.stderr
