"""Any policy behind a safety filter, which changes actions after which a contact could no longer be avoided.

`filtered(NAME)` is such a policy. The filter knows the robot's limits and shape, and sees where it is and what is
around it (`armctl.control.arm_filter`, `armctl.control.rover_filter`); the policy behind it gets what it declares to
see. `FilteredWorlds` are worlds that filter the actions of a learner.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from armctl.control.arm_filter import ArmFilter
from armctl.control.rover_filter import RoverFilter
from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError
from armctl.core.options import NonNegative, changed_options, options
from armctl.envs import EpisodeVectorEnv, Interface, TaskVectorEnv
from armctl.kernels.braking import ArmState
from armctl.kernels.rover_filter import Rover
from armctl.kinematics import ArmModel, ArmShapes
from armctl.policies.policy import Actions, ControllersFailed, Policy
from armctl.policies.privilege import channels_read
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
from armctl.scene import NO_BOXES, BridgeMap
from armctl.tasks import BridgeTask, ReachTask
from armctl.tasks.bridge import CONTROL_PERIOD

GRAVITY, FRICTION, SLIP = 9.81, 0.85, 0.1
"""m/s^2; the share of the tyres' friction that counts on soft tyres, and m/s from which on it is full, as fitted to the
simulated rover."""


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


class Filters(Protocol):
    """Safety filters of n worlds."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""

    def act(self, world: int, action: Array) -> Array:
        """Return a world's action if it is safe, or else a near one that is."""


class SafetyFilter:
    """The filter of n worlds, which counts what it changes.

    Args:
        env: worlds of armctl's tasks of reaching or of the bridge.
        name: its name in errors.
        chosen: options by name: `ArmFilterOptions` or `RoverFilterOptions`.

    Raises `ConfigurationError` for an environment without a filter, and for a wrong option.

    """

    def __init__(self, env: EpisodeVectorEnv | Interface, name: str, chosen: Mapping[str, Any]) -> None:
        self._filters = _make_filters(env, name, chosen)
        assert isinstance(env, TaskVectorEnv)
        self._shape, self._range = env.single_action_space.shape, np.ptp(env.task.action_range, axis=0)
        self.foresight = env.task.foresight
        self.interventions = np.zeros(env.num_envs, dtype=np.int64)
        """(n,) number of actions that were changed in each world."""
        self.sizes = np.zeros(env.num_envs)
        """(n,) sum of these changes: the largest of an action's numbers, relative to its range."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._filters.reset(ids)

    def __call__(self, actions: Any) -> list[Any]:
        """Return n safe actions."""
        return [self._safe(i, action) for i, action in enumerate(actions)]

    def _safe(self, world: int, action: Any) -> Any:
        """Return a world's safe action; one that is invalid stays as it is, and is told of by others."""
        if np.shape(action) != self._shape or not np.isfinite(action := np.array(action, dtype=float)).all():
            return action
        safe = self._filters.act(world, action)
        if safe is not action:
            self.interventions[world] += 1
            self.sizes[world] += (np.abs(safe - action) / self._range).max()
        return safe


def _make_filters(env: EpisodeVectorEnv | Interface, name: str, chosen: Mapping[str, Any]) -> Filters:
    if not isinstance(env, TaskVectorEnv) or not isinstance(env.task, (ReachTask, BridgeTask)):
        raise ConfigurationError(f"{name}: the safety filter is for armctl's own tasks of reaching and of the bridge")
    if env.normalized:
        raise ConfigurationError(f"{name} acts in physical units, not in worlds with actions='normalized'")
    if isinstance(env.task, ReachTask):
        return ArmFilters(env.task, changed_options(ArmFilterOptions(), chosen, f"option of {name}"))
    return RoverFilters(env, changed_options(RoverFilterOptions(), chosen, f"option of {name}"))


class Filtered:
    """A policy whose actions in n worlds pass a filter."""

    sees: Any = "state"

    def __init__(self, policy: Policy, safety_filter: SafetyFilter) -> None:
        self._policy, self._filter = policy, safety_filter
        self.foresight = tuple(dict.fromkeys((*getattr(policy, "foresight", ()), *safety_filter.foresight)))
        self.reads = tuple(dict.fromkeys((*channels_read(policy), "state")))
        self.training_steps = policy.training_steps
        for fact in ("training_minutes", "training_cost", "family", "kind"):
            if hasattr(policy, fact):
                setattr(self, fact, getattr(policy, fact))
        self.interventions, self.intervention_sizes = safety_filter.interventions, safety_filter.sizes

    @property
    def failures(self) -> Any:
        """Number of solver failures in each world, of the policy behind the filter."""
        return getattr(self._policy, "failures", 0)

    def plans(self, world: int) -> Mapping[str, Array]:
        """Return the plans of the policy behind the filter."""
        return dict(getattr(self._policy, "plans", lambda world: {})(world))

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises what the policy raises."""
        self._filter.reset(ids)
        self._policy.reset(ids)

    def act(self, observations: Observations) -> Actions:
        """Return safe actions (n, ...). Raises what the policy raises."""
        try:
            return np.array(self._filter(self._policy.act(observations)))
        except ControllersFailed as error:
            raise ControllersFailed(error.errors, self._filter(error.actions)) from error


class FilteredWorlds(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Worlds that filter the actions of a learner, which so explores without contacts.

    They are made with a vector environment of armctl's, before its first reset, and the filter's options by name.
    Raises `ConfigurationError` as `SafetyFilter` does.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], **options: Any) -> None:
        super().__init__(env)
        worlds: Any = env.unwrapped
        self._filter = SafetyFilter(worlds, "filter", options)
        self.executed: NDArray[Any] = np.zeros(env.action_space.shape or ())
        """(n, ...) last actions after the filter."""
        self.changed = np.zeros(env.num_envs, dtype=bool)
        """(n,) whether it has changed them."""
        worlds.observers.append(self)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environment's."""
        mode: AutoresetMode = self.env.metadata["autoreset_mode"]
        return mode

    def step(self, actions: ArrayLike) -> Any:
        """Make one control step in every world."""
        previous = self._filter.interventions.copy()
        self.executed = np.array(self._filter(actions))
        self.changed = self._filter.interventions > previous
        return self.env.step(self.executed)

    def began(self, ids: NDArray[np.int32]) -> None:
        """Take note that worlds `ids` have begun a new episode."""
        self._filter.reset(ids)

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Take note of a control step."""


class ArmFilters:
    """Filters of n arms. Raises `ConfigurationError` for torques."""

    def __init__(self, task: ReachTask, chosen: ArmFilterOptions) -> None:
        self._control = control = task.options.control
        if control == "torque":
            raise ConfigurationError("the safety filter of arms goes by their drives, which control='torque' has not")
        self._task, self._margin, dof = task, chosen.margin, task.robot.dof
        self._gains = np.array(task.simulation.model.actuator_gainprm[: 2 * dof, 0]).reshape(2, dof)
        self._shapes, self._to_positions = ArmShapes(ArmModel(task.robot)), control in ("position", "relative")
        self.filters: dict[int, ArmFilter] = {}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`, among new boxes."""
        task = self._task
        for i in ids.tolist():
            boxes = getattr(task, "boxes", lambda world: NO_BOXES)(i)
            self.filters[i] = ArmFilter(
                self._shapes, boxes, self._gains, to_positions=self._to_positions, margin=self._margin,
                period=task.control_period,
            )  # fmt: skip

    def act(self, world: int, action: Array) -> Array:
        """Return an action (dof,) if it is safe, or else a near one that is."""
        arm, limits, state = self._task.arm, self._task.robot.limits, self.state(world)
        origin = {"relative": state.joints}.get(self._control, 0.0)
        scale = arm.period if self._control == "delta" else 1.0
        proposal = np.clip(action, arm.action_low, arm.action_high) / scale + origin
        if self._to_positions:
            proposal = np.clip(proposal, limits.lower, limits.upper)
        command = self.filters[world](state, proposal)
        return action if np.array_equal(command, proposal) else (command - origin) * scale

    def state(self, world: int) -> ArmState:
        """Return the state of a world's arm."""
        arm = self._task.arm
        position, velocity = arm.commands[world].reshape(2, -1).copy()
        return ArmState(position, velocity, arm.joint_positions[world].copy(), arm.joint_velocities[world].copy())


class RoverFilters:
    """Filters of n rovers. Raises `ConfigurationError` without physics."""

    def __init__(self, env: TaskVectorEnv, chosen: RoverFilterOptions) -> None:
        task = env.task
        if task.options.dynamics != "physics":
            raise ConfigurationError("the safety filter of rovers is for wheels that slide: use dynamics='physics'")
        self._env, self._task, self._chosen = env, task, chosen
        self._rover = rover_model(task.simulation.model)
        self.filters: dict[int, RoverFilter] = {}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        for i in ids.tolist():
            self.filters[i] = RoverFilter(
                self._rover, margin=self._chosen.margin, people_margin=self._chosen.people_margin,
                drift=self._chosen.drift,
            )  # fmt: skip

    def act(self, world: int, action: Array) -> Array:
        """Return an action (2,) if it is safe, or else a near one that is."""
        return self.filters[world](*self.inputs(world), action)

    def inputs(self, world: int) -> tuple[BridgeMap, Array, float, float]:
        """Return the map, the rover's state, its pitch and the time in a world, as `RoverFilter` takes them."""
        perceived, state = self._env.perceived(), np.empty(10)
        pose, (ahead, turn) = perceived.state.poses[world], perceived.state.velocities[world]
        velocity, rims, pitch = self._task.rover.slip(world)
        sideways = velocity[1] * np.cos(pose[2]) - velocity[0] * np.sin(pose[2])
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        state[:3], state[5], state[6:] = pose, turn, rims
        state[3:5] = ahead * cos - sideways * sin, ahead * sin + sideways * cos
        return perceived.map(world), state, pitch, float(self._task.state.time[world])


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
