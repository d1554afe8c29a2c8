"""Completions by Tab, after `armctl --install-completion`: names that are found without loading a simulator."""

from collections.abc import Iterable

from typer import Context

from armctl import DEFAULT_ENV
from armctl.core.registration import environment_names, files_beside, files_within, installed
from armctl.robot_description.builtin import BUILTIN_ARMS


def _starting(names: Iterable[str], incomplete: str) -> list[str]:
    return sorted(name for name in names if name.startswith(incomplete))


def environments(incomplete: str) -> list[str]:
    """Ids of environments."""
    return _starting(environment_names(), incomplete)


def policies(incomplete: str) -> list[str]:
    """Names of policies. Shells complete the paths of files by themselves."""
    return _starting(installed("armctl.policies").names, incomplete)


def agents(incomplete: str) -> list[str]:
    """Names of learned agents: policies with a card beside their module."""
    return _starting(files_beside("armctl.policies", ".json"), incomplete)


def recipes(incomplete: str) -> list[str]:
    """Names of recipes and learners."""
    return _starting({*files_within("armctl.recipes", ".toml"), *installed("armctl.learners").names}, incomplete)


def tunable(incomplete: str) -> list[str]:
    """Names of recipes, and of policies with a file of options beside their module."""
    return _starting({*recipes(incomplete), *files_beside("armctl.policies", ".toml")}, incomplete)


def trackers(incomplete: str) -> list[str]:
    """Names of experiment trackers."""
    return _starting(installed("armctl.trackers").names, incomplete)


def robots(incomplete: str) -> list[str]:
    """Names of robots. Shells complete the paths of files by themselves."""
    return _starting(BUILTIN_ARMS, incomplete)


def environment_options(context: Context, incomplete: str) -> list[str]:
    """Options of the environment on the command line, `NAME=`, and then the values of one, if they are few."""
    from armctl.envs.describe import describe_options  # loads the task: half a second, but only here

    options = {option.name: option for option in describe_options(context.params.get("env") or DEFAULT_ENV)}
    name, equals, _ = incomplete.partition("=")
    if not equals:
        return _starting((f"{option}=" for option in options), incomplete)
    kind = options[name].type if name in options else ""
    values = list(BUILTIN_ARMS) if name == "robot" else ["True", "False"] if kind == "bool" else kind.split(" | ")
    return _starting((f"{name}={value}" for value in values if value.isidentifier()), incomplete)


def disturbances(incomplete: str) -> list[str]:
    """Names of disturbances."""
    from armctl.disturbances import ARM, ROVER  # loads MuJoCo: a second, but only here

    return _starting({*ARM, *ROVER}, incomplete)
