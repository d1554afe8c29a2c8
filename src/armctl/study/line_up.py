"""Line-up of a suite: the policies of each task, and its disturbances."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from armctl.agents import read_card
from armctl.core.errors import FAILURES, ArmctlError, EnvironmentFailed, described
from armctl.core.kinds import Kind, declared_kind
from armctl.core.registration import bare_id, load_installed
from armctl.core.time_limit import time_limit
from armctl.envs import ThirdPartyVectorEnv, chosen_policy_seed, task_of
from armctl.policies import (
    GROUP,
    UNSKILLED,
    ControllersFailed,
    WorldsByInterface,
    agent_cards,
    expanded,
    make_policy,
    policy_names,
)
from armctl.policies.declare import is_made_for
from armctl.policies.policy import PlaysApart
from armctl.rollout.construction import build_timed
from armctl.rollout.loop import environment_limit, wrap_environment_errors
from armctl.runtime.isolation import close
from armctl.study.levels import sweep_levels
from armctl.study.options import StudyOptions


@dataclass(frozen=True)
class SuiteSize:
    """Number of episodes, disturbances and levels of a suite."""

    episodes: int
    """Most episodes of each policy in each cell, which stops when it is decided."""
    disturbances: tuple[str, ...]
    """Those that a task has of these, or all of its own if it has none of these."""
    levels: tuple[float, ...]
    """Shares of the range of default levels: 0 is the level without effect, 1 the strongest."""
    one_of_each_kind: bool = False
    """True if only a task's first classical and its first learned policy play, and no hybrid."""
    undisturbed_episodes: int | None = None
    """The most of the undisturbed cell, which chooses policies and decides the headline; None: as in others."""


FULL = SuiteSize(
    50,
    ("noise", "noise_on_state", "delay", "payload", "friction", "pushes", "mismatch"),
    (0.5, 1.0),
    undisturbed_episodes=200,
)
"""Full suite, two levels of each disturbance."""
QUICK = SuiteSize(100, ("delay",), (0.75,), one_of_each_kind=True)
"""Quick suite.

100 episodes decide in each of ten tasks if one policy alone succeeds in 11 of them. They do not show equivalence within
2 points: if both policies never differ, that takes 316 episodes."""


def main_disturbances(env: str, size: SuiteSize) -> dict[str, list[float]]:
    """Return the levels of a task's disturbances in a suite. Raise `ConfigurationError`."""
    possible = sweep_levels(env)
    main = {name: levels for name, levels in possible.items() if name in size.disturbances} or possible
    if "noise_on_state" in main:  # the same noise, which spares nobody
        main.pop("noise", None)
    return {name: sorted({_level(levels, share) for share in size.levels}) for name, levels in main.items()}


def _level(levels: Sequence[float], share: float) -> float:
    """Return the level at a share of the way from the first, which has no effect, to the last; never the first."""
    return levels[max(1, round(share * (len(levels) - 1)))]


def line_up(env: str, one_of_each_kind: bool = False) -> tuple[str, ...]:
    """Return the policies of a task's suite: its default ones, experts that fit, and agents made for it.

    With `one_of_each_kind`, return only the first expert that is no hybrid, and the first agent. Raises
    `ConfigurationError`.
    """
    with closing(WorldsByInterface(env, 1)) as worlds:
        names = dict.fromkeys((*default_policies(env), *(name for name in policy_names() if _fits(name, env, worlds))))
    skilled = [name for name in names if name not in UNSKILLED] or list(names)
    if not one_of_each_kind:
        return tuple(skilled)
    kinds = {name: "learned" if name in agent_cards() else _declared_kind(name) for name in skilled}
    first = {kinds[name]: name for name in reversed(skilled) if kinds[name] != "hybrid"}
    return tuple(name for name in skilled if name in first.values())


def _declared_kind(name: str) -> Kind:
    return declared_kind(load_installed(GROUP, name, "policy")) or "classical"


def _fits(name: str, env: str, worlds: WorldsByInterface) -> bool:
    """Return True if an installed policy can act in an environment and, if it is an agent, was made for it.

    In an environment of others, also if it is an expert.
    """
    envs, *_ = getattr(load_installed(GROUP, name, "policy"), "made_for", ("*",))
    if isinstance(worlds.requested, ThirdPartyVectorEnv) and not is_made_for(env, envs):
        return False
    try:
        card = getattr(make_policy(name, worlds.of(name)), "card", None)
    except ArmctlError:
        return False
    return card is None or bare_id(card.env) == bare_id(env)


def fitting(policies: Mapping[str, Any], env: str, options: StudyOptions) -> tuple[dict[str, Any], dict[str, str]]:
    """Return those of some policies that can act in an environment, by name, and why the others cannot.

    Each decides the first control step of an episode, in a world of its own. Raises `ConfigurationError`, and
    `EnvironmentFailed`.
    """
    usable, reasons = dict[str, Any](), dict[str, str]()
    for name, policy in policies.items():
        players, _ = expanded({name: policy})
        misfits = (_misfit(player, label, env, options) for label, player in players.items())
        if (why := next(filter(None, misfits), None)) is None:
            usable[name] = policy
        else:
            reasons[name] = why
    return usable, reasons


def _misfit(policy: Any, name: str, env: str, options: StudyOptions) -> str | None:
    """Return why a policy cannot make a control step in an environment; None if it can."""
    actors = []
    with closing(WorldsByInterface(env, 1)) as interfaces:
        try:
            worlds, secret = interfaces.of(policy), chosen_policy_seed(None)
            actor, _ = build_timed(policy, worlds, name, secret, options.get("isolate", False), options.get("timeout"))
            actors.append(actor)
            timeout = options.get("timeout")
            limit = None if isinstance(actor, PlaysApart) else timeout
            with wrap_environment_errors("a trial", 0, environment_limit(worlds, timeout)):
                observations, _ = worlds.reset(seed=0)
            with time_limit(limit, "its first decision"):
                actor.reset(np.zeros(1, np.int32))
                action = actor.act(observations)
            worlds.step(action)
        except EnvironmentFailed:
            raise
        except FAILURES as error:
            cause = error.first if isinstance(error, ControllersFailed) else error
            return str(cause) if isinstance(cause, ArmctlError) else described(cause)
        finally:
            close(actors)
    return None


def unusable_agents(env: str) -> dict[str, str]:
    """Return why installed agents cannot play the task that they were made for, by name; unreadable cards included."""
    reasons = {}
    with closing(WorldsByInterface(env, 1)) as worlds:
        for name, card in agent_cards().items():
            try:
                if bare_id(read_card(card).env) == bare_id(env):
                    make_policy(name, worlds.of(name))
            except ArmctlError as error:
                reasons[name] = str(error)
    return reasons


def default_policies(env: str) -> tuple[str, ...]:
    """Return the default line-up of an environment, which its task declares."""
    policies: tuple[str, ...] = task_of(env).default_policies
    return policies
