"""A learned agent that looks before it leaps: it plays its episode in imagination, and executes what went well there.

At the start of an episode, an agent among boxes acts in many imagined copies of its world, in most of them with noise
(`armctl.kinematics.ImaginedArms`: the drives' law and distances, no physics). The commands of the copy that arrives
first, without coming too near to anything, are then executed. That is repeated when the arm is not where it should be.
Without such a copy, the agent acts by itself. This is random shooting with a learned proposal, as in Nagabandi et al.,
"Neural network dynamics for model-based deep reinforcement learning with model-free fine-tuning", ICRA 2018, but for a
model that is known.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.agents import OnnxPolicy
from armctl.core.arrays import Array
from armctl.core.options import Count, NonNegative, options
from armctl.envs import ModelInterface, Sees
from armctl.kinematics import ArmModel, ArmShapes, ImaginedArms
from armctl.kinematics.imagined import ARRIVED, MOVING
from armctl.policies import made_for, make_policy, sees
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach import CONTROL_PERIOD, observation_slices
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES
from armctl.tasks.reach.obstacles import obstacles_observation


@made_for("armctl/ArmReachObstacles-v0", controls="ur5: position")
@sees("model", family="imagination", kind="hybrid")
def make(env: ModelInterface) -> "ShootingPolicy":
    """`obstacles_plan_bc`, which plays its episodes in imagination first, by kinematics, and executes the best."""
    agent = make_policy("obstacles_plan_bc", env)
    assert isinstance(agent, OnnxPolicy)
    return ShootingPolicy(agent, env)


@options
class ShootingOptions:
    """Options of a `ShootingPolicy`."""

    copies: Count = 16
    """Imagined copies of a world in a round; the first of all acts without noise."""
    rounds: Count = 32
    """Rounds until an agent without success in imagination acts by itself."""
    steps: Count = 75
    """Control steps of an imagined episode, at most."""
    noise: NonNegative = 0.15
    """Standard deviation of what is added to each joint's command in each step, rad."""
    margin: NonNegative = 0.008
    """Distance kept from boxes, floor and the arm itself, m. Joints are some mrad off the commands, and so links some
    mm."""
    inside: NonNegative = 0.005
    """Difference of radius between the true target sphere and the smaller imagined one, m, for the same reason."""
    deviation: NonNegative = 0.06
    """Distance between a joint and where it should be, rad, after which there is a new plan."""
    patience: Count = 5
    """Control steps by itself before an agent imagines again."""


class ShootingPolicy:
    """n agents with imagination, each of which acts in its own world like `agent`, a clone with relative commands."""

    sees: Sees = "model"

    def __init__(self, agent: OnnxPolicy, env: ModelInterface, options: ShootingOptions | None = None) -> None:
        self.options = options or ShootingOptions()
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost
        self._agent, self._env, n = agent, env, env.num_envs
        self._shapes, self._tolerance = ArmShapes(ArmModel(env.robot)), env.options.tolerance
        dof = self._shapes.model.dof
        self._slices = observation_slices(dof) | {"boxes": slice(6 + dof, None)}
        self._expected = ImaginedArms(self._shapes, n, MAX_OBSTACLES, tolerance=0.0, period=CONTROL_PERIOD)
        self._plans, self._lengths = np.zeros((n, self.options.steps, dof)), np.zeros(n, int)
        self._steps, self._unplanned_steps = np.zeros(n, int), np.zeros(n, int)
        self._new_episode = np.ones(n, dtype=bool)
        self._previous_positions = np.zeros((n, dof))
        self.failures = np.zeros(n, dtype=np.int64)
        """Count (n,) of plans for which no imagined episode was a success, over all episodes."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Start new episodes in worlds `ids`."""
        self._new_episode[ids] = True

    def plans(self, world: int) -> Mapping[str, Array]:
        """Return the rest of the end-effector's imagined path, (m, 3) m, without the drives' law."""
        ahead = self._plans[world, self._steps[world] : self._lengths[world]]
        return {"path": self._shapes.model.positions(ahead)} if len(ahead) else {}

    def act(self, observations: Any) -> Array:
        """Return joint positions (n, dof), rad, to move to, for observations (n, k)."""
        parts = {name: np.asarray(observations[:, part], float) for name, part in self._slices.items()}
        positions, expected = parts["joint_positions"], self._expected
        off_plan = self._new_episode | (abs(positions - expected.positions).max(axis=1) > self.options.deviation)
        if off_plan.any():
            top = self._shapes.model.limits.velocity
            moves = np.where(self._new_episode[:, None], 0.0, positions - self._previous_positions) / CONTROL_PERIOD
            boxes = parts["boxes"].reshape(len(positions), -1, BOX_NUMBERS)
            ids = np.flatnonzero(off_plan)
            velocities = np.clip(moves, -top, top)[ids]
            expected.begin(ids, positions[ids], velocities, parts["target_position"][ids], boxes[ids])
        at_end = self._steps >= self._lengths
        self._unplanned_steps[self._new_episode] = 0
        due = np.flatnonzero(off_plan | (at_end & (self._unplanned_steps == 0)))
        if len(due):
            self._plan(due, parts)
        self._previous_positions, self._new_episode[:] = positions, False
        commands = self._next_commands(observations)
        expected.move(commands)
        return commands

    def _next_commands(self, observations: Any) -> Array:
        """Return the next commands of the plans, and of the agent where there is none."""
        planned = self._steps < self._lengths
        unplanned = ~planned
        commands = np.zeros_like(self._previous_positions)
        if unplanned.any():
            commands[unplanned] = self._agent.act(observations[unplanned])
        self._unplanned_steps = np.where(unplanned, (self._unplanned_steps + 1) % self.options.patience, 0)
        commands[planned] = self._plans[planned, self._steps[planned]]
        self._steps += planned
        return commands

    def _plan(self, worlds: NDArray[np.intp], parts: Mapping[str, Array]) -> None:
        """Make new plans for some worlds; empty ones where nothing was a success."""
        self._lengths[worlds] = self._steps[worlds] = 0
        for number in range(self.options.rounds):
            self._shoot(worlds, parts, first=number == 0)
            worlds = worlds[self._lengths[worlds] == 0]
            if not len(worlds):
                break
        self.failures[worlds] += 1

    def _shoot(self, worlds: NDArray[np.intp], parts: Mapping[str, Array], first: bool) -> None:
        """Take as plans the commands of the copy of each world that arrives first, if one does."""
        options, dof, copies = self.options, self._shapes.model.dof, self.options.copies
        tolerance = max(self._tolerance - options.inside, self._tolerance / 2)
        arms = ImaginedArms(
            self._shapes, len(worlds) * copies, MAX_OBSTACLES, tolerance=tolerance, period=CONTROL_PERIOD,
            margin=options.margin,
        )  # fmt: skip
        world_of = np.repeat(worlds, copies)
        targets, boxes = parts["target_position"][world_of], parts["boxes"][world_of]
        arms.begin(
            np.arange(len(world_of)), self._expected.positions[world_of], self._expected.velocities[world_of], targets,
            boxes.reshape(len(world_of), -1, BOX_NUMBERS),
        )  # fmt: skip
        size = options.steps, copies, dof
        noise = np.stack([self._env.rng(int(world)).normal(scale=options.noise, size=size) for world in worlds])
        if first:
            noise[:, :, 0] = 0.0
        commands = np.zeros((options.steps, len(world_of), dof))
        for step in range(options.steps):
            moving = np.flatnonzero(arms.states == MOVING)
            if not len(moving):
                break
            observations = obstacles_observation(
                self._shapes.model, arms.positions[moving], targets[moving], boxes[moving]
            )
            noise_now = noise[:, step].reshape(len(world_of), dof)[moving]
            commands[step, moving] = self._agent.act(observations) + noise_now
            arms.move(commands[step])
            arrived = moving[arms.states[moving] == ARRIVED]
            solved, first_copies = np.unique(world_of[arrived], return_index=True)
            self._plans[solved, : step + 1] = commands[: step + 1, arrived[first_copies]].swapaxes(0, 1)
            self._lengths[solved] = step + 1
            arms.states[self._lengths[world_of] > 0] = ARRIVED
