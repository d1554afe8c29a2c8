"""The options of every environment that is made of a task, besides its task's."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from armctl.core.errors import ConfigurationError, unknown_name

LARGEST_REWARD = 1e90
"""Largest reward, or reward term, of a control step: statistics square the sum of those of an episode."""
ACTIONS = ("physical", "normalized")


@dataclass(frozen=True)
class EnvironmentOptions:
    """Disturbances, actions, rewards and time limit in n worlds of any task."""

    max_episode_steps: int | None = None
    """Control steps until an episode is truncated; None: never."""
    disturbances: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    """Levels by name, such as `{"noise": 0.01, "payload": 2.0}`; see `armctl.disturbances`. A pair such as
    `(0.0, 0.02)` is a range, from which each episode draws its own level."""
    actions: str = "physical"
    """`physical`, in the task's units, or `normalized`: -1 and 1 stand for the task's `action_range`."""
    flat_infos: bool = False
    """No dicts within infos: `reward_terms/goal` in place of `goal` in `reward_terms`."""
    reward_scale: float = 1.0
    """Factor of the rewards that `step` returns, for learners; `infos["reward_terms"]` are without it."""
    reward_weights: Mapping[str, float] = field(default_factory=dict)
    """Factors of single terms in these rewards, such as `{"collision": 0.2}`; 1 for others."""

    def __post_init__(self) -> None:
        if self.actions not in ACTIONS:
            raise unknown_name("actions", self.actions, ACTIONS)
        if not (isinstance(self.reward_scale, (int, float)) and 0 < self.reward_scale < LARGEST_REWARD):
            raise ConfigurationError(f"reward_scale is a number above 0, not {self.reward_scale!r}")
        if not isinstance(weights := self.reward_weights, Mapping):
            raise ConfigurationError(f"reward_weights are numbers by the names of reward terms, not {weights!r}")
        for name, weight in weights.items():
            if not (isinstance(weight, (int, float)) and abs(weight) < LARGEST_REWARD):
                raise ConfigurationError(f"the weight of the reward term {name!r} is a finite number, not {weight!r}")
        if self.max_episode_steps is not None:
            check_at_least_one("max_episode_steps", self.max_episode_steps)


NAMES = tuple(option.name for option in fields(EnvironmentOptions))


def split_options(options: Mapping[str, Any]) -> tuple[EnvironmentOptions, dict[str, Any]]:
    """Return the options of every environment, and the others, which are the task's. Raises `ConfigurationError`."""
    general = {name: value for name, value in options.items() if name in NAMES}
    return EnvironmentOptions(**general), {name: value for name, value in options.items() if name not in NAMES}


def check_at_least_one(name: str, value: int) -> None:
    """Raise `ConfigurationError` for what is not a whole number from 1 on."""
    if not isinstance(value, (int, np.integer)) or value < 1:
        raise ConfigurationError(f"{name} is a whole number from 1 on, not {value!r}")
