import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace
from typing import Any, cast

import imageio.v3 as imageio
import pandas as pd
import pytest

from armctl.cli import completion
from armctl.policies.trainings import card_path

from .command_line import ARMCTL, armctl, program
from .stores import wait_for_episodes


@pytest.mark.one_case
@pytest.mark.parametrize("verb", ["list", "compare", "sweep", "worst-case", "suite", "run", "view", "collect", "train"])
def test_help_teaches_each_verb(verb, tmp_path):
    assert verb in armctl("--help", cwd=tmp_path).stdout
    assert "Usage: armctl" in armctl(verb, "--help", cwd=tmp_path).stdout


@pytest.mark.one_case
@pytest.mark.parametrize(
    "verb", ["compare", "train", "sweep", "worst-case", "suite", "view", "collect", "plan", "export"]
)
def test_help_has_no_types_of_flags_and_breaks_none(verb, tmp_path):
    text = program(verb, "--help", cwd=tmp_path, COLUMNS="80").stdout
    assert "<bool>" not in text + program("--help", cwd=tmp_path).stdout
    options = text.partition("─ Options")[2]
    assert not re.search(r"<(int|float|str|path|table|bool)|34028236", options.replace("<list[str]>", ""))


def test_help_is_a_word_too(tmp_path):
    assert armctl("help", cwd=tmp_path).stdout == armctl("--help", cwd=tmp_path).stdout
    assert armctl("help", "plan", cwd=tmp_path).stdout == armctl("plan", "--help", cwd=tmp_path).stdout


def test_an_error_in_a_terminal_is_broken_between_words(tmp_path):
    code = f"import pty; pty.spawn([{ARMCTL!r}, 'run', 'reach_ki'])"
    environment = os.environ | {"COLUMNS": "60", "NO_COLOR": "1", "TERM": "xterm"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment)
    lines = done.stdout.replace("\r", "").splitlines()
    assert max(map(len, lines)) <= 60
    assert "bridge_moving_state_ppo," in " ".join(lines).split()


def test_help_loads_no_simulator():
    code = (
        "import sys; from armctl.cli import app; from typer.testing import CliRunner\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print([m for m in ('mujoco', 'pinocchio', 'pandas', 'scipy', 'onnxruntime', 'torch') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.slow
def test_comparing_needs_no_torch():
    code = (
        "import sys, armctl; assert len(armctl.compare(['reach_ppo', 'reach_ik'], episodes=2).episodes) == 4\n"
        "print([m for m in ('torch', 'stable_baselines3', 'onnxscript') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.slow
def test_training_without_the_extra_says_what_to_install(tmp_path):
    code = """
import sys
class NoTorch:
    def find_spec(name, path, target=None):
        if name == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name=name)
sys.meta_path.insert(0, NoTorch)
from armctl.cli import main
main()
"""
    command = [sys.executable, "-c", code, "train", "ppo"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert "armctl-suite[rl]" in done.stderr


def test_the_version_is_shown(tmp_path):
    assert re.match(r"armctl \d+\.\d+\.\d+, MuJoCo \d", armctl("--version", cwd=tmp_path).stdout)


@pytest.mark.parametrize(
    ("complete", "start", "found"),
    [
        (completion.environments, "armctl/Bridge", ["armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"]),
        (completion.policies, "reach_i", ["reach_ik", "reach_impedance"]),
        (completion.agents, "bridge_moving_d", ["bridge_moving_distil"]),
        (
            completion.agents,
            "bridge_moving_",
            [f"bridge_moving_{kind}" for kind in ("distil", "ppo", "robust_distil", "state_ppo")],
        ),
        (completion.recipes, "reach_p", ["reach_ppo", "reach_ppo_fast"]),
        (completion.disturbances, "d", ["delay", "dropout"]),
    ],
)
def test_names_are_completed(complete, start, found):
    assert complete(start) == found


@pytest.mark.parametrize(
    ("env", "start", "results"),
    [
        (None, "tol", ["tolerance="]),
        (None, "control=v", ["control=velocity"]),
        (None, "robot=u", ["robot=ur10", "robot=ur3", "robot=ur5", "robot=ur5_robotiq85"]),
        (None, "goal=", ["goal=False", "goal=True"]),
        (None, "tolerance=", []),
        ("armctl/BridgeCross-v0", "dyn", ["dynamics="]),
        ("armctl/BridgeCross-v0", "dynamics=k", ["dynamics=kinematic"]),
    ],
)
def test_options_are_completed_with_their_values(env, start, results):
    assert completion.environment_options(cast(Any, SimpleNamespace(params={"env": env})), start) == results
    assert completion.robots("ur1") == ["ur10"]


def test_a_folder_with_an_agent_is_a_policy(tmp_path):
    for suffix in (".json", ".onnx"):
        (tmp_path / "mine").mkdir(exist_ok=True)
        shutil.copy(card_path("reach_bc").with_suffix(suffix), tmp_path / "mine" / f"agent{suffix}")
    for arguments in (["compare", "mine", "random", "--episodes", "1", "--out", "r"], ["run", "mine", "--steps", "1"]):
        assert "mine/agent.json" in armctl(*arguments, cwd=tmp_path).stdout or arguments[0] == "run"
    assert card_path(str(tmp_path / "mine")) == tmp_path / "mine" / "agent.json"
    (tmp_path / "empty").mkdir()
    assert "there is no policy 'empty'" in armctl("run", "empty", cwd=tmp_path, check=False).stderr


def test_tab_completes_without_a_simulator(tmp_path):
    line = {"_ARMCTL_COMPLETE": "complete_bash", "COMP_WORDS": "armctl compare reach_o", "COMP_CWORD": "2"}
    assert program("compare", "reach_o", cwd=tmp_path, **line).stdout.split() == ["reach_ompl"]
    code = (
        "import sys; from armctl.cli import completion\n"
        "assert completion.policies('') and completion.recipes('') and completion.agents('')\n"
        "print([m for m in ('mujoco', 'pinocchio', 'pandas', 'onnxruntime', 'torch') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.slow
def test_robot_is_short_for_an_option(tmp_path):
    for arguments in (["--robot", "ur3"], ["--set", "robot=ur3"]):
        armctl("compare", "random", "--episodes", "1", "--out", "here", "--overwrite", *arguments, cwd=tmp_path)
        assert '"robot": "ur3"' in (tmp_path / "here" / "summary.json").read_text()


def test_compare_prints_and_writes(tmp_path):
    text = armctl("compare", "--episodes", "3", "--seed", "4", "--out", "here", cwd=tmp_path).stdout
    for word in ("reach_ik", "reach_ppo", "random", "Paired differences", "episodes.csv"):
        assert word in text
    assert (tmp_path / "here" / "summary.json").is_file()
    again = armctl("compare", "--episodes", "3", "--out", "here", cwd=tmp_path, check=False)
    assert again.returncode == 2
    assert "--overwrite" in again.stderr


@pytest.mark.slow
def test_other_formats_are_all_that_standard_output_holds(tmp_path):
    command = ("compare", "reach_ik", "random", "--episodes", "2", "--out", "here", "--format")
    first, *others = (armctl(*command, name, cwd=tmp_path) for name in ("json", "csv", "markdown", "latex"))
    policies = json.loads(first.stdout)["policies"]
    assert [policy["success"]["value"] for policy in policies] == [1, 0]
    table = pd.read_csv(io.StringIO(others[0].stdout))
    assert table.success.tolist()[:2] == [1, 0]
    assert others[1].stdout.startswith("**No verdict from 2 episodes")
    assert others[2].stdout.startswith("% in the preamble")
    for done in (first, *others):
        assert "has the episodes" not in done.stdout
        assert "has the episodes" in done.stderr
    wrong = armctl(*command, "jsno", cwd=tmp_path, check=False)
    assert (wrong.returncode, "'json'" in wrong.stderr) == (2, True)


@pytest.mark.slow
def test_a_pipe_has_no_width_unless_it_is_told_one(tmp_path):
    name = "a_module_with_a_very_long_name_indeed:and_a_function_with_a_very_long_name_of_its_own"
    (tmp_path / f"{name.partition(':')[0]}.py").write_text(
        f"def {name.partition(':')[2]}(env):\n    import armctl; return armctl.make_policy('random', env)\n"
    )
    command = ("compare", name, "reach_ik", "--episodes", "2", "--out", "here")
    wide, narrow = (armctl(*command, cwd=tmp_path, COLUMNS=columns).stdout for columns in ("", "50"))
    assert re.search(rf"^{name} +[\d.]+ % .* observation ", wide, re.MULTILINE)
    tables = narrow.partition("has the episodes")[0].splitlines()[:-1]
    assert max(map(len, tables)) <= 50
    assert "…" not in wide


@pytest.mark.slow
def test_ctrl_c_keeps_finished_episodes(tmp_path):
    command = [ARMCTL, "compare", "random", "--episodes", "100000", "--out", "here"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_for_episodes(tmp_path / "here")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "Interrupted" in output
    assert len(pd.read_csv(tmp_path / "here" / "episodes.csv")) >= 3
    assert (tmp_path / "here" / "summary.json").is_file()


@pytest.mark.slow
def test_sweep_prints_and_writes_and_goes_on(tmp_path):
    command = ("sweep", "reach_ik", "--episodes", "2", "--disturbance", "delay=1", "--disturbance", "noise=0.05,0")
    first, again = (armctl(*command, "--out", "here", cwd=tmp_path).stdout for _ in range(2))
    assert first == again
    assert "delay, control steps" in first
    assert pd.read_csv(tmp_path / "here" / "sweep.csv").level.tolist() == [0, 1, 0, 0.05]
    cells = pd.read_csv(tmp_path / "here" / "episodes.csv").cell
    assert cells.unique().tolist() == ["none", "delay-1.0", "noise-0.05"]


@pytest.mark.slow
def test_ctrl_c_keeps_what_a_sweep_has_finished(tmp_path):
    command = [ARMCTL, "sweep", "random", "--episodes", "100000", "--disturbance", "delay", "--out", "here"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_for_episodes(tmp_path / "here")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "resumes from there" in output
    assert "Traceback" not in errors
    assert set(pd.read_csv(tmp_path / "here" / "episodes.csv").cell) == {"none"}


@pytest.mark.slow
def test_worst_cases_are_searched_printed_and_reported(tmp_path):
    command = (
        "worst-case", "random", "--disturbances", "payload=10,delay", "--budget", "50", "--episodes", "3", "--worlds",
        "10", "--set", "max_episode_steps=20", "--no-video", "--out", "here",
    )  # fmt: skip
    first = armctl(*command, cwd=tmp_path)
    assert "payload 0 to 10 (kg), delay 0 to 8" in " ".join(first.stdout.split())
    assert "armctl view random" in first.stdout
    assert (tmp_path / "here" / "report.html").exists()
    assert pd.read_csv(tmp_path / "here" / "worst_case.csv").policy.tolist() == ["random"]
    again = armctl(*command, "--format", "json", cwd=tmp_path)
    assert json.loads(again.stdout)["worst_cases"][0]["distance"] == 0


def test_run_prints_states_actions_and_rewards(tmp_path):
    text = armctl("run", "random", "--episodes", "2", "--steps", "3", cwd=tmp_path).stdout
    assert len(re.findall(r"^step \d", text, re.MULTILINE)) == 6
    for word in ("end_effector_position", "joint_positions", "target_position", "action", "reward"):
        assert word in text
    assert text.count("stopped after 3 steps, as asked, return -3") == 2
    assert "timeout" not in text


def test_run_tells_a_timeout_from_the_steps_that_were_asked_for(tmp_path):
    assert "timeout after 3 steps" in armctl("run", "random", "--set", "max_episode_steps=3", cwd=tmp_path).stdout
    assert re.search(r"reached after \d+ steps", armctl("run", "reach_ik", "--steps", "99", cwd=tmp_path).stdout)


@pytest.mark.slow
def test_run_records_a_video_or_says_what_is_missing(tmp_path):
    (tmp_path / "films").mkdir()
    done = armctl("run", "reach_ik", "--steps", "5", "--video", "films/reach.mp4", cwd=tmp_path, check=False)
    if done.returncode:
        assert "libegl1" in done.stderr
        return
    frames = imageio.imread(tmp_path / "films" / "reach.mp4")
    assert frames.shape[1:] == (480, 640, 3)
    assert len(frames) >= 5
    assert frames.std() > 20


@pytest.mark.slow
def test_a_policy_in_the_current_folder_is_found(tmp_path):
    (tmp_path / "mine.py").write_text("def still(env):\n    import armctl; return armctl.make_policy('random', env)\n")
    assert "mine:still" in armctl("compare", "mine:still", "--episodes", "2", cwd=tmp_path).stdout
    done = subprocess.run([sys.executable, "-m", "armctl", "list"], capture_output=True, text=True, cwd=tmp_path)
    assert "reach_ik" in done.stdout


@pytest.mark.slow
def test_a_task_in_the_current_folder_is_found(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import armctl\n"
        "armctl.register('mine/Loose-v0', 'armctl.tasks:ReachTask', max_episode_steps=60, tolerance=0.3)\n"
    )
    loose = ["--episodes", "2", "--env", "mine:mine/Loose-v0"]
    assert "reach_ik: 2 reached" in armctl("compare", "reach_ik", *loose, cwd=tmp_path).stdout
    for env in ("nobodys:mine/Loose-v0", "mine:mine/Tight-v0"):
        done = armctl("compare", "random", "--env", env, cwd=tmp_path, check=False)
        assert done.returncode == 2, done.stdout


@pytest.mark.slow
def test_train_follows_a_recipe_with_changes(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'learner = "ppo"\nenv = "armctl/ArmReach-v0"\nshaping = "distance"\nseeds = [5]\n'
        "[options]\nworlds = 8\nbatch_size = 64\nvalidation_episodes = 2\nevaluation_episodes = 2\n"
    )
    changes = ["--steps", "300", "--shaping", "none", "--option", "gamma=0.9", "--set", "tolerance=0.1"]
    text = armctl("train", "mine.toml", *changes, cwd=tmp_path).stdout
    assert "held-out episodes" in text
    card = json.loads((tmp_path / "runs" / "mine-5" / "agent.json").read_text())
    assert (card["recipe"], card["training_seed"], card["shaping"]) == ("mine", 5, None)
    assert card["env_options"] == {"tolerance": 0.1}
    assert (card["learner_options"]["gamma"], card["learner_options"]["steps"]) == (0.9, 300)
    again = armctl("train", "mine.toml", "--resume", cwd=tmp_path, check=False)
    assert again.returncode == 2
    assert "was started with env_options {'tolerance': 0.1}, not {}" in again.stderr


def test_run_starts_at_any_episode(tmp_path):
    first, third = (armctl("run", "random", "--steps", "1", "--episode", n, cwd=tmp_path).stdout for n in ("0", "2"))
    both = armctl("run", "random", "--steps", "1", "--episodes", "3", cwd=tmp_path).stdout
    assert first in both
    assert third in both


@pytest.mark.slow
def test_a_suite_is_played_and_reported_and_one_task_that_fails_stops_no_other(tmp_path):
    words = ("suite", "--quick", "--episodes", "1", "--out", "here", "--env", "Pendulum-v1")
    done = armctl(*words, cwd=tmp_path)
    assert "Pendulum-v1: the environment does not say what a success is." in done.stdout
    assert (tmp_path / "here" / "report.html").is_file()
    assert (tmp_path / "here" / "Pendulum-v1.html").is_file()
    (tmp_path / "bad.py").write_text("def Maze():\n    raise OSError('no maze')\n")
    again = armctl(*words, "--env", "bad.py:Maze", "--format", "json", cwd=tmp_path, check=False)
    assert again.returncode == 1
    assert [task["env"] for task in json.loads(again.stdout)["tasks"]] == ["Pendulum-v1"]
    assert any("no maze" in remark for remark in json.loads(again.stdout)["remarks"])
    other = armctl(*words, "--seed", "4", cwd=tmp_path, check=False)
    assert other.returncode == 2
    assert "seed: 0 there, 4 here" in other.stderr


def test_an_interrupted_suite_says_how_to_resume(tmp_path, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("armctl.rollout.parallel.rollouts", interrupt)
    done = armctl("suite", "--env", "Pendulum-v1", "--episodes", "1", "--out", "here", cwd=tmp_path, check=False)
    assert done.returncode == 130
    assert "The same command with --out here resumes from there." in done.stdout
