"""What makes a comparison another one: the modules and scripts that its policies and environments are written in."""

import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import pytest

from armctl import __file__ as package
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.envs import make_worlds
from armctl.runtime import identity as identity_module
from armctl.runtime.identity import checksum_of_core, checksums_of_code, identity

from ..command_line import armctl
from .resuming import plays

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
def test_an_import_within_a_function_counts(tmp_path, lazy, monkeypatch):
    body = "def pd(observation):\n    from gains import G\n    return observation[3:9] * G\n"
    (tmp_path / "mine.py").write_text(body if lazy else "from gains import G\n" + body)
    (tmp_path / "gains.py").write_text("G = 0.1\n")
    command = ["compare", "mine.py:pd", "--episodes", "2", "--out", "out", "--set", "max_episode_steps=3"]
    monkeypatch.syspath_prepend(tmp_path)
    armctl(*command, cwd=tmp_path)
    (tmp_path / "gains.py").write_text("G = 0.9\n")
    refused = armctl(*command, cwd=tmp_path, check=False)
    assert "code: gains.py" in refused.stderr


REGISTERED = """
import gymnasium
gymnasium.register("mine/M-v0", entry_point="labyrinth:Maze", max_episode_steps={steps}, kwargs={{"g": {g}}})
"""


MAZE = """
from gymnasium.envs.classic_control import PendulumEnv

class Maze(PendulumEnv):
    pass
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "steps", "g"), [("registered", 60, 10.0), ("registered", 50, 3.0), ("code: labyrinth.py", 50, 10.0)]
)
def test_an_environment_that_is_registered_or_made_otherwise(tmp_path, changed, steps, g):
    """Its class is named as Gymnasium's users do: by a text, in a module beside."""
    (tmp_path / "labyrinth.py").write_text(MAZE)
    (tmp_path / "reg.py").write_text(REGISTERED.format(steps=50, g=10.0))
    command = ["compare", "random", "--env", "reg:mine/M-v0", "--episodes", "2", "--out", "out"]
    armctl(*command, cwd=tmp_path)
    assert "finished by an earlier run" in armctl(*command, cwd=tmp_path).stdout
    (tmp_path / "reg.py").write_text(REGISTERED.format(steps=steps, g=g))
    if "labyrinth" in changed:
        (tmp_path / "labyrinth.py").write_text(MAZE + "# edited\n")
    assert changed in armctl(*command, cwd=tmp_path, check=False).stderr


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


@pytest.mark.slow
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


@pytest.mark.one_case
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_global_that_a_script_sets_is_another_policy(modules, tmp_path, monkeypatch):
    (mine,) = modules(mine="GAIN = 0.1\n\ndef pd(x):\n    return x[3:9] * GAIN\n")
    assert plays(tmp_path / "out", ["mine:pd"]) == 0
    assert plays(tmp_path / "out", ["mine:pd"]) == 2
    monkeypatch.setattr(mine, "GAIN", 0.9)
    with pytest.raises(ResultsError, match="objects: mine:pd"):
        plays(tmp_path / "out", ["mine:pd"])


@pytest.mark.slow
def test_an_edit_of_armctls_source_changes_the_identity(tmp_path, monkeypatch):
    """Of each module that an episode needs: those that are loaded in a process which has played one."""
    script = (
        "import sys, armctl; armctl.compare('random', episodes=1, env_options={'max_episode_steps': 1}); "
        "print(*[m.__file__ for n, m in sys.modules.items() if n.startswith('armctl.') and hasattr(m, '__file__')])"
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    root = Path(package).parent
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
