"""The levels of disturbances that a sweep or a suite plays."""

import functools
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.disturbances import DisturbanceSpec, available
from armctl.envs import make_worlds
from armctl.episodes.stored import SLOW_DOWN_NAME
from armctl.rollout.real_time import SLOW_DOWN

Disturbances = Mapping[str, Sequence[float] | None] | Sequence[str] | None
"""Names of disturbances, or levels by name, where None means the default levels. None alone means all disturbances."""


def sweep_levels(
    env: str, disturbances: Disturbances = None, env_options: Mapping[str, Any] | None = None
) -> dict[str, list[float]]:
    """Return the levels of a sweep's disturbances without repeats, ordered by distance from the one without effect.

    Raises `ConfigurationError`.
    """
    return checked_levels(disturbance_specs(env, env_options or {}), disturbances)


def disturbance_specs(env: str, options: Mapping[str, Any]) -> dict[str, DisturbanceSpec]:
    """Return the disturbances of an environment that are not constant in its options. Raise `ConfigurationError`."""
    with closing(make_worlds(env, 1, options)) as vec_env:
        specs = available(vec_env.task.disturbances, vec_env.task)
    constant = options.get("disturbances", {})
    return {name: spec for name, spec in specs.items() if name not in constant} | {SLOW_DOWN_NAME: SLOW_DOWN}


def checked_levels(specs: Mapping[str, DisturbanceSpec], disturbances: Disturbances) -> dict[str, list[float]]:
    """Return the levels of each disturbance, the one without effect first. Raise `ConfigurationError`."""
    if disturbances is None:
        disturbances = [name for name in specs if name != SLOW_DOWN_NAME]
    requested = [disturbances] if isinstance(disturbances, str) else disturbances
    by_name: Mapping[str, Any] = requested if isinstance(requested, Mapping) else dict.fromkeys(requested)
    levels = {}
    for name, values in by_name.items():
        if name not in specs:
            raise unknown_name("disturbance to sweep here", name, specs)
        spec = specs[name]
        values = spec.levels if values is None else values
        if isinstance(values, str) or not isinstance(values, Sequence):
            raise ConfigurationError(f"the levels of {name} are numbers, such as {list(spec.levels)}, not {values!r}")
        others = {spec.checked(name, level) for level in values} - {spec.neutral}
        if not others:
            raise ConfigurationError(f"{name} needs a level besides {spec.neutral:g}, which changes nothing")
        levels[name] = [spec.neutral, *sorted(others, key=functools.partial(_away, spec.neutral))]
    return levels


def _away(neutral: float, level: float) -> tuple[float, float]:
    return abs(level - neutral), level
