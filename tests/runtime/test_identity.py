"""What makes a comparison another one: everything that a policy or an environment is made of."""

import functools
import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import threading
import types
from pathlib import Path

import numpy as np
import pytest
import torch

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.envs import make_worlds
from armctl.runtime import identity as identity_module
from armctl.runtime.fingerprint import fingerprint
from armctl.runtime.identity import checksum_of_core, checksums_of_code, differences, identity
from armctl.runtime.provenance import versions
from armctl.study import compare
from armctl.study.results import read_comparison

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


def test_what_cannot_be_hashed_is_played_and_written_but_not_resumed(tmp_path):
    """Whoever asks for it is told which of the policies it is, and which part of it."""
    policies = {"locked": Gain(0.1), "mine": Gain(0.1)}
    policies["locked"].lock = threading.Lock()  # type: ignore[attr-defined]
    first = compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert len(first.results) == 4
    assert read_comparison(tmp_path).names == ["locked", "mine"]
    with pytest.raises(ResultsError) as refused:
        compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert "episodes of locked cannot be resumed, since it cannot be hashed (its .lock of type lock: " in str(
        refused.value
    )
    assert "use a module:function" in str(refused.value)
    assert "--overwrite" in str(refused.value)
    assert "mine" not in str(refused.value)
    assert compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS, overwrite=True).resumed == 0


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
    monkeypatch.setattr(identity_module, "_first_seen", {})
    import edited_later

    monkeypatch.setitem(sys.modules, "edited_later", sys.modules.pop("edited_later"))  # it is gone after the test
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


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Writes modules of one's own, and imports them as a new process would."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(identity_module, "_first_seen", {})
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def load(**texts):
        identity_module._first_seen.clear()
        importlib.invalidate_caches()
        for name, text in texts.items():
            (tmp_path / f"{name}.py").write_text(text)
            sys.modules.pop(name, None)
        return [importlib.import_module(name) for name in texts]

    before = set(sys.modules)
    yield load
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


REWARD = """
SCALE = {scale}

def helper(state):
    return SCALE * state.distance

def near(state):
    return helper(state)
"""


def plays(out, policies="random", **options):
    return compare(policies, episodes=2, out=out, env_options=OPTIONS | options).resumed


def test_an_edited_reward_term_of_a_module_does_not_resume(modules, tmp_path):
    """Though the option is the same function, of the same module and name."""
    (terms,) = modules(terms=REWARD.format(scale=1.0))
    assert plays(tmp_path / "out", reward={"near": terms.near}) == 0
    (terms,) = modules(terms=REWARD.format(scale=1.0))
    assert plays(tmp_path / "out", reward={"near": terms.near}) == 2
    (terms,) = modules(terms=REWARD.format(scale=2.0))
    with pytest.raises(ResultsError, match="env_options: reward"):
        plays(tmp_path / "out", reward={"near": terms.near})


IMPORTS = {
    "computed": "import importlib\nname = 'ga' + 'ins'\nG = importlib.import_module(name)\n",
    "by a text": "import importlib\n\ndef pd(x):\n    return x[3:9] * importlib.import_module('gains').GAIN\n",
    "from its file": "import importlib.util, pathlib\nspec = importlib.util.spec_from_file_location('other', "
    "pathlib.Path(__file__).with_name('gains.py'))\nG = importlib.util.module_from_spec(spec)\n"
    "spec.loader.exec_module(G)\n",
}


@pytest.mark.parametrize("how", IMPORTS)
def test_a_module_that_importlib_loads_counts(modules, tmp_path, how):
    policy = IMPORTS[how] + ("" if "def pd" in IMPORTS[how] else "\ndef pd(x):\n    return x[3:9] * G.GAIN\n")
    _, mine = modules(gains="GAIN = 0.1\n", mine=policy)
    assert plays(tmp_path / "out", [mine.pd]) == 0
    _, mine = modules(gains="GAIN = 0.1\n", mine=policy)
    assert plays(tmp_path / "out", [mine.pd]) == 2
    _, mine = modules(gains="GAIN = 0.9\n", mine=policy)
    with pytest.raises(ResultsError, match=r"gains|objects: pd"):
        plays(tmp_path / "out", [mine.pd])


def test_a_module_that_was_loaded_then_counts_loaded_or_not_and_others_do_not(modules, tmp_path):
    """What a policy reads of a module may be beyond what its code tells: then it is a module that was loaded."""
    modules(settings="GAIN = 0.1\n")
    assert plays(tmp_path / "out") == 0
    modules(plots="COLOUR = 1\n")
    assert plays(tmp_path / "out") == 2
    del sys.modules["settings"]
    assert plays(tmp_path / "out") == 2
    (tmp_path / "settings.py").write_text("GAIN = 0.9\n")
    with pytest.raises(ResultsError, match=r"loaded: .*settings.py \w+ there, changed"):
        plays(tmp_path / "out")
    identity_module._first_seen.clear()
    with pytest.raises(ResultsError, match=r"loaded: .*settings.py \w+ there, \w+ here"):
        plays(tmp_path / "out")


def test_a_global_that_a_script_sets_is_another_policy(modules, tmp_path, monkeypatch):
    (mine,) = modules(mine="GAIN = 0.1\n\ndef pd(x):\n    return x[3:9] * GAIN\n")
    assert plays(tmp_path / "out", ["mine:pd"]) == 0
    assert plays(tmp_path / "out", ["mine:pd"]) == 2
    monkeypatch.setattr(mine, "GAIN", 0.9)
    with pytest.raises(ResultsError, match="objects: mine:pd"):
        plays(tmp_path / "out", ["mine:pd"])


@pytest.mark.parametrize(
    "place",
    ["armctl.tasks.reach.reach:ReachTask.instruction", "armctl.tasks.reach.reach:LARGEST_RELATIVE_MOVE"],
)
def test_a_constant_of_the_task_that_a_script_sets_is_another_task(tmp_path, monkeypatch, place):
    assert plays(tmp_path) == 0
    monkeypatch.setattr(place.replace(":", "."), 0.123)
    with pytest.raises(ResultsError, match="constants"):
        plays(tmp_path)


class Net(torch.nn.Module):
    def __init__(self, gain):
        super().__init__()
        self.linear, self.gain = torch.nn.Linear(1, 1), gain
        torch.nn.init.zeros_(self.linear.weight)
        torch.nn.init.zeros_(self.linear.bias)

    def act(self, observation):
        return observation[3:9] * self.gain


class Doubled(Net):
    def act(self, observation):
        return 2 * super().act(observation)


@pytest.mark.parametrize("other", [lambda: Net(0.9), lambda: Doubled(0.1)], ids=["attribute", "type"])
def test_a_torch_module_with_the_same_parameters_is_another_one(tmp_path, other):
    assert plays(tmp_path, {"net": Net(0.1)}) == 0
    assert plays(tmp_path, {"net": Net(0.1)}) == 2
    with pytest.raises(ResultsError, match="objects: net"):
        plays(tmp_path, {"net": other()})


@pytest.mark.parametrize("package", ["numba", "llvmlite", "coal", "torch"])
def test_another_version_of_what_computes_does_not_resume(tmp_path, monkeypatch, package):
    assert plays(tmp_path) == 0
    real = versions()
    assert package in real
    monkeypatch.setattr(identity_module, "versions", lambda: real | {package: "0.1"})
    with pytest.raises(ResultsError, match=f"versions: {package} "):
        plays(tmp_path)


@pytest.mark.slow
def test_an_edit_of_armctls_source_changes_the_identity(tmp_path, monkeypatch):
    """Of each module that an episode needs: those that are loaded in a process which has played one."""
    script = (
        "import sys, armctl; armctl.compare('random', episodes=1, env_options={'max_episode_steps': 1}); "
        "print(*[m.__file__ for n, m in sys.modules.items() if n.startswith('armctl.') and hasattr(m, '__file__')])"
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    root = Path(armctl.__file__).parent
    needed = [Path(name).relative_to(root) for name in output.split() if Path(name).is_relative_to(root)]
    folders = {path.parts[0] for path in needed}
    assert {"envs", "kernels", "policies", "rollout", "simulation", "study", "tasks"} <= folders
    copy = tmp_path / "armctl"
    shutil.copytree(root, copy, ignore=lambda _, names: [n for n in names if "." in n and not n.endswith(".py")])
    spec = types.SimpleNamespace(submodule_search_locations=[str(copy)])
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec)
    original = checksum_of_core.__wrapped__()
    assert original == checksum_of_core()  # of this package, which is the same
    unnoticed = set()
    for folder in sorted(folders):
        path = copy / next(one for one in needed if one.parts[0] == folder)
        text = path.read_text()
        path.write_text(text + "# edited\n")
        unnoticed |= {folder} if checksum_of_core.__wrapped__() == original else set()
        path.write_text(text)
    assert not unnoticed - SHOWING
    monkeypatch.setattr(identity_module, "checksum_of_core", lambda: "edited")
    assert identity("armctl/ArmReach-v0", {}, 0, {}, {}, make_worlds("ArmReach-v0", 1))["source"] == "edited"


SHOWING = {"cli", "report", "viewer"}
"""Folders of what shows results, or starts comparisons, and takes no part in an episode."""


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
