"""Check of the reach experts that an environment is one that they can work in."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from armctl.core.errors import ConfigurationError
from armctl.envs import ModelInterface
from armctl.tasks import ReachOptions

Options = TypeVar("Options", bound=ReachOptions)


def checked_options(
    name: str,
    env: ModelInterface,
    options: type[Options],
    env_id: str,
    observation: Iterable[str],
    controls: Sequence[str],
) -> Options:
    """Return the task's options; raises `ConfigurationError` unless the task suits the expert called `name`.

    It has to be one with `options`, whose observation begins with the parts `observation`, with one of `controls`.
    """
    if not isinstance(env.options, options):
        raise ConfigurationError(f"{name} cannot play this task: use it with {env_id}")
    expected = list(observation)
    if (parts := list(env.options.parts))[: len(expected)] != expected or env.options.goal:
        raise ConfigurationError(f"{name} reads the observation {', '.join(expected)}, not {', '.join(parts)}")
    if env.options.control not in controls:
        allowed = " or ".join(map(repr, controls))
        raise ConfigurationError(f"{name} needs control {allowed}, not {env.options.control!r}")
    return env.options
