"""The box of disturbances in which a worst case is searched, and the levels of its points and episodes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.disturbances import DisturbanceSpec, LevelRange, episode_rng
from armctl.episodes.stored import SLOW_DOWN_NAME
from armctl.study.axis import Axis
from armctl.study.grids import DEFAULT_PAIRS
from armctl.study.levels import Disturbances, checked_levels

MAX_DISTURBANCES = 6
"""Largest number of disturbances of a search: with more, its budget is too small for the interactions of each two."""


def search_axes(specs: Mapping[str, DisturbanceSpec], disturbances: Disturbances) -> list[Axis]:
    """Return the axes of a box; a level by name is the end of its range. Raise `ConfigurationError`."""
    requested = default_disturbances(specs) if disturbances is None else disturbances
    levels = checked_levels(specs, requested)
    if not 1 <= len(levels) <= MAX_DISTURBANCES:
        raise ConfigurationError(f"a worst case is one of 1 to {MAX_DISTURBANCES} disturbances, not of {len(levels)}")
    axes = []
    for name, at in levels.items():
        end = requested[name] if isinstance(requested, Mapping) else None
        if end is not None and len(end) != 1:
            raise ConfigurationError(
                f"{name} takes the end of its range, such as {name}={at[-1]:g}, not several levels"
            )
        if name == SLOW_DOWN_NAME:
            raise ConfigurationError(f"{SLOW_DOWN_NAME} is no part of a box of disturbances: sweep it")
        axes.append(Axis(name, at[0], at[-1], specs[name].whole, specs[name].unit))
    return axes


def default_disturbances(specs: Mapping[str, DisturbanceSpec]) -> list[str]:
    """Return the disturbances of `DEFAULT_PAIRS` that a task has, noise also on the state where there is such a one."""
    noise = "noise_on_state" if "noise_on_state" in specs else "noise"
    names = dict.fromkeys(noise if name == "noise" else name for pair in DEFAULT_PAIRS for name in pair)
    possible = [name for name in names if name in specs]
    if not possible:
        raise ConfigurationError(f"this environment has none of {', '.join(names)}: name disturbances")
    return possible


def levels_between(axes: Sequence[Axis], low: Array, high: Array) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest level of each disturbance between two points, as environments take them."""
    ends = np.stack([low, high], axis=1)
    return {axis.name: axis.levels_between(*between) for axis, between in zip(axes, ends, strict=True)}


def levels_at(axes: Sequence[Axis], point: Array) -> dict[str, float]:
    """Return the levels at a point; those without effect are left out."""
    levels = {axis.name: axis.level(share) for axis, share in zip(axes, point, strict=True)}
    return {axis.name: levels[axis.name] for axis in axes if levels[axis.name] != axis.neutral}


def point_at(axes: Sequence[Axis], levels: Mapping[str, float]) -> Array:
    """Return the point with these levels; others are without effect."""
    return np.array([axis.share(levels.get(axis.name, axis.neutral)) for axis in axes])


def points_of(axes: Sequence[Axis], disturbances: Mapping[str, Any], seed: int, episodes: Sequence[int]) -> Array:
    """Return the point (n, d) of each episode, whose levels the environment has drawn from `disturbances`."""

    def share_of(axis: Axis, episode: int) -> float:
        low, high = disturbances.get(axis.name, (axis.neutral, axis.neutral))
        if low == high:
            return axis.share(low)
        rng = episode_rng(f"level of {axis.name}", seed, episode)
        return axis.share(LevelRange(low, high, axis.whole).draw(rng))

    return np.array([[share_of(axis, episode) for axis in axes] for episode in episodes]).reshape(-1, len(axes))
