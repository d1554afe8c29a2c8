"""How many threads torch computes on.

The networks are small: beyond a few threads, these only wait for each other. torch's own choice counts the machine's
cores, of which a container or a cluster's job may have been given two.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import joblib
import torch

MOST_THREADS = 4
"""Layers have some hundred units, and batches some hundred rows: more threads take longer to meet than they save."""


@contextmanager
def bounded_threads() -> Iterator[None]:
    """Let torch compute on at most `MOST_THREADS` threads, and no more than there are cores to use.

    `OMP_NUM_THREADS` and `torch.set_num_threads` can lower it further.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(min(before, joblib.cpu_count(), MOST_THREADS))
    try:
        yield
    finally:
        torch.set_num_threads(before)
