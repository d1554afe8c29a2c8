"""Agents that observe the state, in environments whose own observation is another."""

import dataclasses
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv
from armctl.policies.policy import Policy


class StateObservingAgent:
    """An agent that acts on the state of `env`, whatever this environment shows."""

    training_steps = 0

    def __init__(self, agent: Policy, env: TaskVectorEnv) -> None:
        self.sees, self.reset, self._agent, self._task = agent.sees, agent.reset, agent, env.task

    def act(self, observations: Any) -> NDArray[Any]:
        """Return actions (n, ...) for the present states."""
        return self._agent.act(self._task.state_observation())


@contextmanager
def state_observing_env(env: TaskVectorEnv) -> Iterator[TaskVectorEnv]:
    """Make one environment of the same task whose observation is the state, for agents that were made for such ones."""
    options = dataclasses.replace(env.task.options, observation="state")
    with closing(TaskVectorEnv(1, task=type(env.task), **vars(options))) as single_env:
        yield single_env
