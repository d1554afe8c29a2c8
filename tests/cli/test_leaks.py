"""Environments that leak, clocks that jump: results are as they are, and whatever holds the process up has a name."""

import re
import signal
import subprocess
from pathlib import Path

import pytest

import armctl
import armctl.rl

from ..command_line import ARMCTL, program

LEAKING = """
import os, threading, time
import gymnasium, numpy as np

KEPT = []

class Files(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (1,)); action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, seed=None, options=None):
        self.leak()
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.zeros(1, np.float32), 0.0, True, False, {}

    def leak(self):
        KEPT.extend(os.open(os.devnull, os.O_RDONLY) for _ in range(50))

class Memory(Files):
    def leak(self):
        KEPT.append(np.ones(1 if len(KEPT) < 30 else 10**14))

class Threads(Files):
    def leak(self):
        threading.Thread(target=time.sleep, args=(600,), name="listener").start()

def still(observation):
    return [0.0]
"""


@pytest.fixture
def home(tmp_path):
    (tmp_path / "leaking.py").write_text(LEAKING)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "limit", "says"),
    [("Files", "-n 400", "Too many open files"), ("Memory", "-n 1000", "Unable to allocate")],
)
def test_what_was_played_before_nothing_was_left_is_kept(env, limit, says, home):
    words = f"compare leaking.py:still --env leaking.py:{env} --episodes 60 --out out"
    done = subprocess.run(f"ulimit {limit}; {ARMCTL} {words}", shell=True, capture_output=True, text=True, cwd=home)
    assert done.returncode == 1, done.stderr
    assert says in done.stdout + done.stderr
    assert "was cut short" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    program("episodes", "out", "--csv", cwd=home)
    assert 2 < len((home / "out" / "episodes.csv").read_text().splitlines()) < 60


@pytest.mark.slow
def test_threads_that_hold_up_the_end_are_named(home):
    words = ["compare", "leaking.py:still", "--env", "leaking.py:Threads", "--episodes", "2", "--out", "out"]
    with subprocess.Popen(
        [ARMCTL, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=home
    ) as run:
        lines = iter(run.stderr.readline, "")
        assert next(
            line for line in lines if "threads of an environment or a policy run on, such as 'listener'" in line
        )
        run.send_signal(signal.SIGINT)
        run.wait(300)
        assert "Traceback" not in run.stderr.read()
    assert run.returncode == 130
    assert (home / "out" / "episodes.csv").exists()


@pytest.mark.slow
def test_armctl_s_own_workers_do_not_hold_up_the_end(home):
    words = ["compare", "leaking.py:still", "--env", "Pendulum-v1", "--episodes", "2", "--workers", "2"]
    done = subprocess.run([ARMCTL, *words], capture_output=True, text=True, cwd=home, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "run on" not in done.stderr


def test_no_duration_is_measured_by_a_clock_that_can_be_set():
    """Dates are written, and nothing else is taken from the time of day."""
    package = Path(armctl.__file__).parent
    learners = Path(armctl.rl.__path__[0])
    files = [*package.rglob("*.py"), *learners.rglob("*.py")]
    assert not [
        path.name for path in files if re.search(r"\btime\.time(_ns)?\(|from time import.*\btime\b", path.read_text())
    ]
    dates = {path.name for path in files if re.search(r"datetime\.(now|today|utcnow)|\.st_[mc]time", path.read_text())}
    assert dates == {
        "provenance.py",
        "trials.py",
        "render.py",
        "options.py",
        "arm.py",
    }  # arm.py: whether a file changed
