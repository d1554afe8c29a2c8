"""Reads datasets of the reach task in a process of its own: see `test_datasets.py`."""

import numpy as np
from child import serve

from armctl.datasets.minari import read_demonstrations
from armctl.envs import make_worlds

WORLDS = make_worlds("armctl/ArmReach-v0", 1)


def check(path):
    episodes = read_demonstrations(path, WORLDS)
    for episode in episodes:
        assert episode.observations.shape == (len(episode) + 1, 12)
        assert episode.actions.shape == (len(episode), 6)
        assert np.isfinite(np.asarray(episode.observations)).all()
        assert np.isfinite(episode.actions).all()
    return f"{len(episodes)} episodes"


if __name__ == "__main__":
    serve(check)
