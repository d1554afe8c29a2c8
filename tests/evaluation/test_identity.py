"""What makes a comparison another one: everything that a policy or an environment is made of."""

import functools
import os
import subprocess
import sys
import threading
import types

import numpy as np
import pytest

from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation import compare
from armctl.evaluation.fingerprint import fingerprint
from armctl.evaluation.identity import checksums_of_code, differences

from ..command_line import program

OPTIONS = {"max_episode_steps": 3}


class Gain:
    def __init__(self, gain):
        self.gain = gain

    def act(self, observation):
        return observation[3:9] * self.gain


def closure(gain):
    def act(observation):
        return observation[3:9] * gain

    return act


def default(gain):
    def act(observation, gain=gain):
        return observation[3:9] * gain

    return act


def of_a_class(gain):
    class Local:
        factor = gain

        def act(self, observation):
            return observation[3:9] * self.factor

    return Local


def of_a_property(gain):
    class Local:
        factor = property(lambda self: gain)

        def act(self, observation):
            return observation[3:9] * self.factor

    return Local()


def nested(gain):
    inner = closure(gain)
    return lambda observation: inner(observation)


KINDS = {
    "object": Gain, "closure": closure, "default": default, "class": of_a_class, "property": of_a_property,
    "bound method": lambda gain: Gain(gain).act,
    "partial of a lambda": lambda gain: functools.partial(lambda factor, observation: observation[3:9] * factor, gain),
    "nested": nested, "object with a function inside": lambda gain: Gain(closure(gain)),
    "array": lambda gain: np.full(5000, gain), "set": lambda gain: {"a", "b", str(gain)},
    "frozen": lambda gain: frozenset({"a", str(gain)}),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_another_value_inside_is_another_object(kind):
    make = KINDS[kind]
    assert fingerprint(make(0.1)) == fingerprint(make(0.1))
    assert fingerprint(make(0.1)) != fingerprint(make(0.9))
    assert "unknown" not in fingerprint(make(0.1))


def test_what_cannot_be_told_equals_nothing():
    given = Gain(threading.Lock())
    assert fingerprint(given) != fingerprint(given)
    assert fingerprint(given).startswith("unknown (")


@pytest.mark.parametrize("kind", ["object", "closure", "default", "class", "bound method"])
def test_another_policy_of_the_same_name_does_not_resume(tmp_path, kind):
    make = KINDS[kind]
    compare({"mine": make(0.1)}, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert compare({"mine": make(0.1)}, episodes=2, out=tmp_path, env_options=OPTIONS).resumed == 2
    with pytest.raises(ResultsError, match="objects: mine"):
        compare({"mine": make(0.9)}, episodes=2, out=tmp_path, env_options=OPTIONS)


SCRIPT = """
import armctl, sys
FACTORS = {{"left", "right", "both"}}

def half():
    return {gain} if "left" in FACTORS else 0

class Pd:
    def act(self, observation):
        return observation[3:9] * half()

def pd(observation):
    return observation[3:9] * half()

found = armctl.compare([pd, Pd], episodes=2, out="out", env_options={{"max_episode_steps": 3}})
print("resumed", found.resumed)
"""


@pytest.mark.parametrize("by_file", [True, False], ids=["file", "stdin"])
def test_a_script_that_runs_again_resumes_and_an_edited_one_does_not(tmp_path, by_file):
    """In processes whose sets have another order: it is the same script."""

    def run(gain, seed, begin=""):
        text = begin + SCRIPT.format(gain=gain)
        (tmp_path / "script.py").write_text(text)
        command = [sys.executable, "script.py"] if by_file else [sys.executable, "-"]
        environment = os.environ | {"PYTHONHASHSEED": seed}
        given = None if by_file else text
        return subprocess.run(command, input=given, cwd=tmp_path, capture_output=True, text=True, env=environment)

    assert "resumed 0" in run(0.1, "1").stdout
    again = run(0.1, "2", begin="# it stands lower now\n")
    assert "resumed 4" in again.stdout, again.stderr
    assert "ResultsError" in run(0.9, "3").stderr


@pytest.mark.parametrize("lazy", [True, False])
def test_an_import_within_a_function_counts(tmp_path, lazy):
    body = "def pd(observation):\n    from gains import G\n    return observation[3:9] * G\n"
    (tmp_path / "mine.py").write_text(body if lazy else "from gains import G\n" + body)
    (tmp_path / "gains.py").write_text("G = 0.1\n")
    command = ["compare", "mine.py:pd", "--episodes", "2", "--out", "out", "--set", "max_episode_steps=3"]
    first = program(*command, cwd=tmp_path, check=lazy is False, PYTHONPATH=str(tmp_path))
    assert first.returncode == 0, first.stderr
    (tmp_path / "gains.py").write_text("G = 0.9\n")
    refused = program(*command, cwd=tmp_path, check=False, PYTHONPATH=str(tmp_path))
    assert "code: gains.py" in refused.stderr


REGISTERED = """
import gymnasium
gymnasium.register("mine/M-v0", entry_point="maze:Maze", max_episode_steps={steps}, kwargs={{"g": {g}}})
"""
MAZE = """
from gymnasium.envs.classic_control import PendulumEnv

class Maze(PendulumEnv):
    pass
"""


@pytest.mark.parametrize(
    ("changed", "steps", "g"), [("registered", 60, 10.0), ("registered", 50, 3.0), ("code: maze.py", 50, 10.0)]
)
def test_an_environment_that_is_registered_or_made_otherwise(tmp_path, changed, steps, g):
    """Its class is named as Gymnasium's users do: by a text, in a module beside."""
    (tmp_path / "maze.py").write_text(MAZE)
    (tmp_path / "reg.py").write_text(REGISTERED.format(steps=50, g=10.0))
    command = ["compare", "random", "--env", "reg:mine/M-v0", "--episodes", "2", "--out", "out"]
    program(*command, cwd=tmp_path)
    assert "finished by an earlier run" in program(*command, cwd=tmp_path).stdout
    (tmp_path / "reg.py").write_text(REGISTERED.format(steps=steps, g=g))
    if "maze" in changed:
        (tmp_path / "maze.py").write_text(MAZE + "# edited\n")
    assert changed in program(*command, cwd=tmp_path, check=False).stderr


def test_a_module_that_was_edited_after_its_import_is_not_what_runs(tmp_path, monkeypatch):
    (tmp_path / "edited_later.py").write_text("def pd(observation):\n    return observation[3:9]\n")
    monkeypatch.syspath_prepend(tmp_path)
    import edited_later

    checksums_of_code([edited_later.pd])
    (tmp_path / "edited_later.py").write_text("def pd(observation):\n    return 0 * observation[3:9]\n")
    with pytest.raises(ConfigurationError, match="has changed since Python imported it"):
        checksums_of_code([edited_later.pd])


def test_options_that_are_objects_count_by_value(tmp_path):
    def reward(scale):
        return {"max_episode_steps": 3, "reward": {"near": lambda state: scale * state.distance}}

    compare("random", episodes=2, out=tmp_path, env_options=reward(1.0))
    assert compare("random", episodes=2, out=tmp_path, env_options=reward(1.0)).resumed == 2
    with pytest.raises(ResultsError, match="env_options: reward"):
        compare("random", episodes=2, out=tmp_path, env_options=reward(2.0))


def test_differences_are_told_one_by_one():
    assert differences({"a": 1, "b": {"x": 1, "y": 2}}, {"a": 1, "b": {"x": 1, "z": 3}}) == [
        "b: y 2 there, None here",
        "b: z None there, 3 here",
    ]


def test_a_library_is_not_followed_and_a_broken_neighbour_is_none(tmp_path, monkeypatch):
    (tmp_path / "tidy.py").write_text(
        "import numpy\nimport broken_neighbour\nfrom . import nothing\n\ndef pd(x): ...\n"
    )
    (tmp_path / "broken_neighbour.py").write_text("X = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    import broken_neighbour  # noqa: F401

    (tmp_path / "broken_neighbour.py").write_text("print 'Python 2'\n")
    code = compile(
        (tmp_path / "tidy.py").read_text().replace("from . import nothing\n", ""), tmp_path / "tidy.py", "exec"
    )
    module = types.ModuleType("tidy")
    module.__file__ = str(tmp_path / "tidy.py")
    monkeypatch.setitem(sys.modules, "tidy", module)
    exec(code, vars(module))
    assert set(checksums_of_code([module])) == {"tidy.py", "broken_neighbour.py"}
