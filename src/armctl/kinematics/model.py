"""The controllers' model of an arm: Pinocchio, built from one URDF."""

import copy
from functools import cached_property
from pathlib import Path

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.kinematics.obstacles import add_boxes
from armctl.robot_description import ArmDescription, load_arm
from armctl.robot_description.collision_pairs import FLOOR, add_collision_pairs, capsule_geometry, link_frame
from armctl.robot_description.joint_profiles import travel_time
from armctl.scene import NO_BOXES, Boxes

Array = NDArray[np.float64]


class ArmModel:
    """Forward kinematics, Jacobians, limits and collisions of one arm.

    Joint positions q are (dof,) rad; positions are in the frame of the arm's base, m. Not thread-safe.
    """

    def __init__(self, robot: str | Path | ArmDescription = "ur5") -> None:
        self.description = load_arm(robot)
        self.limits = self.description.limits
        self.dof = self.description.dof
        self.home = self.description.home
        self.pinocchio = pinocchio.buildModelFromXML(self.description.urdf)
        self.tip = link_frame(self.pinocchio, self.description.tip)
        self._data = self.pinocchio.createData()
        self.boxes = NO_BOXES
        """Obstacles."""
        self._shapes = capsule_geometry(self.pinocchio, self.description.capsules)
        add_collision_pairs(self._shapes, self.description.collision_pairs)
        self._contacts = self._shapes.createData()
        self.axes = self._joint_axes()
        """Axis of each joint in its own frame, (dof, 3)."""
        self._chain = self._joint_chain()
        self._tip_offset = np.array(self.pinocchio.frames[self.tip].placement.translation)
        self._base_shapes = [
            shape for shape in self._shapes.geometryObjects if shape.parentJoint == 0 and shape.name != FLOOR
        ]
        self.shoulder = np.array(self.pinocchio.jointPlacements[1].translation)
        """Origin of the first joint, (3,) m."""

    def among(self, boxes: Boxes) -> "ArmModel":
        """The same arm among boxes: `is_free` then takes them into account."""
        model = copy.copy(self)
        model.boxes = boxes
        model._data = self.pinocchio.createData()
        model._shapes = self._shapes.copy()
        add_boxes(model._shapes, boxes)
        model._contacts = model._shapes.createData()
        return model

    def placement(self, q: Array) -> pinocchio.SE3:
        """Pose of the end-effector as a Pinocchio object, valid until the next call."""
        pinocchio.forwardKinematics(self.pinocchio, self._data, q)
        return pinocchio.updateFramePlacement(self.pinocchio, self._data, self.tip)

    def pose(self, q: Array) -> Array:
        """Pose of the end-effector, homogeneous (4, 4)."""
        return np.asarray(self.placement(q).homogeneous)

    def position(self, q: Array) -> Array:
        """Position of the end-effector, (3,) m."""
        return np.array(self.placement(q).translation)

    def jacobian(self, q: Array) -> Array:
        """World-aligned Jacobian at the end-effector, (6, dof): linear (m/rad) above angular (rad/rad)."""
        return self._jacobian(q, pinocchio.LOCAL_WORLD_ALIGNED)

    def local_jacobian(self, q: Array) -> Array:
        """Jacobian (6, dof) in the end-effector's own frame: linear (m/rad) above angular (rad/rad)."""
        return self._jacobian(q, pinocchio.LOCAL)

    def positions(self, q: Array) -> Array:
        """End-effector positions (..., 3) m of a batch (..., dof), without a Python loop over it."""
        return self.positions_and_jacobians(q)[0]

    def positions_and_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Positions (..., 3) m and linear Jacobians (..., 3, dof) m/rad of a batch (..., dof)."""
        frames = self.joint_frames(q)
        tip = self.tip_positions(frames)
        jacobians = cross(self.joint_axes(frames), tip[..., None, :] - frames[..., :3, 3])
        return tip, np.swapaxes(jacobians, -1, -2)

    def joint_frames(self, q: Array) -> Array:
        """Homogeneous poses (..., dof, 4, 4) of the frames that the joints move, for q (..., dof)."""
        q = np.asarray(q, dtype=float)[..., None, None]
        steps = self._chain[0] + np.sin(q) * self._chain[1] + (1 - np.cos(q)) * self._chain[2]
        for i in range(1, self.dof):
            np.matmul(steps[..., i - 1, :, :], steps[..., i, :, :].copy(), out=steps[..., i, :, :])
        return np.asarray(steps)

    def joint_axes(self, frames: Array) -> Array:
        """Joint axes (..., dof, 3) in the base frame, at `joint_frames` (..., dof, 4, 4)."""
        return np.asarray((frames[..., :3, :3] @ self.axes[:, :, None])[..., 0])

    def tip_positions(self, frames: Array) -> Array:
        """End-effector positions (..., 3) m at `joint_frames` (..., dof, 4, 4)."""
        return np.asarray(frames[..., -1, :3, :3] @ self._tip_offset + frames[..., -1, :3, 3])

    def is_free(self, q: Array) -> bool:
        """Whether q is collision-free: the capsules touch neither each other, nor the floor, nor a box."""
        return not pinocchio.computeCollisions(self.pinocchio, self._data, self._shapes, self._contacts, q, True)

    def box_distances(self, q: Array, boxes: Boxes) -> Array:
        """Distance (k,) m of each box from the whole arm at `q` (dof,): 0 or below in contact."""
        pinocchio.updateGeometryPlacements(self.pinocchio, self._data, self._shapes, self._contacts, q)
        links = [
            (shape.geometry, coal.Transform3s(placement.rotation, placement.translation))
            for shape, placement in zip(self._shapes.geometryObjects, self._contacts.oMg, strict=True)
            if isinstance(shape.geometry, coal.Capsule)
        ]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        distances = np.full(len(boxes), np.inf)
        for i, (centre, half_size, turn) in enumerate(
            zip(boxes.centres, boxes.half_sizes, boxes.rotations, strict=True)
        ):
            box, placement = coal.Box(*(2 * half_size)), coal.Transform3s(turn, centre)
            for link, at in links:
                result.clear()
                distances[i] = min(distances[i], coal.distance(link, at, box, placement, request, result))
        return distances

    def base_distance(self, position: Array) -> float:
        """Distance (m) of `position` (3,) from the arm's fixed links; infinite if they have no shape."""
        point, placement = coal.Sphere(0.0), coal.Transform3s(np.eye(3), position)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        distances = [
            coal.distance(shape.geometry, coal.Transform3s(shape.placement), point, placement, request, result)
            for shape in self._base_shapes
        ]
        return min(distances, default=np.inf)

    def within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Whether all joints of q (..., dof) are within their position limits, (...)."""
        return np.asarray(np.all((q >= self.limits.lower) & (q <= self.limits.upper), axis=-1))

    def random_configurations(self, rng: np.random.Generator, count: int) -> Array:
        """Configurations (count, dof), uniform within the joint limits and +-pi."""
        low, high = np.maximum(self.limits.lower, -np.pi), np.minimum(self.limits.upper, np.pi)
        return rng.uniform(low, high, (count, self.dof))

    def nearest_turn(self, q: Array, seed: Array) -> Array:
        """The same configurations, each joint shifted by whole turns to be near `seed`, as far as its limits allow."""
        turn = 2 * np.pi
        near = q + turn * np.round((seed - q) / turn)
        return near + turn * ((near < self.limits.lower).astype(float) - (near > self.limits.upper))

    @cached_property
    def base_yaw_is_vertical(self) -> bool:
        """Whether the first joint turns the end-effector about the vertical through the origin."""
        q = self.home + np.array([[0.3], [0.3]])
        q[1, 0] += 1.0
        (x, y, z), after = self.positions(q)
        cos, sin = np.cos(1.0), np.sin(1.0)
        return bool(np.allclose((cos * x - sin * y, sin * x + cos * y, z), after, atol=1e-4))

    def least_time(self, start: Array, goal: Array) -> Array:
        """Seconds in which all joints can move from rest at `start` to `goal` (..., dof), without stopping there."""
        return np.asarray(np.max(travel_time(goal - start, 0.0, self.limits), axis=-1))

    def cruise_time(self, start: Array, goal: Array) -> Array:
        """Seconds from `start` to `goal` (..., dof) at the slowest joint's velocity limit: additive along a path."""
        return np.asarray(np.max(np.abs(goal - start) / self.limits.velocity, axis=-1))

    def _jacobian(self, q: Array, frame: pinocchio.ReferenceFrame) -> Array:
        found = pinocchio.computeFrameJacobian(self.pinocchio, self._data, q, self.tip, frame)
        return np.asarray(found).reshape(6, self.dof)  # Pinocchio returns a vector for a single joint

    def _joint_axes(self) -> Array:
        """Axis of each joint in its own frame, (dof, 3)."""
        pinocchio.computeJointJacobians(self.pinocchio, self._data, np.zeros(self.dof))
        jacobians = (
            pinocchio.getJointJacobian(self.pinocchio, self._data, i + 1, pinocchio.LOCAL) for i in range(self.dof)
        )
        return np.array([jacobian.reshape(6, self.dof)[3:, i] for i, jacobian in enumerate(jacobians)])

    def _joint_chain(self) -> Array:
        """Terms (3, dof, 4, 4) of each joint's pose in the frame of the joint before it.

        The first is constant, the second scales with the sine of the joint angle, the third with 1 - its cosine
        (Rodrigues' formula).
        """
        chain = np.zeros((3, self.dof, 4, 4))
        for i, (placement, axis) in enumerate(zip(self.pinocchio.jointPlacements[1:], self.axes, strict=True)):
            turn = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
            chain[0, i] = placement.homogeneous
            chain[1, i, :3, :3] = placement.rotation @ turn
            chain[2, i, :3, :3] = placement.rotation @ turn @ turn
        return chain


def cross(first: Array, second: Array) -> Array:
    """Cross product (..., 3): several times faster than NumPy's for the few vectors of an arm."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return np.asarray(first[..., ahead] * second[..., behind] - first[..., behind] * second[..., ahead])
