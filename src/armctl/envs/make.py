"""Makes environments by their ids."""

import inspect
import math
from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.vector import AutoresetMode

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.registration import load_task
from armctl.envs.episodes import EpisodeVectorEnv
from armctl.envs.find import RETURN_BOUNDS, find_spec, is_task, wrap_errors
from armctl.envs.success import OPTIONS, SuccessRule
from armctl.envs.third_party import ThirdPartyTask, ThirdPartyVectorEnv
from armctl.envs.vector import TaskVectorEnv

RESERVED = {
    "autoreset_mode", "flat_infos", "id", "num_envs", "render_mode", "task", "threads", "vector_kwargs",
    "vectorization_mode", "wrappers",
}  # fmt: skip
"""Arguments that callers cannot set as options."""
ONE_WORLD = "name a class or function that makes one world, and armctl makes as many as it needs"
SCORING = {*OPTIONS, "disturbances"}
"""Options for environments of others, which these do not get to see."""


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
        with wrap_errors(spec.id):
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
    disturbances = scoring.pop("disturbances", {})
    others = ThirdPartyVectorEnv(
        lambda: _make_third_party(spec, options, render_mode),
        num_envs,
        success=SuccessRule(**scoring),
        disturbances=disturbances,
    )
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


def _make_third_party(spec: EnvSpec, options: Mapping[str, Any], render_mode: str | None) -> gymnasium.Env[Any, Any]:
    rendering: dict[str, Any] = {} if render_mode is None else {"render_mode": render_mode}
    if spec.entry_point is None:
        raise ConfigurationError(f"{spec.id} makes vector environments only: {ONE_WORLD}")
    with wrap_errors(spec.id):
        _check_options(spec, options)
        try:
            return gymnasium.make(spec, disable_env_checker=True, **rendering, **options)
        except TypeError as error:
            if "must inherit from the gymnasium.Env class" not in str(error):
                raise
            raise ConfigurationError(f"{spec.id} makes no gymnasium.Env: {ONE_WORLD}") from error


def _check_options(spec: EnvSpec, options: Mapping[str, Any]) -> None:
    """Raise `ConfigurationError` for an option that neither the environment's constructor nor Gymnasium takes."""
    steps = options.get("max_episode_steps", 1)
    if type(steps) is not int or steps < 1:
        raise ConfigurationError(f"max_episode_steps is a whole number from 1 on, not {steps!r}")
    maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    parameters = inspect.signature(maker).parameters if maker else {}
    for name in parameters.keys() - {"self", *options, *spec.kwargs}:
        parameter = parameters[name]
        if parameter.default is parameter.empty and parameter.kind is parameter.POSITIONAL_OR_KEYWORD:
            raise ConfigurationError(f"{spec.id} needs its option {name}: --set {name}=VALUE")
    if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return
    allowed = {*parameters, "max_episode_steps", *SCORING, RETURN_BOUNDS} - RESERVED - {"self"}
    for name in options:
        if name not in allowed:
            raise unknown_name(f"option of {spec.id}", name, allowed)
