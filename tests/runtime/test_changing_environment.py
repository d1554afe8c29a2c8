"""Environments that change while a policy thinks, and hold whatever an environment may hold."""

import gymnasium
import numpy as np
import pytest

import armctl


class ByItself(gymnasium.Env):
    """Changes by itself while a policy thinks, as one with subscribers, and holds whatever an environment may hold."""

    observation_space = action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def __init__(self):
        self.clock, self.scan = 0, np.zeros(8)
        self.hours, self.pause = np.arange("2024-01-01", "2024-01-09", dtype="datetime64[h]"), np.timedelta64(1, "h")
        self.names, self.records = np.array(["left"]), np.zeros(3, [("a", "f4"), ("b", "i8")])
        self.road: dict[str, object] = {"name": "a"}
        self.road["next"] = self.roads = [self.road]
        self.table = np.ones(10**7)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1), {}

    def step(self, action):
        return np.zeros(1), 0.0, False, True, {}


@pytest.mark.one_case
@pytest.mark.parametrize("sees", ["observation", "state"])
def test_an_environment_that_changes_by_itself_disqualifies_nobody_who_was_not_given_it(sees):
    made = []

    def make(**options):
        made.append(ByItself())
        return made[-1]

    gymnasium.register("ByItself-v0", entry_point=make)

    @armctl.sees(sees)
    class Thinking:
        def __init__(self, env):
            self.change()

        def change(self):
            for env in made:
                env.clock += 1
                env.scan += 1
                env.table[:] += 1

        def act(self, observation):
            self.change()
            return np.zeros(1)

    comparison = armctl.compare([Thinking, "random"], "ByItself-v0", episodes=3)
    assert ("Thinking" in comparison.failures) == (sees == "state")
    assert len(comparison.results.by_policy()["random"]) == 3
