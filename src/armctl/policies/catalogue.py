"""Installed policies and tasks as `armctl list` shows them, from cards and declarations: no simulator is loaded."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import EnvSpec

from armctl.agents import read_card
from armctl.core.declarations import declaration
from armctl.core.errors import FAILURES, AgentFileError
from armctl.core.foresight import FORESIGHT
from armctl.core.registration import installed, load_task
from armctl.envs.find import is_task
from armctl.policies.declare import is_made_for
from armctl.policies.names import GROUP, agent_cards, declared_sees, describe_policy, policy_names

SHORT = {"observation": "observation", "model": "robot model", "map": "map", "state": "true state"}
"""Privileges in a narrow column."""


@dataclass(frozen=True)
class ListedPolicy:
    """A policy as it is listed."""

    name: str
    summary: str
    kind: str
    """`expert`, `hybrid`, `baseline`, or `agent` with the kind of its learning."""
    sees: str = "unknown"
    foresight: tuple[str, ...] = ()
    controls: str = "unknown"
    """Robots, and how they are commanded."""
    envs: str = "*"
    """Pattern of the ids of the environments for which it is made."""


def listed_policies() -> list[ListedPolicy]:
    """Return all installed policies, by name."""
    cards = agent_cards()
    return [_agent(name, cards[name]) if name in cards else _expert(name) for name in policy_names()]


def _agent(name: str, path: Path) -> ListedPolicy:
    try:
        card = read_card(path)
    except AgentFileError as error:
        return ListedPolicy(name, str(error), "agent")
    privilege = "camera" if "camera" in card.interface else SHORT[declared_sees(name)]
    controls = ": ".join(card.interface[key] for key in ("robot", "control") if key in card.interface)
    kind = f"agent, {card.family or card.learner}"
    return ListedPolicy(name, describe_policy(name), kind, privilege, (), controls, card.env)


def _expert(name: str) -> ListedPolicy:
    declared = declaration(installed(GROUP)[name].value)
    if declared is None:  # made by code that has to run
        with contextlib.suppress(*FAILURES):
            return ListedPolicy(name, describe_policy(name), "expert", SHORT[declared_sees(name)])
        return ListedPolicy(name, "cannot be loaded", "expert")
    (privilege,), more = declared.decorators.get("sees", ([declared.values.get("sees", "observation")], {}))
    foresight = more.get("foresight", declared.values.get("foresight", ()))
    foresight = (foresight,) if isinstance(foresight, str) else tuple(foresight)
    (envs,), made_for = declared.decorators.get("made_for", (["*"], {}))
    kind = "baseline" if envs == "*" else more.get("kind", declared.values.get("kind", "expert"))
    controls = made_for.get("controls", "any")
    return ListedPolicy(name, declared.summary, kind, SHORT.get(privilege, privilege), foresight, controls, envs)


def privilege_in(spec: EnvSpec, policy: ListedPolicy) -> str:
    """Return what a policy sees, and foresees of what changes by itself in an environment."""
    foresight = (name for name in policy.foresight if name in task_values(spec).get("foresight", ()))
    return " + ".join([policy.sees, *(FORESIGHT[name] for name in foresight)])


def policies_of(spec: EnvSpec, policies: Sequence[ListedPolicy]) -> list[ListedPolicy]:
    """Return the policies that are made for an environment, those of its default line-up first."""
    order = {name: place for place, name in enumerate(task_values(spec).get("default_policies", ()))}
    fitting = [policy for policy in policies if is_made_for(spec.id, policy.envs)]
    return sorted(fitting, key=lambda policy: order.get(policy.name, len(order)))


def task_values(spec: EnvSpec) -> Mapping[str, Any]:
    """Return what an environment's task declares in its class, such as `instruction` and `default_policies`.

    Raises `ConfigurationError` for a task that can neither be read nor loaded.
    """
    if not is_task(spec):
        return {}
    task = spec.kwargs["task"]
    declared = declaration(task) if isinstance(task, str) else None
    return vars(load_task(task)) if declared is None else declared.values
