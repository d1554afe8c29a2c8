"""The search space of a tuning: a table `[tune]` that mirrors the file it stands in, with ranges in place of values.

[options]
gamma = 0.97
hidden_units = 128

[tune.options]
gamma = { low = 0.9, high = 0.999 }
hidden_units = { choices = [64, 128, 256] }
"""

import copy
import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from armctl.core.errors import ConfigurationError

Value = bool | int | float | str


class Range(BaseModel):
    """The values that an option may take: from `low` to `high`, whole numbers if these are, or one of `choices`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    low: int | float | None = None
    high: int | float | None = None
    log: bool = False
    """True if values are drawn by their logarithm, as for learning rates."""
    choices: tuple[Value, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _tuple_of_choices(cls, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(choices := value.get("choices"), list):
            return value | {"choices": tuple(choices)}
        return value

    @model_validator(mode="after")
    def _is_one_or_the_other(self) -> "Range":
        if self.choices:
            if self.low is not None or self.high is not None or self.log:
                raise ValueError("a range has either choices, or low and high")
            if len(self.choices) < 2 or len(set(map(repr, self.choices))) < len(self.choices):
                raise ValueError("choices are at least two, and differ")
        elif self.low is None or self.high is None:
            raise ValueError("a range has low and high, or choices")
        elif not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"low must be less than high, and both finite, not {self.low!r} and {self.high!r}")
        elif self.log and self.low <= 0:
            raise ValueError(f"with log, low must be more than 0, not {self.low!r}")
        return self

    @property
    def is_whole(self) -> bool:
        """True if its values are whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def __contains__(self, value: object) -> bool:
        if self.choices:
            return any(value == choice and type(value) is type(choice) for choice in self.choices)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        assert self.low is not None
        assert self.high is not None
        return self.low <= value <= self.high and (isinstance(value, int) or not self.is_whole)


SearchSpace = Mapping[str, Range]
"""Ranges by path, such as `options.gamma`."""


def search_space(table: Mapping[str, Any], values: Mapping[str, Any], source: str) -> dict[str, Range]:
    """Return the ranges in a table `[tune]`, by path. `values` are those of the file, `source` its name.

    Raises `ConfigurationError` for what is no range, and for an option whose present value is not in its range, or not
    in the file: a tuning begins with it.
    """
    ranges: dict[str, Range] = {}
    for path, definition in _leaves(table):
        try:
            ranges[path] = Range.model_validate(definition)
        except ValidationError as error:
            why = error.errors()[0]["msg"].removeprefix("Value error, ")
            raise ConfigurationError(f"{source}: [tune] {path}: {why}; not {definition!r}") from error
        try:
            present = value_at(values, path)
        except KeyError:
            raise ConfigurationError(
                f"{source} does not say which value {path} has now: add it, for a tuning begins there"
            ) from None
        if present not in ranges[path]:
            raise ConfigurationError(f"{source}: the present value of {path}, {present!r}, is not in {definition!r}")
    return ranges


def value_at(values: Mapping[str, Any], path: str) -> Any:
    """Return the value at a path. Raises `KeyError`."""
    for key in path.split("."):
        if not isinstance(values, Mapping):
            raise KeyError(path)
        values = values[key]
    return values


def with_values(values: Mapping[str, Any], chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy with other values at some paths, all of which it has."""
    changed = copy.deepcopy(dict(values))
    for path, value in chosen.items():
        *above, last = path.split(".")
        inner = changed
        for key in above:
            inner = inner[key]
        inner[last] = value
    return changed


def _leaves(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield everything that should be a range, with its path: what is no table, or a table with a range's keys."""
    for key, value in table.items():
        path = f"{above}{key}"
        if isinstance(value, Mapping) and not value.keys() & Range.model_fields.keys():
            yield from _leaves(value, f"{path}.")
        else:
            yield path, value
