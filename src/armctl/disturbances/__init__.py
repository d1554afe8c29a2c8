"""Disturbances: noise, delay, payload, friction, weak motors, lost images, pushes, and errors of the robot's model."""

import functools
import zlib
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.disturbances.disturbance import Disturbable, Disturbance, DisturbanceSpec, LevelRange
from armctl.disturbances.fields import JointFriction, LinkMismatch, Payload, Slipperiness, Strength, WheelMismatch
from armctl.disturbances.signals import IMAGES, Delay, Dropout, Noise, Pushes, StateNoise

__all__ = [
    "ARM", "GENERIC", "ROVER", "Delay", "Disturbable", "Disturbance", "DisturbanceSpec", "Dropout", "JointFriction",
    "LevelRange", "LinkMismatch", "Noise", "Payload", "Pushes", "Slipperiness", "StateNoise", "Strength",
    "WheelMismatch", "available", "begin_episodes", "disturb", "episode_rng",
]  # fmt: skip

ON_TOP = (0.0, 0.0, 0.22)
"""m above the rover's axles."""

Share = functools.partial(DisturbanceSpec, highest=1.0)
LARGEST_MISMATCH = 0.2
"""Share: the largest default level. With 1, there would be links and wheels of no size and no mass."""
LARGEST_PUSH, LARGEST_ROVER_PUSH = 100.0, 40.0
"""N s: a person of 70 kg who runs into an arm has some 200 with his whole weight, and passes on less than half. 100
throw a rover about at 8 m/s, four times as fast as it drives."""


def _has_camera(task: Disturbable) -> bool:
    space = task.observation_space
    return isinstance(space, gymnasium.spaces.Dict) and not space.spaces.keys().isdisjoint(IMAGES)


def _observes_real_numbers(task: Disturbable) -> bool:
    """Return True if noise reaches all that is observed: whole numbers, such as 8-bit pictures, have none."""
    space = task.observation_space
    parts = [*space.spaces.values()] if isinstance(space, gymnasium.spaces.Dict) else [space]
    return all(isinstance(part, gymnasium.spaces.Box) and np.issubdtype(part.dtype, np.floating) for part in parts)


def _has_physics(task: Disturbable) -> bool:
    return task.physical


def _acts_by_numbers(task: Disturbable) -> bool:
    return isinstance(task.action_space, gymnasium.spaces.Box)


GENERIC: dict[str, DisturbanceSpec] = {
    "noise": DisturbanceSpec(
        Noise,
        "sensor noise, standard deviation",
        "units of each number",
        (0, 0.01, 0.02, 0.05, 0.1),
        1e3,
        applies=_observes_real_numbers,
    ),
    "delay": DisturbanceSpec(
        Delay, "late actions", "control steps", (0, 1, 2, 4, 8), 100, whole=True, applies=_acts_by_numbers
    ),
    "dropout": Share(Dropout, "lost camera images", "share", (0, 0.1, 0.25, 0.5, 0.75), applies=_has_camera),
}
"""Disturbances of any task."""
ARM: dict[str, DisturbanceSpec] = {
    "noise": DisturbanceSpec(
        Noise, "sensor noise, standard deviation", "m, rad, m/s", (0, 0.005, 0.01, 0.02, 0.05), 10
    ),
    "delay": DisturbanceSpec(Delay, "late actions", "control steps of 40 ms", (0, 1, 2, 4, 8), 100, whole=True),
    "payload": DisturbanceSpec(Payload, "a ball at the end-effector", "kg", (0, 2, 5, 10, 20), 50),
    "friction": Share(JointFriction, "dry friction of the joints", "of largest torque", (0, 0.1, 0.2, 0.4, 0.8)),
    "strength": Share(Strength, "torque of the motors", "left", (1, 0.8, 0.6, 0.4, 0.2)),
    "pushes": DisturbanceSpec(
        Pushes, "pushes at the end-effector, about one a second", "N s", (0, 5, 10, 20, 40), LARGEST_PUSH
    ),
    "mismatch": DisturbanceSpec(
        LinkMismatch, "largest error of the model's link masses and lengths", "share", (0, 0.02, 0.05, 0.1, 0.2),
        LARGEST_MISMATCH,
    ),
}  # fmt: skip
"""Disturbances of an arm."""
ROVER: dict[str, DisturbanceSpec] = {
    "noise": DisturbanceSpec(
        Noise, "sensor noise, standard deviation", "m, m/s, rad/s", (0, 0.05, 0.1, 0.2, 0.5), 10,
        applies=_observes_real_numbers,
    ),
    "noise_on_state": DisturbanceSpec(
        StateNoise, "the same, also on the true state for policies that see it", "m, m/s, rad/s",
        (0, 0.05, 0.1, 0.2, 0.5), 10, applies=_observes_real_numbers,
    ),
    "delay": DisturbanceSpec(Delay, "late actions", "control steps of 100 ms", (0, 1, 2, 3, 5), 100, whole=True),
    "payload": DisturbanceSpec(
        functools.partial(Payload, offset=ON_TOP), "a ball on top", "kg", (0, 5, 10, 20, 40), 100,
        applies=_has_physics,
    ),
    "friction": Share(
        Slipperiness, "friction of the tyres", "left", (1, 0.75, 0.5, 0.25, 0.1), applies=_has_physics
    ),
    "strength": Share(
        Strength, "torque of the motors", "left", (1, 0.8, 0.6, 0.4, 0.2), applies=_has_physics
    ),
    "pushes": DisturbanceSpec(
        functools.partial(Pushes, horizontal=True), "pushes at the base, about one a second", "N s",
        (0, 5, 10, 20, 40), LARGEST_ROVER_PUSH, applies=_has_physics,
    ),
    "mismatch": DisturbanceSpec(
        WheelMismatch, "largest error of the model's wheel radii and base mass", "share", (0, 0.02, 0.05, 0.1, 0.2),
        LARGEST_MISMATCH, applies=_has_physics,
    ),
    "dropout": GENERIC["dropout"],
}  # fmt: skip
"""Disturbances of a rover."""


def available(specs: Mapping[str, DisturbanceSpec], task: Disturbable) -> dict[str, DisturbanceSpec]:
    """Return the disturbances in `specs` that apply to a task with its present options, by name."""
    return {name: spec for name, spec in specs.items() if spec.applies(task)}


def disturb(
    task: Disturbable, specs: Mapping[str, DisturbanceSpec], levels: Mapping[str, Any]
) -> dict[str, Disturbance]:
    """Apply disturbances to a task permanently, each at its level. Levels that change nothing are left out.

    A level is a number, or a pair of the lowest and the highest: then each episode draws its own, uniformly.

    Raises `ConfigurationError`.
    """
    if not isinstance(levels, Mapping):
        raise ConfigurationError(f"disturbances are levels by name, such as {{'payload': 2.0}}, not {levels!r}")
    usable = available(specs, task)
    for name in levels:
        if name not in usable:
            raise unknown_name("disturbance here", name, usable)
    ranges = {name: spec.checked_range(name, levels[name]) for name, spec in usable.items() if name in levels}
    disturbances = {}
    for name, drawn_from in ranges.items():
        if drawn_from.low == drawn_from.high == usable[name].neutral:
            continue
        disturbances[name] = usable[name].make(task, drawn_from.high)
        if drawn_from.low < drawn_from.high:
            if not disturbances[name].per_episode:
                raise ConfigurationError(f"the level of {name} cannot differ between episodes: give one level")
            disturbances[name].drawn_from = drawn_from
    return disturbances


def begin_episodes(
    disturbances: Mapping[str, Disturbance], ids: NDArray[np.int32], seeds: NDArray[np.int64], episodes: NDArray[Any]
) -> None:
    """Prepare the worlds `ids`, which are about to be reset, for their episodes, of `seeds` (n,) and `episodes` (n,).

    A disturbance changes what earlier ones have left of the robot. So all are renewed if one is.
    """
    for name, disturbance in disturbances.items():
        for i in ids:
            seed, episode = int(seeds[i]), int(episodes[i])
            disturbance.rngs[i] = episode_rng(name, seed, episode)
            if disturbance.drawn_from is not None:  # by a generator of its own: all else is as at that level fixed
                disturbance.levels[i] = disturbance.drawn_from.draw(episode_rng(f"level of {name}", seed, episode))
    if any(disturbance.renewed for disturbance in disturbances.values()):
        for disturbance in reversed([*disturbances.values()]):
            disturbance.undo(ids)
        for disturbance in disturbances.values():
            disturbance.apply(ids)
    for disturbance in disturbances.values():
        disturbance.begin(ids)


def episode_entropy(seed: int, episode: int) -> tuple[int, ...]:
    """Return an episode's entropy for `numpy.random.SeedSequence`, which is no other episode's.

    NumPy cuts seeds into words of 32 bits, and fills up with zeros: without the 1, episode 0 of seed 2^32 + s would be
    episode 1 of seed s.
    """
    return (seed, episode) if seed < 2**32 else (seed, episode, 1)


def episode_of(rng: np.random.Generator) -> tuple[int, int] | None:
    """Seed and episode of a generator that was made of their `episode_entropy`, and has drawn nothing yet.

    None for any other generator.
    """
    sequence = rng.bit_generator.seed_seq
    match sequence:
        case np.random.SeedSequence(entropy=(int(seed), int(episode), *_) as entropy, spawn_key=()):
            fresh = np.random.default_rng(sequence).bit_generator.state
            is_ours = tuple(entropy) == episode_entropy(seed, episode)
            return (seed, episode) if is_ours and rng.bit_generator.state == fresh else None
    return None


def episode_rng(name: str, seed: int, episode: int) -> np.random.Generator:
    """Return the generator of a disturbance in an episode, independent of the task's and of other disturbances'."""
    sequence = np.random.SeedSequence(episode_entropy(seed, episode), spawn_key=(zlib.crc32(name.encode()),))
    return np.random.default_rng(sequence)
