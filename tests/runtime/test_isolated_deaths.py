"""An isolated policy whose process dies or hangs loses that episode, and nothing of it is left in the end."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest

from armctl.core.errors import ConfigurationError
from armctl.runtime import isolation
from armctl.study import compare

from .guessing import guess_task

pytestmark = pytest.mark.slow  # interpreters are started


@pytest.fixture
def home(tmp_path, monkeypatch):
    guess_task(tmp_path, monkeypatch)
    return tmp_path


DEATHS = {
    "os._exit(3)": "its process ended with status 3",
    "ctypes.string_at(0)": "its process died by SIGSEGV",
    "os.kill(os.getpid(), 9)": "its process died by SIGKILL",
    "time.sleep(1e6)": "its process has not answered for 3 s, and was ended",
    "raise ValueError('no')": r"ValueError: no \(mine.py:7\)",
    "sys.exit(4)": r"SystemExit: 4 \(mine.py:7\)",
    "return 'forwards'": r"it returned 'forwards'; expected are numbers of shape \(1,\) \(mine.py:5\)",
    "os.write(FD, b'nonsense' * 9)": "its process",
    "socket.socket(fileno=FD).sendall(struct.pack('!i', len(BOMB)) + BOMB)": "what is none of armctl's messages",
}


@pytest.mark.one_case
@pytest.mark.parametrize(("death", "num_envs"), [*((death, 1) for death in DEATHS), ("os._exit(3)", 3)])
def test_a_policy_that_dies_or_hangs_loses_that_episode_and_plays_on(home, death, num_envs, monkeypatch):
    monkeypatch.setattr(isolation, "PATIENCE", 3.0)
    (home / "mine.py").write_text(f"""import ctypes, os, pickle, socket, stat, struct, sys, time
NAMES = [name for name in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{{name}}")]
FD = max(int(name) for name in NAMES if stat.S_ISSOCK(os.fstat(int(name)).st_mode))
BOMB = pickle.dumps(type("Bomb", (), {{"__reduce__": lambda self: (os.system, ("touch bombed",))}})())
def policy(observation):
    if 0.45 < observation[0] < 0.55:
        {death}
    return [0.5]
""")
    comparison = compare(["mine.py:policy"], "guess_task.py:Guess", episodes=7, seed=2, isolate=True, worlds=num_envs)
    episodes = comparison.episodes
    assert len(episodes) == 7
    assert episodes.episode[episodes.outcome == "error"].tolist() == [5]
    message = comparison.failures["mine.py:policy"]
    assert re.search(DEATHS[death], message), message
    assert not (home / "bombed").exists()


def test_a_policy_whose_process_always_dies_cannot_play(home):
    (home / "mine.py").write_text("import os\ndef policy(observation):\n    os._exit(3)\n")
    comparison = compare(["mine.py:policy", "random"], "guess_task.py:Guess", episodes=2, isolate=True)
    assert "mine.py:policy failed in episode 0" in comparison.failures["mine.py:policy"]
    assert "its process ended with status 3" in comparison.failures["mine.py:policy"]
    assert [policy.policy for policy in comparison.policies] == ["random"]


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import os\nos._exit(3)", "mine.py:policy could not be made: its process ended with status 3"),
        ("raise ValueError('no')", "cannot load the policy 'mine.py:policy': ValueError: no"),
        ("def policies(observation): pass", "no policy in mine.py: 'policy'.*Did you mean 'policies'"),
        ("def policy(env): return 3", "mine.py:policy made something of type int, which is not a policy"),
        ("def policy(env): return env.task", "env.task is not for a policy that sees the observation"),
    ],
)
def test_what_cannot_be_made_is_told_as_ever(home, code, says):
    (home / "mine.py").write_text(code)
    with pytest.raises(ConfigurationError, match=says):
        compare(["mine.py:policy"], "guess_task.py:Guess", episodes=1, isolate=True)


SLEEPS, KEEPS_THE_GIL = ("time.sleep(1e6)", 2), ("ctypes.PyDLL(None).sleep(10**6)", 1)


@pytest.mark.parametrize(
    ("doing", "workers", "by"),
    [
        (*SLEEPS, signal.SIGINT),
        (*SLEEPS, signal.SIGKILL),
        (*KEEPS_THE_GIL, signal.SIGKILL),
        (*KEEPS_THE_GIL, signal.SIGTERM),
        pytest.param(*SLEEPS, signal.SIGTERM, marks=pytest.mark.thorough),
        pytest.param(*KEEPS_THE_GIL, signal.SIGINT, marks=pytest.mark.thorough),
    ],
)
def test_nothing_is_left_when_the_comparison_ends(home, doing, workers, by):
    (home / "mine.py").write_text(f"""
import ctypes, os, time
def policy(observation):
    open(f"pid-{{os.getpid()}}", "w").close()
    {doing}
""")
    command = ["-m", "armctl", "compare", "mine.py:policy", "--env", "guess_task.py:Guess", "--episodes", "9"]
    process = subprocess.Popen([sys.executable, *command, "--isolate", "--workers", str(workers)], process_group=0)
    waited(lambda: list(home.glob("pid-*")), 600)
    os.killpg(process.pid, by) if by == signal.SIGINT else process.send_signal(by)
    process.wait(300)
    children = [int(path.name.removeprefix("pid-")) for path in home.glob("pid-*")]
    assert waited(lambda: not any(map(is_running, children)), 120)


def waited(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
    return True


def is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
