"""Declarations of what policies see, and what they get for it."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from armctl.core.errors import ConfigurationError, defined_at, unknown_name
from armctl.envs import SEES, EpisodeVectorEnv, Interface, PolicyStreams, Sees, how_to_declare, interface_of

Factory = TypeVar("Factory")
PERCEIVED = ("observation", "state")
"""Through which of a disturbance's channels policies perceive their worlds."""


def sees(privilege: Sees, *, family: str | None = None) -> Callable[[Factory], Factory]:
    """Declare what a policy sees: a decorator of the function or class that makes it, or of a plain policy.

    `family` is the kind of method, such as `MPC`, by which a suite ranks policies of several tasks together.

    - `observation`: only what the environment gives to every policy; this is the default;
    - `model`: the robot's description and the task's options as well;
    - `map`: also what stands still around the robot;
    - `state`: everything that is true. Only such a policy gets the environment itself.

    Raises `ConfigurationError` for anything else.
    """
    check_sees(privilege)

    def declare(factory: Factory) -> Factory:
        factory.sees = privilege  # type: ignore[attr-defined]
        if family is not None:
            factory.family = family  # type: ignore[attr-defined]
        return factory

    return declare


def check_sees(privilege: object) -> None:
    """Raise `ConfigurationError` for what is not a key of `SEES`."""
    if privilege not in SEES:
        raise unknown_name("privilege", privilege, SEES)


def declared(source: Any) -> str:
    """Return what a policy, or its maker, declares to see. Raises `ConfigurationError`."""
    source = _unwrapped(source)
    privilege = getattr(source, "sees", "observation")
    if isinstance(source, type) and isinstance(privilege, property):  # its instances know
        return "observation"
    check_sees(privilege)
    return str(privilege)


def _unwrapped(source: Any) -> Any:
    """Return the function of a partial one, unless this declares something itself."""
    while isinstance(source, functools.partial) and "sees" not in vars(source):
        source = source.func
    return source


def knowledge_for(
    privilege: str, env: EpisodeVectorEnv | Interface, name: str, streams: PolicyStreams
) -> EpisodeVectorEnv | Interface:
    """Return what a policy called `name` gets of an environment: an interface, or all of it with privilege `state`.

    Its random numbers are those of `streams`, or of the policy that makes it.

    Raises `ConfigurationError` if it is made by another policy, in whose interface there is less.
    """
    if isinstance(env, Interface):
        return env.limited_to(privilege, name)
    return env if privilege == "state" else interface_of(env, privilege, streams)


def as_declared(policy: Any, privilege: str, name: str, source: Any) -> Any:
    """Return a policy that was made with a declared privilege, and says so itself, and its family if one was declared.

    Raises `ConfigurationError` if it says that it sees more.
    """
    declaration = declared(policy)
    if list(SEES).index(declaration) > list(SEES).index(privilege):
        raise ConfigurationError(
            f"{name} made a policy that sees the {SEES[declaration]}, which has to be declared before it is made: "
            f"{how_to_declare(declaration)}{defined_at(source)}"
        )
    if declaration != privilege:
        policy.sees = privilege
    if (family := getattr(_unwrapped(source), "family", None)) is not None:
        policy.family = family
    return policy


def channels_read(policy: Any) -> tuple[str, ...]:
    """Return which of `observation` and `state` a policy reads: its `reads`, or by default what it declares to see.

    Raises `ConfigurationError` for anything else.
    """
    default = ("state",) if getattr(policy, "sees", "observation") == "state" else ("observation",)
    reads = getattr(policy, "reads", default)
    for channel in reads:
        if channel not in PERCEIVED:
            raise unknown_name("channel that a policy reads", channel, PERCEIVED)
    return tuple(reads)


def privileges(by_name: Mapping[str, str]) -> str:
    """Return a sentence about what policies see, from keys of `SEES` by name; empty if they all see the same."""
    if len(set(by_name.values())) < 2:
        return ""
    parts = (f"{name} ({SEES.get(privilege, privilege)})" for name, privilege in by_name.items())
    return f"Their privileges differ: {', '.join(parts)}."
