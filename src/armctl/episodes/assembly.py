"""Makes a table of episodes from the rows and blocks of a store, which anybody may have written."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.envs import ERROR
from armctl.episodes.blocks import columns_of_block
from armctl.episodes.columns import Column, Pages, Ragged, is_unknown
from armctl.episodes.record import LARGEST_RETURN
from armctl.episodes.rows import INTEGERS, LAYOUT, NUMBERS, TEXTS, UNKNOWN, Origin, Sizes, columns_of_rows
from armctl.episodes.table import FEW, TYPES, EpisodeTable, array

ROWS_AT_ONCE = 1_000
"""Rows that are read together: values of more do not stay in the processor's cache."""
BYTES_IN_MEMORY = 2**24
"""Bytes after which what was read of a large table leaves the memory."""


def table_of(
    rows: Iterable[Sequence[Any]], blocks: Iterable[Sequence[Any]], sizes: Sizes, origin: Origin
) -> EpisodeTable:
    """Return the episodes in some rows and blocks, of these sizes or smaller than they in all.

    Raises `ValueError` or `IndexError` for one that was changed, or belongs to another cell, or cannot be an episode
    of the policies.
    """
    if not sizes.episodes:
        return EpisodeTable()
    time_type = sizes.time_type
    types = {name: (_type_of(name), sizes.episodes) for name in LAYOUT}
    types |= {"reward_terms": (np.dtype(float), sizes.rewards), "decision_ms": (time_type, sizes.decisions)}
    ends_of_lists = 2 * 8 * (sizes.episodes + 1)
    pages = Pages(sum(8 + kind.itemsize * size for kind, size in types.values()) + ends_of_lists)
    columns = {name: pages.array(size, kind) for name, (kind, size) in types.items()}
    ends, different, num_bytes = dict.fromkeys(columns, 0), _Different(), 0
    for part in _parts(rows, blocks, origin, time_type):
        if origin.policies is not None:
            texts = {name: origin.texts.texts[part[name]] for name in ("policy", "outcome")}
            _check_possible(part | texts, origin.policies)
        for name, values in different.places(part).items():
            columns[name][ends[name] : (end := ends[name] + len(values))] = values
            ends[name] = end
            num_bytes += values.nbytes
        if num_bytes > BYTES_IN_MEMORY:
            pages.release()
            num_bytes = 0
    columns = {name: values[: ends[name]] for name, values in columns.items()}
    return _table(columns, different, origin, pages)


def _parts(
    rows: Iterable[Sequence[Any]], blocks: Iterable[Sequence[Any]], origin: Origin, time_type: "np.dtype[Any]"
) -> Iterator[dict[str, NDArray[Any]]]:
    for block in blocks:
        yield columns_of_block(block, origin, time_type)
    remaining = iter(rows)
    while batch := list(itertools.islice(remaining, ROWS_AT_ONCE)):
        yield columns_of_rows(batch, origin, time_type)


def _type_of(name: str) -> "np.dtype[Any]":
    """Return the type of the numbers of a column."""
    if name in NUMBERS:
        return np.dtype(float)
    if name in FEW or name in TEXTS:
        return np.dtype(np.int32)
    return np.dtype(bool if bool in TYPES[name] else np.int64)


class _Different:
    """The different values of columns with few."""

    def __init__(self) -> None:
        self._places: dict[str, dict[Any, int]] = {name: {} for name in INTEGERS if name in FEW}

    def places(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return columns, those with few different values as the places of these, to which new ones are added."""
        return {**columns, **{name: self._places_of(name, columns[name]) for name in self._places}}

    def values(self, name: str) -> NDArray[Any] | None:
        """Return the different values of a column; None if there may be many."""
        return array(name, [*self._places[name]]) if name in self._places else None

    def _places_of(self, name: str, values: NDArray[np.int64]) -> NDArray[np.intp]:
        different, codes = np.unique(values, return_inverse=True)
        kind, places = bool if bool in TYPES[name] else int, self._places[name]
        uniques = [
            None if NoneType in TYPES[name] and value == UNKNOWN else kind(value) for value in different.tolist()
        ]
        return np.array([places.setdefault(value, len(places)) for value in uniques])[codes]


def _table(columns: dict[str, NDArray[Any]], different: _Different, origin: Origin, pages: Pages) -> EpisodeTable:
    texts = origin.texts
    terms, rewards, times = (columns.pop(name) for name in ("terms", "reward_terms", "decision_ms"))
    fields = {
        name: Column(values, texts.texts if name in TEXTS else different.values(name))
        for name, values in columns.items()
    }
    same = np.broadcast_to(np.int32(0), len(terms))
    fields |= {"env": Column(same, array("env", [origin.env])), "seed": Column(same, array("seed", [origin.seed]))}
    lists = Ragged.of(rewards, texts.num_terms(terms), pages), Ragged.of(times, columns["length"], pages)
    pages.release()
    return EpisodeTable.of_columns(fields, texts.term_names, terms, *lists, pages)


def _check_possible(columns: Mapping[str, NDArray[Any]], policies: Sequence[str]) -> None:
    """Raise `ValueError` unless all may be episodes of these policies."""
    if not set(columns["policy"].tolist()) <= set(policies):
        raise ValueError("it has an episode that is not of this comparison")
    if (first := columns["episode"].min()) < 0:
        raise ValueError(f"{first} is not the number of an episode")
    for name, values in {"return": columns["total_reward"], "reward_terms": columns["reward_terms"]}.items():
        if len(odd := values[~(np.abs(values) <= LARGEST_RETURN)]):
            raise ValueError(f"{name} has {odd[0]}, and should be between -{LARGEST_RETURN:g} and {LARGEST_RETURN:g}")
    times, lengths = columns["decision_ms"], columns["length"]
    if (columns["outcome"][lengths == 0] != ERROR).any():
        raise ValueError(f"it has an episode without decision times whose outcome is not {ERROR!r}")
    firsts = (np.cumsum(lengths) - lengths)[lengths > 0]
    if is_unknown(times[firsts]).any() or _no_times(times).any():
        raise ValueError("it has decision times that are no times: numbers from 0 on, and nan where none began")
    if _no_times(columns["reset_ms"]).any():
        raise ValueError("it has a reset_ms that is no time")


def _no_times(times: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(((times < 0) & ~is_unknown(times)) | np.isinf(times))
