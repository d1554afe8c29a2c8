"""Privileges as they are granted: a policy gets what it declares to see."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from armctl.core.errors import ConfigurationError, defined_at, unknown_name
from armctl.core.foresight import check_declared, how_to_declare
from armctl.core.kinds import declared_kind
from armctl.envs import SEES, EpisodeVectorEnv, Interface, PolicyStreams, interface_of
from armctl.policies.declare import declared, declared_foresight, unwrapped

PERCEIVED = ("observation", "state")
"""Through which of a disturbance's channels policies perceive their worlds."""


def knowledge_for(
    source: Any, env: EpisodeVectorEnv | Interface, name: str, streams: PolicyStreams
) -> EpisodeVectorEnv | Interface:
    """Return what the policy of this `source`, called `name`, gets of an environment.

    That is an interface, or all of the environment for a policy that declares to see the state.

    Its random numbers are those of `streams`, or of the policy that makes it.

    Raises `ConfigurationError` if it is made by another policy, in whose interface there is less.
    """
    privilege, foresight = declared(source), declared_foresight(source)
    if isinstance(env, Interface):
        return env.limited_to(privilege, foresight, name)
    if env.task.granted is not None:  # a policy is being made that sees the state, and makes this one
        for more in foresight:
            check_declared(more, "state", env.task.granted)
    return env if privilege == "state" else interface_of(env, privilege, streams, foresight)


@contextmanager
def granting(source: Any, env: EpisodeVectorEnv | Interface) -> Iterator[None]:
    """Let an environment tell of the future, while a policy is made, what this `source` declares to foresee."""
    if isinstance(env, Interface):
        yield
        return
    previous, env.task.granted = env.task.granted, declared_foresight(source)
    try:
        yield
    finally:
        env.task.granted = previous


def as_declared(policy: Any, name: str, source: Any) -> Any:
    """Return a policy that was made of a source, and says itself what that declares.

    Raises `ConfigurationError` if it says that it sees or foresees more.
    """
    privilege, foresight = declared(source), declared_foresight(source)
    declaration = declared(policy)
    if list(SEES).index(declaration) > list(SEES).index(privilege):
        raise ConfigurationError(
            f"{name} made a policy that sees the {SEES[declaration]}, which has to be declared before it is made: "
            f"{how_to_declare(declaration)}{defined_at(source)}"
        )
    for more in declared_foresight(policy):
        check_declared(more, privilege, foresight)
    if declaration != privilege:
        policy.sees = privilege
    if foresight:
        policy.foresight = foresight
    if (family := getattr(unwrapped(source), "family", None)) is not None:
        policy.family = family
    if (kind := declared_kind(unwrapped(source))) is not None:
        policy.kind = kind
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
