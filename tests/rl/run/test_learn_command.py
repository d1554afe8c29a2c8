"""The verb `train`, seen from the terminal. The verb `export` is tested in `test_sb3_export.py`."""

import json
import re
import shlex

import pytest

from armctl.agents import read_card
from armctl.cli.options import options_of
from armctl.core.options import option_arguments
from armctl.training.trials import read_trials
from tests.command_line import armctl

QUICK = ["--steps", "300", "--option", "worlds=8", "--option", "batch_size=64", "--option", "evaluation_every=100",
         "--option", "validation_episodes=2", "--option", "evaluation_episodes=2"]  # fmt: skip


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """What a training of an arm with options prints, and where it was."""
    folder = tmp_path_factory.mktemp("trained")
    changes = ["--set", "robot=ur10", "--set", "max_episode_steps=9", "--set", "disturbances={'noise': 0.01}"]
    done = armctl("train", "reach_ppo", *QUICK, *changes, "--out", "my runs/first", cwd=folder)
    return done, folder


@pytest.mark.slow
def test_the_follow_up_command_can_be_pasted(trained):
    done, folder = trained
    command = shlex.split(done.stdout.strip().splitlines()[-1].partition(": ")[2])
    assert command[:2] == ["armctl", "compare"]
    assert "my runs/first/agent.json" in command
    assert [command[i + 1] for i, word in enumerate(command) if word == "--set"] == [
        "robot=ur10", "max_episode_steps=9", "disturbances={'noise': 0.01}",
    ]  # fmt: skip
    text = armctl(*command[1:], "--episodes", "2", cwd=folder).stdout
    assert "ur10" in text or "agent" in text


@pytest.mark.slow
def test_the_training_is_recorded_with_what_was_changed(trained):
    _, folder = trained
    (row,) = read_trials(folder / "my runs" / "trials.csv")
    assert (row["recipe"], row["ended"], row["episodes"]) == ("reach_ppo", "finished", "2")
    assert row["sha256"] == read_card(folder / "my runs/first/agent.json").sha256
    changed = json.loads(row["changed"])
    assert changed["env_options"] == {"robot": "ur10", "max_episode_steps": 9, "disturbances": {"noise": 0.01}}
    assert changed["options"]["worlds"] == 8


@pytest.mark.slow
def test_a_log_gets_a_line_for_each_evaluation_and_no_bars(trained):
    done, _ = trained
    assert len(re.findall(r"^\d+ steps: success .*% of 2 held-out episodes$", done.stdout, re.MULTILINE)) >= 3
    assert "\r" not in done.stdout + done.stderr
    assert "%|" not in done.stderr


def test_options_are_written_as_they_are_read():
    options = {"a": "ur10", "b": "1", "c": (1, 2.5), "d": None, "e": "two words", "f": {"noise": 0.1}, "g": "None"}
    words = option_arguments(options)
    assert words[::2] == ["--set"] * len(options)
    assert options_of(words[1::2]) == options


@pytest.mark.one_case
@pytest.mark.parametrize(
    "wrong",
    [
        ["reach_bc", "--teacher", "reach_ki"],
        ["reach_dagger", "--teacher", "reach_ki"],
        ["reach_bc", "--option", "dataset=nowhere"],
        ["reach_cloned_ppo", "--option", "dataset=nowhere"],
        ["reach_ppo", "--set", "robot=ur7"],
    ],
)
def test_a_mistake_leaves_no_folder(wrong, tmp_path):
    done = armctl("train", *wrong, "--out", "run", cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_resuming_says_that_checkpoints_can_run_code(trained, tmp_path):
    warning = "Its checkpoints are pickles, which can run code: go on only if it is your own."
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "settings.json").write_text("{}")
    done = armctl("train", "reach_ppo", "--out", "there", "--resume", cwd=tmp_path, check=False)
    assert done.stderr.splitlines()[0] == f"Resuming there. {warning}"
    assert warning not in trained[0].stdout + trained[0].stderr
    told = re.sub(r"[│\s]+", " ", armctl("train", "--help", cwd=tmp_path).stdout)
    assert "Checkpoints can run code: only of your own." in told


def test_a_recipe_speaks_plainly(tmp_path):
    (tmp_path / "hostile.toml").write_text(
        'learner = "ppo\\u001b[2J[/]"\nenv = "armctl/ArmReach-v0"\nshaping = "\\u001b]0;title\\u0007"\n'
    )
    for arguments in (["hostile.toml"], ["hostile.toml", "--out", "\x1b[2J[/]"]):
        done = armctl("train", *arguments, cwd=tmp_path, check=False)
        assert (done.returncode, "Traceback" in done.stderr) == (2, False)
        assert "\x1b" not in done.stdout + done.stderr
