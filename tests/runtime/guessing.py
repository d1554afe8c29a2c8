"""A task that only who cheats can win, for tests of isolated policies."""

import sys

TASK = """
import time
import gymnasium, numpy as np

class Guess(gymnasium.Env):
    '''Each step has a secret number, drawn just before it is compared: who knows it wins.'''
    observation_space = gymnasium.spaces.Box(0, 1, (1,))
    action_space = gymnasium.spaces.Box(0, 1, (1,), np.float64)
    bonus = 0.0
    dt = 0.05

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.seed_of_episode, self.steps, self.begun = seed, 0, time.monotonic()
        np.random.seed(seed)
        self.drawn = np.random.default_rng(seed).random()
        return np.array([self.drawn], np.float32).round(1), {}

    def step(self, action):
        self.steps += 1
        known = abs(float(action[0]) - self.drawn) < 1e-9 or abs(float(action[0]) - np.random.random()) < 1e-9
        won = bool(known) or self.bonus > 0
        return np.zeros(1, np.float32), float(won), won, self.steps >= 3, {"is_success": won}
"""


def guess_task(folder, monkeypatch):
    """Write it as `guess_task.py` into a folder, and go there."""
    (folder / "guess_task.py").write_text(TASK)
    monkeypatch.chdir(folder)
    for name in ("guess_task", "mine"):
        monkeypatch.delitem(sys.modules, name, raising=False)
