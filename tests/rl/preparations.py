"""Preparations, features and teachers that the tests name."""

import numpy as np
import torch


class NearestInColumns(torch.nn.Module):
    """Depth images as the least depth in each column."""

    def __init__(self, observation_space):
        super().__init__()

    def forward(self, observations):
        return {"ranges": observations["image"].amin(dim=1), "motion": observations["motion"]}


class Alternating:
    """A teacher whose actions depend on the control step, which no observation tells."""

    def reset(self):
        self.step = 0

    def act(self, observation):
        self.step += 1
        return np.full(6, 0.5 if self.step % 2 else -0.5)
