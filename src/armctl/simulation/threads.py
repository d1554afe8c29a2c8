"""Number of threads that a process computes on, so that several can share a machine."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from armctl.core.errors import ConfigurationError

THREADS_ENV_VAR = "ARMCTL_THREADS"
"""Environment variable with the largest number of threads; without it, all cores that the process may use."""


def usable_threads() -> int:
    """Return the number of cores to use, or less if `ARMCTL_THREADS` says so, which is a whole number from 1 on."""
    cores, limit = len(os.sched_getaffinity(0)), os.environ.get(THREADS_ENV_VAR)
    if limit is None:
        return cores
    if not limit.isdecimal() or int(limit) < 1:
        raise ConfigurationError(f"{THREADS_ENV_VAR} is a number of threads from 1 on, not {limit!r}")
    return min(cores, int(limit))


@contextmanager
def one_thread() -> Iterator[None]:
    """Let this process compute on one thread within the block: other processes work beside it."""
    previous = os.environ.get(THREADS_ENV_VAR)
    os.environ[THREADS_ENV_VAR] = "1"
    try:
        yield
    finally:
        del os.environ[THREADS_ENV_VAR]
        if previous is not None:
            os.environ[THREADS_ENV_VAR] = previous
