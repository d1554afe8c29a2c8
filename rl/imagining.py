"""A learned agent that looks before it leaps: it plays its episode in imagination, and executes what went well there.

At the start of an episode, an agent among boxes acts in many imagined copies of its world, in most of them with noise
(`armctl.kinematics.ImaginedArms`: the drives' law and distances, no physics). The commands of the copy that arrives
first, without coming too near to anything, are then executed. That is repeated when the arm is not where it should be.
Without such a copy, the agent acts by itself. This is random shooting with a learned proposal, as in Nagabandi et al.,
"Neural network dynamics for model-based deep reinforcement learning with model-free fine-tuning", ICRA 2018, but for a
model that is known.
"""

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.agents import OnnxPolicy
from armctl.core.options import options
from armctl.envs import ModelInterface, Sees
from armctl.kinematics import ArmModel, ArmShapes, ImaginedArms
from armctl.kinematics.imagined import ARRIVED, MOVING
from armctl.rl.following import observed
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach import CONTROL_PERIOD, observation_slices
from armctl.tasks.reach.obstacle_layout import MOST_OBSTACLES

Array = NDArray[np.float64]
Count = Annotated[int, Field(ge=1)]
Length = Annotated[float, Field(ge=0)]


@options
class ImaginingOptions:
    """Options of an `ImaginingPolicy`."""

    copies: Count = 16
    """Imagined copies of a world in a round; the first of all acts without noise."""
    rounds: Count = 32
    """Rounds until an agent without success in imagination acts by itself."""
    steps: Count = 75
    """Control steps of an imagined episode, at most."""
    noise: Length = 0.15
    """rad: standard deviation of what is added to each joint's command in each step."""
    margin: Length = 0.008
    """m, kept from boxes, floor and the arm itself. Joints are some mrad off the commands, and so links some mm."""
    inside: Length = 0.005
    """m by which the imagined sphere is smaller than the true one, for the same reason."""
    deviation: Length = 0.06
    """rad between a joint and where it should be, after which there is a new plan."""
    patience: Count = 5
    """Control steps by itself before an agent imagines again."""


class ImaginingPolicy:
    """n agents with imagination, each of which acts in its own world like `agent`, a clone with relative commands."""

    sees: Sees = "model"

    def __init__(self, agent: OnnxPolicy, env: ModelInterface, options: ImaginingOptions | None = None) -> None:
        self.options = options or ImaginingOptions()
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost
        self._agent, self._env, n = agent, env, env.num_envs
        self._shapes, self._tolerance = ArmShapes(ArmModel(env.robot)), env.options.tolerance
        dof = self._shapes.model.dof
        self._parts = observation_slices(dof) | {"boxes": slice(6 + dof, None)}
        self._now = ImaginedArms(self._shapes, n, MOST_OBSTACLES, tolerance=0.0, period=CONTROL_PERIOD)
        self._plans, self._lengths = np.zeros((n, self.options.steps, dof)), np.zeros(n, int)
        self._steps, self._alone = np.zeros(n, int), np.zeros(n, int)
        self._fresh = np.ones(n, dtype=bool)
        self._before = np.zeros((n, dof))
        self.failures = np.zeros(n, dtype=np.int64)
        """(n,) how often no imagined episode was a success, over all episodes."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids` start a new episode."""
        self._fresh[ids] = True

    def plans(self, world: int) -> Mapping[str, Array]:
        """The rest of the end-effector's imagined path, (m, 3) m, without the drives' law."""
        ahead = self._plans[world, self._steps[world] : self._lengths[world]]
        return {"path": self._shapes.model.positions(ahead)} if len(ahead) else {}

    def act(self, observations: Any) -> NDArray[np.float64]:
        """Joint positions (n, dof), rad, to move to, for observations (n, k)."""
        seen = {name: np.asarray(observations[:, part], float) for name, part in self._parts.items()}
        positions, now = seen["joint_positions"], self._now
        lost = self._fresh | (abs(positions - now.positions).max(axis=1) > self.options.deviation)
        if lost.any():
            top = self._shapes.model.limits.velocity
            moved = np.where(self._fresh[:, None], 0.0, positions - self._before) / CONTROL_PERIOD
            boxes = seen["boxes"].reshape(len(positions), -1, BOX_NUMBERS)
            ids = np.flatnonzero(lost)
            velocities = np.clip(moved, -top, top)[ids]
            now.begin(ids, positions[ids], velocities, seen["target_position"][ids], boxes[ids])
        ended = self._steps >= self._lengths
        self._alone[self._fresh] = 0
        due = np.flatnonzero(lost | (ended & (self._alone == 0)))
        if len(due):
            self._imagine(due, seen)
        self._before, self._fresh[:] = positions, False
        commands = self._follow(observations)
        now.move(commands)
        return commands

    def _follow(self, observations: Any) -> Array:
        """The next commands of the plans, and of the agent where there is none."""
        planned = self._steps < self._lengths
        alone = ~planned
        commands = np.zeros_like(self._before)
        if alone.any():
            commands[alone] = self._agent.act(observations[alone])
        self._alone = np.where(alone, (self._alone + 1) % self.options.patience, 0)
        commands[planned] = self._plans[planned, self._steps[planned]]
        self._steps += planned
        return commands

    def _imagine(self, worlds: NDArray[np.intp], seen: Mapping[str, Array]) -> None:
        """Make new plans for some worlds; empty ones where nothing was a success."""
        self._lengths[worlds] = self._steps[worlds] = 0
        for turn in range(self.options.rounds):
            self._round(worlds, seen, first=turn == 0)
            worlds = worlds[self._lengths[worlds] == 0]
            if not len(worlds):
                break
        self.failures[worlds] += 1

    def _round(self, worlds: NDArray[np.intp], seen: Mapping[str, Array], first: bool) -> None:
        """Take as plans the commands of the copy of each world that arrives first, if one does."""
        asked, dof, copies = self.options, self._shapes.model.dof, self.options.copies
        tolerance = max(self._tolerance - asked.inside, self._tolerance / 2)
        arms = ImaginedArms(
            self._shapes, len(worlds) * copies, MOST_OBSTACLES, tolerance=tolerance, period=CONTROL_PERIOD,
            margin=asked.margin,
        )  # fmt: skip
        of = np.repeat(worlds, copies)
        targets, boxes = seen["target_position"][of], seen["boxes"][of]
        numbers = boxes.reshape(len(of), -1, BOX_NUMBERS)
        arms.begin(np.arange(len(of)), self._now.positions[of], self._now.velocities[of], targets, numbers)
        size = asked.steps, copies, dof
        noise = np.stack([self._env.rng(int(world)).normal(scale=asked.noise, size=size) for world in worlds])
        if first:
            noise[:, :, 0] = 0.0
        commands = np.zeros((asked.steps, len(of), dof))
        for step in range(asked.steps):
            moving = np.flatnonzero(arms.states == MOVING)
            if not len(moving):
                break
            some = observed(self._shapes, arms.positions[moving], targets[moving], boxes[moving])
            commands[step, moving] = self._agent.act(some) + noise[:, step].reshape(len(of), dof)[moving]
            arms.move(commands[step])
            arrived = moving[arms.states[moving] == ARRIVED]
            found, first_copies = np.unique(of[arrived], return_index=True)
            self._plans[found, : step + 1] = commands[: step + 1, arrived[first_copies]].swapaxes(0, 1)
            self._lengths[found] = step + 1
            arms.states[self._lengths[of] > 0] = ARRIVED
