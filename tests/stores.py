"""Stores with one cell, as most tests have them."""

import contextlib

from armctl.episodes.store import Store
from armctl.episodes.stored import UNDISTURBED, read_store


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
