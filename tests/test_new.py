"""`armctl new`: what it writes runs."""

import re

import pytest

from armctl.core.registration import environment_names

from .command_line import armctl


@pytest.mark.slow
@pytest.mark.parametrize(("name", "title"), [("push_box", "PushBox"), ("hover", "Hover")])
def test_a_new_task_runs_in_every_verb(name, title, tmp_path):
    says = armctl("new", "task", name, cwd=tmp_path).stdout
    env = f"{name}.py:mine/{title}-v0"
    assert f"armctl compare --env {env}" in says
    text = armctl("compare", "--env", env, "--episodes", "4", "--out", "r", cwd=tmp_path).stdout
    assert re.search(rf"{name}.py:Expert +100.0 %", text)
    listed = armctl("list", "--env", env, cwd=tmp_path).stdout
    assert "Slide the puck to the target." in listed
    armctl("run", f"{name}.py:Expert", "--env", env, "--steps", "3", "--set", "tolerance=0.1", cwd=tmp_path)
    assert not any(env_id.startswith("mine/") for env_id in environment_names())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["task", "Push Box"], "small letters, digits and _"),
        (["task", "../evil"], "small letters, digits and _"),
        (["task", "there"], "there.py cannot be written: File exists"),
        (["robot", "mine"], "robot"),
    ],
)
def test_nothing_is_written_over_or_elsewhere(arguments, says, tmp_path):
    (tmp_path / "there.py").write_text("mine = 1")
    done = armctl("new", *arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert says in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["there.py"]
    assert (tmp_path / "there.py").read_text() == "mine = 1"
