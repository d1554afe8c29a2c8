"""A policy or an environment of this process that hangs ends after the time limit; what was played stays."""

import contextlib
import threading
import time

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from armctl.core.errors import TookTooLong
from armctl.core.time_limit import time_limit
from armctl.study import compare, suite
from armctl.study.results import read_comparison


class Walk(gymnasium.Env):
    """Five steps on a line; one that is told to hang does so in the third step of its first episode."""

    observation_space, action_space = spaces.Box(-9, 9, (1,)), spaces.Box(-1, 1, (1,))

    def __init__(self, hangs=""):
        self.hangs = hangs

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        if self.hangs == "reset":
            time.sleep(60)
        return np.zeros(1), {}

    def step(self, action):
        self.t += 1
        while self.hangs == "step" and self.t == 3:
            pass
        return np.zeros(1), 0.0, False, self.t == 5, {"success": True}


WALK = "tests.rollout.test_timeouts:Walk"


class Hangs:
    """Hangs in its second episode, and handles every `Exception`."""

    def __init__(self):
        self.episodes = 0

    def reset(self):
        self.episodes += 1

    def act(self, observation):
        while self.episodes == 2:
            with contextlib.suppress(Exception):
                time.sleep(60)
        return [0.0]


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_policy_that_hangs_ends_and_others_play_on(tmp_path, workers):
    played = compare({"hangs": Hangs, "random": "random"}, WALK, episodes=4, timeout=0.3, out=tmp_path, workers=workers)
    message = "hangs failed in episode 1: its decision took more than 0.3 s (--timeout)"
    assert workers > 1 or played.failures == {"hangs": message}
    assert "its decision took more than 0.3 s (--timeout)" in played.failures["hangs"]
    kept = read_comparison(tmp_path).episodes
    assert (kept[kept.policy == "random"].success).sum() == 4
    assert workers > 1 or kept[kept.policy == "hangs"].outcome.tolist() == ["success"]


def test_an_environment_that_hangs_ends_the_policies_that_play_in_it():
    played = compare("random", WALK, episodes=2, timeout=0.2, env_options={"hangs": "step"})
    assert played.failures == {
        "random": "the environment failed in episode 0 of random: it took more than 0.2 s (--timeout)"
    }
    assert any("seed is unknown" in note and "more than 0.2 s" in note for note in played.notes)
    with pytest.raises(Exception, match=r"it took more than 0.2 s \(--timeout\)"):
        compare("random", WALK, episodes=2, timeout=0.2, env_options={"hangs": "reset"})


def test_a_suite_leaves_out_a_policy_that_hangs_in_its_first_decision():
    def sleeps(observation):
        time.sleep(60)

    with pytest.raises(Exception, match=r"its first decision took more than 0\.2 s"):
        suite([WALK], policies=[sleeps], timeout=0.2)


def test_what_cannot_be_interrupted_is_judged_when_it_comes_back():
    judged = []

    def late():
        try:
            with time_limit(0.05, "it"):
                time.sleep(0.1)
        except TookTooLong as error:
            judged.append(str(error))

    thread = threading.Thread(target=late)
    thread.start()
    thread.join()
    assert judged == ["it took more than 0.05 s (--timeout)"]


def test_a_limit_ends_with_its_call():
    with time_limit(0.05, "it"):
        pass
    time.sleep(0.1)
    with time_limit(None, "it"):
        time.sleep(0.01)
