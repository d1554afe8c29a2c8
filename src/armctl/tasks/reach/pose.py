"""Reach a pose: bring the arm's end-effector to a position in an orientation, both new in each episode.

An episode ends as in `armctl.tasks.reach.reach`, as soon as both are within their tolerances, at rest or not. Targets
are certified: a configuration within the joint limits that touches neither the arm itself nor the floor is in the pose.
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import mujoco
import numpy as np
from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.options import Positive, options
from armctl.kernels.target_distance import angles_between
from armctl.kinematics import MinimumTimePose
from armctl.robot_description import ArmDescription
from armctl.robots.arm import PREFIX, build_arm_world
from armctl.tasks.reach.observation import FEATURES, HIDDEN, OBSERVATION, Bounds, rotated
from armctl.tasks.reach.options import ReachOptions
from armctl.tasks.reach.potentials import MinimumTimeToPose
from armctl.tasks.reach.reach import ReachTask
from armctl.tasks.reach.state import ReachState, Term
from armctl.tasks.task import Ids, Potential

AXIS_LENGTH, AXIS_RADIUS = 0.12, 0.006
"""m, of the axes that are drawn at target and end-effector: x red, y green, z blue."""


@dataclass(frozen=True)
class PoseReachState(ReachState):
    """The state, and orientations: the first two axes of a frame, in the base (Zhou et al., CVPR 2019).

    Unlike angles and quaternions, these six numbers are a continuous function of the orientation.
    """

    end_effector_axes: Array
    """(n, 6)"""
    target_axes: Array
    """(n, 6)"""
    angle: Array
    """(n,) rad, between both orientations."""


END_EFFECTOR_AXES: Term = lambda state: state.end_effector_axes  # noqa: E731
TARGET_AXES: Term = lambda state: state.target_axes  # noqa: E731
POSE_OBSERVATION: Mapping[str, Term] = {
    **OBSERVATION,
    "end_effector_axes": END_EFFECTOR_AXES,
    "target_axes": TARGET_AXES,
}


def _all_axes(axes: Array) -> Array:
    """Return all three axes (n, 3, 3), one per row, of the first two (n, 6)."""
    first, second = axes[:, :3], axes[:, 3:]
    return np.stack((first, second, np.cross(first, second)), axis=1)


def _ahead(axes: Array, state: PoseReachState) -> Array:
    return rotated(axes.reshape(-1, 2, 3), -state.base_yaw).reshape(-1, 6)


POSE_FEATURES: Mapping[str, Term] = {
    **FEATURES,
    "end_effector_axes_ahead": lambda state: _ahead(state.end_effector_axes, state),
    "target_axes_ahead": lambda state: _ahead(state.target_axes, state),
    "turn": lambda state: (_all_axes(state.end_effector_axes) @ _all_axes(state.target_axes).swapaxes(1, 2)).reshape(
        -1, 9
    ),
}
POSE_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": POSE_OBSERVATION,
    "features": POSE_FEATURES,
    "full": {**POSE_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order. `turn` is the target's orientation in the end-effector's frame."""


@options
class ReachPoseOptions(ReachOptions):
    """Options of `armctl/ArmPose-v0`. Raises `ConfigurationError` for invalid values."""

    tolerance: Positive = 0.02
    """m, of the position."""
    angle_tolerance: Annotated[float, Field(gt=0, le=180)] = 10.0
    """Degrees, of the orientation."""
    target: Literal["reachable"] = "reachable"
    """A pose is always sampled within reach."""

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = POSE_OBSERVATIONS
    has_goals: ClassVar[bool] = False

    @property
    def lever(self) -> float:
        """Distance (m) that counts as much as an angle of 1 rad."""
        return self.tolerance / math.radians(self.angle_tolerance)


class ReachPoseTask(ReachTask):
    """n arms, each with a target pose."""

    options: ReachPoseOptions
    options_type: ClassVar[type[Any]] = ReachPoseOptions
    state_type: ClassVar[type[Any]] = PoseReachState
    units: ClassVar[Mapping[str, str]] = {**ReachTask.units, "end_effector_axes": "", "target_axes": ""}
    instruction = "Move the end-effector to the target's position, in the target's orientation."
    default_policies: ClassVar[tuple[str, ...]] = (
        "reach_ik",
        "reach_mpc",
        "reach_ruckig",
        "reach_rate",
        "pose_dagger",
        "random",
    )
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        "distance": ReachTask.potentials["distance"],
        "ik": MinimumTimeToPose,
    }

    state: PoseReachState

    certificates: Array
    """(n, dof) rad: a free configuration in each target's pose."""

    @property
    def lever(self) -> float:
        """Distance (m) that counts as much as an angle of 1 rad."""
        return self.options.lever

    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Move arms to home, and targets to random poses."""
        super().reset(ids, rngs)
        self._place_targets(ids)
        self._update_state(self._action)
        self._target_query.nearest[ids] = np.maximum(self.state.distance, self.lever * self.state.angle)[ids]
        self._update_state(self._action)

    def min_time(self, world: int) -> float:
        """Return a lower bound on the time to the target within the joint limits, without regard to obstacles, s.

        It is the least time into the ball of places around the tolerances of both position and orientation.
        """
        state, q, velocity = self.state, self.arm.joint_positions[world], self.arm.joint_velocities[world]
        centre = self._minimum_time.centre(self._targets[world], state.target_axes[world])
        return self._minimum_time.min_time(q, centre, math.sqrt(2) * self.options.tolerance, velocity)

    def goal_distances(self) -> Array:
        """Return the distances (n,) of the positions, m, plus `lever` times the angles between the orientations."""
        return self.state.distance + self.lever * self.state.angle

    @functools.cached_property
    def _minimum_time(self) -> MinimumTimePose:
        return MinimumTimePose(self._workspace.model, self.lever)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, draw_axes)

    def _bind_arrays(self) -> None:
        super()._bind_arrays()
        rotations, model = self.simulation.array("xmat").reshape(self.n, -1, 9), self.simulation.model
        tip, target = model.body(PREFIX + self.arm.description.tip).id, model.body("target").id
        self._rotations, self._target_rotations = rotations[:, tip], rotations[:, target]
        self._quaternions = self.simulation.array("mocap_quat")[:, 0]
        self.certificates = np.tile(self.arm.description.home, (self.n, 1))
        self._target_query = self._target_query._replace(rotations=np.zeros((self.n, 9)), lever=self.lever)

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        pose, self.certificates[world] = self._workspace.sample_pose(rng, self.options.tolerance)
        self._set_target(world, pose)

    def _set_target(self, world: int, pose: Array) -> None:
        self._targets[world] = pose[:3, 3]
        mujoco.mju_mat2Quat(self._quaternions[world], pose[:3, :3].ravel())

    def _place_targets(self, ids: Ids | None) -> None:
        super()._place_targets(ids)
        np.copyto(self._target_query.rotations, self._target_rotations)

    def _state_values(self, action: Array) -> dict[str, Any]:
        angles = np.empty(self.n)
        angles_between(np.ascontiguousarray(self._rotations), self._target_query.rotations, angles)
        return super()._state_values(action) | {
            "end_effector_axes": first_axes(self._rotations),
            "target_axes": first_axes(self._target_rotations),
            "angle": angles,
        }

    def _part_bounds(self) -> dict[Term, Bounds]:
        unit = (-1.0 - 1e-6, 1.0 + 1e-6)
        axes = (END_EFFECTOR_AXES, TARGET_AXES, *list(POSE_FEATURES.values())[len(FEATURES) :])
        return super()._part_bounds() | dict.fromkeys(axes, unit)


def first_axes(rotations: Array) -> Array:
    """Return the first two columns, one after the other, (n, 6), of rotation matrices (n, 9)."""
    return np.concatenate((rotations[:, 0::3], rotations[:, 1::3]), axis=1)


def draw_axes(spec: Any, description: ArmDescription) -> None:
    """Draw axes at target and end-effector, which collide with nothing."""
    for body in (spec.body("target"), spec.body(PREFIX + description.tip)):
        for axis in range(3):
            end, colour = AXIS_LENGTH * np.eye(3)[axis], 0.1 + 0.8 * np.eye(3)[axis]
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[AXIS_RADIUS, 0, 0],
                fromto=[0.0, 0.0, 0.0, *end],
                rgba=[*colour, 1.0],
                contype=0,
                conaffinity=0,
                mass=0,
            )
