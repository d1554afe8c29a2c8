"""Notices a policy that writes to the world: what an episode depends on, compared before and after it is made and acts.

These are MuJoCo's state, the model's fields of each world, the arrays and plain values among the attributes of the
environment, its spaces, its task, the parts of the task and the robot's limits, and the constants of the task's classes
and of the modules that define them. A policy may change things and put them back, as a planner does that tries actions.
For environments of others, these are MuJoCo's state, the arrays and plain values among their own attributes (the first
`MAX_PLACES`, and no large arrays), and the same constants; they are compared only for policies that are given the
environment itself, since such an environment may change by its own threads while a policy thinks.
"""

import contextlib
import itertools
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import FAILURES, Disqualified
from armctl.envs import EpisodeVectorEnv, TaskVectorEnv, ThirdPartyVectorEnv
from armctl.simulation import Simulation

_PLAIN = (bool, int, float, str, np.generic)
_MJ_DATA = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "xfrc_applied")
_LARGE = 2**16
"""Bytes. A copy of a larger array takes longer than most decisions: a read-only one is taken as unchanged."""
MAX_PLACES = 10_000
"""Number of values of an environment of others that are compared."""
_SPACES = ("single_observation_space", "single_action_space", "observation_space", "action_space")


class StateGuard:
    """Watches the worlds of an environment while a policy is made, and while it decides.

    `has_access` tells whether the policy is given the environment itself, None until it is made. armctl's own
    environments are watched in any case. Meanwhile, the environment tells of the future what the policy's `foresight`
    includes.
    """

    def __init__(self, env: Any, has_access: bool | None = None, foresight: tuple[str, ...] | None = None) -> None:
        self._worlds: EpisodeVectorEnv = env.unwrapped
        self.has_access, self._foresight = has_access, foresight
        self._places: list[_Place] = []

    @contextmanager
    def assert_unchanged(self, new_episode: bool = False) -> Iterator[None]:
        """Check that what happens inside leaves the worlds as they are. Raises `Disqualified`.

        The values to compare are looked up when an episode begins. Changed values are put back, so that the next
        policies play the same task; the current episodes are lost.
        """
        self._worlds.task.granted = self._foresight
        try:
            with self._compared(new_episode):
                yield
        finally:
            self._worlds.task.granted = None

    @contextmanager
    def _compared(self, new_episode: bool) -> Iterator[None]:
        is_foreign = isinstance(self._worlds, ThirdPartyVectorEnv)
        if is_foreign and self.has_access is False:
            yield
            return
        if new_episode:
            self._places = [_Place.of(*place) for place in _places(self._worlds)]
        state = getattr(self._worlds.task, "state", None)  # another object at each control step
        in_state = (_Place.of(*place) for place in _inside("task.state", getattr(state, "__dict__", {})))
        places = [*self._places, *in_state]
        previous = _values(places)
        previous_contents = _contents(previous)
        failure: BaseException | None = None
        try:
            yield
        except FAILURES as error:
            failure = error
        contents = _contents(_values(places))
        if (self.has_access or not is_foreign) and previous_contents != contents:
            values = zip(places, previous, previous_contents, contents, strict=True)
            changed = [(place, value, content) for place, value, content, current in values if content != current]
            for place, value, content in changed:
                place.put_back(value, content)
            names = ", ".join(place.name for place, *_ in changed[:3])
            raise Disqualified(f"it wrote to the world, which is only for reading: {names}") from failure
        if failure is not None:
            raise failure


class _Place(NamedTuple):
    """A place where a value is that an episode depends on: a key of a dict, a list, or a class."""

    look_up: Callable[[Any], Any]
    key: Any
    holder: Any
    name: str

    @classmethod
    def of(cls, name: str, holder: Any, key: Any) -> "_Place":
        return cls(_items(holder).__getitem__, key, holder, name)

    @property
    def value(self) -> Any:
        """Value that is there; None if it is gone."""
        try:
            return self.look_up(self.key)
        except LookupError:
            return None

    def put_back(self, value: Any, content: Any) -> None:
        """Restore what was there: a plain value, or an array and its content."""
        if isinstance(value, np.ndarray) and value.flags.writeable:
            value[...] = np.frombuffer(content, value.dtype).reshape(value.shape)
        if isinstance(self.holder, type):
            setattr(self.holder, self.key, value)
        else:
            with contextlib.suppress(IndexError):
                self.holder[self.key] = value


def _values(places: Sequence[_Place]) -> list[Any]:
    """Return what is there; None for what is gone."""
    try:
        return [look_up(key) for look_up, key, _, _ in places]
    except LookupError:
        return [place.value for place in places]


def _contents(values: Sequence[Any]) -> list[Any]:
    """Return plain values, and the bytes of arrays."""
    return [_content(value) if isinstance(value, np.ndarray) else value for value in values]


def _content(array: NDArray[Any]) -> bytes | int:
    return id(array) if array.nbytes > _LARGE and not array.flags.writeable else array.tobytes()


def _places(worlds: EpisodeVectorEnv) -> Iterator[tuple[str, Any, Any]]:
    """Yield the places of values that an episode depends on: a name, and the key or index in a dict, list or class."""
    task: Any = worlds.task
    yield from _inside("env", vars(worlds))
    for name in _SPACES:
        yield from _inside(f"env.{name}", getattr(getattr(worlds, name, None), "__dict__", {}))
    yield from _inside("task", vars(task))
    for name, part in vars(task).items():
        if name != "state" and hasattr(part, "__dict__") and not isinstance(part, (Simulation, gymnasium.Space)):
            yield from _inside(f"task.{name}", vars(part))
    yield from _inside("robot.limits", getattr(getattr(task.robot, "limits", None), "__dict__", {}))
    yield from _constants(worlds)
    if isinstance(worlds, TaskVectorEnv):
        yield from _inside("simulation", task.simulation.live_arrays)
    elif isinstance(worlds, ThirdPartyVectorEnv):
        for i, world in enumerate(worlds.worlds):
            yield from itertools.islice(_small(_inside(f"world {i}", vars(world.unwrapped))), MAX_PLACES)
            for name, part in vars(world.unwrapped).items():
                if isinstance(part, mujoco.MjData):
                    yield from _inside(f"world {i}.{name}", {key: getattr(part, key) for key in _MJ_DATA})


def constants(worlds: EpisodeVectorEnv) -> dict[str, Any]:
    """Return the constants of the task by name: those of its classes, and of the modules that define them."""
    return {name: _items(holder)[key] for name, holder, key in _constants(worlds)}


def _constants(worlds: EpisodeVectorEnv) -> Iterator[tuple[str, Any, Any]]:
    cls = type(worlds.worlds[0].unwrapped if isinstance(worlds, ThirdPartyVectorEnv) else worlds.task)
    for kind in cls.__mro__:
        if kind is not object:
            yield from _inside(kind.__name__, kind)
    for module in dict.fromkeys(kind.__module__ for kind in cls.__mro__):
        if module != "builtins" and module in sys.modules:
            yield from _inside(module, vars(sys.modules[module]))


def _small(places: Iterator[tuple[str, Any, Any]]) -> Iterator[tuple[str, Any, Any]]:
    """Leave out large arrays, which environments may fill as they like, and which take long to compare."""
    return (place for place in places if getattr(_items(place[1])[place[2]], "nbytes", 0) <= _LARGE)


def _inside(name: str, holder: Any, outer: tuple[int, ...] = ()) -> Iterator[tuple[str, Any, Any]]:
    """Yield the places of values in a dict, a list or a class; `outer` are the ids of those around it."""
    items = _items(holder)
    for key, value in items.items() if isinstance(items, Mapping) else enumerate(items):
        if isinstance(key, str) and key.startswith("__"):
            continue  # Python's own, of modules and classes
        numbers = isinstance(value, np.ndarray) and value.dtype != object
        if numbers or _is_plain(value) or (isinstance(value, tuple) and all(map(_is_plain, value))):
            yield f"{name}.{key}", holder, key
        elif isinstance(value, (dict, list)) and key != "metadata" and id(value) not in outer:
            yield from _inside(f"{name}.{key}", value, (*outer, id(holder)))


def _items(holder: Any) -> Mapping[Any, Any] | Sequence[Any]:
    return vars(holder) if isinstance(holder, type) else holder


def _is_plain(value: Any) -> bool:
    return isinstance(value, _PLAIN)
