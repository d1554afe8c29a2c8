"""Names of policies, known without loading any."""

import inspect
import os.path
import re
from pathlib import Path
from typing import Any

from armctl.agents import CARD
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.registration import files_beside, installed, load_installed
from armctl.policies.declare import declared

GROUP = "armctl.policies"
"""Entry-point group under which a package offers policies."""
UNSKILLED = {"random"}
"""Policies that are only a lower bound: no part of a suite unless a task has no others, nor of a Pareto front."""
FORMS = (".json", ".onnx", ".toml", ".zip")
"""Endings of the names of agents, options and models."""
TRAINING = re.compile(r"(?P<recipe>.+)\[(?P<seed>\*|\d{1,18})\]")
"""Form of the names of one training of a recipe, and of all."""
FILTERED = re.compile(r"filtered\((?P<policy>.*)\)(?::(?P<options>.*))?", re.DOTALL)
"""Form of the names of policies behind the safety filter (see `armctl.policies.filtered`), with its options."""


def policy_names() -> list[str]:
    """Return the names of all installed policies."""
    return sorted(installed(GROUP).names)


def describe_policy(name: str) -> str:
    """Return the first line of the docstring of an installed policy's factory."""
    return (inspect.getdoc(load_installed(GROUP, name, "policy")) or "").partition("\n")[0]


def declared_sees(name: str) -> str:
    """Return what an installed policy declares to see: a key of `armctl.envs.SEES`."""
    return declared(load_installed(GROUP, name, "policy"))


def agent_cards() -> dict[str, Path]:
    """Return the cards of installed agents, by name."""
    return files_beside(GROUP, ".json")


def with_agent(name: str) -> str:
    """Return the path of the agent in the folder `name`, as `armctl train` makes it; any other name as it is."""
    return os.path.join(name, CARD) if name not in policy_names() and os.path.isfile(os.path.join(name, CARD)) else name


def without_filter(policy: Any) -> Any:
    """Return the policy that is behind the safety filter, by its name; any other policy as it is."""
    match = FILTERED.fullmatch(policy) if isinstance(policy, str) else None
    return policy if match is None else match["policy"]


def check_policy_name(name: str) -> None:
    """Raise `ConfigurationError` for a name that has no form of a policy's."""
    if (inner := without_filter(name)) != name:
        if without_filter(inner) != inner or inner.endswith("[*]"):
            raise ConfigurationError(f"the safety filter takes one policy, filtered(NAME) or filtered(NAME[0]): {name}")
        name = inner
    elif name.startswith("filtered("):
        raise ConfigurationError(
            f"{name} is read as a policy behind the safety filter, filtered(POLICY) or "
            "filtered(POLICY):OPTION=VALUE,OPTION=VALUE"
        )
    if name.endswith(".py"):
        raise ConfigurationError(f"there is no policy {name!r}. Name a function or class in that file: {name}:NAME")
    if not (name in policy_names() or ":" in name or name.endswith(FORMS) or TRAINING.fullmatch(name)):
        raise unknown_name(
            "policy", name, [*policy_names(), "path/to/agent.json", "path/to/options.toml", "file.py:NAME"]
        )
