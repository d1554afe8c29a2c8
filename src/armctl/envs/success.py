"""Success of an episode in an environment of others, as its steps or its return tell it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, nearest, unknown_name
from armctl.envs import foreign_values

KEYS = ("is_success", "success")
"""Keys of `info` that tell of success unless another one is named: the first that is there."""
RULES = ("last", "any", "return")


@dataclass(frozen=True)
class SuccessRule:
    """Rule by which success is read from an episode.

    Raises `ConfigurationError` for options that exclude each other.
    """

    success: Literal["last", "any", "return"] | None = None
    """`last`: its last step tells of a success, the default; `any`: any of its steps does; `return`: its return is at
    least `success_return`, the default with one."""
    success_key: str | None = None
    """Key of `info` that tells of success; None: the first of `KEYS` that is there."""
    success_return: float | None = None
    """Least return of a success."""

    def __post_init__(self) -> None:
        if self.success is not None and self.success not in RULES:
            raise unknown_name("rule of success", self.success, RULES)
        if not (self.success_return is None or _is_number(self.success_return)):
            raise ConfigurationError(f"success_return is a number, not {self.success_return!r}")
        if not (self.success_key is None or (isinstance(self.success_key, str) and self.success_key)):
            raise ConfigurationError(f"success_key is a key of info, not {self.success_key!r}")
        if self.success == "return" and self.success_return is None:
            raise ConfigurationError("success by return needs the least return of a success: --success-return X")
        if self.success_return is not None and (self.success not in (None, "return") or self.success_key is not None):
            raise ConfigurationError(
                "success_return reads success from returns, and success_key, last and any from info: leave one out"
            )

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of `info` that may tell of success."""
        return KEYS if self.success_key is None else (self.success_key,)

    @property
    def in_words(self) -> str:
        """The rule, if any option states it; else empty."""
        if self == UNSTATED:
            return ""
        if self.success_return is not None:
            return f"An episode is a success if its return is at least {self.success_return:g}."
        keys = " or ".join(f'info["{key}"]' for key in self.keys)
        return f"An episode is a success if {keys} is true in {'any' if self.success == 'any' else 'the last'} step."


UNSTATED = SuccessRule()
OPTIONS = tuple(option.name for option in fields(SuccessRule))


class SuccessReader:
    """Reads success of the current episodes in n worlds of an environment `name`, with `remarks` on what it tells."""

    def __init__(self, rule: SuccessRule, num_envs: int, name: str, remarks: dict[str, None]) -> None:
        self._rule, self._name, self._remarks = rule, name, remarks
        self._returns = np.zeros(num_envs)
        self._last: NDArray[np.object_] = np.full(num_envs, None)
        """(n,) the last step's word on success; None if it has none."""
        self._any: NDArray[np.object_] = np.full(num_envs, None)
        """(n,) the word of all steps: True if one of them told of a success."""

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._returns[ids], self._last[ids], self._any[ids] = 0.0, None, None

    def step(self, i: int, reward: float, info: Mapping[str, Any]) -> None:
        """Read a step of world i."""
        self._returns[i] += reward
        self._last[i] = word = self._read(info)
        if word is not None:
            self._any[i] = word or bool(self._any[i])

    def success(self, i: int, info: Mapping[str, Any]) -> bool | None:
        """Return whether the episode of world i, which ended with this `info`, was a success; None if unknown."""
        if self._rule.success_return is not None:
            return bool(self._returns[i] >= self._rule.success_return)
        word: bool | None = self._any[i] if self._rule.success == "any" else self._last[i]
        if word is None and self._rule.success_key is not None:
            self._remark_missing(self._rule.success_key, info)
        if self._rule.success is None and self._last[i] is False and self._any[i]:
            self._remarks[
                f"In some episodes of {self._name}, an earlier step tells of a success, and the last one does not: the "
                "last step counts. With --success any, each step does."
            ] = None
        return word

    def _read(self, info: Mapping[str, Any]) -> bool | None:
        """Return what a step tells of success; None if nothing that is true or false."""
        key = next((key for key in self._rule.keys if info.get(key) is not None), None)
        if key is None or (success := foreign_values.truth(info[key])) is not None:
            return None if key is None else success
        self._remarks[
            f'info["{key}"] of {self._name} is a {type(info[key]).__name__} that is neither true nor false: where an '
            "episode's last step has one, its success is unknown."
        ] = None
        return None

    def _remark_missing(self, key: str, info: Mapping[str, Any]) -> None:
        if key not in info:
            keys = sorted(map(str, info))
            self._remarks[
                f'Some episodes of {self._name} end without info["{key}"], so that their success is unknown.'
                f"{nearest(key, keys)} There are: {', '.join(keys) or 'none'}."
            ] = None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
