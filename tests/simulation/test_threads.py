import os
from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.simulation.control_step import _shares
from armctl.simulation.threads import THREADS_ENV_VAR, usable_threads

CORES = len(os.sched_getaffinity(0))


@pytest.mark.parametrize(("limit", "threads"), [("1", 1), (str(CORES + 7), CORES)])
def test_a_limit_lowers_the_number_of_threads(monkeypatch, limit, threads):
    monkeypatch.setenv(THREADS_ENV_VAR, limit)
    assert usable_threads() == threads
    worlds: Any = gymnasium.make_vec("armctl/ArmReach-v0", num_envs=2)
    assert worlds.unwrapped.task.simulation.threads == threads


def test_without_a_limit_all_cores_are_used(monkeypatch):
    monkeypatch.delenv(THREADS_ENV_VAR, raising=False)
    assert usable_threads() == CORES


@pytest.mark.parametrize("limit", ["0", "-1", "two", "", "1.5"])
def test_what_is_no_number_of_threads_is_refused(monkeypatch, limit):
    monkeypatch.setenv(THREADS_ENV_VAR, limit)
    with pytest.raises(ConfigurationError, match=THREADS_ENV_VAR):
        usable_threads()


@pytest.mark.parametrize("number", [1, 2, 10, 256])
@pytest.mark.parametrize("threads", [2, 3, 16])
def test_each_world_is_in_one_share_and_the_last_ones_are_small(number, threads):
    ids = np.arange(100, 100 + number, dtype=np.int32)
    shares = _shares(ids, threads)
    assert np.concatenate(shares).tolist() == ids.tolist()
    sizes = [len(share) for share in shares]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] == 1
    assert sizes[0] <= max(1, number / (2 * threads))
