"""A learned agent that looks where it is going: before it would touch something, it does something else.

At each control step, an agent that sees the bridge's state drives on in an imagined copy of its world, which has no
physics (`armctl.tasks.bridge.planar`), and in which people walk straight on, and turn back before a barrier. If it
touches something there, other commands are tried in as many copies; each is held for a while before the agent drives on
by itself. The one that goes well for longest is executed, and of those the one that gets farthest. This is a rollout
with a learned base policy (Bertsekas, "Rollout algorithms for discrete optimization: a survey", 2013), which steps in
only before a contact.
"""

import itertools
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.agents import OnnxPolicy, load_agent
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.envs import Sees, TaskVectorEnv
from armctl.kernels import planar
from armctl.rl.of_state import world_of_states
from armctl.scene.pedestrians import turned_back
from armctl.tasks import BridgeTask
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER
from armctl.tasks.bridge.options import MOVES
from armctl.tasks.bridge.planar import ACCELERATION, Geometry, block_rows

Array = NDArray[np.float64]
Count = Annotated[int, Field(ge=1)]
Velocities = Annotated[tuple[float, ...], Field(min_length=1)]


@options
class LookAheadOptions:
    """Options of a `LookingAheadPolicy`. Each pair of velocities is tried; agents themselves drive no faster."""

    steps: Count = 18
    """Control steps that are imagined."""
    held: Count = 5
    """Control steps for which another command is held."""
    linear: Velocities = (-0.3, 0.0, 0.4, 0.8, 1.2, 1.6)
    """m/s."""
    angular: Velocities = (-2.0, -1.0, 0.0, 1.0, 2.0)
    """rad/s."""


class LookingAheadPolicy:
    """n agents that look ahead, each of which acts in its own world like `agent`, which sees the state.

    Raises `ConfigurationError` for an agent of another kind.
    """

    sees: Sees = "state"

    def __init__(self, agent: OnnxPolicy, env: TaskVectorEnv, options: LookAheadOptions | None = None) -> None:
        if agent.sees != "state" or agent.card.memory:
            raise ConfigurationError("only agents without a memory that see a bridge's state look ahead there")
        self.options = options or LookAheadOptions()
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost
        self.reset = agent.reset
        self._agent, self._env = agent, env
        self._geometry = Geometry.of(env.task.options, env.task.simulation.model)
        self._others = np.array(list(itertools.product(self.options.linear, self.options.angular)))
        self.failures = np.zeros(env.num_envs, dtype=np.int64)
        """(n,) in how many control steps everything that was tried ended in a contact."""

    def act(self, observations: Any) -> Array:
        """Linear and angular velocities (n, 2), m/s and rad/s."""
        states = self._env.perceived().state_observation()
        commands = np.asarray(self._agent.act(states), float)
        alone = self._driven(states, commands, held=1)
        risky = np.flatnonzero(alone.free_at_first & (alone.lasted < self.options.steps))
        if len(risky):
            count = len(self._others)
            tried = self._driven(
                states[risky].repeat(count, 0), np.tile(self._others, (len(risky), 1)), self.options.held
            )
            lasted, got_to = tried.lasted.reshape(-1, count), tried.poses[:, 0].reshape(-1, count)
            best = np.lexsort((got_to, lasted))[:, -1]
            longest = lasted[np.arange(len(risky)), best]
            better = longest > alone.lasted[risky]
            commands[risky[better]] = self._others[best[better]]
            self.failures[risky] += np.maximum(longest, alone.lasted[risky]) < self.options.steps
        return commands

    def _driven(self, states: NDArray[np.float32], commands: Array, held: int) -> "ImaginedRovers":
        """Rovers that hold commands (n, 2) first, and then drive on as the agent does."""
        rovers, commands = ImaginedRovers(self._geometry, states, self.options.steps), commands.copy()
        for step in range(self.options.steps):
            going = rovers.going
            if not len(going):
                break
            if step >= held:
                commands[going] = self._agent.act(rovers.states(going))
            rovers.drive(commands)
        return rovers


def looking_ahead(card: Path, env: TaskVectorEnv, options: LookAheadOptions | None = None) -> LookingAheadPolicy:
    """The agent with a `card`, which sees the state whatever the worlds of `env` show.

    Raises `ConfigurationError` for another task than the bridge, and what `LookingAheadPolicy` and `load_agent` raise.
    """
    if not isinstance(env.task, BridgeTask):
        raise ConfigurationError("agents look ahead on bridges only: use armctl/BridgeCrossMoving-v0")
    with world_of_states(env) as world:
        return LookingAheadPolicy(load_agent(card, world), env, options)


class ImaginedRovers:
    """Rovers that are imagined on bridges for at most so many control steps, without physics.

    `states` (n, k) are those of `armctl.tasks.bridge.observation.full_state`.
    """

    def __init__(self, geometry: Geometry, states: NDArray[np.float32], steps: int) -> None:
        n = len(states)
        x, y, cos, sin, *_ = states.T.astype(float)
        self.poses, self.velocities = np.column_stack((x, y, np.arctan2(sin, cos))), states[:, 4:ROVER].astype(float)
        self._steps, self._step = steps, 0
        self._geometry, self._ended = geometry, np.zeros(n, dtype=np.int64)
        self._seen_blocks = states[:, ROVER : ROVER + BLOCK * geometry.blocks]
        self._people = self._predicted(states[:, ROVER + BLOCK * geometry.blocks :].reshape(n, -1, WALKER))
        self._scenes = planar.Scenes(
            block_rows(self._seen_blocks.reshape(n, -1, BLOCK).astype(float)),
            np.ones((n, 2, geometry.segments), dtype=bool),
            self._people[0],
        )
        self._drive(np.arange(n), self._people[:1], np.zeros((n, 2)), 0.0)
        self.free_at_first = self._ended == planar.FREE
        """(n,) whether it touches nothing before it drives."""
        self.lasted = np.where(self.free_at_first, steps, 0)
        """(n,) control steps until it touches something or leaves the bridge backwards: `steps` if it does not."""

    @property
    def going(self) -> NDArray[np.intp]:
        """Those that have neither come to an end nor arrived."""
        return np.flatnonzero((self._ended == planar.FREE) & ~self._geometry.wheels_at_goal(self.poses).any(axis=1))

    def drive(self, commands: Array) -> None:
        """Drive those that are going for one control step, with commands (n, 2)."""
        going, ticks = self.going, slice(MOVES * self._step + 1, MOVES * (self._step + 1) + 1)
        self._drive(going, self._people[ticks], commands, CONTROL_PERIOD)
        self._ended[going[self.poses[going, 0] < 0]] = planar.BARRIER
        self.lasted[going[self._ended[going] != planar.FREE]] = self._step
        self._step += 1

    def states(self, ids: NDArray[np.intp]) -> NDArray[np.float32]:
        """What is observed of rovers `ids`, (len(ids), k)."""
        x, y, yaw = self.poses[ids].T
        now, soon = (self._people[MOVES * self._step + tick, ids] for tick in (0, 1))
        people = np.concatenate((now, (soon - now) * MOVES / CONTROL_PERIOD), axis=2).reshape(len(ids), -1)
        own = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), self.velocities[ids]))
        return np.concatenate((own, self._seen_blocks[ids], people), axis=1, dtype=np.float32)

    def _drive(self, ids: NDArray[np.intp], people: Array, commands: Array, period: float) -> None:
        sizes = self._geometry
        planar.drive(
            ids, sizes.deck, self._scenes, ACCELERATION, sizes.outline, people, period,
            commands, self.poses, self.velocities, self._ended,
        )  # fmt: skip

    def _predicted(self, people: NDArray[np.float32]) -> Array:
        """Where people (n, w, 4) will be in each tick, from now on, (ticks, n, w, 2) m."""
        times = np.arange(MOVES * self._steps + 2)[:, None, None, None] * CONTROL_PERIOD / MOVES
        x, y = np.moveaxis(people[..., :2] + times * people[..., 2:], -1, 0)
        return np.stack((x, turned_back(y, self._geometry.turn)), axis=-1)
