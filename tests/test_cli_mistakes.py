"""A mistake at the command line gets one clear line, and a traceback where one is asked for."""

import ast
import re
from pathlib import Path

import pytest

from .command_line import armctl

HOME = Path(__file__).parents[1]
FORK = "<robot name='fork'><link name='base'/><link name='left'/><link name='right'/>" + "".join(
    f"<joint name='{side}' type='revolute'><parent link='base'/><child link='{side}'/></joint>"
    for side in ("left", "right")
) + "</robot>"  # fmt: skip
"""An arm with two tips."""


QUITS = """def act(observation):
    raise SystemExit(5)
class Made:
    def __init__(self): raise SystemExit(6)
    def act(self, observation): pass
"""


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["compare", "reach_ki"], "Did you mean 'reach_ik'"),
        (["compare", "random", "--set", "robto=ur3"], "Did you mean 'robot'"),
        (["compare", "random", "--set", "disturbances={'noize': 1}"], "Did you mean 'noise'"),
        (["sweep", "random", "--disturbance", "playload"], "Did you mean 'payload'"),
        (["sweep", "random", "--disturbance", "payload=heavy"], "payload are numbers, such as"),
        (["sweep", "random", "--disturbance", "delay=0.5"], "delay is a whole number"),
        (["compare", "random", "--set", "robot"], "NAME=VALUE"),
        (["compare", "none.json"], "there is no agent"),
        (["run", "random", "--env", "armctl/Reach-v0"], "ArmReach"),
        (["run", "random", "--env", "Reach"], "Did you mean 'ArmReach-v0'"),
        (["run", "random", "--env", "Pendulun-v1"], "Did you mean 'Pendulum-v1'"),
        (["run", "random", "--set", "robot=two.urdf"], r"2 leaf links \(left, right\).*`--set tip=LINK`"),
        (["run", "random", "--set", "robot=two.urdf", "--set", "tip=lift"], "Did you mean 'left'.*base, left, right"),
        (["reproduce", "reach_ik"], "reach_ik is not a learned agent: .* Agents are .*reach_ppo"),
        (["reproduce", "reach_pp"], "Did you mean 'reach_ppo'"),
        (["list", "--env", "armctl/ArmReech-v0"], "Did you mean 'armctl/ArmReach-v0'"),
        (["run", "random", "--set", "control=torqe"], "Did you mean 'torque'"),
        (["collect", "reach_ki", "--out", "data"], "Did you mean 'reach_ik'"),
        (["collect", "random", "--out", "/proc/data", "--episodes", "1"], "cannot be written"),
        (["train", "reach_bc", "--option", "dataset=nowhere"], "no Minari dataset nowhere"),
        (["train", "reach_dagger", "--teacher", "reach_ki"], "Did you mean 'reach_ik'"),
        (["view", "random", "--set", "robto=ur3"], "Did you mean 'robot'"),
        (["train", "pppo"], "Did you mean 'ppo'"),
        (["train", "reach_pp"], "Did you mean 'reach_ppo'"),
        (["train", "none.toml"], "cannot be read"),
        (["train", "reach_ppo", "--shaping", "distanse"], "Did you mean 'distance'"),
        (["train", "reach_ppo", "--option", "gama=0.9"], "Did you mean 'gamma'"),
        (["train", "reach_ppo", "--option", "gamma"], "--option needs NAME=VALUE"),
        (["train", "reach_ppo", "--option", "gamma=high"], "gamma"),
        (["train", "reach_ppo", "--shaping-scale", "nan"], "shaping_scale"),
        (["train", "reach_ppo", "--out", "/dev/null/run"], "cannot be written"),
        (["train", "ppo", "--env", "armctl/ArmReach-v1"], "Did you mean 'armctl/ArmReach-v0'"),
        (["train", "ppo", "--resume", "--out", "nowhere"], "no training to resume"),
        (["run", "random", "--video", "/dev/null/film.mp4"], "cannot be written: there is no folder /dev/null"),
        (["run", "random", "--video", "nowhere/film.mp4"], "cannot be written: there is no folder nowhere"),
        (["run", "random", "--rerun", "nowhere/log.rrd"], "cannot be written: there is no folder nowhere"),
        (["compare", "random", "--margin", "-3"], "between 0 and 100 points, not -3"),
        (["compare", "random", "--margin", "100"], "between 0 and 100 points, not 100"),
        (["compare", "random", "--at-most", "9"], "--at-most is for --until decided"),
        (["compare", "random", "--until", "decided", "--episodes", "9"], "--episodes is a fixed number"),
        (["compare", "random", "--until", "decided"], "random plays alone"),
        (["compare", "random", "reach_ik", "--until", "dawn"], "decided"),
        (["compare", "random", "--robot", "ur11"], "Did you mean 'ur10'"),
        (["compare", "random", "--robot", "ur10", "--set", "robot=ur3"], "--robot and --set robot=ur3 say the same"),
        (["export", "missing.zip", "--env", "Pendulum-v1"], "there is no model missing.zip"),
        (["export", "exits.py", "--env", "Pendulum-v1"], "models are files .zip"),
        (["run", "random", "--video", "/proc/film.mp4"], "cannot be written: No such file"),
        (["run", "random", "--video", "film.xyz"], "ends in one of .mp4, .mkv"),
        (["run", "random", "--video", "film.mp4", "--watch"], "exclude each other"),
        (["run", "random", "--set", "max_episode_steps=abc"], "max_episode_steps"),
        (["train", "ppo", "--set", "control=nope", "--out", "fresh"], "control"),
        (["run", "random", "--env", "exits.py:Maze"], r"cannot load the environment .*SystemExit: 17 \(exits.py:1\)"),
        (["run", "exits.py:act"], "cannot load the policy .*SystemExit: 17"),
        (["run", "quits.py:act"], r"quits.py:act failed in episode 0: SystemExit: 5 \(quits.py:2\)"),
        (["run", "quits.py:Made"], r"quits.py:Made could not be made: SystemExit: 6"),
        (["collect", "random", "--out", "loop", "--episodes", "1"], "loop cannot be written to"),
        (["export", "model.zip", "--out", "", "--env", "Pendulum-v1"], "an agent is a file .onnx"),
        (["export", "model.zip", "--out", "x" * 300 + ".onnx", "--env", "Pendulum-v1"], "model.zip"),
        (["report", "x" * 300], "there is no folder"),
        (["compare", "x" * 300 + ".json"], "there is no agent"),
        (["compare", "random", "--episodes", "9" * 30], "at most 10,000,000"),
    ],
)
def test_mistakes_get_one_clear_line(arguments, says, tmp_path):
    (tmp_path / "two.urdf").write_text(FORK)
    (tmp_path / "exits.py").write_text("raise SystemExit(17)\n")
    (tmp_path / "quits.py").write_text(QUITS)
    (tmp_path / "loop").symlink_to("loop")
    done = armctl(*arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert re.search(says, done.stderr)
    assert done.stderr.count("\n") == 1
    assert "Errno" not in done.stderr
    assert not list(tmp_path.glob("nowhere"))


@pytest.mark.one_case
@pytest.mark.parametrize(
    "arguments",
    [
        ["compare", "random"], ["sweep", "random"], ["suite"], ["collect", "random", "--out", "data"],
        ["train", "ppo", "--env", "armctl/ArmReach-v0", "--seed", "0,1"], ["tune", "reach_mpc", "--trials", "1"],
    ],
    ids=" ".join,
)  # fmt: skip
@pytest.mark.parametrize("workers", ["1001", "9" * 30])
def test_no_verb_starts_more_processes_than_a_machine_has(arguments, workers, tmp_path):
    done = armctl(*arguments, "--workers", workers, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "workers must be at least 1 and at most 1,000" in done.stderr


@pytest.mark.slow
def test_no_message_has_the_number_of_a_systems_error():
    """Whoever catches `OSError` writes its `reason`, or `strerror`, and not the error with its number."""
    raw = []
    for file in (file for folder in ("src/armctl", "rl", "baselines") for file in (HOME / folder).rglob("*.py")):
        for handler in (node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ExceptHandler)):
            caught = {name.id for name in ast.walk(handler.type or handler) if isinstance(name, ast.Name)}
            written = [part.value for part in ast.walk(handler) if isinstance(part, ast.FormattedValue)]
            names = {value.id for value in written if isinstance(value, ast.Name)}
            if handler.name in names and caught & {"OSError", "FileNotFoundError", "PermissionError"}:
                raw.append(f"{file}:{handler.lineno}")
    assert not raw


@pytest.mark.slow
def test_a_traceback_is_shown_where_it_is_asked_for(tmp_path):
    (tmp_path / "mine.py").write_text("def typo(observation):\n    return obsevation\n")
    arguments = ["compare", "mine.py:typo", "--episodes", "1", "--out", "r"]
    short = armctl(*arguments, cwd=tmp_path, check=False)
    assert "'obsevation' is not defined (mine.py:2)" in " ".join(short.stdout.split())
    assert "Traceback" not in short.stdout + short.stderr
    for words in (["--traceback", *arguments], [*arguments, "--traceback"]):
        long = armctl(*words, "--overwrite", cwd=tmp_path, check=False)
        assert "line 2, in typo" in long.stderr
    refused = armctl("run", "mine.py:tipo", "--traceback", cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert "Traceback" in refused.stderr
