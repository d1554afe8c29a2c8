"""Errors whose messages do not name the cause: the line that raised them, and a hint at MuJoCo's version."""

import importlib

import mujoco
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError, described
from armctl.envs import make_worlds
from armctl.remote.connection import error_in
from armctl.study import compare

LIBRARY = """
import mujoco, numpy as np

class Model:
    eq_data = np.zeros((1, 12))

def check(kind):
    assert kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)

def shape():
    model = Model()
    model.eq_data[0] = np.zeros(11)

def other():
    return int("x")
"""
MINE = """
import gymnasium
import mujoco
import old_library
from gymnasium import spaces

class Env(gymnasium.Env):
    observation_space = action_space = spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample() * 0, {}

    def step(self, action):
        assert self.ready

class Made(Env):
    def __init__(self):
        old_library.check(mujoco.mjtJoint.mjJNT_FREE)

def act(observation):
    assert observation[0] > 100
"""
HINT = f". MuJoCo is {mujoco.__version__} here, and this code may be for an older one"


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A user's folder, with a package that is installed in it."""
    (tmp_path / "site-packages").mkdir()
    (tmp_path / "site-packages" / "old_library.py").write_text(LIBRARY)
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "site-packages")


def told(call):
    with pytest.raises(Exception) as raised:  # noqa: PT011 - of any kind
        call()
    return described(raised.value)


def test_an_error_without_a_text_is_told_by_its_line(mine):
    (failure,) = compare({"mine.py:act": "mine.py:act"}, "armctl/ArmReach-v0", episodes=1).failures.values()
    assert failure.endswith('AssertionError: "assert observation[0] > 100" in mine.py:22')


def test_older_packages_are_sent_to_another_python(mine):
    old_library = importlib.import_module("old_library")

    assert HINT in told(lambda: old_library.check(np.int32(3)))
    assert HINT in told(old_library.shape)
    assert HINT in told(lambda: mujoco.mj_no_such_function)
    assert HINT in told(lambda: mujoco.MjData.no_such_array)
    assert HINT not in told(old_library.other)
    assert HINT not in told(lambda: np.no_such_function)  # type: ignore[attr-defined]
    with pytest.raises(ConfigurationError, match=r"mjJNT_SLIDE\)\" in old_library.py:8 \(mine.py:19\)\. MuJoCo is"):
        make_worlds("mine.py:Made", 1)


def test_an_error_of_another_process_without_a_text_is_told_by_its_line():
    text = (
        'Traceback (most recent call last):\n  File "/far/mine.py", line 3, in act\n    assert ready\n           ^^^\n'
    )
    error = error_in(f"{text}AssertionError\n")
    assert (type(error).__name__, str(error)) == ("AssertionError", '"assert ready" in mine.py:3')
    assert str(error_in(f"{text}mine.Error: no\n")) == "no"
