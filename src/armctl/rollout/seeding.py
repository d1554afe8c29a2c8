"""Checks that an environment obeys its seed, and observes what it declares.

If it does not obey its seed, policies do not meet the same episodes.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from armctl.core.errors import EnvironmentFailed
from armctl.core.registration import bare_id
from armctl.envs import make_worlds, one_of
from armctl.rollout.loop import environment_limit, wrap_environment_errors

STEPS = 25
"""Number of steps of each trial. Most ways to ignore a seed show at the reset, the others soon after it."""
Step = tuple[Any, float, bool, bool]
"""Observation, reward, terminated, truncated."""


@dataclass(frozen=True)
class SeedCheck:
    """Result of the trials of an environment and its seed."""

    notes: list[str]
    """Remarks about one that plays an episode differently each time, or all episodes alike."""
    obeyed: bool = True
    """False if an episode was another one when it was played again."""


def check_seed(env: str, env_options: Mapping[str, Any] | None = None, timeout: float | None = None) -> SeedCheck:
    """Return how an environment takes its seed, and whether it observes what it declares.

    Two worlds play episodes 0 and 1 with the same random actions, and then once more with the episodes swapped. So a
    difference shows whether it comes from the global random state, from what was played before, or from the instance.
    `timeout` is the time (s) that a reset or a step may take.
    """
    name, notes = bare_id(env), list[str]()
    with closing(make_worlds(env, 2, env_options)) as worlds:
        worlds.single_action_space.seed(0)
        actions = [worlds.single_action_space.sample() for _ in range(STEPS)]
        limit = environment_limit(worlds, timeout)
        try:
            once, again = (_play(worlds, episodes, actions, limit) for episodes in ((0, 1), (1, 0)))
        except EnvironmentFailed as error:
            return SeedCheck([f"Whether {name} obeys its seed is unknown: {error}"])
    if misfit := _misfit(worlds.single_observation_space, [observation for observation, *_ in once[0]]):
        notes.append(f"{name} {misfit}.")
    for episode in (0, 1):
        step = _first_difference(once[episode], again[1 - episode])
        if step is not None:
            when = f"in step {step}" if step else "from its start"
            notes.append(
                f"{name} does not obey its seed: episode {episode} differs {when} when it is played again. So policies "
                "do not meet the same episodes, and no result can be repeated exactly."
            )
            return SeedCheck(notes, obeyed=False)
    if _first_difference(once[0], once[1]) is None:
        notes.append(
            f"{name} plays the same episode whatever its seed: all episodes are one and the same, and only policies "
            "can make a difference."
        )
    return SeedCheck(notes)


def _misfit(space: Any, observations: Sequence[Any]) -> str:
    """Return how observations differ from the declared space, in words; empty if they do not."""
    if not isinstance(space, gymnasium.spaces.Box):
        return ""
    shapes = {np.shape(observation) for observation in observations}
    if shapes != {space.shape}:
        return f"declares observations of shape {space.shape}, and observes {' and '.join(map(str, sorted(shapes)))}"
    if np.isnan(np.array(observations, dtype=float)).any():
        return "observes numbers that are not finite"
    return ""


def _play(worlds: Any, episodes: Sequence[int], actions: Sequence[Any], limit: float | None) -> list[list[Step]]:
    """Return the steps of each world, from the reset to the episode's end, or as many as there are actions."""
    with wrap_environment_errors("a trial", episodes[0], limit):
        observations, _ = worlds.reset(seed=[0, 0], options={"episode": list(episodes)})
    trials: list[list[Step]] = [[(one_of(observations, i), 0.0, False, False)] for i in range(2)]
    for action in actions:
        with wrap_environment_errors("a trial", episodes[0], limit):
            observations, rewards, terminated, truncated, _ = worlds.step([action, action])
        for i, trial in enumerate(trials):
            if not (trial[-1][2] or trial[-1][3]):
                trial.append((one_of(observations, i), float(rewards[i]), bool(terminated[i]), bool(truncated[i])))
    return trials


def _first_difference(trial: list[Step], other: list[Step]) -> int | None:
    """Return the first step in which two trials differ, 0 for the reset; None if they are the same."""
    pairs = enumerate(zip(trial, other, strict=False))
    steps = (i for i, (a, b) in pairs if not (_same(a[0], b[0]) and a[1:] == b[1:]))
    return next(steps, None if len(trial) == len(other) else min(len(trial), len(other)))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, dict):
        return all(_same(a[name], b[name]) for name in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    a, b = np.asarray(a), np.asarray(b)
    return np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
