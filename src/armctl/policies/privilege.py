"""What policies declare to see, and what they get for it."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from armctl.core.errors import ConfigurationError, defined_at, unknown_name
from armctl.envs import SEES, EpisodeVectorEnv, Interface, PolicyStreams, Sees, how_to_declare, interface_of

Factory = TypeVar("Factory")
PERCEIVED = ("observation", "state")
"""Through which of a disturbance's channels policies perceive their worlds."""


def sees(what: Sees) -> Callable[[Factory], Factory]:
    """Declare what a policy sees: a decorator of the function or class that makes it, or of a plain policy.

    - `observation`: only what the environment gives to everybody; so it is without a declaration;
    - `model`: the robot's description and the task's options as well;
    - `map`: also what stands still around the robot;
    - `state`: everything that is true. Only such a policy gets the environment itself.

    Raises `ConfigurationError` for anything else.
    """
    check_sees(what)

    def declare(factory: Factory) -> Factory:
        factory.sees = what  # type: ignore[attr-defined]
        return factory

    return declare


def check_sees(what: object) -> None:
    """Raise `ConfigurationError` for what is not a key of `SEES`."""
    if what not in SEES:
        raise unknown_name("privilege", what, SEES)


def declared(given: Any) -> str:
    """What a policy, or what makes one, declares to see. Raises `ConfigurationError`."""
    while isinstance(given, functools.partial) and "sees" not in vars(given):
        given = given.func
    what = getattr(given, "sees", "observation")
    if isinstance(given, type) and isinstance(what, property):  # its instances know
        return "observation"
    check_sees(what)
    return str(what)


def told(
    what: str, env: EpisodeVectorEnv | Interface, name: str, streams: PolicyStreams
) -> EpisodeVectorEnv | Interface:
    """What a policy called `name` gets of an environment: an interface, or all of it if the policy sees the state.

    Its random numbers are those of `streams`, or of the policy that makes it.

    Raises `ConfigurationError` if it is made by another policy, in whose interface there is less.
    """
    if isinstance(env, Interface):
        return env.limited_to(what, name)
    return env if what == "state" else interface_of(env, what, streams)


def as_declared(policy: Any, what: str, name: str, source: Any) -> Any:
    """A policy that was made with what had been declared, and says so itself.

    Raises `ConfigurationError` if it says that it sees more.
    """
    own = declared(policy)
    if list(SEES).index(own) > list(SEES).index(what):
        raise ConfigurationError(
            f"{name} made a policy that sees the {SEES[own]}, which has to be declared before it is made: "
            f"{how_to_declare(own)}{defined_at(source)}"
        )
    if own != what:
        policy.sees = what
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


def privileges(seen: Mapping[str, str]) -> str:
    """A sentence about what some policies see, from a key of `SEES` by name; empty if they all see the same."""
    if len(set(seen.values())) < 2:
        return ""
    said = (f"{name} ({SEES.get(what, what)})" for name, what in seen.items())
    return f"Their privileges differ: {', '.join(said)}."
