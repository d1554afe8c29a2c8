"""Agents that see the state, in worlds that show something else."""

import dataclasses
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv
from armctl.policies import Policy


class OfState:
    """An agent that sees the state of worlds, whatever these show."""

    training_steps = 0

    def __init__(self, agent: Policy, worlds: TaskVectorEnv) -> None:
        self.sees, self.reset, self._agent, self._task = agent.sees, agent.reset, agent, worlds.task

    def act(self, observations: Any) -> NDArray[Any]:
        """Actions (n, ...) for the present states."""
        return self._agent.act(self._task.state_observation())


@contextmanager
def world_of_states(worlds: TaskVectorEnv) -> Iterator[TaskVectorEnv]:
    """One world of the same task that shows its state: for agents that were made for such worlds."""
    options = dataclasses.replace(worlds.task.options, observation="state")
    with closing(TaskVectorEnv(1, task=type(worlds.task), **vars(options))) as world:
        yield world
