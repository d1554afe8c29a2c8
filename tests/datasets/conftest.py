import subprocess

import pytest

from armctl.datasets.collect import collect

from .collections_of_random import ARMCTL, COMMAND, SHORT


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "random-v0"
    subprocess.run([ARMCTL, *COMMAND, "--out", out], check=True, capture_output=True)
    return out


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A collection of 9 episodes that nothing has interrupted."""
    out = tmp_path_factory.mktemp("nine") / "whole"
    collect("random", episodes=9, out=out, worlds=3, env_options=SHORT)
    return out


@pytest.fixture
def interrupted(tmp_path):
    """A collection of 9 episodes with 5 finished; the folder."""

    def progress(finished):
        if finished == 5:
            raise KeyboardInterrupt

    collection = collect("random", episodes=9, out=tmp_path / "d", env_options=SHORT, progress=progress)
    assert (collection.episodes, collection.interrupted) == (5, True)
    return tmp_path / "d"
