"""Notes about a robot from a file: what its reader repaired, left out or assumed, and what can hardly be meant.

Whoever loads a robot is told of them, and they are in its description, in a study's identity and in its report.
"""

import multiprocessing
import warnings
from pathlib import Path

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.robot_description.collision_pairs import link_frame

POSTURES = 32
"""Random configurations on which an arm is examined."""
RANK = 1e-4
"""m/rad and rad/rad: a direction in which no joint moves the end-effector faster is not commanded."""


def tell(path: Path, notes: tuple[str, ...]) -> None:
    """Warn of the notes about a file, once for a file: not in the workers of a process, which has told them."""
    if notes and multiprocessing.parent_process() is None:
        text = "".join(f"\n- {note}" for note in notes)
        warnings.warn_explicit(f"notes about the robot, which are in its results too:{text}", UserWarning, str(path), 0)


def notes_on_kinematics(urdf: str, tip: str) -> list[str]:
    """Return notes about what an arm's joints can do, by its URDF (`ArmDescription.urdf`) and end-effector link."""
    model = pinocchio.buildModelFromXML(urdf)
    data, frame = model.createData(), link_frame(model, tip)
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, model.nq))
    frames = pinocchio.LOCAL_WORLD_ALIGNED
    jacobians = np.array([
        np.reshape(pinocchio.computeFrameJacobian(model, data, q, frame, frames), (6, model.nv)) for q in postures
    ])  # fmt: skip
    directions, places = (_rank(part) for part in (jacobians, jacobians[:, :3]))
    notes = []
    if directions < 6:
        position = f", of its position {places} of 3" if places < 3 else ""
        notes.append(
            f"The arm's joints ({model.nv}) command {directions} of the 6 directions of its end-effector{position}: "
            "poses are reached only where these suffice."
        )
    return notes


def _rank(jacobians: Array) -> int:
    """Return the number of directions that Jacobians (n, k, dof) command anywhere."""
    return int(np.linalg.matrix_rank(jacobians, RANK).max())
