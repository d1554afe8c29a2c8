"""A learned agent that looks where it is going: before it would touch something, it does something else.

At each control step, an agent that sees the bridge's state drives on in an imagined copy of its world, which has no
physics (`armctl.tasks.bridge.planar`), and in which people walk straight on, and turn back before a barrier. If it
touches something there, other commands are tried in as many copies; each is held for a while before the agent drives on
by itself. The one that goes well for longest is executed, and of those the one that gets farthest. This is a rollout
with a learned base policy (Bertsekas, "Rollout algorithms for discrete optimization: a survey", 2013), which steps in
only before a contact. It acts on estimates (`armctl.baselines.hybrids.prepared_states`).
"""

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.agents import OnnxPolicy
from armctl.agents.costs import TuningCost, total_tuning
from armctl.baselines.hybrids.prepared_states import PreparedStates
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, changed_options, options
from armctl.envs import Sees, TaskVectorEnv
from armctl.kernels import planar
from armctl.policies import made_for, make_policy, sees
from armctl.policies.state_observing import state_observing_env
from armctl.scene.pedestrians import turned_back
from armctl.tasks import BridgeTask
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER
from armctl.tasks.bridge.options import MOVES
from armctl.tasks.bridge.planar import Geometry, block_rows

Velocities = Annotated[tuple[float, ...], Field(min_length=1)]

TUNING = TuningCost(trials=7)
"""Trials of the options, as `rl/trials.csv` has them."""


@made_for("armctl/BridgeCrossMoving-v0", controls="rover")
@sees("state", family="imagination", kind="hybrid")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> "LookaheadPolicy":
    """`bridge_moving_state_ppo`, which looks ahead: where it would touch something, it tries other commands first."""
    choice = changed_options(LookaheadOptions(), options, "option of bridge_moving_imagined")
    policy = lookahead("bridge_moving_state_ppo", env, choice)
    cost = policy.training_cost
    policy.training_cost = replace(cost, tuning=total_tuning([cost.tuning, TUNING]))
    return policy


def lookahead(agent: str | Path, env: TaskVectorEnv, options: "LookaheadOptions | None" = None) -> "LookaheadPolicy":
    """Make an agent look ahead, by its name or the path of its card; it sees the state whatever `env` shows.

    Raises `ConfigurationError` for another task than the bridge, and what `LookaheadPolicy` and `make_policy` raise.
    """
    if not isinstance(env.task, BridgeTask):
        raise ConfigurationError("agents look ahead on bridges only: use armctl/BridgeCrossMoving-v0")
    with state_observing_env(env) as single_env:
        policy = make_policy(agent, single_env)
        if not isinstance(policy, OnnxPolicy):
            raise ConfigurationError(f"only learned agents look ahead, and {agent} is none")
        return LookaheadPolicy(policy, env, options)


@options
class LookaheadOptions:
    """Options of a `LookaheadPolicy`. Each pair of velocities is tried; agents themselves drive no faster."""

    steps: Count = 18
    """Control steps that are imagined."""
    held: Count = 5
    """Control steps for which another command is held."""
    linear: Velocities = (-0.3, 0.0, 0.4, 0.8, 1.2, 1.6)
    """Linear velocities to try, m/s."""
    angular: Velocities = (-2.0, -1.0, 0.0, 1.0, 2.0)
    """Angular velocities to try, rad/s."""
    prepared: bool = True
    """Estimate the rover, its drives and delay, blocks and people. False: believe every reading."""


class LookaheadPolicy:
    """n agents that look ahead, each of which acts in its own world like `agent`, which sees the state.

    Raises `ConfigurationError` for an agent of another kind.
    """

    sees: Sees = "state"

    def __init__(self, agent: OnnxPolicy, env: TaskVectorEnv, options: LookaheadOptions | None = None) -> None:
        if agent.sees != "state" or agent.card.memory:
            raise ConfigurationError("only agents without a memory that see a bridge's state look ahead there")
        self.options = options or LookaheadOptions()
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost
        self._agent, self._env = agent, env
        self._geometry = Geometry.of(env.task.options, env.task.simulation.model)
        self._alternatives = np.array(list(itertools.product(self.options.linear, self.options.angular)))
        self._prepared = PreparedStates(env, self._geometry.turn) if self.options.prepared else None
        self.failures = np.zeros(env.num_envs, dtype=np.int64)
        """Count (n,) of control steps in which every alternative ended in a contact."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._agent.reset(ids)
        if self._prepared:
            self._prepared.reset(ids)

    def act(self, observations: Any) -> Array:
        """Return linear and angular velocities (n, 2), m/s and rad/s."""
        states = self._prepared.observe() if self._prepared else self._env.perceived().state_observation()
        commands = np.asarray(self._agent.act(states), float)
        nominal = self._drive(states, commands, held=1)
        risky = np.flatnonzero(nominal.free_at_start & (nominal.survival_steps < self.options.steps))
        if len(risky):
            count = len(self._alternatives)
            rovers = self._drive(
                states[risky].repeat(count, 0), np.tile(self._alternatives, (len(risky), 1)), self.options.held
            )
            survival_steps, progress = rovers.survival_steps.reshape(-1, count), rovers.poses[:, 0].reshape(-1, count)
            best = np.lexsort((progress, survival_steps))[:, -1]
            longest = survival_steps[np.arange(len(risky)), best]
            better = longest > nominal.survival_steps[risky]
            commands[risky[better]] = self._alternatives[best[better]]
            self.failures[risky] += np.maximum(longest, nominal.survival_steps[risky]) < self.options.steps
        return self._prepared.command(commands) if self._prepared else commands

    def _drive(self, states: NDArray[np.float32], commands: Array, held: int) -> "ImaginedRovers":
        """Return rovers that have held commands (n, 2) first, and then driven on as the agent does."""
        rovers, commands = ImaginedRovers(self._geometry, states, self.options.steps), commands.copy()
        for step in range(self.options.steps):
            active = rovers.active
            if not len(active):
                break
            if step >= held:
                commands[active] = self._agent.act(rovers.states(active))
            rovers.drive(commands)
        return rovers


class ImaginedRovers:
    """Rovers that are imagined on bridges for at most so many control steps, without physics.

    `states` (n, k) are those of `armctl.tasks.bridge.observation.full_state`.
    """

    def __init__(self, geometry: Geometry, states: NDArray[np.float32], steps: int) -> None:
        n = len(states)
        x, y, cos, sin, *_ = states.T.astype(float)
        self.poses, self.velocities, self._contacts = self._rovers = planar.Rovers(
            np.column_stack((x, y, np.arctan2(sin, cos))), states[:, 4:ROVER].astype(float), np.zeros(n, dtype=np.int64)
        )
        self._geometry, self._steps, self._step = geometry, steps, 0
        self._blocks = states[:, ROVER : ROVER + BLOCK * geometry.blocks]
        self._people = self._predict(states[:, ROVER + BLOCK * geometry.blocks :].reshape(n, -1, WALKER))
        self._scenes = planar.Scenes(
            block_rows(self._blocks.reshape(n, -1, BLOCK).astype(float)),
            np.ones((n, 2, geometry.segments), dtype=bool),
            self._people[0],
        )
        self._drive(np.arange(n), self._people[:1], np.zeros((n, 2)), 0.0)
        self.free_at_start = self._contacts == planar.FREE
        """Mask (n,) of those that touch nothing before they drive."""
        self.survival_steps = np.where(self.free_at_start, steps, 0)
        """Control steps (n,) until a rover touches something or leaves the bridge backwards, or else `steps`."""

    @property
    def active(self) -> NDArray[np.intp]:
        """Rovers that have neither come to an end nor arrived."""
        return np.flatnonzero((self._contacts == planar.FREE) & ~self._geometry.wheels_at_goal(self.poses).any(axis=1))

    def drive(self, commands: Array) -> None:
        """Drive the active ones for one control step, with commands (n, 2)."""
        active, ticks = self.active, slice(MOVES * self._step + 1, MOVES * (self._step + 1) + 1)
        self._drive(active, self._people[ticks], commands, CONTROL_PERIOD)
        self._contacts[active[self.poses[active, 0] < 0]] = planar.BARRIER
        self.survival_steps[active[self._contacts[active] != planar.FREE]] = self._step
        self._step += 1

    def states(self, ids: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return what is observed of rovers `ids`, (len(ids), k)."""
        x, y, yaw = self.poses[ids].T
        positions, next_positions = (self._people[MOVES * self._step + tick, ids] for tick in (0, 1))
        people = np.concatenate((positions, (next_positions - positions) * MOVES / CONTROL_PERIOD), axis=2)
        rovers = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), self.velocities[ids]))
        return np.concatenate((rovers, self._blocks[ids], people.reshape(len(ids), -1)), axis=1, dtype=np.float32)

    def _drive(self, ids: NDArray[np.intp], people: Array, commands: Array, period: float) -> None:
        sizes = self._geometry
        planar.drive(ids, sizes.deck, self._scenes, sizes.rover, people, period, commands, self._rovers)

    def _predict(self, people: NDArray[np.float32]) -> Array:
        """Return where people (n, w, 4) will be in each tick, from the present on, (ticks, n, w, 2) m."""
        times = np.arange(MOVES * self._steps + 2)[:, None, None, None] * CONTROL_PERIOD / MOVES
        x, y = np.moveaxis(people[..., :2] + times * people[..., 2:], -1, 0)
        return np.stack((x, turned_back(y, self._geometry.turn)), axis=-1)
