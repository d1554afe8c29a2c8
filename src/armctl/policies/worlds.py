"""Worlds in which policies with different interfaces meet the same episodes.

How a policy sees and commands the robot is its own affair (`Task.interface_options`): a learned agent plays with the
interface that it was trained with, which its card names, and an installed expert with what it declares (`made_for`) and
else the task's own, except for a requested `control` and named parts of the observation. Everything else plays with the
requested one.
"""

from collections.abc import Mapping
from contextlib import closing
from typing import Any

from armctl.core.registration import bare_id
from armctl.disturbances import available
from armctl.envs import EpisodeVectorEnv, make_worlds, task_of
from armctl.policies.declare import unwrapped
from armctl.policies.find import is_expert, loaded
from armctl.policies.policy import Policy
from armctl.policies.privilege import channels_read
from armctl.policies.trainings import card_of
from armctl.remote.names import is_remote

LEARNERS_ONLY = frozenset({"reward_scale", "reward_weights"})


class WorldsByInterface:
    """Vector environments of one task, one for each interface.

    Returns are the task's: `LEARNERS_ONLY` are left out. Raises `ConfigurationError` as `make_worlds` does.
    """

    left_out = LEARNERS_ONLY
    """Options that these worlds do not have."""

    def __init__(
        self, env: str, num_envs: int, options: Mapping[str, Any] | None = None, threads: int = 0, **how: Any
    ) -> None:
        self._env, self._interface = env, frozenset(task_of(env).interface_options)
        self._arguments: dict[str, Any] = {"num_envs": num_envs, "threads": threads, **how}
        self._options = {name: value for name, value in (options or {}).items() if name not in self.left_out}
        self.requested: EpisodeVectorEnv = make_worlds(env, options=self._options, **self._arguments)
        """Environment with the requested interface."""
        self._envs = [(self._options, self.requested)]
        self._remote_options: dict[str, dict[str, Any]] = {}

    def of(self, policy: Any) -> EpisodeVectorEnv:
        """Return the worlds in which a policy plays, of any of the forms that `make_policy` takes."""
        options = self.options_of(policy)
        for made_for, worlds in self._envs:
            if made_for == options:
                return worlds
        applicable = self._applicable_options(options)
        self._envs.append((options, make_worlds(self._env, options=applicable, **self._arguments)))
        return self._envs[-1][1]

    def options_of(self, policy: Any) -> dict[str, Any]:
        """Return the environment's options for a policy."""
        card = card_of(policy)
        others = {name: value for name, value in self._options.items() if name not in self._interface}
        if card is not None and bare_id(card.env) == bare_id(self._env):
            names = self._interface - LEARNERS_ONLY
            return others | {name: value for name, value in card.env_options.items() if name in names}
        if card is None and is_expert(policy):
            kept = {name: value for name, value in self._options.items() if _is_for_experts(name, value)}
            declared: dict[str, Any] = getattr(unwrapped(loaded(policy)), "interface", {})
            return others | {name: value for name, value in declared.items() if name in self._interface} | kept
        if card is None and is_remote(policy):
            return others | self._options_for_remote(policy)
        return self._options

    def spared(self, policy: Any, built: Policy) -> tuple[str, ...]:
        """Return the disturbances that do not reach a policy.

        They change what is not in its interface, or what it does not read.
        `built` is the policy as made for `of(policy)`. Raises `ConfigurationError` if it reads an unknown channel.
        """
        effective, reads = self.of(policy).disturbances, channels_read(built)
        names = self.requested.disturbances
        return tuple(name for name in names if name not in effective or not effective[name].reaches(reads))

    def _options_for_remote(self, remote: str) -> dict[str, Any]:
        """Return the options of the interface that a policy in another process asks for; it is asked only once."""
        if remote not in self._remote_options:
            from armctl.policies.remote import interface_options  # it needs the extra `remote`

            options = interface_options(remote)
            self._remote_options[remote] = {name: value for name, value in options.items() if name in self._interface}
        return self._remote_options[remote]

    def _applicable_options(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options without disturbances of what this interface lacks: who gets no image loses none."""
        if not (levels := options.get("disturbances")):
            return options
        undisturbed = {name: value for name, value in options.items() if name != "disturbances"}
        with closing(make_worlds(self._env, options=undisturbed, **self._arguments | {"num_envs": 1})) as plain:
            effective = available(plain.task.disturbances, plain.task)
        return undisturbed | {"disturbances": {name: level for name, level in levels.items() if name in effective}}

    def close(self) -> None:
        """Close all of them."""
        for _, worlds in self._envs:
            worlds.close()


def _is_for_experts(name: str, value: Any) -> bool:
    return name == "control" or (name == "observation" and not isinstance(value, str))
