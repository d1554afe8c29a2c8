"""Arithmetic of the safety filter of arms: see `armctl.control.arm_filter`.

Drives are rolled out by their law: a period under a command, then braking until all joints rest. Positions and
velocities are those that the drives command.
"""

from typing import NamedTuple

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels.arm import forward
from armctl.kernels.capsules import place
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import drive_joints
from armctl.kernels.edges import Scene, distance, measure_all

MAX_TICKS = 1000
"""Ticks after which drives that still move count as unsafe."""
AT_REST = 1e-9
"""rad/s."""
FADING = 0.97
"""Factor by which a recent speed fades in a tick."""
BISECTIONS = 4
"""Halvings of the segment between the braking and the proposed command."""


class FilteredArm(NamedTuple):
    """An arm that keeps clear of itself, the floor and boxes."""

    scene: Scene
    motion: Array
    """(pairs, dof) m/rad: bound on how far each joint moves a pair."""
    margin: float
    """m that pairs keep at rest."""
    caps: Array
    """(pairs,) m: the most that a pair has to keep."""
    lag: float
    """s: joints are at most so late behind their drives; so much more has to be kept."""
    to_positions: bool
    """True if commands are positions, else velocities."""
    ticks: int
    """Ticks of the drives per period."""
    tick: float
    """s."""


class DriveState(NamedTuple):
    """State of an arm's drives."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""
    recent: Array
    """(dof,) rad/s: the highest recent speeds, by which joints are late."""


class Memory(NamedTuple):
    """Memory of a rollout."""

    q: Array
    speeds: Array
    """(2 dof,) as `drive_joints` has them."""
    brake: Array
    """(dof,) command that stops the drives."""
    moved: Array
    """(dof,) rad in a tick."""
    recent: Array
    """(dof,) rad/s: the highest recent speeds."""
    caps: Array
    """(pairs,) m: the most that a pair has to keep, at most its distance at the start if that is below the margin."""
    apart: Array
    """(pairs,) m: lower bounds on distances."""
    rotations: Array
    origins: Array
    ends: Array


@compiled
def memory_of(arm):
    """Return memory for rollouts of an arm."""
    dof, num_pairs, num_links = len(arm.scene.joints), len(arm.scene.pairs), len(arm.scene.links)
    return Memory(
        np.empty(dof), np.empty(2 * dof), np.empty(dof), np.empty(dof), np.empty(dof), np.empty(num_pairs),
        np.empty(num_pairs),
        np.empty((dof, 3, 3)), np.empty((dof, 3)), np.empty((num_links, 2, 3)),
    )  # fmt: skip


@compiled
def brake_commands(arm, q, velocity, commands):
    """Compute the `commands` (dof,) that stop drives at `q` with `velocity` (dof,) as soon as they can.

    Positions are where the joints come to rest if their speeds drop by the full acceleration in each tick.
    """
    for i in range(len(q)):
        commands[i] = 0.0
        if arm.to_positions:
            step = arm.scene.joints[i].acceleration * arm.tick
            whole = np.floor(abs(velocity[i]) / step)
            braking = arm.tick * (whole * abs(velocity[i]) - step * whole * (whole + 1) / 2)
            commands[i] = q[i] + np.sign(velocity[i]) * braking


@compiled
def advance(arm, command, memory):
    """Move drives by a tick towards a command (dof,)."""
    q, speeds, moved = memory.q, memory.speeds, memory.moved
    drive_joints(arm.scene.joints, command, arm.to_positions, q, q, speeds, np.inf, arm.tick)
    for i in range(len(q)):
        moved[i] = abs(speeds[i] * arm.tick)
        memory.recent[i] = max(FADING * memory.recent[i], abs(speeds[i]))
        q[i] += speeds[i] * arm.tick


@compiled
def keeps_clear(arm, memory):
    """Return True if no pair comes nearer than it has to keep, in the tick that has just been made or at its end.

    While joints move, a pair's distance changes by at most its bound: between two distances d and e it stays at least
    (d + e - bound) / 2. A pair is measured as soon as the next such tick may bring it too near.
    """
    _, links, pairs, boxes = arm.scene
    placed = False
    for k in range(len(pairs)):
        bound, lag_motion = 0.0, 0.0
        for i in range(len(memory.moved)):
            bound += arm.motion[k, i] * memory.moved[i]
            lag_motion += arm.motion[k, i] * memory.recent[i]
        kept, previous = min(arm.margin + arm.lag * lag_motion, memory.caps[k]), memory.apart[k]
        memory.apart[k] = previous - bound
        if memory.apart[k] < kept + 2 * bound:
            if not placed:
                forward(arm.scene.joints, memory.q, memory.rotations, memory.origins)
                place(links, memory.rotations, memory.origins, memory.ends)
                placed = True
            memory.apart[k] = distance(links, boxes, memory.ends, pairs[k])
            required = min(arm.margin, memory.caps[k])
            if memory.apart[k] < kept or previous + memory.apart[k] - bound < 2 * required:
                return False
    return True


@compiled
def start(state, apart, memory):
    """Begin a rollout at a state of the drives, with pairs `apart` (pairs,) m."""
    dof = len(state.position)
    copy_to(state.position, memory.q)
    copy_to(state.velocity, memory.speeds[:dof])
    copy_to(state.velocity, memory.speeds[dof:])
    copy_to(state.recent, memory.recent)
    copy_to(apart, memory.apart)


@compiled
def stops_safely(arm, state, apart, command, memory):
    """Return True if a period under a command (dof,), and the braking after it, keep clear."""
    dof = len(command)
    start(state, apart, memory)
    for _ in range(arm.ticks):
        advance(arm, command, memory)
        if not keeps_clear(arm, memory):
            return False
    brake_commands(arm, memory.q, memory.speeds[:dof], memory.brake)
    for _ in range(MAX_TICKS):
        if np.abs(memory.speeds[:dof]).max() <= AT_REST:
            return True
        advance(arm, memory.brake, memory)
        if not keeps_clear(arm, memory):
            return False
    return False


@compiled
def effective(arm, state, apart, command, memory, commands):
    """Compute the `commands` (dof,) of least size that move drives in the next period as a command does.

    It is where they stop if they brake after it, or their velocities then.
    """
    dof = len(command)
    start(state, apart, memory)
    for _ in range(arm.ticks):
        advance(arm, command, memory)
    if arm.to_positions:
        brake_commands(arm, memory.q, memory.speeds[:dof], commands)
    else:
        copy_to(memory.speeds[:dof], commands)


@compiled
def square_distance(first, second):
    """Return the squared distance of two commands (dof,)."""
    square = 0.0
    for i in range(len(first)):
        square += (first[i] - second[i]) ** 2
    return square


@compiled
def nearest_alternative(arm, state, apart, target, memory, command):
    """Compute the safe `command` (dof,) nearest to the `target` among some, by the distance of its effect.

    These brake all joints in part, or one joint, or all but one. If none is safe, all brake.
    """
    dof = len(target)
    brake, tried = np.empty(dof), np.empty(dof)
    brake_commands(arm, state.position, state.velocity, brake)
    copy_to(brake, command)
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        for i in range(dof):
            tried[i] = brake[i] + middle * (target[i] - brake[i])
        if stops_safely(arm, state, apart, tried, memory):
            low = middle
            copy_to(tried, command)
        else:
            high = middle
    for k in range(2 * dof):
        copy_to(target if k < dof else brake, tried)
        tried[k % dof] = brake[k % dof] if k < dof else target[k % dof]
        is_nearer = square_distance(tried, target) < square_distance(command, target)
        if is_nearer and stops_safely(arm, state, apart, tried, memory):
            copy_to(tried, command)


@compiled
def nearest_safe(arm, state, proposal, command):
    """Compute the safe `command` (dof,) nearest to a `proposal`: the same, or the nearest of some alternatives."""
    memory, apart = memory_of(arm), np.empty(len(arm.scene.pairs))
    measure_all(arm.scene, state.position, apart)
    for k in range(len(apart)):
        memory.caps[k] = min(arm.caps[k], apart[k]) if apart[k] < arm.margin else arm.caps[k]
    if stops_safely(arm, state, apart, proposal, memory):
        copy_to(proposal, command)
        return
    target = np.empty(len(proposal))
    effective(arm, state, apart, proposal, memory, target)
    nearest_alternative(arm, state, apart, target, memory, command)
