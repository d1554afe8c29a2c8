"""Texts from files reach the terminal as text: no markup is read, no control sequence is passed on."""

import contextlib
import importlib.resources
import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table
from rich.text import Text

from armctl.cli import learn
from armctl.cli.options import progress_bar
from armctl.core.console import PlainConsole, printable
from armctl.report.terminal import DocumentView, output_console
from armctl.verdict.tables import Cell, Column, Document, Remark
from armctl.verdict.tables import Table as ResultTable

from ..command_line import ARMCTL, armctl

HOSTILE = [
    "[red]x[/red]",
    "[/]",
    "[/bold]",
    "\x1b[2J\x1b[31m",
    "\x1b]52;c;aGk=\x07",
    "\x9b31m",
    "a\rb",
    "\x7f",
    "\u202ea",
]
FORBIDDEN = {*map(chr, [*range(9), *range(11, 32), *range(127, 160)]), "\u202e"}
HOSTILE_ENVIRONMENT = r"""
import gymnasium, numpy as np

class Maze(gymnasium.Env):
    "\x1b[2J[/] A maze."
    observation_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}
    def step(self, action):
        raise RuntimeError("\x1b[2J\x9b31m[/] out of maze")
"""


def test_escapes_stand_for_control_characters_and_nothing_else():
    assert printable("\x1b[31mred\x1b]0;t\x07\x9b\x7f\r\u202e\u2066\udcff") == (
        r"\x1b[31mred\x1b]0;t\x07\x9b\x7f\r\u202e\u2066\udcff"
    )
    kept = "Grüße, 世界, ─, 🤖, [red], \\x1b,\ttab,\nline"
    assert printable(kept) == kept


def test_there_is_no_other_console():
    home = Path(__file__).parents[1]
    code = {path: path.read_text() for folder in ("src", "rl", "baselines") for path in (home / folder).rglob("*.py")}
    others = re.compile(r"\bConsole\(|from_markup|\brich import print\b|track\(|TextColumn\((?!.*markup=False)")
    assert others.search("console = Console(stderr=True)")
    assert [path for path, text in code.items() if others.search(text)] == []


@pytest.mark.parametrize("text", HOSTILE)
def test_a_console_shows_strings_as_they_are(text, capsys):
    console = PlainConsole(width=80)
    table = Table(text)
    table.add_row(text, Text(text))
    for shown in (text, table, Text(text), f"before {text}"):
        console.print(shown)
    console.rule(text)
    with console.status(Text(text)) as status:
        status.update(Text(text))
    with progress_bar() as bar:
        bar.add_task(text, total=1)
    said = capsys.readouterr().out
    assert not FORBIDDEN & set(said)
    assert "[" not in text.replace("\x1b[", "") or said.count(text) >= 5


@pytest.mark.parametrize("text", HOSTILE)
def test_results_are_shown_with_the_names_that_they_have(text, capsys):
    table = ResultTable("key", text, (Column(text), Column("success")), ((Cell(text, text), Cell("1", "2")),), (), text)
    document = Document((table, Remark(text, "problem")))
    output_console().print(DocumentView(document))
    assert not FORBIDDEN & set(capsys.readouterr().out)


def agent_of(folder, name, changes=()):
    """A shipped agent under another name, with changes to its card."""
    shipped = importlib.resources.files("armctl.rl.agents")
    (folder / f"{name}.onnx").write_bytes((shipped / "reach_ppo.onnx").read_bytes())
    card = json.loads((shipped / "reach_ppo.json").read_text()) | dict(changes)
    (folder / f"{name}.json").write_text(json.dumps(card))
    return f"{name}.json"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["[red]x[red]", "[bold]", "[", "[@click=f()]y[]"])
def test_square_brackets_in_names_are_no_markup(tmp_path, name):
    agent = agent_of(tmp_path, name)
    said = armctl("run", agent, "--steps", "2", cwd=tmp_path).stdout
    assert f"{agent}, episode 0" in said
    said = armctl("compare", agent, "--episodes", "2", "--set", "max_episode_steps=3", "--out", name, cwd=tmp_path)
    assert agent in said.stdout
    assert f"{name}/episodes.csv has the episodes" in said.stdout
    assert f"{name}/page.html is the report" in (
        armctl("report", name, "--no-video", "--out", f"{name}/page.html", cwd=tmp_path).stdout
    )
    wrong = armctl("run", f"{name}.py:f[/]", cwd=tmp_path, check=False)
    assert (wrong.returncode, "Traceback" in wrong.stderr) == (2, False)
    assert "f[/]" in wrong.stderr


@pytest.mark.slow
def test_what_a_card_says_is_no_control_sequence(tmp_path):
    text = "\x1b[2J\x1b]0;title\x07\x9b31m[/]"
    for field in ("name", "learner", "recipe", "env", "teacher", "shaping", "versions", "interface"):
        agent = agent_of(tmp_path, field, {field: {text: text} if field in ("versions", "interface") else text})
        for verb in (("run", agent, "--steps", "1"), ("reproduce", agent)):
            if verb[0] == "run" or field == "env":  # reproduce plays a thousand episodes of what it can load
                done = armctl(*verb, cwd=tmp_path, check=False)
                assert not FORBIDDEN & set(done.stdout + done.stderr)
                assert "Traceback" not in done.stderr


def test_an_environment_of_ones_own_speaks_plainly(tmp_path):
    (tmp_path / "mine.py").write_text(HOSTILE_ENVIRONMENT)
    for arguments in (["run", "random", "--env", "mine.py:Maze"], ["list", "--env", "mine.py:Maze"]):
        done = armctl(*arguments, cwd=tmp_path, check=False)
        assert not FORBIDDEN & set(done.stdout + done.stderr)
        assert "Traceback" not in done.stderr
    done = armctl(
        "compare", "random", "--env", "mine.py:Maze", "--out", "o", "--episodes", "1", cwd=tmp_path, check=False
    )
    assert not FORBIDDEN & set(done.stdout + done.stderr)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_progress_bar_in_a_terminal_shows_names_as_they_are(tmp_path):
    agent = agent_of(tmp_path, "[bold]\x1b]0;title\x07x")
    arguments = ["compare", agent, "--episodes", "30", "--set", "max_episode_steps=3", "--out", "[bold]"]
    environment = os.environ | {"TERM": "xterm"}
    reader, terminal = pty.openpty()
    with subprocess.Popen(
        [ARMCTL, *arguments], cwd=tmp_path, stdout=terminal, stderr=terminal, stdin=terminal, env=environment
    ) as process:
        os.close(terminal)
        said = b""
        with contextlib.suppress(OSError):  # Linux's word for its end
            while part := os.read(reader, 4096):
                said += part
    os.close(reader)
    assert process.returncode == 0, said
    assert b"[bold]" in said
    assert b"\x1b]0;" not in said
    assert rb"\x1b]0;" in said


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://me:{}@host/db", "mysql+pymysql://me:{}@host:3306/db", "https://{}@hub.example/x", "http://me:{}@[::1]:80/",
        "ray://me:{}@host:10001", "ftp://:{}@host", "https://me:x@{}@host/", "mssql://h/db?password={}&user=me",
    ],
)  # fmt: skip
@pytest.mark.parametrize("secret", ["hunter2", "a/b", "12345", "p%40ss", "a:b", "ö~!$"])
def test_secrets_in_addresses_are_not_shown(address, secret, capsys):
    if "/" in secret and ("://{}" in address or "@{}" in address):
        return  # a host ends there
    text = f"cannot reach {address.format(secret)} (mine.py:3)"
    PlainConsole(stderr=True).print(text, soft_wrap=True)
    learn.say(text)
    for shown in (printable(text), *capsys.readouterr()):
        assert secret not in shown
        assert "***" in shown
        assert "(mine.py:3)" in shown


@pytest.mark.parametrize(
    "text",
    [
        "http://127.0.0.1:8000/?token=a1b2", "https://hub/owner/x@main", "http://hub:8080/owner/x@main", "a:b@c",
        "https://github.com/armctl/armctl", "http://[::1]:80/a@b", "file:///tmp/a@b", "me@host", "dask://host:8786",
    ],
)  # fmt: skip
def test_other_addresses_are_shown(text):
    assert printable(text) == text
