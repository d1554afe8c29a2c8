"""One policy in one world, decision by decision, and what there is to tell of it: what a viewer plays from."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.envs import make_worlds
from armctl.evaluation.rollouts import wrap_policy_errors
from armctl.policies import Plans, Policy, make_policy

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Status:
    """How an episode stands."""

    policy: str
    seed: int
    episode: int
    steps: int = 0
    decision_ms: float = 0.0
    """Wall time of the last decision."""
    distance: float = 0.0
    """m to the target or the goal line."""
    rewards: Mapping[str, float] = field(default_factory=dict)
    """Earned so far, by term; the return is their sum."""
    contacts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """What has been touched since the last decision, and by which parts, where they are told apart."""
    outcome: str | None = None
    """Once the episode has ended."""

    @property
    def total_reward(self) -> float:
        """The return so far."""
        return sum(self.rewards.values())


class Stage:
    """Plays one episode at a time in one world; another policy, seed or episode may come on at any time.

    Raises `ConfigurationError` or `AgentFileError` for what cannot be made.
    """

    def __init__(
        self, policy: str, env: str, seed: int = 0, episode: int = 0, env_options: Mapping[str, Any] | None = None
    ) -> None:
        self.env_id = env
        self._env = make_worlds(env, 1, env_options)
        self.task = self._env.task
        self.longest = self._env.max_episode_steps
        """Decisions until an episode is truncated; None for never."""
        self.period = self.task.control_period
        """Seconds between control steps."""
        self.status = Status("", seed, episode)
        self.play(policy, seed, episode)

    def play(self, policy: str, seed: int, episode: int) -> None:
        """Begin an episode. Raises `ConfigurationError` or `AgentFileError`, and goes on as before."""
        if policy != self.status.policy:
            self._actor: Policy = make_policy(policy, self._env)
        self._observations, infos = self._env.reset(seed=[seed], options={"episode": [episode]})
        with wrap_policy_errors(policy, episode):
            self._actor.reset(np.zeros(1, dtype=np.int32))
        self.status = Status(policy, seed, episode, distance=self._distance(), contacts=_touched(infos))

    def step(self) -> None:
        """Make one decision, unless the episode has ended. Raises `PolicyFailed`."""
        status = self.status
        if status.outcome is not None:
            return
        with wrap_policy_errors(status.policy, status.episode):
            began = time.perf_counter()
            actions = self._actor.act(self._observations)
            decision_ms = 1e3 * (time.perf_counter() - began)
            self._observations, _, terminated, truncated, infos = self._env.step(actions)
        earned = {name: status.rewards.get(name, 0.0) + float(term[0]) for name, term in infos["reward_terms"].items()}
        self.status = replace(
            status,
            steps=status.steps + 1,
            decision_ms=decision_ms,
            distance=self._distance(),
            rewards=earned,
            contacts=_touched(infos),
            outcome=str(infos["outcome"][0]) if terminated[0] or truncated[0] else None,
        )

    def plans(self) -> Mapping[str, Array]:
        """Lines by name, (m, 3) m each, that the policy means to follow; none of policies that do not tell."""
        return self._actor.plans(0) if isinstance(self._actor, Plans) else {}

    def close(self) -> None:
        """Give memory back."""
        self._env.close()

    def _distance(self) -> float:
        return float(self.task.goal_distances()[0])


def _touched(infos: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """What is touched in the first world, from `info["contacts"]`: by thing, or by part and thing."""
    touched: dict[str, tuple[str, ...]] = {}
    for name, value in infos.get("contacts", {}).items():
        if isinstance(value, Mapping):
            for thing in (thing for thing, touches in value.items() if touches[0]):
                touched[thing] = (*touched.get(thing, ()), name)
        elif value[0]:
            touched[name] = ()
    return touched
