"""Room to follow a moving target: how much of an end-effector's surroundings an arm reaches without another posture."""

import numpy as np

from armctl.core.arrays import Array
from armctl.kinematics.damped_least_squares import damped_step
from armctl.kinematics.ik import Ik
from armctl.kinematics.minimum_time_reach import approach
from armctl.kinematics.model import ArmModel
from armctl.robot_description.joint_profiles import trapezoidal_displacement

DIRECTIONS = np.vstack((np.eye(3), -np.eye(3), np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3) / np.sqrt(3)))
"""Unit vectors (14, 3) to faces and corners of a cube."""
ITERATIONS = 5
"""Levenberg-Marquardt iterations to each place."""
MISS = 0.01
"""m: largest distance from a place that counts as reached."""
LARGEST_MOVE = 1.2
"""rad: a joint that moves farther gives up its posture."""
CANDIDATES, WAY_POINTS = 32, 20
"""Configurations whose room is measured, the soonest; configurations on the way there that are to be free."""
ROOM, FULL_ROOM = 0.15, 2.0
"""m: distance around a moving target in which it is expected to stay; s: worth of a posture with room for all that."""
NEWTON_STEPS, TRACKING_DAMPING = 4, 8e-3
"""Corrections of a posture in a control step; their damping, m^2, with which joints turn slowly near singularities."""


def room(model: ArmModel, q: Array, distance: float) -> Array:
    """Return the share (k,) of the places at `distance` (m) around the end-effector that q (k, dof) can be moved to.

    A place counts if the arm reaches it near `q`, within its limits and free of collisions.
    """
    start = np.repeat(q, len(DIRECTIONS), axis=0)
    places = (model.positions(q)[:, None] + distance * DIRECTIONS).reshape(-1, 3)
    moved = approach(model, start, places, ITERATIONS)
    reached = np.linalg.norm(model.positions(moved) - places, axis=1) < MISS
    near = np.abs(moved - start).max(axis=1) < LARGEST_MOVE
    usable = reached & near & model.are_usable(moved)
    return np.asarray(usable.reshape(len(q), -1).mean(axis=1))


def with_room(ik: Ik, target: Array, start: Array, distance: float) -> Array | None:
    """Return the configuration (dof,) at `target` (3,) that is soonest reached with the most room.

    It is None if there is no configuration. Full room at `distance` (m) is worth `FULL_ROOM` of the way from `start`
    (dof,), which is free if possible.
    """
    model = ik.model
    goals = np.array(list(ik.free_configurations(target))).reshape(-1, model.dof)
    goals = model.nearest_turn(goals, start)
    goals = goals[model.within_limits(goals)]
    if not len(goals):
        return None
    goals = goals[np.argsort(model.min_time(start, goals), kind="stable")[:CANDIDATES]]
    scores = model.min_time(start, goals) - FULL_ROOM * room(model, goals, distance)
    ordered = goals[np.argsort(scores, kind="stable")]
    return np.asarray(next((goal for goal in ordered if _is_way_free(model, start, goal)), ordered[0]))


def moved_along(model: ArmModel, posture: Array, target: Array, period: float) -> Array:
    """Return `posture` (dof,) with the end-effector moved to `target` (3,), or as far as joints turn in `period` (s).

    Joints at their speed limit leave the rest to the others.
    """
    fastest = model.limits.velocity * period
    lower = np.maximum(posture - fastest, model.limits.lower)
    upper = np.minimum(posture + fastest, model.limits.upper)
    for _ in range(NEWTON_STEPS):
        step = damped_step(model.jacobian(posture)[:3], target - model.position(posture), TRACKING_DAMPING)
        posture = np.clip(posture + step, lower, upper)
    return posture


def _is_way_free(model: ArmModel, start: Array, goal: Array) -> bool:
    """Return True if the drives' motion from rest at `start` to rest at `goal`, (dof,) each, is free of collisions."""
    times = np.linspace(0, 2 * float(model.min_time(start, goal)), WAY_POINTS)
    return bool(model.are_free(start + trapezoidal_displacement(times, goal - start, model.limits)).all())
