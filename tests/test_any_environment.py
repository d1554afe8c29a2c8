"""The verbs in environments of others, with ids after a module or a file, and short ones."""

import json
import re
import shutil
import signal
import subprocess
from pathlib import Path

import gymnasium
import pandas as pd
import pytest

from armctl.episodes.record import TIME_COLUMNS

from .command_line import ARMCTL, armctl, program
from .forgery import rewrite
from .stores import read_cell, wait_for_episodes

HERE = Path(__file__).parent
POLICIES = """
def right(observation):
    return [0.2]


def slow(observation):
    return [0.1]
"""


@pytest.fixture
def home(tmp_path):
    """A folder with a user's files."""
    shutil.copy(HERE / "envs" / "odd_environments.py", tmp_path / "odd_environments.py")
    (tmp_path / "mine.py").write_text(POLICIES)
    return tmp_path


LINE = [
    "odd_environments:odd/Line-v0",
    "odd_environments:Line-v0",
    "odd_environments.py:odd/Line-v0",
    "odd_environments.py:Line",
]
PAIR = ["mine.py:right", "mine:slow"]


@pytest.mark.slow
@pytest.mark.parametrize("env", LINE)
def test_compare_resume_and_report(home, env):
    arguments = ["compare", *PAIR, "random", "--env", env, "--episodes", "12", "--out", "results"]
    done = armctl(*arguments, "--report", cwd=home)
    assert "Undecided between mine.py:right and mine:slow: success +0.0 points" in done.stdout  # both always win
    assert "is not made of a task" in " ".join(done.stdout.split())
    episodes = home / "results" / "episodes.csv"
    rows = pd.read_csv(episodes)
    assert rows.env.unique().tolist() == [
        env.partition(":")[2].replace("Line-v0", "odd/Line-v0").replace("odd/odd", "odd")
    ]
    assert rows.groupby("policy").success.sum()["mine.py:right"] == 12
    assert rows.contacts.isna().all()
    assert "Played again" not in (home / "results" / "report.html").read_text()
    identity, _, runs, results = read_cell(home / "results")
    rewrite(home / "results", identity, {}, results[:19], runs)  # as after a kill
    again = armctl(*arguments, cwd=home)
    assert "were finished by an earlier run" in " ".join(again.stdout.split())
    same = [column for column in rows if column not in TIME_COLUMNS]
    pd.testing.assert_frame_equal(pd.read_csv(episodes)[same], rows[same])
    armctl("report", "results", "--no-video", cwd=home)


@pytest.mark.slow
def test_another_spelling_of_an_id_resumes(home):
    first = ["compare", "reach_ik", "--episodes", "2", "--out", "results", "--env"]
    armctl(*first, "ArmReach-v0", cwd=home)
    assert "2 episodes were finished" in " ".join(armctl(*first, "armctl/ArmReach-v0", cwd=home).stdout.split())


@pytest.mark.slow
def test_a_program_finds_files_and_modules_and_so_do_its_workers(home):
    for env in ("odd_environments.py:Line", "odd_environments:odd/Line-v0"):
        program(
            "compare", *PAIR, "--env", env, "--episodes", "6", "--workers", "2", "--overwrite", "--out", "r", cwd=home
        )
        assert len(pd.read_csv(home / "r" / "episodes.csv")) == 12


@pytest.mark.slow
def test_sweep_collect_and_run(home):
    env = ["--env", "odd_environments.py:Silent"]
    swept = armctl("sweep", *PAIR, *env, "--episodes", "12", "--out", "s", "--disturbance", "delay=0,5", cwd=home)
    assert "delay" in swept.stdout
    points = pd.read_csv(home / "s" / "sweep.csv")
    assert points.success.isna().all()
    assert points.groupby("level")["return"].mean().is_monotonic_decreasing
    assert (points.p[points.level > 0] < 0.01).all()
    armctl("report", "s", "--no-video", cwd=home)
    armctl("collect", PAIR[0], *env, "--episodes", "3", "--out", "data", cwd=home)
    shown = armctl("run", PAIR[0], *env, "--steps", "2", cwd=home).stdout
    assert "stopped after 2 steps, as asked" in shown
    assert "the environment failed" not in shown


@pytest.mark.slow
def test_success_by_return(home):
    arguments = ["compare", *PAIR, "--env", "odd_environments.py:Silent", "--episodes", "12", "--out", "r"]
    armctl(*arguments, cwd=home)
    summary = json.loads((home / "r" / "summary.json").read_text())
    assert [policy["success"] for policy in summary["policies"]] == [None, None]
    assert summary["differences"][0]["success_p"] is None
    refused = armctl(*arguments, "--success-return", "-20", cwd=home, check=False)
    assert refused.returncode == 2
    assert "another comparison" in refused.stderr
    armctl(*arguments, "--success-return", "-12", "--overwrite", cwd=home)
    rates = [policy["success"]["value"] for policy in json.loads((home / "r" / "summary.json").read_text())["policies"]]
    assert rates[0] > rates[1]


def test_a_comparison_by_return_stops_when_it_is_decided_and_one_without_pairs_is_refused(home):
    until = ["--until", "decided", "--at-most", "200", "--out", "r"]
    printed = " ".join(armctl("compare", *PAIR, "--env", "odd_environments.py:Silent", *until, cwd=home).stdout.split())
    assert "of at most 200 episodes: p and intervals hold at any number of episodes." in printed
    assert "by betting, which holds at any number of episodes" in printed
    refused = armctl("compare", *PAIR, "--env", "odd_environments.py:Deaf", *until[:4], cwd=home, check=False)
    assert refused.returncode == 2
    assert "no method holds at any number of them" in " ".join(refused.stderr.split())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Deaf", "DeafLater", "Remembering"])
def test_an_environment_that_ignores_its_seed_is_judged_without_pairs(home, name):
    arguments = [*PAIR, "--env", f"odd_environments.py:{name}", "--episodes", "12"]
    said = armctl("compare", *arguments, "--out", "r", cwd=home).stdout
    armctl("report", "r", "--no-video", cwd=home)
    printed = " ".join(said.split())
    assert f"{name} does not obey its seed" in printed
    assert "(on different episodes" in printed
    assert "Unpaired differences, on different episodes" in printed
    assert re.search(r"\d+ of 12 / \d+ of 12", printed)
    assert "p: Barnard's exact test" in printed
    summary = json.loads((home / "r" / "summary.json").read_text())
    assert (summary["paired"], summary["differences"][0]["paired"]) == (False, False)
    assert summary["differences"][0]["sample_sizes"] == [12, 12]
    report = (home / "r" / "report.html").read_text()
    assert "Pairs of policies, on different episodes" in report
    planned = armctl("plan", "--pilot", "r", cwd=home).stdout
    swept = armctl("sweep", *arguments, "--out", "s", "--disturbance", "noise=0,0.1", cwd=home).stdout
    assert "than without disturbance, on different episodes (Barnard's exact test" in " ".join(swept.split())
    assert "on different episodes" in " ".join(planned.split())
    assert not [text for text in (said, report, planned, swept) if "McNemar" in text or "on the same episodes" in text]


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["compare", "random", "--env", "odd_environments.py:Lime"], "Did you mean"),
        (["compare", "random", "--env", "odd_environments.py:Broken"], "no licence (odd_environments.py:"),
        (["compare", "random", "--env", "armctl/ArmReach-v0", "--success-return", "5"], "success_return"),
        (
            ["compare", "random", "--env", "odd_environments.py:Line", "--return-bounds", "0", "-5"],
            "two finite numbers",
        ),
        (
            ["compare", "random", "--env", "odd_environments.py:Silent", "--return-bounds", "-0.5", "0"],
            "episode 0 of random has the return -",
        ),
        (["view", "random", "--env", "odd_environments.py:Line"], "view shows environments that are made of tasks"),
        (["train", "ppo", "--env", "odd_environments.py:Line"], "armctl export"),
    ],
)
def test_mistakes_get_one_clear_line(home, arguments, said):
    done = armctl(*arguments, cwd=home, check=False)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not (home / "runs").exists()


@pytest.mark.slow
def test_what_an_interrupt_leaves_is_resumed(home):
    slow = "import time\n\n\ndef right(observation):\n    time.sleep(0.01)\n    return [0.2]\n"
    (home / "slow.py").write_text(slow)
    command = [
        "compare",
        "slow.py:right",
        "random",
        "--env",
        "odd_environments.py:Line",
        "--episodes",
        "40",
        "--out",
        "r",
    ]
    running = subprocess.Popen([ARMCTL, *command], cwd=home, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_for_episodes(home / "r")
    running.send_signal(signal.SIGINT)
    out, _ = running.communicate(timeout=300)
    assert running.returncode == 130, out
    kept = len(pd.read_csv(home / "r" / "episodes.csv"))
    assert 5 <= kept < 80
    resumed = armctl(*command, cwd=home).stdout
    assert f"{kept} episodes were finished by an earlier run" in " ".join(resumed.split())
    assert len(pd.read_csv(home / "r" / "episodes.csv")) == 80


@pytest.mark.slow
@pytest.mark.parametrize("env", ["Reacher-v5", "Pendulum-v1", "HalfCheetah-v5"])
def test_a_controller_beside_an_agent_of_stable_baselines3(tmp_path, env):
    """What a researcher does: their environment, a controller of theirs, their trained model."""
    from stable_baselines3 import PPO

    PPO("MlpPolicy", env, n_steps=64, seed=0).learn(128).save(tmp_path / "model.zip")
    size = gymnasium.make(env).action_space.shape[0]
    (tmp_path / "mine.py").write_text(f"import numpy as np\n\n\ndef still(observation):\n    return np.zeros({size})\n")
    armctl("export", "model.zip", "--env", env, "--out", "agent.onnx", "--trust", cwd=tmp_path)
    policies = ["mine.py:still", "agent.onnx", "random"]
    short = ["--env", env, "--episodes", "10", "--set", "max_episode_steps=10"]
    armctl("compare", *policies, *short, "--out", "r", "--report", cwd=tmp_path)
    report = (tmp_path / "r" / "report.html").read_text()
    assert report.count("data:video/mp4") == 6
    assert "Played again" not in report
    armctl("sweep", *policies, *short, "--out", "s", "--disturbance", "noise=0,0.1", cwd=tmp_path)
    points = pd.read_csv(tmp_path / "s" / "sweep.csv")
    assert points.policy.tolist() == policies * 2
    assert points["return"].notna().all()
