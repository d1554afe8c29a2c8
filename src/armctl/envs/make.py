"""Makes environments by their ids."""

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode

from armctl.envs.vector import TaskVectorEnv
from armctl.errors import ConfigurationError, unknown_name
from armctl.registration import add_cwd_to_path, environment_names, load_task
from armctl.tasks import Task

RESERVED = {"num_envs", "autoreset_mode", "render_mode", "threads", "task"}
"""Arguments that callers cannot set as options."""


def make_worlds(
    env: str,
    worlds: int,
    options: Mapping[str, Any] | None = None,
    threads: int = 0,
    autoreset_mode: AutoresetMode | str = AutoresetMode.DISABLED,
) -> TaskVectorEnv:
    """A vector environment of `worlds` worlds, stepped on `threads` threads (0: all cores).

    By default there is no autoreset: worlds stand still after an episode. `module:Name-v0` is an environment that the
    module registers. Raises `ConfigurationError`.
    """
    if reserved := RESERVED & set(options or {}):
        raise ConfigurationError(f"{reserved.pop()} cannot be set as an option: armctl sets it itself")
    spec = find_spec(env)
    made = gymnasium.make_vec(spec, num_envs=worlds, autoreset_mode=autoreset_mode, threads=threads, **(options or {}))
    assert isinstance(made, TaskVectorEnv)
    return made


def task_of(env: str) -> type[Task]:
    """The task class of an environment; raises `ConfigurationError`."""
    return load_task(find_spec(env).kwargs["task"])


def find_spec(env: str) -> Any:
    """Gymnasium's specification of a task's environment. The module in `module:Name-v0` is imported first.

    Raises `ConfigurationError`.
    """
    module, _, name = env.rpartition(":")
    try:
        if module:
            add_cwd_to_path()
            __import__(module)
    except Exception as error:  # a third-party module may raise anything
        raise ConfigurationError(f"no environment {env!r}: {type(error).__name__}: {error}") from error
    if name not in gymnasium.registry:
        raise unknown_name("environment", name, environment_names())
    spec = gymnasium.spec(name)
    if name not in environment_names():
        raise ConfigurationError(f"{env} is not one of armctl's environments: {', '.join(environment_names())}")
    return spec
