"""Policies of a batch that hold still."""

from armctl.envs import Sees


class HoldsStill:
    """Holds still: a base for policies that do a little else."""

    sees: Sees = "observation"
    training_steps = 0

    def reset(self, ids):
        pass

    def act(self, observations):
        return observations[:, 3:9]


class Still(HoldsStill):
    """Holds still, after it has done something."""

    def __init__(self, sees="observation", act=lambda: None, reset=lambda: None):
        self.sees, self.does, self.forgets = sees, act, reset

    def reset(self, ids):
        self.forgets()

    def act(self, observations):
        self.does()
        return super().act(observations).astype(float)
