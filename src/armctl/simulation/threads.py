"""How many threads a process computes on, so that several can share a machine."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from armctl.core.errors import ConfigurationError

LIMIT = "ARMCTL_THREADS"
"""Environment variable with the largest number of threads; without it, all cores that the process may use."""


def usable_threads() -> int:
    """As many as there are cores to use, or fewer if `ARMCTL_THREADS` says so, which is a whole number from 1 on."""
    cores, limit = len(os.sched_getaffinity(0)), os.environ.get(LIMIT)
    if limit is None:
        return cores
    if not limit.isdecimal() or int(limit) < 1:
        raise ConfigurationError(f"{LIMIT} is a number of threads from 1 on, not {limit!r}")
    return min(cores, int(limit))


@contextmanager
def one_thread() -> Iterator[None]:
    """Let this process compute on one thread meanwhile: others work beside it."""
    before = os.environ.get(LIMIT)
    os.environ[LIMIT] = "1"
    try:
        yield
    finally:
        del os.environ[LIMIT]
        if before is not None:
            os.environ[LIMIT] = before
