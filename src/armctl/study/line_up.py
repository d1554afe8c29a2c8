"""Who plays in a suite's tasks, and under which disturbances."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from armctl.agents import read_card
from armctl.core.errors import ArmctlError
from armctl.core.registration import bare_id
from armctl.envs import task_of
from armctl.policies import WorldsByInterface, agent_cards, make_policy, policy_names
from armctl.study.levels import sweep_levels

UNSKILLED = {"random"}
"""Policies that are left out of a suite unless a task has no others."""


@dataclass(frozen=True)
class SuiteSize:
    """How much a suite plays."""

    episodes: int
    """Of each policy in each cell."""
    disturbances: tuple[str, ...]
    """Those that a task has of these, or all of its own if it has none of these."""
    levels: tuple[float, ...]
    """Which of a disturbance's default levels: 0 is the one without effect, 1 the strongest."""


FULL = SuiteSize(50, ("noise", "noise_on_state", "delay", "payload", "friction", "pushes", "mismatch"), (0.5, 1.0))
"""Two levels of each: on two cores, less than an hour."""
QUICK = SuiteSize(20, ("delay", "mismatch"), (0.75,))
"""On two cores, about five minutes."""


def main_disturbances(env: str, size: SuiteSize) -> dict[str, list[float]]:
    """The levels of a task's disturbances in a suite. Raises `ConfigurationError`."""
    possible = sweep_levels(env)
    main = {name: levels for name, levels in possible.items() if name in size.disturbances} or possible
    if "noise_on_state" in main:  # the same noise, which spares nobody
        main.pop("noise", None)
    return {name: sorted({_level(levels, share) for share in size.levels}) for name, levels in main.items()}


def _level(levels: Sequence[float], share: float) -> float:
    """The level at a share of the way from the first, which has no effect, to the last; never the first."""
    return levels[max(1, round(share * (len(levels) - 1)))]


def line_up(env: str) -> tuple[str, ...]:
    """The policies of a task's suite: its default ones, experts that fit, and agents made for it.

    Raises `ConfigurationError`.
    """
    with closing(WorldsByInterface(env, 1)) as worlds:
        names = dict.fromkeys((*default_policies(env), *(name for name in policy_names() if _fits(name, env, worlds))))
    return tuple(name for name in names if name not in UNSKILLED) or tuple(names)


def _fits(name: str, env: str, worlds: WorldsByInterface) -> bool:
    """Whether an installed policy can act in an environment and, if it is an agent, was made for it."""
    try:
        card = getattr(make_policy(name, worlds.of(name)), "card", None)
    except ArmctlError:
        return False
    return card is None or bare_id(card.env) == bare_id(env)


def unusable_agents(env: str) -> dict[str, str]:
    """Why installed agents cannot play the task that they were made for, by name; also those of unreadable cards."""
    told = {}
    with closing(WorldsByInterface(env, 1)) as worlds:
        for name, card in agent_cards().items():
            try:
                if bare_id(read_card(card).env) == bare_id(env):
                    make_policy(name, worlds.of(name))
            except ArmctlError as error:
                told[name] = str(error)
    return told


def default_policies(env: str) -> tuple[str, ...]:
    """The default line-up of an environment, which its task declares."""
    policies: tuple[str, ...] = task_of(env).default_policies
    return policies
