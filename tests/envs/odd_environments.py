"""Environments of others, good and bad, for the tests."""

import itertools

import gymnasium
import numpy as np
from gymnasium import spaces

started = itertools.count()


class Line(gymnasium.Env):
    """Walk along a line to 1, from a random place. Obeys its seed."""

    observation_space: spaces.Space = spaces.Box(-2, 2, (1,))
    action_space: spaces.Space = spaces.Box(-0.2, 0.2, (1,))

    def __init__(self, steps=20):
        self.steps = steps

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.uniform(-1, 0, 1).astype(np.float32), 0
        return self.x, {}

    def step(self, action):
        self.x, self.t = np.clip(self.x + np.float32(action), -2, 2), self.t + 1
        there = bool(abs(self.x[0] - 1) < 0.1)
        return self.x, self.reward(), there, self.t >= self.steps, self.info(there)

    def reward(self):
        return -abs(float(self.x[0]) - 1)

    def info(self, there):
        return {"is_success": there}


class Silent(Line):
    """Says nothing of success."""

    def info(self, there):
        return {}


class Winning(Line):
    """Names success only where there is one."""

    def info(self, there):
        return {"success": np.bool_(True)} if there else {}


class Deaf(Line):
    """Ignores its seed: starts from the global random state."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.random.uniform(-1, 0, 1).astype(np.float32)  # noqa: NPY002
        return self.x, {}


class DeafLater(Line):
    """Obeys its seed at the start, and is disturbed at random later."""

    def step(self, action):
        return super().step(action + np.random.normal(0, 0.01, 1) * (self.t >= 3))  # noqa: NPY002


class Remembering(Line):
    """Starts from what was played before."""

    count = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count += 1
        self.x = self.x + np.float32(0.01 * self.count)
        return self.x, {}


class Monotonous(Line):
    """All episodes are the same."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.zeros(1, dtype=np.float32)
        return self.x, {}


class Nan(Line):
    """Its reward is not a number in the third step."""

    def reward(self):
        return np.nan if self.t == 3 else 0.0


class Crashing(Line):
    """Has a typo in its reward."""

    def reward(self):
        return self.distanec  # type: ignore[attr-defined]


class Endless(Line):
    """Never ends."""

    def __init__(self):
        super().__init__(steps=10**9)

    def step(self, action):
        return np.zeros(1, dtype=np.float32), 0.0, False, False, {}


class Broken(Line):
    """Cannot be made."""

    def __init__(self):
        raise OSError("no licence")


class Rich(Line):
    """Observes and acts by several parts."""

    observation_space = spaces.Dict({"x": Line.observation_space, "t": spaces.Discrete(1000)})
    action_space = spaces.MultiDiscrete([3, 2])

    def reset(self, *, seed=None, options=None):
        x, info = super().reset(seed=seed)
        return {"x": x, "t": 0}, info

    def step(self, action):
        x, *rest = super().step(np.array([0.1 * (action[0] - 1)]))
        return {"x": x, "t": self.t}, *rest


class Mixed(Line):
    """Observes and acts by tuples of unlike parts."""

    observation_space = spaces.Tuple((spaces.Box(-2, 2, (2,)), spaces.Discrete(1000)))
    action_space = spaces.Tuple((spaces.Discrete(3), spaces.Box(-1, 1, (1,))))

    def reset(self, *, seed=None, options=None):
        x, info = super().reset(seed=seed)
        return (np.repeat(x, 2), 0), info

    def step(self, action):
        x, *rest = super().step(0.1 * (action[0] - 1) * action[1])
        return (np.repeat(x, 2), self.t), *rest


class Misfit(Line):
    """Observes more than it declares."""

    def reset(self, *, seed=None, options=None):
        x, info = super().reset(seed=seed)
        return np.repeat(x, 2), info

    def step(self, action):
        x, *rest = super().step(action)
        return np.repeat(x, 2), *rest


class Blind(Line):
    """Observes NaN from the third step on."""

    def step(self, action):
        x, *rest = super().step(action)
        return x * (np.nan if self.t > 2 else 1), *rest


class Paired(Line):
    """Has two rewards."""

    def reward(self):
        return np.array([1.0, 2.0])


class NoSpaces(gymnasium.Env):
    """Declares nothing."""


def line_of(steps=20):
    """A function that makes an environment."""
    return Line(steps)


gymnasium.register("odd/Line-v0", Line, max_episode_steps=30)  # type: ignore[arg-type] # a class makes one too
