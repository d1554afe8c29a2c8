"""Makes environments by their ids."""

import inspect
import math
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.vector import AutoresetMode

from armctl.core.errors import FAILURES, ArmctlError, ConfigurationError, described, nearest, unknown_name
from armctl.core.registration import (
    VECTOR_ENV,
    check_named,
    environment_names,
    import_named,
    importable_from,
    load_task,
    own_names,
    remember_named,
    was_named,
)
from armctl.envs.episodes import EpisodeVectorEnv
from armctl.envs.third_party import ThirdPartyTask, ThirdPartyVectorEnv
from armctl.envs.vector import TaskVectorEnv

RESERVED = {
    "autoreset_mode", "flat_infos", "id", "num_envs", "render_mode", "task", "threads", "vector_kwargs",
    "vectorization_mode", "wrappers",
}  # fmt: skip
"""Arguments that callers cannot set as options."""
SCORING = {"success_return", "disturbances"}
"""Options for environments of others, which these do not get to see."""
RETURN_BOUNDS = "return_bounds"
"""The option of any environment with its least and largest possible return, which it does not get to see."""


def make_worlds(
    env: str,
    num_envs: int,
    options: Mapping[str, Any] | None = None,
    threads: int = 0,
    autoreset_mode: AutoresetMode | str = AutoresetMode.DISABLED,
    render_mode: str | None = None,
) -> EpisodeVectorEnv:
    """Return a vector environment of `num_envs` worlds; see `find_spec` for the forms of `env`.

    By default there is no autoreset: worlds stand still after an episode. Environments made of tasks step their worlds
    on `threads` threads (0: all cores), those of others one by one. Raises `ConfigurationError`.
    """
    options = dict(options or {})
    if reserved := RESERVED & set(options):
        raise ConfigurationError(f"{reserved.pop()} cannot be set as an option: armctl sets it itself")
    stated = None if (bounds := options.pop(RETURN_BOUNDS, None)) is None else _checked_return_bounds(bounds)
    spec = find_spec(env)
    if is_task(spec):
        vector: dict[str, Any] = {
            "num_envs": num_envs,
            "autoreset_mode": autoreset_mode,
            "threads": threads,
            "render_mode": render_mode,
        }
        with _wrap_errors(spec.id):
            vec_env: Any = gymnasium.make_vec(spec, **vector, **options)
        assert isinstance(vec_env, TaskVectorEnv)
        vec_env.stated_return_bounds = stated
        return vec_env
    if autoreset_mode is not AutoresetMode.DISABLED:
        raise ConfigurationError(
            f"{env} is not made of a task, and armctl trains in such environments only: train in it with a library "
            "such as Stable-Baselines3, and make an agent of its model with `armctl export`"
        )
    scoring = {name: options.pop(name) for name in SCORING & set(options)}
    if not isinstance(scoring.get("success_return", 0.0), (int, float)):
        raise ConfigurationError(f"success_return is a number, not {scoring['success_return']!r}")
    others = ThirdPartyVectorEnv(lambda: _make_third_party(spec, options, render_mode), num_envs, **scoring)
    others.stated_return_bounds = stated
    return others


def _checked_return_bounds(bounds: Any) -> tuple[float, float]:
    values = bounds if isinstance(bounds, (tuple, list)) else []
    numbers = [float(value) for value in values if isinstance(value, (int, float))]
    if len(numbers) != 2 or len(bounds) != 2 or not -math.inf < numbers[0] < numbers[1] < math.inf:
        raise ConfigurationError(
            f"{RETURN_BOUNDS} are the least and the largest possible return, two finite numbers such as (-200, 0), not "
            f"{bounds!r}"
        )
    return numbers[0], numbers[1]


def task_of(env: str) -> type[Any]:
    """Return the task class of an environment, or what stands for it; raises `ConfigurationError`."""
    spec = find_spec(env)
    return load_task(spec.kwargs["task"]) if is_task(spec) else ThirdPartyTask


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
    loaded = import_named(module, f"the environment {env!r}")
    maker = getattr(loaded, name, None)
    is_id = name in gymnasium.registry or not callable(maker)
    spec = _registered(name, env, loaded) if is_id else EnvSpec(id=name, entry_point=maker)
    if isinstance(spec.entry_point, str):
        with _wrap_errors(env), importable_from(Path(module).parent if module.endswith(".py") else Path.cwd()):
            load_env_creator(spec.entry_point)
    remember_named(env, f"{module}:{spec.id}")
    return spec


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
    short = [id_.rpartition("/")[2] for id_ in gymnasium.registry]
    return (
        f"{nearest(name, [*gymnasium.registry, *short])} There are: {', '.join(environment_names())}, those that "
        "Gymnasium knows, such as Pendulum-v1, and yours: file.py:NAME"
    )


def _make_third_party(spec: EnvSpec, options: Mapping[str, Any], render_mode: str | None) -> gymnasium.Env[Any, Any]:
    rendering: dict[str, Any] = {} if render_mode is None else {"render_mode": render_mode}
    with _wrap_errors(spec.id):
        _check_options(spec, options)
        return gymnasium.make(spec, disable_env_checker=True, **rendering, **options)


@contextmanager
def _wrap_errors(name: str) -> Iterator[None]:
    """Turn any error of an environment of others into `ConfigurationError`, with its place."""
    try:
        yield
    except ArmctlError:
        raise
    except FAILURES as error:
        raise ConfigurationError(f"{name} could not be made: {described(error)}") from error


def _check_options(spec: EnvSpec, options: Mapping[str, Any]) -> None:
    """Raise `ConfigurationError` for an option that neither the environment's constructor nor Gymnasium takes."""
    steps = options.get("max_episode_steps", 1)
    if type(steps) is not int or steps < 1:
        raise ConfigurationError(f"max_episode_steps is a whole number from 1 on, not {steps!r}")
    maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    parameters = inspect.signature(maker).parameters if maker else {}
    if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return
    allowed = {*parameters, "max_episode_steps", *SCORING, RETURN_BOUNDS} - RESERVED - {"self"}
    for name in options:
        if name not in allowed:
            raise unknown_name(f"option of {spec.id}", name, allowed)
