"""Worlds in which policies with different interfaces meet the same episodes.

How a policy sees and commands the robot is its own affair (`Task.interface_options`): a learned agent plays with the
interface that it was trained with, which its card names, and any policy with what it declares (`armctl.interface`) and
else the requested one. An installed expert plays with what it is usually made for (`made_for`) and else the task's own,
except for a requested `control` and named parts of the observation.
"""

from collections.abc import Mapping
from contextlib import closing
from typing import Any

from armctl.core.errors import ConfigurationError
from armctl.core.registration import bare_id
from armctl.disturbances import available
from armctl.envs import SEES, EpisodeVectorEnv, interface_values, make_worlds, task_of
from armctl.policies.declare import FRAMES, unwrapped
from armctl.policies.find import is_expert, loaded, policy_name
from armctl.policies.interfaces import check_option, declared_interface
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
        self._remote_interfaces: dict[str, tuple[dict[str, Any], bool]] = {}

    def of(self, policy: Any) -> EpisodeVectorEnv:
        """Return the worlds in which a policy plays, of any of the forms that `make_policy` takes."""
        options = self.options_of(policy)
        for made_for, worlds in self._envs:
            if made_for == options:
                return worlds
        try:
            worlds = make_worlds(self._env, options=self._applicable_options(options), **self._arguments)
        except ConfigurationError as error:
            raise ConfigurationError(f"{policy_name(policy)} is made for another interface: {error}") from error
        self._envs.append((options, worlds))
        return worlds

    def options_of(self, policy: Any) -> dict[str, Any]:
        """Return the environment's options for a policy."""
        card = card_of(policy)
        others = {name: value for name, value in self._options.items() if name not in self._interface}
        if card is not None and bare_id(card.env) == bare_id(self._env):
            names = self._interface - LEARNERS_ONLY
            return others | {name: value for name, value in card.env_options.items() if name in names}
        if card is None and is_expert(policy):
            kept = {name: value for name, value in self._options.items() if _is_for_experts(name, value)}
            usual: dict[str, Any] = getattr(unwrapped(loaded(policy)), "usual_interface", {})
            return others | {name: value for name, value in usual.items() if name in self._interface} | kept
        declared, is_complete = self._declared(policy)
        for name in declared.keys() - {FRAMES}:
            check_option(name, sorted(self._interface - LEARNERS_ONLY), policy_name(policy))
        rest = others if is_complete else self._options
        return rest | {name: value for name, value in declared.items() if name != FRAMES}

    def privilege(self, policy: Any, built: Policy) -> str:
        """Return what a policy sees, as tables write it: more than it declares, if it declares such an observation."""
        observed = self.of(policy).task.interface.get("observation", "")
        if "observation" not in self._declared(policy)[0] or built.sees == "state":
            return built.sees
        if observed.startswith("state"):
            return "state"
        return f"{SEES[built.sees]} + velocities" if "joint_velocities" in observed else built.sees

    def in_words(self, policy: Any) -> dict[str, str]:
        """Return how a policy sees and commands the robot, as texts by the names of options."""
        values = interface_values(self.of(policy)) | {FRAMES: self._declared(policy)[0].get(FRAMES, 1)}
        return {name: _in_words(value) for name, value in values.items() if name != "actions"}

    def spared(self, policy: Any, built: Policy) -> tuple[str, ...]:
        """Return the disturbances that do not reach a policy.

        They change what is not in its interface, or what it does not read.
        `built` is the policy as made for `of(policy)`. Raises `ConfigurationError` if it reads an unknown channel.
        """
        effective, reads = self.of(policy).disturbances, channels_read(built)
        names = self.requested.disturbances
        return tuple(name for name in names if name not in effective or not effective[name].reaches(reads))

    def _declared(self, policy: Any) -> tuple[dict[str, Any], bool]:
        """Return the interface that a policy declares, and whether it is complete; another process is asked once."""
        if not is_remote(policy):
            return declared_interface(policy), False
        if policy not in self._remote_interfaces:
            from armctl.policies.remote import remote_interface  # it needs the extra `remote`

            self._remote_interfaces[policy] = remote_interface(policy)
        return self._remote_interfaces[policy]

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


def _in_words(value: Any) -> str:
    return ", ".join(value) if isinstance(value, Mapping) else str(value)


def _is_for_experts(name: str, value: Any) -> bool:
    return name == "control" or (name == "observation" and not isinstance(value, str))
