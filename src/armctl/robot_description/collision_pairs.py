"""An arm's capsules as Pinocchio's collision geometry, and the pairs of them to check."""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import coal
import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.robot_description.capsules import Capsule

Pair = tuple[str, str]

FLOOR = "(floor)"
"""Name of the half-space below z = 0 among the links."""
NEIGHBOURLY = 0.25
"""Share of the sum of their radii: capsules that are never farther apart are neighbours in effect. Since capsules are
wider than links, their distance says nothing about the links, but would forbid most configurations."""
SAMPLES = 1000
"""Random configurations that decide it."""


TOUCHING = 0.002
"""m: links that are nearer at home touch there in effect: no motion from home could keep any clearance between them."""
FLOOR_MARGIN = 0.02
"""m: least height over the floor, in a home that is chosen, of links that would be in it."""
UPRIGHT = 1e-9
"""Tolerance on the cosine of a vertical axis, for rounding."""


class CollisionPairs(NamedTuple):
    """Pairs of links, or of a link and `FLOOR`, that can move against each other without being neighbours."""

    tested: tuple[Pair, ...]
    touching_at_home: tuple[Pair, ...]
    """Pairs that are left out since their capsules, which are wider than links, touch at home."""
    always_near: tuple[Pair, ...]
    """Pairs that are left out since they are near each other in all configurations."""
    floor_depths: dict[str, float]
    """Depth of each link whose capsule is in the floor at home, m."""
    turning_in_floor: tuple[str, ...]
    """Links in the floor that only turn about the vertical, on the spot: they are not tested."""


def capsule_geometry(model: pinocchio.Model, capsules: tuple[Capsule, ...]) -> pinocchio.GeometryModel:
    """Return Pinocchio's collision geometry: the capsules, and the floor."""
    geometry = pinocchio.GeometryModel()
    for capsule in capsules:
        frame = model.frames[link_frame(model, capsule.link)]
        start, end = np.array(capsule.start), np.array(capsule.end)
        axis, length = end - start, float(np.linalg.norm(end - start))
        rotation = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), axis).matrix() if length else np.eye(3)
        placement = frame.placement * pinocchio.SE3(rotation, (start + end) / 2)
        shape = coal.Capsule(capsule.radius, length)
        geometry.addGeometryObject(pinocchio.GeometryObject(capsule.link, frame.parentJoint, placement, shape))
    floor = coal.Halfspace(np.array([0.0, 0, 1]), 0.0)
    geometry.addGeometryObject(pinocchio.GeometryObject(FLOOR, 0, pinocchio.SE3.Identity(), floor))
    return geometry


def link_frame(model: pinocchio.Model, link: str) -> int:
    """Return Pinocchio's frame id of a link, which may share its name with a joint."""
    return int(model.getFrameId(link, pinocchio.FrameType.BODY))


def add_collision_pairs(geometry: pinocchio.GeometryModel, pairs: Iterable[Pair]) -> None:
    """Add pairs to Pinocchio's collision checks."""
    for pair in pairs:
        geometry.addCollisionPair(pinocchio.CollisionPair(*(geometry.getGeometryId(name) for name in pair)))


def pairs_worth_testing(
    urdf: str, capsules: tuple[Capsule, ...], home: Array, impossible: set[frozenset[str]]
) -> CollisionPairs:
    """Return pairs of links, or of a link and `FLOOR`, that can touch.

    Excluded are neighbours, pairs within `TOUCHING` at `home`, pairs that are near each other in all configurations (as
    MoveIt's setup assistant finds them, by sampling), and pairs whose joints carry a pair of links in `impossible`.
    """
    model = pinocchio.buildModelFromXML(urdf, mimic=True)
    geometry = capsule_geometry(model, capsules)
    bodies = (frame for frame in model.frames if frame.type == pinocchio.FrameType.BODY)
    joint_of = {frame.name: frame.parentJoint for frame in bodies} | {FLOOR: None}
    ruled_out = {frozenset(joint_of[link] for link in pair) for pair in impossible if pair <= joint_of.keys()}
    lowest_over_floor = 2 if is_upright(model) else 1  # the first link of an upright arm only turns on the spot
    pairs = [
        (first.name, second.name)
        for first, second in itertools.combinations(geometry.geometryObjects, 2)
        if frozenset(joints := (joint_of[first.name], joint_of[second.name])) not in ruled_out
        and _may_touch(model, *joints, lowest_over_floor)
    ]
    turning = [(link.link, FLOOR) for link in capsules if joint_of[link.link] == 1 < lowest_over_floor]
    add_collision_pairs(geometry, [*pairs, *turning])
    data = geometry.createData()
    for pair, request in zip([*pairs, *turning], data.collisionRequests, strict=True):
        request.security_margin = 0.0 if FLOOR in pair else TOUCHING
    pinocchio.computeCollisions(model, model.createData(), geometry, data, home, False)
    touches = {
        pair: result.isCollision() for pair, result in zip([*pairs, *turning], data.collisionResults, strict=True)
    }
    in_floor = {pair[0]: i for i, pair in enumerate(pairs) if FLOOR in pair and touches[pair]}
    depths = {link: -pinocchio.computeDistance(geometry, data, i).min_distance for link, i in in_floor.items()}
    apart = [pair for pair in pairs if not touches[pair]]
    near = _always_near(model, capsules, [pair for pair in apart if FLOOR not in pair])
    touching = tuple(pair for pair in pairs if touches[pair] and FLOOR not in pair)
    tested = tuple(pair for pair in apart if pair not in near)
    always_near = tuple(pair for pair in pairs if pair in near)
    return CollisionPairs(tested, touching, always_near, depths, tuple(pair[0] for pair in turning if touches[pair]))


def posture_above_floor(urdf: str, capsules: tuple[Capsule, ...], start: Array, pairs: CollisionPairs) -> Array | None:
    """Return a posture (dof,) near `start` that keeps off the floor, with no contacts of other pairs than there.

    It is the nearest of some random ones, in hundredths of rad, with as many joints as at `start` as possible; None if
    there is none. `pairs` are those at `start`.
    """
    model = pinocchio.buildModelFromXML(urdf, mimic=True)
    geometry, kinematics = capsule_geometry(model, capsules), model.createData()
    add_collision_pairs(geometry, [*pairs.tested, *((link, FLOOR) for link in pairs.floor_depths)])
    data = geometry.createData()
    for request in data.collisionRequests[len(pairs.tested) :]:
        request.security_margin = FLOOR_MARGIN
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    postures = np.clip(np.random.default_rng(0).uniform(low, high, (SAMPLES, model.nq)).round(2), low, high)
    nearest_first = postures[np.argsort(np.abs(postures - start).max(axis=1), kind="stable")]

    def touches(q: Array) -> bool:
        return bool(pinocchio.computeCollisions(model, kinematics, geometry, data, q, True))

    posture = next((q for q in nearest_first if not touches(q)), None)
    if posture is not None:
        for joint in np.eye(model.nq, dtype=bool):
            nearer = np.where(joint, start, posture)
            posture = posture if touches(nearer) else nearer
    return posture


def is_upright(model: pinocchio.Model) -> bool:
    """Return True if a model's first joint turns about the vertical."""
    data = model.createData()
    pinocchio.computeJointJacobians(model, data, pinocchio.neutral(model))
    axis = pinocchio.getJointJacobian(model, data, 1, pinocchio.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)[3:, 0]
    return bool(abs(axis[2]) > 1 - UPRIGHT)


def _always_near(model: pinocchio.Model, capsules: tuple[Capsule, ...], pairs: list[Pair]) -> set[Pair]:
    """Return the pairs of links that are never farther apart than a share of their radii, in random configurations."""
    radii = {capsule.link: capsule.radius for capsule in capsules}
    geometry, kinematics = capsule_geometry(model, capsules), model.createData()
    add_collision_pairs(geometry, pairs)
    data, near = geometry.createData(), list(range(len(pairs)))
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    for q in np.random.default_rng(0).uniform(low, high, (SAMPLES, model.nq)):
        if not near:
            break
        pinocchio.updateGeometryPlacements(model, kinematics, geometry, data, q)
        distances = {i: pinocchio.computeDistance(geometry, data, i).min_distance for i in near}
        near = [i for i in near if distances[i] <= NEIGHBOURLY * sum(radii[link] for link in pairs[i])]
    return {pairs[i] for i in near}


def _may_touch(model: pinocchio.Model, first: int | None, second: int | None, lowest_over_floor: int) -> bool:
    """Return True if bodies on two joints (None: the floor) can move against each other without being neighbours."""
    if first is None or second is None:
        return (first or second or 0) >= lowest_over_floor
    return first != second and model.parents[max(first, second)] != min(first, second)
