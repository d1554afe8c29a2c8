"""Plays one policy in one world, control step by control step, and keeps the episode's status, for viewers."""

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.envs import chosen_policy_seed
from armctl.policies import Plans, Policy, WorldsByInterface, make_policy
from armctl.rollout.loop import wrap_environment_errors, wrap_policy_errors


@dataclass(frozen=True)
class Status:
    """The status of an episode."""

    policy: str
    seed: int
    episode: int
    steps: int = 0
    decision_ms: float = 0.0
    """Decision time of the last control step: wall time of the policy's call."""
    distance: float = 0.0
    """m to the target or the goal line."""
    rewards: Mapping[str, float] = field(default_factory=dict)
    """Sum of each reward term so far; the return is the sum of these."""
    contacts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Objects touched since the last control step, and by which parts of the robot, if these are distinguished."""
    outcome: str | None = None
    """None until the episode has ended."""
    truncated: bool = False
    """True if it has ended by the time limit alone."""

    @property
    def total_reward(self) -> float:
        """The return so far."""
        return sum(self.rewards.values())


class Stage:
    """Plays one episode at a time in one world. Another policy, seed or episode can be started at any time.

    The policies' own random numbers come from `policy_seed`, or else from a new secret. Raises `ConfigurationError` or
    `AgentFileError` for a policy or an environment that cannot be made.
    """

    def __init__(
        self,
        policy: str,
        env: str,
        seed: int = 0,
        episode: int = 0,
        env_options: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        policy_seed: int | None = None,
    ) -> None:
        self.env_id, self._policy_seed = env, chosen_policy_seed(policy_seed)
        self._interfaces_again = functools.partial(WorldsByInterface, env, 1, env_options, render_mode=render_mode)
        self._interfaces: WorldsByInterface | None = None
        self.status = Status("", seed, episode)
        self.play(policy, seed, episode)
        self.longest = self.worlds.max_episode_steps
        """Control steps until an episode is truncated; None: never."""
        self.period: float = self.task.control_period or 1 / self.worlds.metadata["render_fps"]
        """Seconds between control steps; if that is unknown, between two frames of a video."""

    def play(self, policy: str, seed: int, episode: int) -> None:
        """Start an episode. If it raises `ConfigurationError` or `AgentFileError`, the current episode continues."""
        if policy != self.status.policy:
            self._cast(policy)
        self.observations, infos = self.worlds.reset(seed=[seed], options={"episode": [episode]})
        with wrap_policy_errors(policy, episode):
            self._actor.reset(np.zeros(1, dtype=np.int32))
        self.status = Status(policy, seed, episode, distance=self._distance(), contacts=_touched(infos))

    def _cast(self, policy: str) -> None:
        """Make a policy, in worlds that have begun no episode yet."""
        interfaces = self._interfaces_again()
        try:
            worlds = interfaces.of(policy)
            self._actor: Policy = make_policy(policy, worlds, policy_seed=self._policy_seed)
        except BaseException:
            interfaces.close()
            raise
        self.close()
        self._interfaces, self.worlds, self.task = interfaces, worlds, worlds.task

    def step(self) -> None:
        """Make one control step, unless the episode has ended. Raises `PolicyFailed` or `EnvironmentFailed`."""
        status = self.status
        if status.outcome is not None:
            return
        self.execute(self.decide())

    def decide(self) -> NDArray[Any]:
        """Return the policy's action, (1, ...). Raises `PolicyFailed`."""
        with wrap_policy_errors(self.status.policy, self.status.episode):
            began = time.perf_counter()
            actions = self._actor.act(self.observations)
            self.status = replace(self.status, decision_ms=1e3 * (time.perf_counter() - began))
        return actions

    def execute(self, actions: NDArray[Any]) -> tuple[dict[str, float], float]:
        """Make one control step with an action; return the reward terms and the reward. Raises `EnvironmentFailed`."""
        status = self.status
        with wrap_environment_errors(status.policy, status.episode):
            self.observations, rewards, terminated, truncated, infos = self.worlds.step(actions)
        terms = {name: float(term[0]) for name, term in infos["reward_terms"].items()}
        self.status = replace(
            status,
            steps=status.steps + 1,
            distance=self._distance(),
            rewards={name: status.rewards.get(name, 0.0) + term for name, term in terms.items()},
            contacts=_touched(infos),
            outcome=self.worlds.outcomes[infos["outcome_id"][0]] if terminated[0] or truncated[0] else None,
            truncated=bool(truncated[0] and not terminated[0]),
        )
        return terms, float(rewards[0])

    def plans(self) -> Mapping[str, Array]:
        """Return the policy's plans: polylines by name, (m, 3) m each; none for policies that do not show any."""
        with wrap_policy_errors(self.status.policy, self.status.episode):
            return self._actor.plans(0) if isinstance(self._actor, Plans) else {}

    def close(self) -> None:
        """Close the environment."""
        if self._interfaces is not None:
            self._interfaces.close()

    def _distance(self) -> float:
        return float(self.task.goal_distances()[0])


def _touched(infos: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Objects touched in the first world, and by which parts, from `info["contacts"]`."""
    touched: dict[str, tuple[str, ...]] = {}
    for name, value in infos.get("contacts", {}).items():
        if isinstance(value, Mapping):
            for thing in (thing for thing, contact in value.items() if contact[0]):
                touched[thing] = (*touched.get(thing, ()), name)
        elif value[0]:
            touched[name] = ()
    return touched
