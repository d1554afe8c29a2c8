"""Reach: bring the arm's end-effector to a target, which is at a new place in each episode."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError
from armctl.disturbances import ARM
from armctl.kernels.control_step import Parts, TargetQuery
from armctl.kernels.target_distance import distances_as_observed
from armctl.kinematics import THOROUGH, ArmModel, MinimumTimeReach, Workspace
from armctl.robot_description import ArmDescription, load_arm
from armctl.robot_description.joint_profiles import TICK
from armctl.robots import Arm, build_arm_world
from armctl.robots.arm import LARGEST_RELATIVE_MOVE, PREFIX, speed_limits
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation
from armctl.simulation.control_step import NO_PARTS
from armctl.simulation.impacts import DEPTH
from armctl.tasks.goals import Goals
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.reach.observation import (
    HIDDEN,
    LENGTH_MARGIN,
    OBSERVATION,
    Bounds,
    bounds_of_parts,
    observation_slices,
    position_goals,
)
from armctl.tasks.reach.options import ReachOptions
from armctl.tasks.reach.potentials import MinimumTime, MpcCost
from armctl.tasks.reach.state import STEP_REWARD, ReachState, Term
from armctl.tasks.task import (
    Ids,
    MotionSample,
    Outcome,
    Potential,
    RewardTerms,
    Task,
    check_reward_terms,
)

CONTROL_PERIOD = 0.04
"""Seconds between control steps: 25 Hz."""
TICKS = round(CONTROL_PERIOD / TICK)
GOAL_SPACES = "achieved_goal", "desired_goal"
"""End-effector and target, (3,) m each: what a goal-conditioned learner gets beside the observation."""


class ReachOutcome(Outcome):
    """Outcome of an episode of a reach task."""

    TIMEOUT = 0
    REACHED = 1, True
    HELD = 2, True
    COLLIDED = 3


class ReachTask(Task):
    """n arms, each with its target."""

    options_type: ClassVar[type[Any]] = ReachOptions
    outcomes: ClassVar[type[Outcome]] = ReachOutcome
    possible_outcomes: ClassVar[tuple[Outcome, ...]] = (ReachOutcome.REACHED, ReachOutcome.TIMEOUT)
    state_type: ClassVar[type[ReachState]] = ReachState
    instruction: ClassVar[str] = "Move the end-effector to the target."
    default_policies: ClassVar[tuple[str, ...]] = ("reach_ik", "reach_ppo", "random")
    disturbances = ARM
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        **Task.potentials,
        "ik": MinimumTime,
        "mpc": MpcCost,
    }
    interface_options = Task.interface_options | {"control", "observation", "goal"}
    units: ClassVar[Mapping[str, str]] = {
        "end_effector_position": "m", "joint_positions": "rad", "joint_velocities": "rad/s", "target_position": "m",
        "position": "joint positions, rad", "relative": "joint positions less the present ones, rad",
        "delta": "change of the joints' goals, rad", "velocity": "joint velocities, rad/s", "torque": "torques, N m",
    }  # fmt: skip
    """Units of parts of the observation, and of an action by the control mode."""
    stops_at_target: ClassVar[bool] = True
    """True if a world stands still from the tick on in which its end-effector enters the sphere."""
    joints: JointSamples

    def __init__(self, n: int, options: ReachOptions, threads: int = 0) -> None:
        self.options = options
        description = load_arm(
            options.robot, tip=options.tip, home=options.home, max_velocity=options.max_velocity,
            max_effort=options.max_effort, density=options.density,
        )  # fmt: skip
        model = self._build(description)
        model.geom("target").size[:] = options.tolerance
        super().__init__(Simulation(model, n, threads, speed_limits(description)), CONTROL_PERIOD)
        self.arm = Arm(self.simulation, description, options.control, CONTROL_PERIOD)
        self.joints, self.rollout_worlds = self.arm.joints, self.arm.rollout_worlds
        self._workspace = Workspace(ArmModel(description))
        self.simulation.model.camera(self.camera).pos[:] *= self._workspace.radius  # the MJCF's suits a reach of 1 m
        self._targets = self.simulation.array("mocap_pos")[:, 0]
        self._target_velocities = np.zeros((n, 3))
        self._feasible = np.ones(n, dtype=bool)
        self._action = np.zeros((n, description.dof))
        self._distance = np.zeros(n)
        tip = model.body(PREFIX + description.tip).id
        stop_within = options.tolerance if self.stops_at_target else -1.0
        self._target_query = TargetQuery(
            tip, np.zeros((1, n, 3)), stop_within, np.full((TICKS, n), np.inf), np.full(n, np.inf),
            np.zeros((TICKS, n, 3)),
        )  # fmt: skip
        self._contacts_part = NO_PARTS.contacts
        self._bind_arrays()
        self.simulation.reset()
        self.simulation.refresh()
        self._update_state(self._action)
        self.reward_functions = self.options.reward_functions
        check_reward_terms(self.reward_terms(), n)
        self._check_observation(n)
        low, high = np.float32(self.arm.action_low), np.float32(self.arm.action_high)
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.observation_space = self._make_observation_space()

    @property
    def interface(self) -> dict[str, str]:
        """Robot, control, and the parts of the observation."""
        return {
            "robot": self.arm.description.name,
            "control": self.arm.control,
            "observation": ", ".join((*self.options.parts, *(GOAL_SPACES if self.options.goal else ()))),
        }

    @property
    def robot(self) -> ArmDescription:
        """The arm's description."""
        return self.arm.description

    @property
    def idle_action(self) -> Array:
        """Stay at home: the home joint positions, or zeros."""
        return self.arm.description.home if self.arm.control == "position" else super().idle_action

    @property
    def payload_body(self) -> str:
        """The end-effector."""
        return PREFIX + self.arm.description.tip

    @property
    def action_range(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Range of joint positions, at most half a turn in each direction."""
        low, high = super().action_range
        positions = self.arm.control == "position"
        return (np.maximum(low, -np.pi), np.minimum(high, np.pi)) if positions else (low, high)

    @property
    def learner_view(self) -> LearnerView:
        """Features: offsets, sines and cosines, unless they are observed. Actions: may be relative to joint positions.

        Raises `ConfigurationError` for an observation that does not begin with the parts of `OBSERVATION`.
        """
        if self.options.observation == "features" and not self.options.goal:
            return LearnerView()
        if list(self.options.parts)[: len(OBSERVATION)] != list(OBSERVATION):
            raise ConfigurationError(f"learners need an observation that begins with {', '.join(OBSERVATION)}")
        dof = self.arm.description.dof
        rest = list(self.observation_parts().items())[len(OBSERVATION) :]
        parts = {name: part.shape[1] for name, part in rest}
        invariant = FeatureSpec("base_yaw_invariant", {"dof": dof, "parts": parts})
        absolute = self.arm.control == "position"
        return LearnerView(
            relative_to=observation_slices(dof)["joint_positions"] if absolute else None,
            largest_move=LARGEST_RELATIVE_MOVE,
            features=FeatureSpec("reach", {"dof": dof}),
            invariant_features=invariant if self._workspace.model.base_yaw_is_vertical else None,
        )

    @property
    def goals(self) -> Goals | None:
        """End-effector and target."""
        return position_goals(self.options.tolerance)

    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Move arms to home, and targets to random positions."""
        self.simulation.reset(ids)
        self._sample_episodes(ids, rngs)
        self.simulation.refresh(ids)
        self._action[ids], self._target_query.nearest[ids] = 0.0, self._distances()[ids]
        self._update_state(self._action)
        self._distance[ids] = self.state.distance[ids]

    def command(self, actions: Array) -> None:
        """Command actions (n, dof), in the unit of `ReachOptions.control`."""
        self._action = actions
        self._distance = self.state.distance
        self.arm.command(actions)

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self._place_targets(ids)
        self.simulation.control_step(TICKS, self.substeps // TICKS, ids, self._parts)

    def observation_parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """Return the parts of `ReachOptions.parts`, (n, k) each."""
        return {name: part(self.state) for name, part in self.options.parts.items()}

    def observe(self, ids: Ids | None = None) -> Observations:
        """Return observations (n, k): the parts side by side; with `goal`, a dict of these and both goals."""
        observation = np.concatenate(list(self.observation_parts().values()), axis=1, dtype=np.float32)
        rows = slice(None) if ids is None else ids
        if not self.options.goal:
            return observation[rows]
        places = (self.state.end_effector_position, self.state.target_position)
        goals = {name: place[rows].astype(np.float32) for name, place in zip(GOAL_SPACES, places, strict=True)}
        return {"observation": observation[rows], **goals}

    def reward_terms(self) -> RewardTerms:
        """Return the terms of `ReachOptions.reward`."""
        self._update_state(self._action)
        return {name: np.asarray(term(self.state), dtype=float) for name, term in self.reward_functions.items()}

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """Return the reward for another goal; goals are (3,) or (n, 3) m. `info` is not used."""
        reached = self.compute_terminated(achieved_goal, desired_goal, info)
        return STEP_REWARD + self.options.goal_reward * reached

    def compute_terminated(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """Return whether the episode would have ended: the end-effector is within the tolerance of the goal."""
        return position_goals(self.options.tolerance).reached(achieved_goal, desired_goal)

    def compute_truncated(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """Return False: the time limit has nothing to do with the goal."""
        return np.zeros(np.shape(desired_goal)[:-1], dtype=bool)[()]

    def outcome(self) -> NDArray[np.int8]:
        """Return `REACHED`, which is 1; `TIMEOUT` while the episode goes on."""
        return self.state.reached.astype(np.int8)

    def info(self) -> dict[str, NDArray[Any]]:
        """Return `feasible`: whether the arm can reach the target (see `armctl.kinematics.Workspace.reachable`)."""
        return {"feasible": self._feasible.copy()}

    def min_time(self, world: int) -> float:
        """Return the least time to the target within the joint limits, without regard to obstacles, s."""
        q, velocity = self.arm.joint_positions[world], self.arm.joint_velocities[world]
        return self._minimum_time.min_time(q, self._targets[world], self.options.tolerance, velocity)

    def goal_distances(self) -> Array:
        """Return the distances (n,) from the end-effectors to their targets, m."""
        return self.state.distance

    def motion(self) -> MotionSample:
        """Return the arms' motion. A contact is a present one of the arm with the floor or itself."""
        arm = self.arm
        return MotionSample(
            arm.end_effector_positions.copy(),
            arm.joint_positions.copy(),
            self._contact(),
            self.joints.since_last_step(),
            self._target_query.positions.copy(),
        )

    @functools.cached_property
    def _parts(self) -> Parts:
        parts = NO_PARTS._replace(drives=self.arm.drives, samples=self.joints.part)
        return parts._replace(target_query=self._target_query, contacts=self._contacts_part)

    @functools.cached_property
    def _minimum_time(self) -> MinimumTimeReach:
        return MinimumTimeReach(self._workspace.model, THOROUGH)

    def _check_observation(self, n: int) -> None:
        for name, part in self.observation_parts().items():
            if part.ndim != 2 or len(part) != n:
                raise ConfigurationError(f"the observation's {name!r} has shape ({n}, k), not {np.shape(part)}")

    def _make_observation_space(self) -> gymnasium.spaces.Space[Any]:
        part_bounds, parts = self._part_bounds(), self.options.parts
        bounds = [
            [np.broadcast_to(bound, values.shape[1]) for bound in part_bounds.get(parts[name], (-np.inf, np.inf))]
            for name, values in self.observation_parts().items()
        ]
        space = gymnasium.spaces.Box(*np.concatenate(bounds, axis=1, dtype=np.float32), dtype=np.float32)
        if not self.options.goal:
            return space
        places = [part_bounds[OBSERVATION[name]] for name in ("end_effector_position", "target_position")]
        boxes = np.array(places, dtype=np.float32)
        place = gymnasium.spaces.Box(boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0), dtype=np.float32)
        return gymnasium.spaces.Dict({"observation": space, **dict.fromkeys(GOAL_SPACES, place)})

    def _part_bounds(self) -> dict[Term, Bounds]:
        """Return bounds of the parts that an observation may have."""
        room, centre = LENGTH_MARGIN * self._workspace.radius, self._workspace.centre
        around = centre - room, centre + room
        targets = self.options.target_box if self.options.target == "box" else around
        bounds = bounds_of_parts(self.arm.description, around, targets)
        return bounds | {HIDDEN["commands"]: ((), ())} if self.arm.control == "torque" else bounds

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control)

    def _bind_arrays(self) -> None:
        """Bind further arrays of the simulation."""
        self._sensors, self._depth = self.simulation.array("sensordata"), self.simulation.model.sensor(DEPTH).adr[0]

    def _contact(self) -> NDArray[np.bool_]:
        """Return (n,) whether the arm has a forbidden contact."""
        return np.asarray(self._sensors[:, self._depth] < 0)

    def _sample_episodes(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Sample the random parts of the new episodes of worlds `ids`."""
        for i, rng in zip(ids, rngs, strict=True):
            self._sample_episode(int(i), rng)

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        """Sample the random part of a world's new episode."""
        if self.options.target == "box":
            self._targets[world] = rng.uniform(*self.options.target_box)
            self._feasible[world] = self._workspace.reachable(self._targets[world], self.options.tolerance)
        else:
            self._targets[world] = self._workspace.sample(rng, clearance=self.options.tolerance)

    def _place_targets(self, ids: Ids | None) -> None:
        """Set where the targets are after each tick of the next control step of these worlds."""
        self._target_query.targets[0] = self._targets

    def _update_state(self, action: Array) -> None:
        values, self.state = self._state_values(action), object.__new__(self.state_type)
        vars(self.state).update(values)  # without `__init__`: that of a frozen class takes 2 us

    def _state_values(self, action: Array) -> dict[str, Any]:
        """Return the fields of `state_type`."""
        return {
            "end_effector_position": self.arm.end_effector_positions,
            "joint_positions": self.arm.joint_positions, "joint_velocities": self.arm.joint_velocities,
            "target_position": self._targets, "target_velocity": self._target_velocities,
            "distance": self._distances(), "previous_distance": self._distance,
            "reached": self._target_query.nearest <= self.options.tolerance,
            "action": action, "drive_commands": self.arm.drive_commands,
            "base_turns": self._workspace.model.base_yaw_is_vertical,
        }  # fmt: skip

    def _distances(self) -> Array:
        distances = np.empty(self.n)
        distances_as_observed(self.arm.end_effector_positions, self._targets, distances)
        return distances
