"""Observations of reach tasks: the parts of each named observation, and the bounds of every number.

- `paper`: end-effector, joint and target positions, as in the system that the task comes from; no velocity.
- `features`: offset to the target, sines and cosines of the joints, scaled to the order of one. If the first joint's
  axis is vertical, they are in the frame that turns with it: rotating the whole scene changes nothing.
- `full`: `paper`, and what else determines how the episode goes on: joint velocities, and the command under way.
"""

import itertools
from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.robot_description import ArmDescription
from armctl.tasks.goals import Goals
from armctl.tasks.reach.state import ReachState, Term

Bounds = Any
"""The least and the largest of each number of a part: a pair of numbers or arrays."""

LENGTH_SCALE = 2.0
"""1/m: scales the lengths of an arm's workspace to the order of one."""
NEARBY = 0.05
"""m: nearer to the target than this, the direction to it fades."""
JOINT_MARGIN = 0.05
"""rad beyond its limits within which a joint always stays (0.014 rad is the most that was ever seen)."""
SPEED_MARGIN = 1.5
"""times its limit within which a joint's speed always stays (see `armctl.simulation.impacts`)."""
LENGTH_MARGIN = 1.25
"""times the workspace's radius within which everything is, also if links are longer than the model says."""


def rotated(vectors: Array, angles: Array) -> Array:
    """Return vectors (n, ..., 3) rotated about the vertical by angles (n,), rad."""
    angles = angles.reshape(-1, *[1] * (vectors.ndim - 2))
    cos, sin = np.cos(angles), np.sin(angles)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y, vectors[..., 2]), axis=-1)


def _offset(state: ReachState) -> Array:
    return rotated(state.target_position - state.end_effector_position, -state.base_yaw)


OBSERVATION: Mapping[str, Term] = {
    "end_effector_position": lambda state: state.end_effector_position,
    "joint_positions": lambda state: state.joint_positions,
    "target_position": lambda state: state.target_position,
}

FEATURES: Mapping[str, Term] = {
    "end_effector_ahead": lambda state: LENGTH_SCALE * rotated(state.end_effector_position, -state.base_yaw),
    "target_ahead": lambda state: LENGTH_SCALE * rotated(state.target_position, -state.base_yaw),
    "offset": lambda state: LENGTH_SCALE * _offset(state),
    "distance": lambda state: LENGTH_SCALE * state.distance[:, None],
    "direction": lambda state: _offset(state) / (state.distance + NEARBY)[:, None],
    "sines": lambda state: np.sin(state.posture),
    "cosines": lambda state: np.cos(state.posture),
}
HIDDEN: Mapping[str, Term] = {
    "joint_velocities": lambda state: state.joint_velocities,
    "commands": lambda state: state.commands,
}
"""Parts of the state that `paper` hides."""
OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": OBSERVATION,
    "features": FEATURES,
    "full": {**OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""

PAPER = {name: part for name, part in OBSERVATION.items() if name != "target_position"}
WITHOUT_GOAL: Mapping[str, Mapping[str, Term]] = {
    "paper": PAPER,
    "features": {
        "end_effector": lambda state: LENGTH_SCALE * state.end_effector_position,
        "joint_sines": lambda state: np.sin(state.joint_positions),
        "joint_cosines": lambda state: np.cos(state.joint_positions),
        "joint_velocities": HIDDEN["joint_velocities"],
    },
    "full": {**PAPER, **HIDDEN},
}
"""The same without the target, for goal-conditioned learners, who are told of it in `desired_goal`.

The features have velocities here: hindsight learns to stay at a goal, which needs the speed.
"""


def position_goals(tolerance: float) -> Goals:
    """Return end-effector and target as goals, (n, 3) m each, reached within a tolerance, m, as they are observed."""

    def reached(positions: Array, targets: Array) -> NDArray[np.bool_]:
        offset = np.float32(targets).astype(float) - np.float32(positions)
        return np.asarray(np.sqrt((offset * offset).sum(axis=-1)) <= tolerance)

    return Goals(attrgetter("end_effector_position"), attrgetter("target_position"), reached, "target_position", 3)


def observation_sizes(dof: int) -> dict[str, int]:
    """Return how many numbers each part of `OBSERVATION` has, in order, for an arm of `dof` joints."""
    return {"end_effector_position": 3, "joint_positions": dof, "target_position": 3}


def observation_slices(dof: int) -> dict[str, slice]:
    """Return where each part of `OBSERVATION` is within an observation."""
    sizes = observation_sizes(dof)
    ends = itertools.accumulate(sizes.values())
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def bounds_of_parts(arm: ArmDescription, places: Bounds, targets: Bounds) -> dict[Term, Bounds]:
    """Return bounds of the parts above, for an arm whose end-effector is in the box `places`, its targets in another.

    Boxes are lowest and highest corners (3,), m.
    """
    limits = arm.limits
    joints = limits.lower - JOINT_MARGIN, limits.upper + JOINT_MARGIN
    speeds = SPEED_MARGIN * limits.velocity
    ahead = LENGTH_SCALE * float(np.linalg.norm(np.abs((*places, *targets)).max(axis=0)))
    return {
        OBSERVATION["end_effector_position"]: places,
        OBSERVATION["joint_positions"]: joints,
        OBSERVATION["target_position"]: targets,
        HIDDEN["joint_velocities"]: (-speeds, speeds),
        HIDDEN["commands"]: (np.append(joints[0], -speeds), np.append(joints[1], speeds)),
        FEATURES["end_effector_ahead"]: (-ahead, ahead),
        FEATURES["target_ahead"]: (-ahead, ahead),
        FEATURES["offset"]: (-2 * ahead, 2 * ahead),
        FEATURES["distance"]: (0.0, 2 * ahead),
        **{FEATURES[name]: (-1.0, 1.0) for name in ("direction", "sines", "cosines")},
        WITHOUT_GOAL["features"]["end_effector"]: (-ahead, ahead),
        **{WITHOUT_GOAL["features"][name]: (-1.0, 1.0) for name in ("joint_sines", "joint_cosines")},
    }
