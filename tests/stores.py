"""Stores with one cell, as most tests have them, and what tests compare of results."""

import contextlib
import time

import pandas as pd

from armctl.episodes.record import TIME_COLUMNS
from armctl.episodes.store import Store
from armctl.episodes.stored import STORE, UNDISTURBED, read_store


@contextlib.contextmanager
def one_cell(folder, identity, episodes=2**62, overwrite=False, run=None):
    """The writer of a folder's only cell."""
    with Store(folder, overwrite) as store:
        store.open(identity["seed"], [UNDISTURBED])
        yield store.cell(UNDISTURBED, identity, episodes, run)


def read_cell(folder):
    """What a folder's only cell holds."""
    (cell,) = read_store(folder).cells.values()
    return cell


def timeless(episodes):
    """Episodes, or those of a folder's `episodes.csv`, without what depends on the machine."""
    table = episodes if isinstance(episodes, pd.DataFrame) else pd.read_csv(episodes / "episodes.csv")
    return table.drop(columns=list(TIME_COLUMNS))


def wait_for_episodes(folder, pages=20, seconds=600):
    """Wait until a run has written some episodes: at least a page of the log each."""
    log, end = folder / f"{STORE}-wal", time.monotonic() + seconds
    while not (log.exists() and log.stat().st_size > pages * 4_096):
        assert time.monotonic() < end
        time.sleep(0.02)
