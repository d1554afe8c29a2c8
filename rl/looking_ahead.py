"""A learned agent that looks where it is going: before it would touch something, it does something else.

At each control step, an agent that sees the bridge's state drives on in an imagined copy of its world, which has no
physics (`armctl.tasks.bridge.planar`), and in which people walk straight on, and turn back before a barrier. If it
touches something there, other commands are tried in as many copies; each is held for a while before the agent drives on
by itself. The one that goes well for longest is executed, and of those the one that gets farthest. This is a rollout
with a learned base policy (Bertsekas, "Rollout algorithms for discrete optimization: a survey", 2013), which steps in
only before a contact.
"""

import dataclasses
import itertools
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from armctl.agents import OnnxPolicy, load_agent
from armctl.envs import Sees, TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.kernels import planar
from armctl.options import options
from armctl.rl.bridge_scans import BLOCK, OWN, WALKER, people_after
from armctl.tasks import BridgeTask
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.options import MOVES
from armctl.tasks.bridge.planar import ACCELERATION, Geometry

Array = NDArray[np.float64]
Count = Annotated[int, Field(ge=1)]


@options
class LookAheadOptions:
    """Options of a `LookingAheadPolicy`."""

    steps: Annotated[int, Field(ge=1, le=18)] = 18
    """Control steps that are imagined: in these, nobody walks across the whole bridge and turns back twice."""
    held: Count = 5
    """Control steps for which other commands are tried."""
    linear: tuple[float, ...] = (-1.0, -0.3, 0.0, 0.4, 0.8, 1.2, 1.6)
    """m/s, of other commands."""
    angular: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)
    """rad/s, of other commands."""
    margin: Annotated[float, Field(ge=0)] = 0.0
    """m, kept from everything in imagination, beyond what worlds without physics keep."""


class LookingAheadPolicy:
    """n agents that look ahead, each of which acts in its own world like `agent`, which sees the state.

    Raises `ConfigurationError` for an agent of another kind.
    """

    sees: Sees = "state"

    def __init__(self, agent: OnnxPolicy, env: TaskVectorEnv, options: LookAheadOptions | None = None) -> None:
        if agent.sees != "state" or agent.card.memory:
            raise ConfigurationError("only agents without a memory that see a bridge's state look ahead there")
        self.options = options or LookAheadOptions()
        self.training_steps, self.training_cost = agent.training_steps, agent.training_cost
        self.reset = agent.reset
        self._agent, self._task = agent, env.task
        self._geometry = Geometry(env.task.options, env.task.simulation.model, self.options.margin)
        self._others = np.array(list(itertools.product(self.options.linear, self.options.angular)))
        self.failures = np.zeros(env.num_envs, dtype=np.int64)
        """(n,) in how many control steps everything that was tried ended in a contact."""

    def act(self, observations: Any) -> Array:
        """Linear and angular velocities (n, 2), m/s and rad/s."""
        states = self._task.state_observation()
        commands = np.asarray(self._agent.act(states), float)
        lasted, _ = self._drive_on(states, commands, 1)
        risky = np.flatnonzero(lasted < self.options.steps)
        if len(risky):
            count = len(self._others)
            tried = np.tile(self._others, (len(risky), 1))
            others, got_to = self._drive_on(states[risky].repeat(count, 0), tried, self.options.held)
            best = (others + 1e-3 * got_to).reshape(-1, count).argmax(axis=1)
            others = others.reshape(-1, count)[np.arange(len(risky)), best]
            better = others > lasted[risky]
            commands[risky[better]] = self._others[best[better]]
            self.failures[risky] += np.maximum(others, lasted[risky]) < self.options.steps
        return commands

    def _drive_on(self, states: NDArray[np.float32], commands: Array, held: int) -> tuple[NDArray[np.intp], Array]:
        """How many control steps go well, (n,), if commands (n, 2) are held first; and the x (m) that rovers get to."""
        rovers, commands = ImaginedRovers(self._task, self._geometry, states), commands.copy()
        for step in range(self.options.steps):
            going = rovers.going
            if step >= held and len(going):
                commands[going] = self._agent.act(rovers.states(going))
            rovers.drive(commands)
        return rovers.lasted, rovers.poses[:, 0]


def looking_ahead(card: Path, env: TaskVectorEnv, options: LookAheadOptions | None = None) -> LookingAheadPolicy:
    """The agent with a `card`, which sees the state whatever the worlds of `env` show.

    Raises `ConfigurationError` for another task than the bridge, and what `LookingAheadPolicy` and `load_agent` raise.
    """
    if not isinstance(env.task, BridgeTask):
        raise ConfigurationError("agents look ahead on bridges only: use armctl/BridgeCrossMoving-v0")
    of_state = dataclasses.replace(env.task.options, observation="state")
    with closing(TaskVectorEnv(1, task=type(env.task), **vars(of_state))) as worlds:
        return LookingAheadPolicy(load_agent(card, worlds), env, options)


class ImaginedRovers:
    """Rovers that are imagined on bridges as observed, without physics: `states` (n, k) are those of `full_state`."""

    def __init__(self, task: BridgeTask, geometry: Geometry, states: NDArray[np.float32]) -> None:
        n, counts = len(states), (task.options.blocks, task.options.walkers)
        own, blocks, people = np.split(states.astype(float), np.cumsum((OWN, BLOCK * counts[0])), axis=1)
        x, y, cos, sin = own.T[:4]
        self.poses, self.velocities = np.column_stack((x, y, np.arctan2(sin, cos))), own[:, 4:].copy()
        self.lasted = np.zeros(n, dtype=np.intp)
        """(n,) control steps so far without a contact."""
        self._touched, self._goal_x = np.zeros(n, dtype=np.int64), task.goal_x
        self._seen_blocks, self._people = states[:, OWN : states.shape[1] - WALKER * counts[1]], people
        self._geometry = geometry
        places, yaw, sizes = np.split(blocks.reshape(n, -1, BLOCK), (2, 3), axis=2)
        self._scenes = planar.Scenes(
            np.concatenate((places, np.cos(yaw), np.sin(yaw), sizes), axis=2),
            np.ones((n, 2, geometry.segments), dtype=bool),
            np.zeros((n, counts[1], 2)),
        )
        self._time = 0.0

    @property
    def going(self) -> NDArray[np.intp]:
        """Those that have neither touched anything nor arrived."""
        return np.flatnonzero((self._touched == planar.FREE) & (self.poses[:, 0] < self._goal_x))

    def drive(self, commands: Array) -> None:
        """Drive those that are going for one control step, with commands (n, 2). Those that have arrived stay."""
        going = self.going
        ticks = self._time + CONTROL_PERIOD * np.arange(1, MOVES + 1) / MOVES
        walkers = np.stack([self._places(time) for time in ticks])
        geometry = self._geometry
        planar.drive(
            going, geometry.deck, self._scenes, ACCELERATION, geometry.outline, walkers, CONTROL_PERIOD,
            commands, self.poses, self.velocities, self._touched,
        )  # fmt: skip
        self._time += CONTROL_PERIOD
        self.lasted += self._touched == planar.FREE

    def states(self, ids: NDArray[np.intp]) -> NDArray[np.float32]:
        """What is observed of rovers `ids`, (len(ids), k)."""
        x, y, yaw = self.poses[ids].T
        now, soon = self._places(self._time)[ids], self._places(self._time + CONTROL_PERIOD)[ids]
        people = np.concatenate((now, (soon - now) / CONTROL_PERIOD), axis=2).reshape(len(ids), -1)
        own = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), self.velocities[ids]))
        return np.concatenate((own, self._seen_blocks[ids], people), axis=1, dtype=np.float32)

    def _places(self, time: float) -> Array:
        """Where people will be after `time` s, (n, w, 2) m."""
        people = torch.as_tensor(self._people).unflatten(1, (-1, WALKER))
        return people_after(people, time, self._geometry.turn).numpy()
