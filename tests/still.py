"""A policy that holds still."""


class Still:
    """Holds still, after it has done something."""

    training_steps = 0

    def __init__(self, sees="observation", act=lambda: None, reset=lambda: None):
        self.sees, self.does, self.forgets = sees, act, reset

    def reset(self, ids):
        self.forgets()

    def act(self, observations):
        self.does()
        return observations[:, 3:9].astype(float)
