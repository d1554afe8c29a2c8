"""Notices a policy that writes to the world: what an episode depends on, compared before and after it acts.

These are MuJoCo's state, the model's fields of each world, and the arrays and plain values among the attributes of the
environment, its task, the parts of the task and the robot's limits. What a policy changes and puts back is allowed, as
by a planner that tries actions. Of environments of others, it is MuJoCo's state, and the arrays and plain values among
their own attributes.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import mujoco
import numpy as np

from armctl.envs import EpisodeVectorEnv, TaskVectorEnv, ThirdPartyVectorEnv
from armctl.errors import Disqualified
from armctl.simulation import Simulation

_PLAIN = (bool, int, float, str, np.generic)
_MJ_DATA = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "xfrc_applied")


class Watch:
    """Watches the worlds of an environment while a policy decides."""

    def __init__(self, env: Any) -> None:
        self._worlds: EpisodeVectorEnv = env.unwrapped
        self._slots: list[tuple[str, Any, Any]] = []

    @contextmanager
    def untouched(self, new_episode: bool = False) -> Iterator[None]:
        """Check that what happens inside leaves the worlds as they are. Raises `Disqualified`.

        What there is to compare is looked up when an episode begins.
        """
        if new_episode:
            self._slots = list(_slots(self._worlds))
        state = getattr(self._worlds.task, "state", None)  # another object at each control step
        slots = [*self._slots, *_inside("task.state", getattr(state, "__dict__", {}))]
        before = [_value(holder, key) for _, holder, key in slots]
        yield
        after = [_value(holder, key) for _, holder, key in slots]
        if before != after:
            changed = [name for (name, *_), one, other in zip(slots, before, after, strict=True) if one != other]
            raise Disqualified(f"it wrote to the world, which is only for reading: {', '.join(changed[:3])}")


def _slots(worlds: EpisodeVectorEnv) -> Iterator[tuple[str, Any, Any]]:
    """Where the values are that an episode depends on: a name, and the key or index in a dict or list."""
    task: Any = worlds.task
    yield from _inside("env", vars(worlds))
    yield from _inside("task", vars(task))
    for name, part in vars(task).items():
        if name != "state" and hasattr(part, "__dict__") and not isinstance(part, (Simulation, gymnasium.Space)):
            yield from _inside(f"task.{name}", vars(part))
    yield from _inside("robot.limits", getattr(getattr(task.robot, "limits", None), "__dict__", {}))
    if isinstance(worlds, TaskVectorEnv):
        yield from _inside("simulation", task.simulation.live_arrays)
    elif isinstance(worlds, ThirdPartyVectorEnv):
        for i, world in enumerate(worlds.worlds):
            yield from _inside(f"world {i}", vars(world.unwrapped))
            for name, part in vars(world.unwrapped).items():
                if isinstance(part, mujoco.MjData):
                    yield from _inside(f"world {i}.{name}", {key: getattr(part, key) for key in _MJ_DATA})


def _inside(name: str, holder: Mapping[Any, Any] | Sequence[Any]) -> Iterator[tuple[str, Any, Any]]:
    items = holder.items() if isinstance(holder, Mapping) else enumerate(holder)
    for key, value in items:
        numbers = isinstance(value, np.ndarray) and value.dtype != object
        if numbers or _is_plain(value) or (isinstance(value, tuple) and all(map(_is_plain, value))):
            yield f"{name}.{key}", holder, key
        elif isinstance(value, (dict, list)) and key != "metadata":
            yield from _inside(f"{name}.{key}", value)


def _is_plain(value: Any) -> bool:
    return isinstance(value, _PLAIN)


def _value(holder: Any, key: Any) -> Any:
    """A plain value, or the checksum of an array; None for what is gone."""
    try:
        value: Any = holder[key]
    except LookupError:
        return None
    if not isinstance(value, np.ndarray):
        return value
    return zlib.crc32(value.data if value.flags.c_contiguous else value.tobytes())
