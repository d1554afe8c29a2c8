"""Notes about a robot from a file: what its reader repaired, left out or assumed, and what can hardly be meant.

Whoever loads a robot is told of them, and they are in its description, in a study's identity and in its report.
"""

import multiprocessing
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.robot_description.capsules import Capsule
from armctl.robot_description.collision_pairs import CollisionPairs, link_frame

POSTURES = 32
"""Random configurations on which an arm is examined."""
RANK = 1e-4
"""m/rad and rad/rad: a direction in which no joint moves the end-effector faster is not commanded."""

SHORTEST, LONGEST = 0.05, 10.0
"""m: an arm of another reach is suspected to be in other units."""
HUGE = 5.0
"""Reaches of an arm; a link that is longer is suspected to be in other units."""


def tell(path: Path, notes: tuple[str, ...]) -> None:
    """Warn of the notes about a file, once for a file: not in the workers of a process, which has told them."""
    if notes and multiprocessing.parent_process() is None:
        text = "".join(f"\n- {note}" for note in notes)
        warnings.warn_explicit(f"notes about the robot, which are in its results too:{text}", UserWarning, str(path), 0)


def notes_on_model(urdf: str, tip: str, capsules: tuple[Capsule, ...]) -> list[str]:
    """Return notes about what an arm can do, by its URDF (`ArmDescription.urdf`), end-effector link and capsules."""
    model = pinocchio.buildModelFromXML(urdf, mimic=True)
    data, frame = model.createData(), link_frame(model, tip)
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, model.nq))
    frames = pinocchio.LOCAL_WORLD_ALIGNED
    jacobians = np.array([
        np.reshape(pinocchio.computeFrameJacobian(model, data, q, frame, frames), (6, model.nv)) for q in postures
    ])  # fmt: skip
    torques = np.array([np.abs(pinocchio.computeGeneralizedGravity(model, data, q)) for q in postures]).max(axis=0)
    return [*_directions(jacobians), *_lengths(model, frame, capsules), *_weak_joints(model, torques)]


def _directions(jacobians: Array) -> Iterator[str]:
    directions, places = (int(np.linalg.matrix_rank(part, RANK).max()) for part in (jacobians, jacobians[:, :3]))
    if directions < 6:
        position = f", of its position {places} of 3" if places < 3 else ""
        yield (
            f"The arm's joints ({jacobians.shape[-1]}) command {directions} of the 6 directions of its "
            f"end-effector{position}: poses are reached only where these suffice."
        )


def _lengths(model: pinocchio.Model, frame: int, capsules: tuple[Capsule, ...]) -> Iterator[str]:
    placements = [*model.jointPlacements[2:], model.frames[frame].placement]
    reach = float(np.linalg.norm([placement.translation for placement in placements], axis=1).sum())
    if not SHORTEST <= reach <= LONGEST:
        yield f"The arm is {reach:.3g} m long: are its lengths in other units? URDFs are in metres."
    moving = [capsule for capsule in capsules if model.frames[link_frame(model, capsule.link)].parentJoint > 0]
    extents = {
        capsule.link: float(np.linalg.norm(np.subtract(capsule.end, capsule.start))) + 2 * capsule.radius
        for capsule in moving
    }
    if huge := [link for link, extent in extents.items() if extent > max(HUGE * reach, SHORTEST)]:
        yield (
            f"Link {huge[0]!r} is {extents[huge[0]]:.3g} m long, on an arm of {reach:.3g} m: are its shapes, or those "
            'of other links, in other units? URDFs are in metres; meshes in millimetres need scale="0.001 0.001 0.001".'
        )


def _weak_joints(model: pinocchio.Model, torques: Array) -> Iterator[str]:
    weak = np.flatnonzero(torques > model.effortLimit)
    if len(weak):
        joint = int(weak[0])
        yield (
            f"Joint {model.names[1 + joint]!r} needs up to {torques[joint]:.3g} N m against gravity, and may use "
            f"{model.effortLimit[joint]:.3g} N m ({len(weak)} joints like it): the arm cannot hold itself everywhere."
        )


def notes_on_assumptions(home: Array | None, acceleration: Array | None, jerk: float | None) -> list[str]:
    """Return notes about values that nobody gave, None for those that were given: rad, rad/s^2, rad/s^3."""
    values = {
        "home (rad)": None if home is None else ", ".join(f"{position:g}" for position in home),
        "acceleration limits (rad/s^2)": None if acceleration is None else _listed(acceleration),
        "jerk limits (rad/s^3)": jerk and f"{jerk:g}",
    }
    assumed = [f"{name} {value}" for name, value in values.items() if value is not None]
    return [f"Assumed, since the file does not say: {'; '.join(assumed)}."] if assumed else []


def _listed(values: Array) -> str:
    """Return numbers as text, or the one that all are."""
    return ", ".join(f"{value:g}" for value in (values[:1] if (values == values[0]).all() else values))


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
