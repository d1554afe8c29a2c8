"""Declarations of what policies see, which load nothing."""

import fnmatch
import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.foresight import FORESIGHT, Foresight, check_known
from armctl.core.kinds import Kind, check_kind
from armctl.envs.sees import SEES, Sees

Factory = TypeVar("Factory")
FRAMES, MAX_FRAMES = "frames", 1000
"""Part of an interface that is none of the environment's options, and the most control steps in it."""


def sees(
    privilege: Sees,
    *,
    family: str | None = None,
    foresight: Foresight | tuple[Foresight, ...] = (),
    kind: Kind | None = None,
) -> Callable[[Factory], Factory]:
    """Declare what a policy sees: a decorator of the function or class that makes it, or of a plain policy.

    `family` is the kind of method, such as `MPC`, by which a suite ranks policies of several tasks together.
    `foresight` is what the policy knows besides: the `target`'s future, the `pedestrians`' future, the level of a
    `disturbance`, or the nominal `simulator`, in which it plans. It gets that by `env.preview(name, world)`.
    `kind` is the side on which verdicts count it: `hybrid` if it plans or controls with a trained network. By default,
    what was trained is `learned`, and anything else `classical`.

    - `observation`: only what the environment gives to every policy; this is the default;
    - `model`: the robot's description and the task's options as well;
    - `map`: also what stands still around the robot;
    - `state`: everything that is true. Only such a policy gets the environment itself.

    Raises `ConfigurationError` for anything else.
    """
    check_sees(privilege)
    names = _checked_foresight(foresight)
    if kind is not None:
        check_kind(kind)

    def declare(factory: Factory) -> Factory:
        factory.sees = privilege  # type: ignore[attr-defined]
        if names:
            factory.foresight = names  # type: ignore[attr-defined]
        if family is not None:
            factory.family = family  # type: ignore[attr-defined]
        if kind is not None:
            factory.kind = kind  # type: ignore[attr-defined]
        return factory

    return declare


def interface(*, frames: int = 1, **options: Any) -> Callable[[Factory], Factory]:
    """Declare the interface that a policy is made for: it plays with it, whatever is requested.

    `options` are options of the environment that say how a policy sees and commands the robot, such as
    `control="velocity", observation="full"`. With `frames`, an observation is a stack (frames, ...) of the last ones,
    the present one last; before an episode's first one, there was always that same one.

    Values are literals: they are read from the source, before that is imported. Raises `ConfigurationError` for
    `frames` that are no whole number from 1 on.
    """
    declaration = options | ({FRAMES: frames} if frames != 1 else {})
    checked_interface(declaration)

    def declare(factory: Factory) -> Factory:
        factory.interface = declaration  # type: ignore[attr-defined]
        return factory

    return declare


def made_for(
    envs: str, *, controls: str, interface: Mapping[str, Any] = MappingProxyType({})
) -> Callable[[Factory], Factory]:
    """Declare, for `armctl list`, for which environments a policy is made, and what it controls there.

    `envs` is an id, a pattern such as `armctl/ArmReach*`, or several with spaces in between; `controls` are robots and
    commands, such as `ur5, position`. Both are literal texts, which are read from the source.
    `interface` are options of the environment with which it plays unless others are requested: a `control`, say.
    """

    def declare(factory: Factory) -> Factory:
        factory.made_for = (envs, controls)  # type: ignore[attr-defined]
        factory.usual_interface = dict(interface)  # type: ignore[attr-defined]
        return factory

    return declare


def is_made_for(env_id: str, envs: str) -> bool:
    """Return True if an environment is among the `envs` of `made_for`."""
    return any(fnmatch.fnmatchcase(env_id, pattern) for pattern in envs.split())


def check_sees(privilege: object) -> None:
    """Raise `ConfigurationError` for what is not a key of `SEES`."""
    if privilege not in SEES:
        raise unknown_name("privilege", privilege, SEES)


def declared(source: Any) -> str:
    """Return what a policy, or its maker, declares to see. Raises `ConfigurationError`."""
    source = unwrapped(source)
    privilege = getattr(source, "sees", "observation")
    if isinstance(source, type) and isinstance(privilege, property):  # its instances know
        return "observation"
    check_sees(privilege)
    return str(privilege)


def declared_foresight(source: Any) -> tuple[str, ...]:
    """Return what a policy, or its maker, declares to foresee: keys of `FORESIGHT`. Raises `ConfigurationError`."""
    foresight = getattr(unwrapped(source), "foresight", ())
    return () if isinstance(foresight, property) else _checked_foresight(foresight)


def checked_interface(options: Any) -> dict[str, Any]:
    """Return an interface as it is declared. Raise `ConfigurationError` for what is none."""
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"the interface of a policy is a mapping of options, not {options!r}")
    frames = options.get(FRAMES, 1)
    if type(frames) is not int or not 1 <= frames <= MAX_FRAMES:
        raise ConfigurationError(f"{FRAMES} are a whole number from 1 to {MAX_FRAMES}, not {frames!r}")
    return dict(options)


def _checked_foresight(foresight: Any) -> tuple[str, ...]:
    names = (foresight,) if isinstance(foresight, str) else tuple(foresight)
    for name in names:
        check_known(name)
    return tuple(name for name in FORESIGHT if name in names)


def unwrapped(source: Any) -> Any:
    """Return the function of a partial one, unless this declares something itself."""
    while isinstance(source, functools.partial) and not {"sees", "interface"} & vars(source).keys():
        source = source.func
    return source
