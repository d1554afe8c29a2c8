"""An arm's capsules as Pinocchio's collision geometry, and the pairs of them to check."""

import itertools
from collections.abc import Iterable

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
) -> tuple[Pair, ...]:
    """Return pairs of links, or of a link and `FLOOR`, that can touch.

    Excluded are neighbours, pairs in contact at `home` (capsules are wider than links), pairs that are near each other
    in all configurations (as MoveIt's setup assistant finds them, by sampling), and pairs whose joints carry a pair of
    links in `impossible`.
    """
    model = pinocchio.buildModelFromXML(urdf)
    geometry = capsule_geometry(model, capsules)
    bodies = (frame for frame in model.frames if frame.type == pinocchio.FrameType.BODY)
    joint_of = {frame.name: frame.parentJoint for frame in bodies} | {FLOOR: None}
    ruled_out = {frozenset(joint_of.get(link) for link in pair) for pair in impossible}
    pairs = [
        (first.name, second.name)
        for first, second in itertools.combinations(geometry.geometryObjects, 2)
        if frozenset(joints := (joint_of[first.name], joint_of[second.name])) not in ruled_out
        and _may_touch(model, *joints)
    ]
    add_collision_pairs(geometry, pairs)
    data = geometry.createData()
    pinocchio.computeCollisions(model, model.createData(), geometry, data, home, False)
    apart = [pair for pair, result in zip(pairs, data.collisionResults, strict=True) if not result.isCollision()]
    always_near = _always_near(model, capsules, [pair for pair in apart if FLOOR not in pair])
    return tuple(pair for pair in apart if pair not in always_near)


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


def _may_touch(model: pinocchio.Model, first: int | None, second: int | None) -> bool:
    """Return True if bodies on two joints (None: the floor) can move against each other without being neighbours."""
    if first is None or second is None:
        return (first or second or 0) > 1  # the first link only turns on the spot
    return first != second and model.parents[max(first, second)] != min(first, second)
