"""Reach: bring the arm's end-effector to a target, which is at a new place in each episode."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, Strict

from armctl.disturbances import ARM
from armctl.errors import ConfigurationError
from armctl.kinematics import THOROUGH, ArmModel, MinimumTimeReach, Workspace
from armctl.options import options
from armctl.robot_description import ArmDescription, load_arm
from armctl.robot_description.joint_profiles import TICK
from armctl.robots import Arm, build_arm_world
from armctl.robots.arm import PREFIX, speed_limits
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation
from armctl.tasks.reach.potentials import MinimumTime, MpcCost
from armctl.tasks.reach.state import OBSERVATION, REWARD, ReachState, Term, observation_slices
from armctl.tasks.task import (
    FeatureSpec,
    Ids,
    LearnerView,
    MotionSample,
    Outcome,
    Potential,
    RewardTerms,
    Task,
    check_reward_terms,
)

Array = NDArray[np.float64]

CONTROL_PERIOD = 0.04
"""Seconds between control steps: 25 Hz."""
LARGEST_RELATIVE_MOVE = 0.5
"""rad: a learner's action moves joints by at most this from their present positions. At its speed limit, a UR5 joint
travels 0.126 rad in a control step, and 0.33 rad until it stops."""

Worlds = NDArray[np.int32] | slice


def _ordered(box: "Box") -> "Box":
    if not all(low <= high for low, high in zip(*box, strict=True)):
        raise ValueError("a box is its lowest and highest corner (x, y, z)")
    return box


Corner = Annotated[tuple[float, float, float], Strict(False)]
Box = Annotated[tuple[Corner, Corner], Strict(False)]
Terms = Annotated[Mapping[str, Term], Field(min_length=1)]


class ReachOutcome(Outcome):
    """How an episode of a reach task ends."""

    TIMEOUT = 0
    REACHED = 1, True
    HELD = 2, True
    COLLIDED = 3


@options
class ReachOptions:
    """Options of `armctl/ArmReach-v0`. Raises `ConfigurationError` for invalid values."""

    robot: str | Path | ArmDescription = "ur5"
    """`ur3`, `ur5`, `ur10`, the path of a URDF file, or the result of `armctl.load_arm`."""
    tip: str | None = None
    """The end-effector's link, for a URDF file in which several links could be it."""
    control: Literal["position", "delta", "velocity", "torque"] = "position"
    """Control mode: the meaning of an action (see `armctl.robots.Arm`)."""
    tolerance: Annotated[float, Field(gt=0)] = 0.05
    """Radius of the target sphere, m: within it, the target is reached."""
    target: Literal["reachable", "box"] = "reachable"
    """`reachable`: uniform over the arm's workspace. `box`: uniform in `target_box`, possibly out of reach (see
    `info["feasible"]`)."""
    target_box: Annotated[Box, AfterValidator(_ordered)] = ((-1.0, -1.0, 0.05), (1.0, 1.0, 1.0))
    """Lowest and highest corner of the box, m."""
    reward: Terms = field(default_factory=lambda: REWARD)
    """Named reward terms."""
    observation: Terms = field(default_factory=lambda: OBSERVATION)
    """Named parts of the observation, in order."""


class ReachTask(Task):
    """n arms, each with its target."""

    options_type: ClassVar[type[Any]] = ReachOptions
    outcomes = ReachOutcome
    default_policies: ClassVar[tuple[str, ...]] = ("reach_ik", "reach_ppo", "random")
    disturbances = ARM
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        **Task.potentials,
        "ik": MinimumTime,
        "mpc": MpcCost,
    }
    joints: JointSamples

    def __init__(self, n: int, options: ReachOptions, threads: int = 0) -> None:
        self.options = options
        description = load_arm(options.robot) if options.tip is None else load_arm(options.robot, tip=options.tip)
        model = self._build(description)
        model.geom("target").size[:] = options.tolerance
        super().__init__(Simulation(model, n, threads, speed_limits(description)), CONTROL_PERIOD)
        self.arm = Arm(self.simulation, description, options.control, CONTROL_PERIOD)
        self.joints = self.arm.joints
        self._workspace = Workspace(ArmModel(description))
        self.simulation.model.camera(self.camera).pos[:] *= self._workspace.radius  # the MJCF's suits a reach of 1 m
        self._targets = self.simulation.array("mocap_pos")[:, 0]
        self._target_velocities = np.zeros((n, 3))
        self._feasible = np.ones(n, dtype=bool)
        self._action = np.zeros((n, description.dof))
        self._distance, self._nearest = np.zeros(n), np.full(n, np.inf)
        self._bind_arrays()
        self.simulation.reset()
        self.simulation.refresh()
        self._update_state(self._action)
        check_reward_terms(self.reward_terms(), n)
        self.reward_functions = self.options.reward
        self._check_observation(n)
        low, high = np.float32(self.arm.action_low), np.float32(self.arm.action_high)
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        size = self.observe().shape[1:]
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, size, dtype=np.float32)

    @property
    def interface(self) -> dict[str, str]:
        """Robot, control, and the parts of the observation."""
        return {
            "robot": self.arm.description.name,
            "control": self.arm.control,
            "observation": ", ".join(self.options.observation),
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
    def learner_view(self) -> LearnerView:
        """Features: offsets, sines and cosines. Actions: relative to the present joint positions.

        Raises `ConfigurationError` for an observation that does not begin with the parts of `OBSERVATION`.
        """
        if list(self.options.observation)[: len(OBSERVATION)] != list(OBSERVATION):
            raise ConfigurationError(f"learners need an observation that begins with {', '.join(OBSERVATION)}")
        low, high, dof = self.action_space.low, self.action_space.high, self.arm.description.dof
        rest = list(self.observation_parts().items())[len(OBSERVATION) :]
        parts = {name: part.shape[1] for name, part in rest}
        invariant = FeatureSpec("base_yaw_invariant", {"dof": dof, "parts": parts})
        absolute = self.arm.control == "position"
        return LearnerView(
            np.maximum(low, -np.pi) if absolute else low,
            np.minimum(high, np.pi) if absolute else high,
            relative_to=observation_slices(dof)["joint_positions"] if absolute else None,
            largest_move=LARGEST_RELATIVE_MOVE,
            features=FeatureSpec("reach", {"dof": dof}),
            invariant_features=invariant if self._workspace.model.base_yaw_is_vertical else None,
        )

    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Move arms to home, and targets to random positions."""
        self.simulation.reset(ids)
        self._sample_episodes(ids, rngs)
        self.simulation.refresh(ids)
        self._action[ids], self._nearest[ids] = 0.0, self._distances()[ids]
        self._update_state(self._action)
        self._distance[ids] = self.state.distance[ids]

    def command(self, actions: Array) -> None:
        """Command actions (n, dof), in the unit of `ReachOptions.control`."""
        self._action = actions
        self._distance = self.state.distance
        self.arm.command(actions)

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        ticks = round(CONTROL_PERIOD / TICK)
        self._nearest = np.full_like(self._distance, np.inf)
        for _ in range(ticks):
            self.arm.drive()
            self.simulation.step(self.substeps // ticks, ids)
            self.joints.take()
            self._on_tick(slice(None) if ids is None else ids)

    def observation_parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """The parts of `ReachOptions.observation`, (n, k) each."""
        return {name: part(self.state) for name, part in self.options.observation.items()}

    def observe(self, ids: Ids | None = None) -> NDArray[np.float32]:
        """Observations (n, k): the parts side by side."""
        observations = np.concatenate(list(self.observation_parts().values()), axis=1, dtype=np.float32)
        return observations if ids is None else observations[ids]

    def reward_terms(self) -> RewardTerms:
        """The terms of `ReachOptions.reward`."""
        self._update_state(self._action)
        return {name: np.array(term(self.state), dtype=float) for name, term in self.options.reward.items()}

    def outcome(self) -> NDArray[np.int8]:
        """`REACHED`; `TIMEOUT` while the episode goes on."""
        return self.state.reached * np.int8(ReachOutcome.REACHED)

    def info(self) -> dict[str, NDArray[Any]]:
        """`feasible`: whether the arm can reach the target (see `armctl.kinematics.Workspace.reachable`)."""
        return {"feasible": self._feasible.copy()}

    def least_time(self, world: int) -> float:
        """Least time to the target within the joint limits, without regard to obstacles, s."""
        q, velocity, target = (
            array[world] for array in (self.arm.joint_positions, self.arm.joint_velocities, self._targets)
        )
        return self._minimum_time.least_time(q, target, self.options.tolerance, velocity)

    def goal_distances(self) -> Array:
        """(n,) distance from the end-effectors to their targets, m."""
        return self.state.distance

    def motion(self) -> MotionSample:
        """The arms' motion. A contact is a present one of the arm with the floor or itself."""
        arm = self.arm
        return MotionSample(
            arm.end_effector_positions.copy(),
            arm.joint_positions.copy(),
            self._contact(),
            self.joints.since_last_step(),
        )

    @functools.cached_property
    def _minimum_time(self) -> MinimumTimeReach:
        return MinimumTimeReach(self._workspace.model, THOROUGH)

    def _check_observation(self, n: int) -> None:
        for name, part in self.observation_parts().items():
            if part.ndim != 2 or len(part) != n:
                raise ConfigurationError(f"the observation's {name!r} has shape ({n}, k), not {np.shape(part)}")

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control)

    def _bind_arrays(self) -> None:
        """Bind further arrays of the simulation."""
        self._contacts = self.simulation.array("ncon")

    def _contact(self) -> NDArray[np.bool_]:
        """(n,) whether the arm has a forbidden contact."""
        return np.asarray(self._contacts > 0)

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

    def _on_tick(self, worlds: Worlds) -> None:
        """Called after each tick of the drives in these worlds."""
        self._nearest = np.minimum(self._nearest, self._distances())

    def _update_state(self, action: Array) -> None:
        self.state = ReachState(
            self.arm.end_effector_positions,
            self.arm.joint_positions,
            self.arm.joint_velocities,
            self._targets,
            self._distances(),
            self._distance,
            self._nearest <= self.options.tolerance,
            self._target_velocities,
            action,
        )

    def _distances(self) -> Array:
        offset = self._targets - self.arm.end_effector_positions
        return np.asarray(np.sqrt((offset * offset).sum(axis=1)))
