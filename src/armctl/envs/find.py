"""Environments by their ids, found without loading a simulator."""

import functools
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator

from armctl.core.declarations import class_value, field_names
from armctl.core.errors import (
    FAILURES,
    ArmctlError,
    ConfigurationError,
    UnknownOption,
    described,
    nearest,
    unknown_name,
)
from armctl.core.registration import (
    VECTOR_ENV,
    check_named,
    environment_names,
    import_named,
    importable_from,
    own_names,
    remember_named,
    was_named,
)
from armctl.envs.environment_options import NAMES
from armctl.remote.names import is_remote

RETURN_BOUNDS = "return_bounds"
"""The option of any environment with its least and largest possible return, which it does not get to see."""


def full_id(env: Any) -> str:
    """Return an environment's id with its namespace, after the module or file in `env`, if any."""
    module, colon, _ = _as_text(env).rpartition(":")
    return f"{module}{colon}{find_spec(env).id}"


def is_task(spec: EnvSpec) -> bool:
    """Return True if an environment is made of a task."""
    return spec.vector_entry_point == VECTOR_ENV


def find_spec(env: Any) -> EnvSpec:
    """Return Gymnasium's specification of an environment.

    `env` is an id (`armctl/ArmReach-v0`, `Pendulum-v1`), an id whose namespace is left out (`ArmReach-v0`), or
    either after the module that registers it, or its file (`mine:mine/Hover-v0`, `mine.py:Hover-v0`). After the module,
    a class or function that makes the environment may be named too (`mine.py:Maze`); Python code can pass it itself.

    Raises `ConfigurationError`.
    """
    env = _as_text(env)
    module, _, name = env.rpartition(":")
    if not module:
        return _registered(name, env, None)
    if is_remote(env):
        from armctl.envs.remote import RemoteEnv  # it needs the extra `remote`

        remember_named(env)
        return EnvSpec(id=name, entry_point=functools.partial(RemoteEnv, env))
    loaded = import_named(module, f"the environment {env!r}")
    maker = getattr(loaded, name, None)
    if isinstance(maker, (gymnasium.Env, gymnasium.vector.VectorEnv)):
        raise ConfigurationError(f"{env} is an environment, and armctl makes its own: name the class or function")
    is_id = name in gymnasium.registry or not callable(maker)
    spec = _registered(name, env, loaded) if is_id else EnvSpec(id=name, entry_point=maker)
    if isinstance(spec.entry_point, str):
        with wrap_errors(env), importable_from(Path(module).parent if module.endswith(".py") else Path.cwd()):
            load_env_creator(spec.entry_point)
    remember_named(env, f"{module}:{spec.id}")
    return spec


def maker_in_script(env: str) -> Any:
    """Return the class or function of the script itself that `env` names, which other processes cannot import.

    None for any other environment.
    """
    module, _, name = env.rpartition(":")
    return getattr(sys.modules["__main__"], name, None) if module == "__main__" else None


def check_option_names(env: str, names: Iterable[str]) -> None:
    """Check names of options as far as a task's source tells them, before the task is loaded.

    Raises `UnknownOption`.
    """
    task = find_spec(env).kwargs.get("task") if ":" not in env else None
    options_type = class_value(task, "options_type") if isinstance(task, str) else None
    if options_type is not None:
        allowed = [*field_names(options_type), *NAMES, RETURN_BOUNDS]
        for name in names:
            if name not in allowed:
                raise UnknownOption(str(unknown_name("option", name, allowed)))


def check_from_file(env: str, options: Mapping[str, Any], source: str) -> None:
    """Check an environment that a file names. Raises `ConfigurationError` if it is code that the user has not named.

    Texts among the options of an environment of others may be paths, so that has to be named too.
    """
    check_named(env, source, "--env")
    texts = [name for name, value in options.items() if isinstance(value, str)]
    if texts and not was_named(env) and not is_task(find_spec(env)):
        raise ConfigurationError(
            f"{source} gives {env} the text {texts[0]}, which may be a path: if you trust it, name the environment "
            f"yourself, --env {shlex.quote(env)}"
        )


def _registered(name: str, env: str, loaded: ModuleType | None) -> EnvSpec:
    if name in gymnasium.registry:
        return gymnasium.spec(name)
    full = [id_ for id_ in gymnasium.registry if id_.partition("/")[2] == name]
    if len(full) == 1:
        return gymnasium.spec(full[0])
    raise ConfigurationError(f"there is no environment {env!r}.{_hint(name, loaded)}")


def _as_text(env: Any) -> str:
    """Return the id of an environment, or `module:NAME` of a class or function that makes one."""
    if isinstance(env, str):
        return env
    name = getattr(env, "__qualname__", "")
    if callable(env) and name.isidentifier() and name in vars(sys.modules[env.__module__]):
        return f"{env.__module__}:{name}"
    raise ConfigurationError(
        f"an environment is an id, 'file.py:NAME', or a class or function at the top of a module that makes it, not "
        f"{env!r}: gymnasium.register gives it an id"
    )


def _hint(name: str, loaded: ModuleType | None) -> str:
    if loaded is not None:
        definitions = own_names(loaded)
        return f"{nearest(name, definitions)} In {loaded.__name__} there are: {', '.join(definitions) or 'none'}"
    if name.endswith(".py"):
        return f" Name what makes it in that file: {name}:NAME"
    if "." in name and all(part.isidentifier() for part in name.split(".")):
        return f" A class or function stands after a colon: {':'.join(name.rsplit('.', 1))}"
    tasks = environment_names()
    near = next(filter(None, (nearest(name, [*ids, *map(_short, ids)]) for ids in (tasks, gymnasium.registry))), "")
    return (
        f"{near} There are: {', '.join(tasks)}, those that "
        "Gymnasium knows, such as Pendulum-v1, and yours: file.py:NAME"
    )


def _short(env_id: str) -> str:
    return env_id.rpartition("/")[2]


@contextmanager
def wrap_errors(name: str) -> Iterator[None]:
    """Turn any error of an environment of others into `ConfigurationError`, with its place."""
    try:
        yield
    except ArmctlError:
        raise
    except FAILURES as error:
        raise ConfigurationError(f"{name} could not be made: {described(error)}") from error
