"""Safety filters of the robots in n worlds: their states, the laws by which they move, and their filtered actions.

Actions act from a state that their robot is still to reach if they are delayed (`armctl.policies.filtered`).
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.control.arm_filter import ArmFilter
from armctl.control.rover_filter import RoverFilter
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import NonNegative, options
from armctl.envs import TaskVectorEnv
from armctl.kernels import braking
from armctl.kernels.rover_filter import Rover, after_period
from armctl.kinematics import ArmModel, ArmShapes
from armctl.robots.rover import (
    MAX_VELOCITY,
    MAX_WHEEL_SPEED,
    PARTS,
    PREFIX,
    TRACK,
    WHEEL_RADIUS,
    WHEEL_SEPARATION_MULTIPLIER,
    WHEELS,
)
from armctl.scene import NO_BOXES, Boxes, BridgeMap
from armctl.tasks import ReachTask
from armctl.tasks.bridge import CONTROL_PERIOD

GRAVITY, FRICTION, SLIP = 9.81, 0.85, 0.1
"""m/s^2; the share of the tyres' friction that counts on soft tyres, and m/s from which on it is full, as fitted to the
simulated rover."""
DRIVES_ACCURACY, RIMS_ACCURACY = (0.001, 0.05), 0.2
"""rad and rad/s of drives, m/s of wheels' rims."""
PITCH_PER_SPEED = 0.3
"""rad per m/s: a rover that brakes by so much in a period may pitch so far."""


@options
class ArmFilterOptions:
    """Options of the safety filter of arms."""

    margin: NonNegative = 0.003
    """m kept from boxes, floor and the arm itself."""


@options
class RoverFilterOptions:
    """Options of the safety filter of rovers."""

    margin: NonNegative = 0.06
    """m kept from sides and blocks."""
    people_margin: NonNegative = 0.1
    """m kept from people."""
    drift: NonNegative = 0.02
    """m/s by which the margin to people grows with the time ahead: what they do otherwise than predicted."""
    late_margin: NonNegative = 0.03
    """m more kept from all for each control step by which actions are delayed."""


class Filters(Protocol):
    """Safety filters of n worlds."""

    max_delay: int
    """Control steps: the longest delay of actions that is recognised."""
    accuracy: Array
    """(s,) accuracy of `fast_law` for each number of a state; infinite for those that show no delay."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""

    def states(self) -> Array:
        """Return the states (n, s) of the robots."""

    def fast_law(self, states: Array, actions: Array) -> Array:
        """Return the states (..., s) a period after others, under actions (..., a), as far as they tell delays."""

    def law(self, states: Array, actions: Array) -> Array:
        """Return the states (..., s) a period after others, under actions (..., a), as exactly as the filter knows."""

    def act(self, world: int, action: Array, state: Array, delay: int = 0) -> Array:
        """Return a world's action if it is safe, or else a near one that is.

        It acts in so many control steps, from a `state` (s,) then.
        """


class ArmFilters:
    """Filters of n arms. A state is positions and velocities of drives, and then of joints, rad and rad/s.

    Raises `ConfigurationError` for torques, and for arms with a hand.
    """

    max_delay = 10

    def __init__(self, task: ReachTask, chosen: ArmFilterOptions) -> None:
        self._control = control = task.options.control
        if control == "torque":
            raise ConfigurationError("the safety filter of arms goes by their drives, which control='torque' has not")
        self._task, self._margin, dof = task, chosen.margin, task.robot.dof
        if task.action_space.shape != (dof,):
            raise ConfigurationError("the safety filter of arms is for joints alone, not for a hand")
        self._gains = np.array(task.simulation.model.actuator_gainprm[: 2 * dof, 0]).reshape(2, dof)
        self._shapes, self._to_positions = ArmShapes(ArmModel(task.robot)), control in ("position", "relative")
        self.accuracy = np.repeat((*DRIVES_ACCURACY, np.inf, np.inf), dof)
        self._free = self._filter(NO_BOXES)
        self.filters: dict[int, ArmFilter] = {}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`, among new boxes."""
        for i in ids.tolist():
            self.filters[i] = self._filter(getattr(self._task, "boxes", lambda world: NO_BOXES)(i))

    def _filter(self, boxes: Boxes) -> ArmFilter:
        return ArmFilter(
            self._shapes, boxes, self._gains, to_positions=self._to_positions, margin=self._margin,
            period=self._task.control_period,
        )  # fmt: skip

    def states(self) -> Array:
        """Return the states (n, 4 dof) of the arms."""
        arm = self._task.arm
        return np.hstack((*arm.drive_commands, arm.joint_positions, arm.joint_velocities))

    def fast_law(self, states: Array, actions: Array) -> Array:
        """Return the states (..., 4 dof) a period after others, in which joints keep their velocities."""
        return self._moved(braking.drives_after_period, states, actions)

    def law(self, states: Array, actions: Array) -> Array:
        """Return the states (..., 4 dof) a period after others, under actions (..., dof)."""
        return self._moved(braking.after_period, states, actions)

    def _moved(self, kernel: Any, states: Array, actions: Array) -> Array:
        later = np.broadcast_to(states, (*actions.shape[:-1], states.shape[-1])).copy()
        rows = later.reshape(-1, 4, actions.shape[-1])
        kernel(self._free.arm, rows, self._commands(actions, later).reshape(-1, actions.shape[-1]))
        return later

    def _origins(self, states: Array) -> Any:
        """Return the positions (..., dof) to which commands are relative."""
        dof = self._task.robot.dof
        return states[..., 2 * dof : 3 * dof] if self._control == "relative" else 0.0

    def _commands(self, actions: Array, states: Array) -> Array:
        """Return the positions or velocities (..., dof) that actions command in `states` (..., 4 dof)."""
        arm, limits = self._task.arm, self._task.robot.limits
        scale = arm.period if self._control == "delta" else 1.0
        commands = np.clip(actions, arm.action_low, arm.action_high) / scale + self._origins(states)
        return np.clip(commands, limits.lower, limits.upper) if self._to_positions else np.asarray(commands)

    def act(self, world: int, action: Array, state: Array, delay: int = 0) -> Array:
        """Return an action (dof,) if it is safe in a `state` (4 dof,), or else a near one that is."""
        proposal = self._commands(action, state)
        command = self.filters[world](braking.ArmState(*state.reshape(4, -1)), proposal)
        if np.array_equal(command, proposal):
            return action
        scale = self._task.arm.period if self._control == "delta" else 1.0
        return np.asarray((command - self._origins(state)) * scale)


class RoverFilters:
    """Filters of n rovers. A state is that of `armctl.kernels.rover_filter`.

    Raises `ConfigurationError` without physics.
    """

    max_delay = 5
    accuracy = np.array((*[np.inf] * 6, *[RIMS_ACCURACY] * 4))

    def __init__(self, env: TaskVectorEnv, chosen: RoverFilterOptions) -> None:
        task = env.task
        if task.options.dynamics != "physics":
            raise ConfigurationError("the safety filter of rovers is for wheels that slide: use dynamics='physics'")
        self._env, self._task, self._chosen = env, task, chosen
        self._rover = rover_model(task.simulation.model)
        self.filters: dict[int, RoverFilter] = {}
        self._ahead: dict[int, float] = {}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        for i in ids.tolist():
            self._ahead.pop(i, None)
            self.filters[i] = RoverFilter(
                self._rover, margin=self._chosen.margin, people_margin=self._chosen.people_margin,
                drift=self._chosen.drift,
            )  # fmt: skip

    def states(self) -> Array:
        """Return the states (n, 10) of the rovers."""
        state = self._env.perceived().state
        slips = [self._task.rover.slip(i)[:2] for i in range(len(state.poses))]
        velocities, rims = (np.array(values) for values in zip(*slips, strict=True))
        (ahead, turn), cos, sin = state.velocities.T, np.cos(state.poses[:, 2]), np.sin(state.poses[:, 2])
        sideways = velocities[:, 1] * cos - velocities[:, 0] * sin
        return np.column_stack((state.poses, ahead * cos - sideways * sin, ahead * sin + sideways * cos, turn, rims))

    def law(self, states: Array, actions: Array) -> Array:
        """Return the states (..., 10) a period after others, under actions (..., 2)."""
        later = np.broadcast_to(states, (*actions.shape[:-1], states.shape[-1])).copy()
        after_period(self._rover, later.reshape(-1, states.shape[-1]), actions.reshape(-1, 2))
        return later

    fast_law = law

    def act(self, world: int, action: Array, state: Array, delay: int = 0) -> Array:
        """Return an action (2,) if it is safe in a `state` (10,), or else a near one that is."""
        bridge, _, pitch, time = self.inputs(world, state, delay)
        ahead = float(state[3] * np.cos(state[2]) + state[4] * np.sin(state[2]))
        expected = PITCH_PER_SPEED * (self._ahead.get(world, ahead) - ahead)
        self._ahead[world] = ahead
        if delay and abs(expected) > abs(pitch):
            pitch = expected
        further = delay * self._chosen.late_margin
        return self.filters[world](bridge, state, pitch, time, action, further)

    def inputs(self, world: int, state: Array, delay: int = 0) -> tuple[BridgeMap, Array, float, float]:
        """Return the map, the rover's state, its pitch now and the time then, as `RoverFilter` takes them."""
        _, _, pitch = self._task.rover.slip(world)
        time = float(self._task.state.time[world]) + delay * CONTROL_PERIOD
        return self._env.perceived().map(world), state, pitch, time


def rover_model(model: Any) -> Rover:
    """Return how a rover of a world's model slides."""
    wheels = np.array([model.body(PREFIX + name).pos[:2] for name in WHEELS])
    base, wheel = model.geom(PREFIX + "base"), model.geom(PREFIX + WHEELS[0])
    ids = [model.body(PREFIX + name).id for name in PARTS]
    mass = float(model.body_mass[ids].sum())
    moment = float(np.sum(model.body_mass[ids[1:]] * (wheels**2).sum(axis=1))) + float(model.body_inertia[ids[0]].max())
    spin = float(model.body_inertia[ids[1]].max() + model.dof_armature[model.joint(PREFIX + WHEELS[0]).dofadr[0]])
    grip = FRICTION * float(wheel.friction[0]) * GRAVITY
    return Rover(
        wheels, np.array([base.size[:2], wheels.max(axis=0) + wheel.size[:2]]), moment / mass, grip, SLIP,
        float(model.actuator_forcerange[model.actuator(PREFIX + WHEELS[0]).id, 1]) * WHEEL_RADIUS / spin,
        grip * mass / 4 * WHEEL_RADIUS**2 / spin, MAX_WHEEL_SPEED * WHEEL_RADIUS,
        TRACK * WHEEL_SEPARATION_MULTIPLIER / 2, MAX_VELOCITY, CONTROL_PERIOD,
    )  # fmt: skip
