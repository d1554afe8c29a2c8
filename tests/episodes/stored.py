"""Stores of made-up episodes, and changes to them as another program would make them."""

import contextlib
import sqlite3

from armctl.episodes.stored import STORE

from ..made_up_episodes import OWN
from ..stores import one_cell


def write(folder, results, identity=OWN):
    with one_cell(folder, identity, 2**62, overwrite=True) as store:
        for result in results:
            store.write(result)
        store.finish({}, [])


def edit(folder, *commands):
    """Change a store as another program would."""
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        for command in commands:
            file.execute(command)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
