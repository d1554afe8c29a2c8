"""The controllers' model of an arm: Pinocchio, built from one URDF."""

import copy
import math
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import arm, capsules, drives
from armctl.kinematics.records import Records, box_records, joint_records, link_records
from armctl.robot_description import ArmDescription, load_arm
from armctl.robot_description.collision_pairs import FLOOR, link_frame
from armctl.scene import NO_BOXES, Boxes


class ArmModel:
    """Forward kinematics, Jacobians, limits and collisions of one arm.

    Joint positions q are (dof,) rad; positions are in the frame of the arm's base, m. Not thread-safe.
    """

    def __init__(self, robot: str | Path | ArmDescription = "ur5") -> None:
        self.description = load_arm(robot)
        self.limits = self.description.limits
        self.dof = self.description.dof
        self.home = self.description.home
        self.pinocchio = pinocchio.buildModelFromXML(self.description.urdf, mimic=True)
        if self.description.armature:
            self.pinocchio.armature = np.array(self.description.armature)
        self.tip = link_frame(self.pinocchio, self.description.tip)
        self._data = self.pinocchio.createData()
        self.boxes = NO_BOXES
        """Obstacles."""
        self._boxes = box_records(NO_BOXES)
        self.axes = self._joint_axes()
        """Axis of each joint in its own frame, (m, 3): of those that follow others, too."""
        self.joints: Records = joint_records(self.pinocchio, self.axes, self.description)
        """For `armctl.kernels.arm`."""
        self.links: Records = link_records(self.pinocchio, self.description)
        """For `armctl.kernels.capsules`, in the order of the description's capsules."""
        names = [capsule.link for capsule in self.description.capsules]
        pairs = [pair for pair in self.description.collision_pairs if FLOOR not in pair]
        self.link_pairs = np.array([[names.index(link) for link in pair] for pair in pairs], dtype=int).reshape(-1, 2)
        """Indices (p, 2) of links that can touch each other."""
        on_floor = (pair[0] for pair in self.description.collision_pairs if FLOOR in pair)
        self.floor_links = np.array([names.index(link) for link in on_floor], dtype=int)
        """Indices of links that can touch the floor."""
        self.shoulder = np.array(self.pinocchio.jointPlacements[1].translation)
        """Origin of the first joint, (3,) m."""

    def among(self, boxes: Boxes) -> "ArmModel":
        """Return the same arm among boxes: `is_free` then takes them into account."""
        model = copy.copy(self)
        model.boxes, model._boxes = boxes, box_records(boxes)
        model._data = self.pinocchio.createData()
        return model

    def with_lengths(self, errors: Array) -> "ArmModel":
        """Return the same arm with links longer by `errors` (`num_segments`,), relative, in the order of `segments`."""
        model = copy.copy(self)
        model.__dict__.pop("_weightless", None)
        model.pinocchio = self.pinocchio.copy()
        places = [*list(model.pinocchio.jointPlacements)[1:], model.pinocchio.frames[self.tip].placement]
        for place, error in zip(places, errors, strict=True):
            place.translation = (1 + error) * place.translation
        model._data = model.pinocchio.createData()
        model.joints = joint_records(model.pinocchio, self.axes, self.description)
        model.shoulder = np.array(model.pinocchio.jointPlacements[1].translation)
        return model

    def placement(self, q: Array) -> pinocchio.SE3:
        """Return the end-effector's pose as a Pinocchio object, valid until the next call."""
        pinocchio.forwardKinematics(self.pinocchio, self._data, q)
        return pinocchio.updateFramePlacement(self.pinocchio, self._data, self.tip)

    def pose(self, q: Array) -> Array:
        """Return the end-effector's pose, homogeneous (4, 4)."""
        return np.asarray(self.placement(q).homogeneous)

    def position(self, q: Array) -> Array:
        """Return the end-effector's position, (3,) m."""
        return np.array(self.placement(q).translation)

    def jacobian(self, q: Array) -> Array:
        """Return the world-aligned Jacobian at the end-effector, (6, dof): linear (m/rad) above angular (rad/rad)."""
        return self._jacobian(q, pinocchio.LOCAL_WORLD_ALIGNED)

    def inertial_torques(self, q: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the torques (dof,) N m that a motion (dof,) needs without gravity: inertial and velocity-dependent."""
        model, data = self._weightless
        return np.asarray(pinocchio.rnea(model, data, q, velocity, acceleration))

    def local_jacobian(self, q: Array) -> Array:
        """Return the Jacobian (6, dof) in the end-effector's own frame: linear (m/rad) above angular (rad/rad)."""
        return self._jacobian(q, pinocchio.LOCAL)

    def positions(self, q: ArrayLike) -> Array:
        """Return end-effector positions (..., 3) m of a batch (..., dof)."""
        flat = self._rows(q)
        positions = np.empty((len(flat), 3))
        arm.tips(self.joints, flat, positions)
        return positions.reshape(*np.shape(q)[:-1], 3)

    @property
    def num_segments(self) -> int:
        """Number of joints, also of those that follow others, and 1."""
        return len(self.joints) + 1

    def segments(self, q: Array) -> Array:
        """Return the vectors (`num_segments`, 3) m from base to end-effector over all joints: they sum to its place.

        The error of the end-effector is linear in errors of the links' lengths: each adds its share of a vector.
        """
        vectors = np.empty((self.num_segments, 3))
        arm.segments(self.joints, np.ascontiguousarray(q, dtype=float), vectors)
        return vectors

    def is_free(self, q: ArrayLike) -> bool:
        """Return True if q (dof,) is collision-free: the capsules touch no other capsule, floor or box."""
        return bool(self.are_free(np.asarray(q)[None])[0])

    def are_free(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) whether each of q (n, dof) is collision-free."""
        return self._checked(q, capsules.are_free)

    def are_usable(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) whether each of q (n, dof) is collision-free and within the position limits."""
        return self._checked(q, capsules.are_usable)

    def box_distances(self, q: ArrayLike, boxes: Boxes) -> Array:
        """Return the distance (k,) m of each box from the whole arm at `q` (dof,): 0 or below in contact."""
        distances = np.full(len(boxes), np.inf)
        capsules.box_distances(self.joints, self.links, box_records(boxes), self._rows(q)[0], distances)
        return distances

    def base_distance(self, position: ArrayLike) -> float:
        """Return the distance (m) of `position` (3,) from the arm's fixed links; infinite if they have no shape."""
        return float(capsules.base_distance(self.links, np.asarray(position, dtype=float)))

    def within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Return (...) whether all joints of q (..., dof) are within their position limits."""
        return np.asarray(np.all((q >= self.limits.lower) & (q <= self.limits.upper), axis=-1))

    def random_configurations(self, rng: np.random.Generator, count: int) -> Array:
        """Return configurations (count, dof), uniform within the joint limits and +-pi."""
        low, high = np.maximum(self.limits.lower, -np.pi), np.minimum(self.limits.upper, np.pi)
        return rng.uniform(low, high, (count, self.dof))

    def nearest_turn(self, q: Array, seed: Array) -> Array:
        """Shift each joint of configurations by whole turns to be near `seed`, as far as its limits allow."""
        turn = 2 * np.pi
        near = q + turn * np.round((seed - q) / turn)
        return near + turn * ((near < self.limits.lower).astype(float) - (near > self.limits.upper))

    @cached_property
    def _weightless(self) -> tuple[Any, Any]:
        """The arm without gravity, and its data."""
        model = self.pinocchio.copy()
        model.gravity.setZero()
        return model, model.createData()

    @cached_property
    def base_yaw_is_vertical(self) -> bool:
        """True if the first joint turns the end-effector about the vertical through the origin."""
        q = self.home + np.array([[0.3], [0.3]])
        q[1, 0] += 1.0
        (x, y, z), turned = self.positions(q)
        cos, sin = np.cos(1.0), np.sin(1.0)
        return bool(np.allclose((cos * x - sin * y, sin * x + cos * y, z), turned, atol=1e-4))

    def min_time(self, start: Array, goals: Array) -> Array:
        """Return the seconds (...) from rest at `start` (dof,) to `goals` (..., dof) at any final speed."""
        rows = self._rows(goals)
        times = np.empty(len(rows))
        drives.min_times(self.joints, start, np.zeros(self.dof), rows, times)
        return times.reshape(np.shape(goals)[:-1])

    def cruise_time(self, start: Array, goal: Array) -> Array:
        """Return the seconds from `start` to `goal` (..., dof) at the velocity limits: additive along a path."""
        return np.asarray(np.max(np.abs(goal - start) / self.limits.velocity, axis=-1))

    def geometry(self, spacing: float = 0.15) -> dict[str, Any]:
        """Return the moving links as numbers, for networks: joints as in `armctl.kernels.arm`, and points along links.

        `base`, `sine`, `versine` are (dof, 3, 3), `offset` is (dof, 3). Points (p, 3) are in the frame of their `joint`
        (p,), which counts from 1, at most `spacing` (m) apart; `radii` (p,) are the links' radii, m. `tip` (3,) m and
        `tip_turn` (3, 3) are place and orientation of the end-effector in the frame of the last joint, `lower` and
        `upper` (dof,) rad the limits, and `home` (dof,) rad is where the arm begins.

        Raises `ConfigurationError` for an arm with joints that slide.
        """
        if sliding := self.description.sliding:
            raise ConfigurationError(f"networks that know an arm's links take joints that turn; {sliding[0]!r} slides")
        if followers := self.description.followers:
            raise ConfigurationError(
                f"networks that know an arm's links take joints with a motor; {followers[0].joint!r} has none"
            )
        joint, points, radii = [], [], []
        for link in self.links[self.links["joint"] > 0]:
            number = 1 + math.ceil(float(np.linalg.norm(link["end"] - link["start"])) / spacing)
            shares = np.linspace(0, 1, number) if number > 2 else np.array([0.5])
            for share in shares:
                points.append((link["start"] + share * (link["end"] - link["start"])).tolist())
                joint.append(int(link["joint"]))
                radii.append(float(link["radius"]))
        turning = {name: self.joints[name].tolist() for name in ("base", "sine", "versine", "offset")}
        tip_turn = self.pinocchio.frames[self.tip].placement.rotation
        ends = {"tip": self.joints["tip"][-1], "tip_turn": tip_turn}
        ranges = {"lower": self.limits.lower, "upper": self.limits.upper, "home": self.home}
        others = {name: numbers.tolist() for name, numbers in {**ends, **ranges}.items()}
        return {**turning, **others, "joint": joint, "points": points, "radii": radii}

    def _jacobian(self, q: Array, frame: pinocchio.ReferenceFrame) -> Array:
        jacobian = pinocchio.computeFrameJacobian(self.pinocchio, self._data, q, self.tip, frame)
        return np.asarray(jacobian).reshape(6, self.dof)  # Pinocchio returns a vector for a single joint

    def _joint_axes(self) -> Array:
        """Return the axis of each joint in its own frame, (m, 3)."""
        model = pinocchio.buildModelFromXML(self.description.urdf)  # with a motor for each
        data, count = model.createData(), model.nv
        pinocchio.computeJointJacobians(model, data, np.zeros(count))
        jacobians = (pinocchio.getJointJacobian(model, data, i + 1, pinocchio.LOCAL) for i in range(count))
        columns = [jacobian.reshape(6, count)[:, i] for i, jacobian in enumerate(jacobians)]
        sliding = self.description.sliding
        return np.array([
            column[:3] if name in sliding else column[3:]
            for name, column in zip(list(model.names)[1:], columns, strict=True)
        ])  # fmt: skip

    def _checked(self, q: ArrayLike, check: Callable[..., None]) -> NDArray[np.bool_]:
        rows = self._rows(q)
        results = np.empty(len(rows), dtype=bool)
        check(self.joints, self.links, self.link_pairs, self.floor_links, self._boxes, rows, results)
        return results

    def _rows(self, q: ArrayLike) -> Array:
        """Return a batch (..., dof) as (n, dof), the one layout for which kernels are compiled."""
        return np.ascontiguousarray(q, dtype=float).reshape(-1, self.dof)
