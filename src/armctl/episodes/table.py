"""Many episodes in little memory: a million should fit, and an `EpisodeResult` each takes some 1,500 bytes.

A table takes some 250 bytes an episode, and 2 for each decision as a rule: an array for each column, and lists of the
decision times and of the sums of the reward terms. Of a large table, few of these are in memory at a time.
"""

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.episodes.columns import Column, Pages, Ragged, Rows, TimeCounts, by_occurrence, is_unknown, milliseconds
from armctl.episodes.metrics import Metrics
from armctl.episodes.record import COLUMNS, EpisodeResult

if TYPE_CHECKING:
    import pandas as pd

_APART = ("reward_terms", "metrics", "decision_ms", "recording")
_PLAIN = [field.name for field in fields(EpisodeResult) if field.name not in _APART]
_METRICS = [field.name for field in fields(Metrics)]
_HINTS = get_type_hints(EpisodeResult) | get_type_hints(Metrics)
TYPES: dict[str, set[type]] = {name: set(get_args(_HINTS[name])) or {_HINTS[name]} for name in (*_PLAIN, *_METRICS)}
"""Types of a field of the results or of their metrics, `NoneType` among them where it may be unknown."""
FEW = {name for name, kinds in TYPES.items() if kinds & {str, NoneType}} | {
    "seed", "solver_failures", "worlds", "workers",
}  # fmt: skip
"""Fields with few different values."""
AT_ONCE = 10_000
"""Episodes that are handled together: more take memory, and fewer time."""


class EpisodeTable(Sequence[EpisodeResult]):
    """A sequence of episode results, each of which is made from the columns when it is asked for.

    Parts of a table share its columns: a slice, or what an array of indices or a mask (len(table),) picks.
    """

    def __init__(self, results: Iterable[EpisodeResult] = ()) -> None:
        listed = list(results)
        values = [vars(result) | vars(result.metrics) for result in listed]
        places: dict[tuple[str, ...], int] = {}
        codes = [places.setdefault(tuple(result.reward_terms), len(places)) for result in listed]
        rewards = [list(result.reward_terms.values()) for result in listed]
        times = [result.decision_ms for result in listed]
        self._columns: Mapping[str, Column] = {
            name: column(name, [fields[name] for fields in values]) for name in TYPES
        }
        self._term_names: Sequence[tuple[str, ...]] = list(places)
        self._term_codes: NDArray[Any] = np.array(codes, np.intp)
        self._rewards = Ragged.of(np.array([*itertools.chain.from_iterable(rewards)], float), [*map(len, rewards)])
        self._times = Ragged.of(np.concatenate([np.empty(0), *times]), [*map(len, times)])
        self._rows: Rows = np.arange(len(listed))
        self._pages = Pages()

    @classmethod
    def of_columns(
        cls,
        columns: Mapping[str, Column],
        term_names: Sequence[tuple[str, ...]],
        term_codes: NDArray[Any],
        rewards: Ragged,
        times: Ragged,
        pages: Pages | None = None,
    ) -> "EpisodeTable":
        """Return a table of these columns, by the names in `TYPES`.

        The names of an episode's reward terms are `term_names[code]`, their sums are a list in `rewards`. Decision
        `times` are in ms, or in ticks. Arrays may be in `pages`.
        """
        table = cls()
        table._columns, table._term_names, table._term_codes = columns, term_names, term_codes
        table._rewards, table._times, table._rows = rewards, times, np.arange(len(term_codes))
        table._pages = pages or table._pages
        return table

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, at: int) -> EpisodeResult: ...
    @overload
    def __getitem__(self, at: slice | NDArray[Any]) -> "EpisodeTable": ...
    def __getitem__(self, at: int | slice | NDArray[Any]) -> "EpisodeResult | EpisodeTable":
        if isinstance(at, int | np.integer):
            return next(self._sharing(self._rows[[at]])._results())
        return self._sharing(self._rows[at])

    def __iter__(self) -> Iterator[EpisodeResult]:
        for part in self.parts():
            yield from part._results()

    def parts(self) -> Iterator["EpisodeTable"]:
        """Yield the episodes in tables of at most `AT_ONCE`, one after the other."""
        for first in range(0, len(self), AT_ONCE):
            yield self._sharing(self._rows[first : first + AT_ONCE])
            self._pages.release()

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of the results or of their metrics, (len(self),); of objects for texts and unknown values."""
        values = self._columns[name].at(self._rows)
        self._pages.release()
        return values

    def different(self, *names: str) -> tuple[list[tuple[Any, ...]], NDArray[np.intp]]:
        """Return the different values of some fields among `FEW`, as they first occur, and which each episode has."""
        columns = [self._columns[name] for name in names]
        codes, num_codes = np.zeros(len(self), np.intp), 1
        for values, different in columns:
            assert different is not None
            firsts, codes = by_occurrence(codes * len(different) + values[self._rows], num_codes * len(different))
            num_codes = len(firsts)
        rows = self._rows[firsts]
        return list(zip(*(each.at(rows).tolist() for each in columns), strict=True)), codes

    def counts(self, *names: str) -> dict[tuple[Any, ...], int]:
        """Return the numbers of episodes by the different values of some fields among `FEW`, as they first occur."""
        values, codes = self.different(*names)
        return dict(zip(values, np.bincount(codes, minlength=len(values)).tolist(), strict=True))

    def without(self, name: str, unknown: NDArray[np.bool_]) -> "EpisodeTable":
        """Return the same episodes; in those that are `unknown`, (len(self),), a field is None."""
        changed, (codes, different) = self._sharing(self._rows), self._columns[name]
        assert different is not None
        codes, listed = codes.copy(), different.tolist()
        if unknown.any():
            codes[self._rows[unknown]] = len(listed)
            listed.append(None)
        changed._columns = {**self._columns, name: Column(codes, array(name, listed))}
        return changed

    def together(self, other: "EpisodeTable") -> "EpisodeTable":
        """Return the episodes of this part of a table, and then those of another part of the same one."""
        assert self._times is other._times
        return self._sharing(np.concatenate((self._rows, other._rows)))

    def by_policy(self) -> dict[str, "EpisodeTable"]:
        """Return the episodes of each policy."""
        policies, codes = self.different("policy")
        return {name: self[codes == code] for code, (name,) in enumerate(policies)}

    def sorted(self, policies: Sequence[str]) -> "EpisodeTable":
        """Return the same, by policy in the given order, and then by episode."""
        names, codes = self.different("policy")
        places = np.array([policies.index(name) for (name,) in names], np.intp)
        return self[np.lexsort((self.column("episode"), places[codes]))]

    @property
    def won(self) -> NDArray[np.bool_]:
        """True for each success; False where that is unknown."""
        return self.column("success").astype(bool)

    @property
    def optimality_gap(self) -> Array:
        """Optimality gap of each (see `EpisodeResult`)."""
        bound = np.where(self.column("lower_bound_steps") > 0, self.column("lower_bound_steps"), math.nan)
        with np.errstate(over="ignore"):
            return np.where(self.won, self.column("length") / bound - 1, math.nan)

    def reward_sums(self) -> dict[str, Array]:
        """Return the sums of each reward term, by its name, in the episodes that have it."""
        sums = dict[str, list[Array]]()
        for part in self.parts():
            rewards, codes = self._rewards.take(part._rows), self._term_codes[part._rows]
            for code in dict.fromkeys(codes.tolist()):
                starts = rewards.ends[:-1][codes == code]
                for i, name in enumerate(self._term_names[code]):
                    sums.setdefault(name, []).append(rewards.values[starts + i])
        return {name: np.concatenate(parts) for name, parts in sums.items()}

    def reward_terms(self) -> tuple[list[tuple[str, ...]], Array]:
        """Return the names of each episode's reward terms, and the sums of these, of one episode after the other."""
        names = [self._term_names[code] for code in self._term_codes[self._rows].tolist()]
        return names, self._rewards.take(self._rows).values

    def decision_ms(self) -> Ragged:
        """Return the decision times of each episode."""
        times = self._times.take(self._rows)
        return Ragged(milliseconds(times.values), times.ends)

    @property
    def is_warm(self) -> NDArray[np.bool_]:
        """(len(self),) whether an episode has decisions, and none of them was the policy's first in its process."""
        has_times = self._times.ends[self._rows + 1] > self._times.ends[self._rows]
        return np.asarray(has_times & np.isnan(self.column("first_call_ms")))

    def first_decision_ms(self) -> Array:
        """Return the time of the reset with the first decision, of each episode that `is_warm`."""
        times = []
        for part in self.parts():
            warm = part.is_warm
            first = milliseconds(part._times.values[part._times.ends[part._rows[warm]]])
            times.append(np.nan_to_num(part.column("reset_ms")[warm], nan=0.0) + first)
        return np.asarray(np.concatenate([np.empty(0), *times]))

    def decision_seconds(self) -> Array:
        """(len(self),) the time of the reset and of all decisions of each episode."""
        spent = []
        for part in self.parts():
            times = part.decision_ms()
            which = np.repeat(np.arange(len(part)), times.lengths)
            sums = np.bincount(which, np.nan_to_num(times.values, copy=False, nan=0.0), len(part))
            spent.append(np.nan_to_num(part.column("reset_ms"), nan=0.0) + sums)
        return np.asarray(np.concatenate([np.empty(0), *spent]) / 1e3)

    def warm_times(self) -> TimeCounts:
        """Return the times of all warm decisions (see `armctl.episodes.metrics.warm_times`)."""
        counts = TimeCounts()
        for part in self.parts():
            times, cold = self._times.take(part._rows), []
            for row in np.flatnonzero(~np.isnan(part.column("first_call_ms"))).tolist():
                starts = np.flatnonzero(~is_unknown(times[row]))
                if len(starts) > 1:
                    cold.append(int(times.ends[row] + starts[0]))
            counts.add(np.delete(times.values, np.array(cold, np.intp)))
        return counts

    def frame(self) -> "pd.DataFrame":
        """Return a row for each, with the columns of `episodes.csv`, as a DataFrame of `EpisodeResult.row` has them."""
        import pandas as pd

        if not len(self):
            return pd.DataFrame(columns=list(COLUMNS))
        values: dict[str, Any] = {}
        for name in COLUMNS:
            if name == "reward_terms":
                values[name] = pd.Series([text for part in self.parts() for text in part._terms_as_json()])
            elif name == "optimality_gap":
                values[name] = self.optimality_gap
            else:
                data = self.column(field_of(name))
                values[name] = pd.Series(data.tolist() if data.dtype == object else data)
        return pd.DataFrame(values)

    def csv_columns(self) -> dict[str, list[Any]]:
        """Return the values of `EpisodeResult.row`, a list for each column of `episodes.csv`."""
        special = {"optimality_gap": self.optimality_gap.tolist, "reward_terms": self._terms_as_json}
        return {name: special[name]() if name in special else self.column(field_of(name)).tolist() for name in COLUMNS}

    def _sharing(self, rows: Rows) -> "EpisodeTable":
        part = object.__new__(EpisodeTable)
        vars(part).update(vars(self), _rows=rows)
        return part

    def _reward_dicts(self) -> Iterator[dict[str, float]]:
        names, values = self.reward_terms()
        remaining = iter(values.tolist())
        return (dict(zip(terms, remaining, strict=False)) for terms in names)  # the rest are of later episodes

    def _terms_as_json(self) -> list[str]:
        return [json.dumps(rewards) for rewards in self._reward_dicts()]

    def _results(self) -> Iterator[EpisodeResult]:
        plain, metrics = (
            zip(*(self.column(name).tolist() for name in names), strict=True) for names in (_PLAIN, _METRICS)
        )
        times = self.decision_ms()
        for row, (values, measured, rewards) in enumerate(zip(plain, metrics, self._reward_dicts(), strict=True)):
            yield EpisodeResult(
                **dict(zip(_PLAIN, values, strict=True)),
                reward_terms=rewards,
                metrics=Metrics(*measured),
                decision_ms=times[row],
            )


def array(name: str, values: list[Any]) -> NDArray[Any]:
    """Return a field's values as an array: of objects if they are texts, or None in some."""
    kinds = TYPES[name]
    if NoneType in kinds and (None in values or not values):
        return np.array(values, object)
    (kind,) = kinds - {NoneType}
    return np.array(values, {str: object, int: None if values else int}.get(kind, kind))


def column(name: str, values: list[Any]) -> Column:
    """Return a field's values as a column."""
    if name not in FEW:
        return Column(array(name, values))
    places = {value: place for place, value in enumerate(dict.fromkeys(values))}
    return Column(np.array([places[value] for value in values], np.int32), array(name, list(places)))


def field_of(name: str) -> str:
    """Return the field of the results that a column of `episodes.csv` holds."""
    return "total_reward" if name == "return" else name
