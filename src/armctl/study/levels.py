"""The levels of disturbances that a sweep or a suite plays."""

import functools
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.disturbances import DisturbanceSpec, available
from armctl.envs import make_worlds
from armctl.rollout.real_time import SLOW_DOWN, SLOWER

Disturbances = Mapping[str, Sequence[float] | None] | Sequence[str] | None
"""Names, or levels by name; None as levels stands for the default ones, and None alone for all disturbances."""


def setting_name(disturbance: str, level: float) -> str:
    """The name, or its last part, of the cell at a level."""
    return f"{disturbance}-{level}"


def sweep_levels(
    env: str, disturbances: Disturbances = None, env_options: Mapping[str, Any] | None = None
) -> dict[str, list[float]]:
    """The levels of a sweep's disturbances without repeats, ordered by their distance from the one without effect.

    Raises `ConfigurationError`.
    """
    return checked_levels(disturbance_specs(env, env_options or {}), disturbances)


def disturbance_specs(env: str, options: Mapping[str, Any]) -> dict[str, DisturbanceSpec]:
    """What can be swept in an environment: what is not constant in its options. Raises `ConfigurationError`."""
    with closing(make_worlds(env, 1, options)) as made:
        specs = available(made.task.disturbances, made.task)
    constant = options.get("disturbances", {})
    return {name: spec for name, spec in specs.items() if name not in constant} | {SLOWER: SLOW_DOWN}


def checked_levels(specs: Mapping[str, DisturbanceSpec], disturbances: Disturbances) -> dict[str, list[float]]:
    """The levels of each disturbance, the one without effect first. Raises `ConfigurationError`."""
    if disturbances is None:
        disturbances = [name for name in specs if name != SLOWER]
    given = [disturbances] if isinstance(disturbances, str) else disturbances
    asked: Mapping[str, Any] = given if isinstance(given, Mapping) else dict.fromkeys(given)
    levels = {}
    for name, wanted in asked.items():
        if name not in specs:
            raise unknown_name("disturbance to sweep here", name, specs)
        spec = specs[name]
        wanted = spec.levels if wanted is None else wanted
        if isinstance(wanted, str) or not isinstance(wanted, Sequence):
            raise ConfigurationError(f"the levels of {name} are numbers, such as {list(spec.levels)}, not {wanted!r}")
        others = {spec.checked(name, level) for level in wanted} - {spec.neutral}
        if not others:
            raise ConfigurationError(f"{name} needs a level besides {spec.neutral:g}, which changes nothing")
        levels[name] = [spec.neutral, *sorted(others, key=functools.partial(_away, spec.neutral))]
    return levels


def _away(neutral: float, level: float) -> tuple[float, float]:
    return abs(level - neutral), level
