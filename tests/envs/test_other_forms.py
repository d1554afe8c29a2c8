"""Environments in packages, in scripts, and in forms that armctl cannot play."""

import re
import subprocess
import sys

import pytest

from ..command_line import armctl

MAZE = """
import gymnasium as gym
import numpy as np
from {tools} import STEP

class Maze(gym.Env):
    observation_space = gym.spaces.Box(-9, 9, (1,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed); self.x, self.t = self.np_random.uniform(-1, 1), 0
        return np.array([self.x], np.float32), {{}}
    def step(self, action):
        self.x += STEP * float(action[0]); self.t += 1
        return np.array([self.x], np.float32), -abs(self.x), False, self.t >= 20, {{}}

def go(observation): return [-np.sign(observation[0])]
"""
FORMS = """
import gymnasium as gym
from pkg.envs.maze import Maze, go

class Many(gym.vector.VectorEnv):
    def __init__(self, num_envs=2, **options): pass
gym.register("forms/Many-v0", vector_entry_point=Many)
def sync(): return gym.vector.SyncVectorEnv([Maze, Maze])
instance = Maze()
several = gym.vector.SyncVectorEnv([Maze])
make = lambda: Maze()
def nothing(): return None
def needs(size, goal=1): return Maze()
class NotAnEnv: pass
"""


@pytest.fixture
def home(tmp_path):
    (tmp_path / "pkg" / "envs").mkdir(parents=True)
    (tmp_path / "pkg" / "__init__.py").write_text("from .envs import Maze\n")
    (tmp_path / "pkg" / "envs" / "__init__.py").write_text("from .maze import Maze\n")
    (tmp_path / "pkg" / "envs" / "tools.py").write_text("STEP = 0.1\n")
    (tmp_path / "pkg" / "envs" / "maze.py").write_text(MAZE.format(tools=".tools"))
    (tmp_path / "forms.py").write_text(FORMS)
    return tmp_path


@pytest.mark.one_case
@pytest.mark.parametrize(
    "env", ["pkg/envs/maze.py:Maze", "pkg.envs.maze:Maze", "pkg:Maze", "pkg/__init__.py:Maze", "forms.py:make"]
)
def test_a_class_in_a_package_is_found_by_its_file_or_module(env, home):
    text = armctl("compare", "pkg/envs/maze.py:go", "--env", env, "--episodes", "2", "--out", "r", cwd=home).stdout
    assert re.search(r"2 truncated", text)


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("env", "says"),
    [
        ("forms/Many-v0", "there is no environment"),
        ("forms.py:forms/Many-v0", "vector environments only: name a class or function that makes one world"),
        ("forms.py:Many", "makes no gymnasium.Env: name a class or function that makes one world"),
        ("forms.py:sync", "makes no gymnasium.Env: name a class or function"),
        ("forms.py:nothing", "makes no gymnasium.Env: name a class or function"),
        ("forms.py:NotAnEnv", "makes no gymnasium.Env: name a class or function"),
        ("forms.py:instance", "name the class or function"),
        ("forms.py:several", "name the class or function"),
        ("forms.py:needs", "needs its option size: --set size=VALUE"),
        ("forms.Many", "after a colon: forms:Many"),
        ("pkg.envs.maze.Maze", "after a colon: pkg.envs.maze:Maze"),
        ("forms.py", "forms.py:NAME"),
    ],
)
def test_what_cannot_be_played_is_told_with_what_to_give_instead(env, says, home):
    done = armctl("run", "random", "--env", env, "--steps", "1", cwd=home, check=False)
    assert done.returncode == 2
    assert says in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_class_of_the_script_works_with_workers_too(workers, home):
    script = home / "script.py"
    script.write_text(f"""{MAZE.format(tools="pkg.envs.tools")}
def make(): return Maze()

if __name__ == "__main__":
    import armctl
    for env in (Maze, make):
        for policies in ([go, "random"], {{"lambda": lambda observation: [0.1]}}):
            result = armctl.compare(policies, env, episodes=4, workers={workers})
            assert set(result.episodes.outcome) == {{"truncated"}}, result.episodes
    print("played")
""")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, cwd=home)
    assert done.stdout == "played\n", done.stderr
