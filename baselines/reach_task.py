"""What the reach experts share: the check that an environment is one that they can work in."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.tasks import ReachTask

Task = TypeVar("Task", bound=ReachTask)


def checked_task(
    name: str, env: TaskVectorEnv, task: type[Task], env_id: str, observation: Iterable[str], controls: Sequence[str]
) -> Task:
    """The task of `env`; raises `ConfigurationError` unless it suits the expert called `name`.

    It has to be a `task`, whose observation begins with the parts `observation`, with one of `controls`.
    """
    if not isinstance(env.task, task):
        raise ConfigurationError(f"{name} cannot play this task: use it with {env_id}")
    options, expected = env.task.options, list(observation)
    if (found := list(options.observation))[: len(expected)] != expected:
        raise ConfigurationError(f"{name} reads the observation {', '.join(expected)}, not {', '.join(found)}")
    if options.control not in controls:
        raise ConfigurationError(f"{name} needs control {' or '.join(map(repr, controls))}, not {options.control!r}")
    return env.task
