"""Fields of the BARN challenge: cylinders on a grid of `CELLS` x `CELLS` cells, between two walls.

Perille, Truong, Xiao and Stone, "Benchmarking metric ground navigation", SSRR 2020. A cellular automaton smooths random
cells, and a field counts if a robot of 0.75 m width can pass. `sample_cells` draws new ones alike, `read_blocks` reads
the challenge's own.
"""

import functools
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, reason

CELLS, CELL = 30, 0.15
"""Number of cells along and across the field, and their side, m: the diameter of a cylinder."""
FIELD_X = 3.0
"""m from the deck's start to the field: 2 m before the rover's start."""
HALF_WIDTH = (CELLS - 2) * CELL / 2
"""m: half the width between the walls, of which each takes a column of cells."""
PASSAGE = 0.37
"""m: radius of a disc that can pass each field. The challenge's narrowest passages are five cells wide."""
FILL_SHARES = (0.15, 0.25)
"""Share of cells that are filled at random."""
SMOOTHINGS = 3
FILL_FROM, CLEAR_BELOW = 5, 2
"""A cell is filled if at least so many of its eight neighbours are, walls among them, and cleared if fewer are."""
ORIGIN = np.array((-4.425, 5.075))
"""m: centre of the first cell, of a wall, in the challenge's files, where y runs ahead and x to the right."""
CYLINDER = re.compile(r"<model name=['\"]unit_cylinder[^>]*>.*?<pose[^>]*>\s*(\S+)\s+(\S+)", re.DOTALL)
Cells = NDArray[np.bool_]
"""(`CELLS`, `CELLS` - 2): filled cells between the walls, from near to far and from left to right."""


def sample_cells(rng: np.random.Generator) -> Cells:
    """Return random cells, smoothed by the automaton. Not every field can be passed."""
    cells = rng.random((CELLS, CELLS - 2)) < rng.uniform(*FILL_SHARES)
    for _ in range(SMOOTHINGS):
        padded = np.pad(cells.astype(int), ((1, 1), (1, 1)), constant_values=((0, 0), (1, 1)))
        rows = padded[:-2] + padded[1:-1] + padded[2:]
        neighbours = rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:] - cells
        cells = (cells | (neighbours >= FILL_FROM)) & (neighbours >= CLEAR_BELOW)
    return cells


@functools.lru_cache(maxsize=1024)
def read_blocks(path: Path) -> Array:
    """Return the blocks of a world of the challenge, as `blocks_of` does. Raises `ConfigurationError`."""
    try:
        places = np.array(CYLINDER.findall(path.read_text(encoding="utf-8")), dtype=float).reshape(-1, 2)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"{path} cannot be read as a world of the BARN challenge: {reason(error)}") from error
    if not len(places):
        raise ConfigurationError(f"{path} has no cylinders: it is no static world of the BARN challenge")
    column, row = np.rint((places - ORIGIN) / CELL).astype(int).T
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    inside = (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS)
    cells[row[inside], column[inside]] = True
    return blocks_of(cells[:, 1:-1])


@functools.cache
def worlds_in(folder: str) -> list[Path]:
    """Return the challenge's static worlds in a folder, in order. Raises `ConfigurationError` if there are none."""
    paths = sorted(Path(folder).expanduser().glob("world_*.world"), key=lambda path: (len(path.name), path.name))
    if not paths:
        raise ConfigurationError(
            f"{folder!r} has no world_*.world: name the folder worlds/BARN of github.com/Daffan/the-barn-challenge"
        )
    return paths


def blocks_of(cells: Cells) -> Array:
    """Return rectangles of filled cells as blocks (k, 5), as a `BridgeMap` has them: runs of equal rows or columns."""
    along, across = _rectangles(cells), _rectangles(cells.T)
    rectangles = along if len(along) <= len(across) else across[:, [2, 3, 0, 1]]
    first_row, last_row, first_column, last_column = CELL * rectangles.T
    x, y = FIELD_X + (first_row + last_row) / 2, HALF_WIDTH - (first_column + last_column) / 2
    return np.column_stack((x, y, 0 * x, (last_row - first_row) / 2, (last_column - first_column) / 2))


def _rectangles(cells: Cells) -> NDArray[np.int64]:
    """Return rectangles (k, 4) that cover the filled cells: first row, last plus one, first column, last plus one."""
    open_runs: dict[tuple[int, int], int] = {}
    finished = []
    for row, filled in enumerate([*cells, np.zeros(cells.shape[1], dtype=bool)]):
        changes = np.flatnonzero(np.diff(filled.astype(int), prepend=0, append=0))
        runs = set(zip(changes[::2].tolist(), changes[1::2].tolist(), strict=True))
        finished += [(open_runs.pop(run), row, *run) for run in sorted(open_runs.keys() - runs)]
        open_runs |= dict.fromkeys(runs - open_runs.keys(), row)
    return np.array(finished, dtype=int).reshape(-1, 4)
