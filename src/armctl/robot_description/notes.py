"""Notes about a robot from a file: what its reader repaired, left out or assumed, and what can hardly be meant.

Whoever loads a robot is told of them, and they are in its description, in a study's identity and in its report.
"""

import multiprocessing
import warnings
from pathlib import Path

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.robot_description.collision_pairs import CollisionPairs, link_frame

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


def note_on_home(home: Array, depths: dict[str, float]) -> str:
    """Return a note about a home (dof,) that was chosen, since otherwise links would be in the floor so deep (m)."""
    positions = ", ".join(f"{position:g}" for position in home)
    return (
        f"With all joints at zero, or mid-range, links would be in the floor, the plane z = 0: {in_words(depths)}. "
        f"Home is {positions} rad instead; home= gives another one."
    )


def in_words(depths: dict[str, float]) -> str:
    """Return links and how deep they are in the floor (m), as text."""
    return ", ".join(f"{link!r} by {depth:.2g} m" for link, depth in depths.items())


def notes_on_pairs(pairs: CollisionPairs) -> list[str]:
    """Return notes about pairs of links that are left out of the contacts."""
    reasons = {
        "touch each other at home": pairs.touching_at_home,
        "are near each other in all postures": pairs.always_near,
    }
    notes = [
        f"Link {link!r} is in the floor, at least its capsule; this is not counted, since it only turns on the spot."
        for link in pairs.turning_in_floor
    ]
    return notes + [
        f"Contacts of {', '.join(f'{first!r} with {second!r}' for first, second in left_out)} are not counted, since "
        f"their capsules, which are wider than links, {reason}."
        for reason, left_out in reasons.items()
        if left_out
    ]


def _rank(jacobians: Array) -> int:
    """Return the number of directions that Jacobians (n, k, dof) command anywhere."""
    return int(np.linalg.matrix_rank(jacobians, RANK).max())
