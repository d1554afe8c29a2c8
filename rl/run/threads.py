"""The number of threads that torch computes on.

torch's own choice counts the machine's cores, of which a container or a cluster's job may have been given two.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import joblib
import torch

from armctl.simulation.threads import usable_threads

MAX_THREADS = 4
"""Estimate for layers of some hundred units, which was not measured on machines with more cores."""


@contextmanager
def bounded_threads() -> Iterator[None]:
    """Let torch compute on at most `MAX_THREADS` threads, and no more than there are cores to use.

    `ARMCTL_THREADS`, `OMP_NUM_THREADS` and `torch.set_num_threads` can lower it further.
    """
    num_threads = torch.get_num_threads()
    torch.set_num_threads(min(num_threads, joblib.cpu_count(), usable_threads(), MAX_THREADS))
    try:
        yield
    finally:
        torch.set_num_threads(num_threads)
