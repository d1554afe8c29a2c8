"""Many episodes in little memory: a million should fit, and an `EpisodeResult` each takes some 1,500 bytes.

A table takes some 350 bytes an episode, and 8 for each decision: a NumPy array for each column, and one ragged array
each for the decision times and for the sums of the reward terms.
"""

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args, get_type_hints, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.episodes.metrics import Metrics, warm_times
from armctl.episodes.record import COLUMNS, EpisodeResult

if TYPE_CHECKING:
    import pandas as pd

Rows = NDArray[np.intp]
_APART = ("reward_terms", "metrics", "decision_ms", "recording")
_PLAIN = [field.name for field in fields(EpisodeResult) if field.name not in _APART]
_METRICS = [field.name for field in fields(Metrics)]
_HINTS = get_type_hints(EpisodeResult) | get_type_hints(Metrics)
TYPES: dict[str, set[type]] = {name: set(get_args(_HINTS[name])) or {_HINTS[name]} for name in (*_PLAIN, *_METRICS)}
"""Types of a field of the results or of their metrics, `NoneType` among them where it may be unknown."""
AT_ONCE = 10_000
"""Episodes that are handled together: more take memory, and fewer time."""


@dataclass(frozen=True)
class Ragged:
    """Lists of numbers, one after the other."""

    values: Array
    ends: NDArray[np.int64]
    """(lists + 1,) where each ends, after a 0."""

    @classmethod
    def of(cls, values: Array, lengths: ArrayLike) -> "Ragged":
        """Split values into lists of these lengths."""
        return cls(values, np.concatenate(([0], np.cumsum(lengths, dtype=np.int64))))

    @property
    def lengths(self) -> NDArray[np.int64]:
        """(lists,) numbers in each list."""
        return np.diff(self.ends)

    def __getitem__(self, row: int) -> Array:
        return np.array(self.values[self.ends[row] : self.ends[row + 1]])

    def take(self, rows: Rows) -> "Ragged":
        """Return the lists in some rows."""
        starts, lengths = self.ends[rows], self.ends[rows + 1] - self.ends[rows]
        shifts = starts - (np.cumsum(lengths) - lengths)
        return Ragged.of(self.values[np.repeat(shifts, lengths) + np.arange(lengths.sum())], lengths)


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
        self._columns: Mapping[str, NDArray[Any]] = {
            name: column(name, [fields[name] for fields in values]) for name in TYPES
        }
        self._term_names: Sequence[tuple[str, ...]] = list(places)
        self._term_codes: Rows = np.array(codes, np.intp)
        self._rewards = Ragged.of(np.array([*itertools.chain.from_iterable(rewards)], float), [*map(len, rewards)])
        self._decision_ms = Ragged.of(np.concatenate([np.empty(0), *times]), [*map(len, times)])
        self._rows: Rows = np.arange(len(listed))

    @classmethod
    def of_columns(
        cls,
        columns: Mapping[str, NDArray[Any]],
        term_names: Sequence[tuple[str, ...]],
        term_codes: Rows,
        rewards: Ragged,
        decision_ms: Ragged,
    ) -> "EpisodeTable":
        """Return a table of these columns, by the names in `TYPES`.

        The names of an episode's reward terms are `term_names[code]`, their sums are a list in `rewards`.
        """
        table = cls()
        table._columns, table._term_names, table._term_codes = columns, term_names, term_codes
        table._rewards, table._decision_ms, table._rows = rewards, decision_ms, np.arange(len(term_codes))
        return table

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, at: int) -> EpisodeResult: ...
    @overload
    def __getitem__(self, at: slice | NDArray[Any]) -> "EpisodeTable": ...
    def __getitem__(self, at: int | slice | NDArray[Any]) -> "EpisodeResult | EpisodeTable":
        if isinstance(at, int | np.integer):
            return self._result(int(self._rows[at]))
        return self._sharing(self._rows[at])

    def __iter__(self) -> Iterator[EpisodeResult]:
        return map(self._result, self._rows.tolist())

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of the results or of their metrics, (len(self),); of objects for texts and unknown values."""
        return np.asarray(self._columns[name][self._rows])

    def with_column(self, name: str, values: Iterable[Any]) -> "EpisodeTable":
        """Return the same episodes with other values of a field."""
        changed, new = self._sharing(self._rows), self._columns[name].astype(object)
        new[self._rows] = list(values)
        changed._columns = {**self._columns, name: column(name, new.tolist())}
        return changed

    def together(self, other: "EpisodeTable") -> "EpisodeTable":
        """Return the episodes of this part of a table, and then those of another part of the same one."""
        assert self._decision_ms is other._decision_ms
        return self._sharing(np.concatenate((self._rows, other._rows)))

    def by_policy(self) -> dict[str, "EpisodeTable"]:
        """Return the episodes of each policy."""
        policies = self.column("policy")
        return {name: self[policies == name] for name in dict.fromkeys(policies.tolist())}

    def sorted(self, policies: Sequence[str]) -> "EpisodeTable":
        """Return the same, by policy in the given order, and then by episode."""
        places = {name: place for place, name in enumerate(policies)}
        order = np.array([places[name] for name in self.column("policy").tolist()])
        return self[np.lexsort((self.column("episode"), order))]

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
        rewards, codes = self._rewards.take(self._rows), self._term_codes[self._rows]
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
        return self._decision_ms.take(self._rows)

    @property
    def is_warm(self) -> NDArray[np.bool_]:
        """(len(self),) whether an episode has decisions, and none of them was the policy's first in its process."""
        has_times = self._decision_ms.lengths[self._rows] > 0
        return np.asarray(has_times & np.isnan(self.column("first_call_ms")))

    def first_decision_ms(self) -> Array:
        """Return the time of the reset with the first decision, of each episode that `is_warm`."""
        warm = self.is_warm
        first = self._decision_ms.values[self._decision_ms.ends[self._rows[warm]]]
        return np.asarray(np.nan_to_num(self.column("reset_ms")[warm], nan=0.0) + first)

    def decision_seconds(self) -> Array:
        """(len(self),) the time of the reset and of all decisions of each episode."""
        spent = np.nan_to_num(self.column("reset_ms"), nan=0.0)
        for first in range(0, len(self), AT_ONCE):
            times = self[first : first + AT_ONCE].decision_ms()
            which = np.repeat(np.arange(len(times.lengths)), times.lengths)
            spent[first : first + AT_ONCE] += np.bincount(
                which, np.nan_to_num(times.values, nan=0.0), len(times.lengths)
            )
        return np.asarray(spent / 1e3)

    def warm_ms(self) -> Array:
        """Return the times of all warm decisions, of one episode after the other, in an array of its own."""
        has_first_call = ~np.isnan(self.column("first_call_ms"))
        (rows,) = np.nonzero(has_first_call)
        bounds = np.unique(np.concatenate((rows, rows + 1, np.arange(0, len(self), AT_ONCE), [len(self)])))
        warm, end = np.empty(int(self._decision_ms.lengths[self._rows].sum())), 0
        for first, last in itertools.pairwise(bounds.tolist()):
            times = warm_times(self[first:last].decision_ms().values, bool(has_first_call[first]))
            warm[end : (end := end + len(times))] = times
        return warm[:end]

    def frame(self) -> "pd.DataFrame":
        """Return a row for each, with the columns of `episodes.csv`, as a DataFrame of `EpisodeResult.row` has them."""
        import pandas as pd

        if not len(self):
            return pd.DataFrame(columns=list(COLUMNS))
        values: dict[str, Any] = {}
        for name in COLUMNS:
            if name == "reward_terms":
                values[name] = pd.Series([json.dumps(self._reward_terms(row)) for row in self._rows.tolist()])
            elif name == "optimality_gap":
                values[name] = self.optimality_gap
            else:
                data = self.column(field_of(name))
                values[name] = pd.Series(data.tolist() if data.dtype == object else data)
        return pd.DataFrame(values)

    def _sharing(self, rows: Rows) -> "EpisodeTable":
        part = object.__new__(EpisodeTable)
        vars(part).update(vars(self), _rows=rows)
        return part

    def _reward_terms(self, row: int) -> dict[str, float]:
        return dict(zip(self._term_names[self._term_codes[row]], self._rewards[row].tolist(), strict=True))

    def _result(self, row: int) -> EpisodeResult:
        values = {name: self._columns[name][row : row + 1].tolist()[0] for name in TYPES}
        return EpisodeResult(
            **{name: values[name] for name in _PLAIN},
            reward_terms=self._reward_terms(row),
            metrics=Metrics(*(values[name] for name in _METRICS)),
            decision_ms=self._decision_ms[row],
        )


def column(name: str, values: list[Any]) -> NDArray[Any]:
    """Return a field's values as an array: of objects if they are texts, or None in some."""
    kinds = TYPES[name]
    if NoneType in kinds and (None in values or not values):
        return np.array(values, object)
    (kind,) = kinds - {NoneType}
    return np.array(values, {str: object, int: None if values else int}.get(kind, kind))


def field_of(name: str) -> str:
    """Return the field of the results that a column of `episodes.csv` holds."""
    return "total_reward" if name == "return" else name
