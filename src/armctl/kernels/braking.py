"""Arithmetic of the safety filter of arms: see `armctl.control.arm_filter`.

Drives are rolled out by their law, and joints behind them by their dynamics: some periods under a command, then braking
until all joints rest. The first period is the proposal, the rest the back-up.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.arm_dynamics import Equations, Joints, equations_of, follow_drives, joints_of, place_joints
from armctl.kernels.capsules import place
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import drive_joints, follow_all, limited
from armctl.kernels.edges import Scene, distance, interpolate, measure_all
from armctl.kernels.sliding import slide

MAX_TICKS = 1000
"""Ticks after which joints that still move count as unsafe."""
AT_REST = 1e-4
"""rad/s of drives, and rad by which joints move in a tick, at most, if they rest."""
FINEST = 1 / 16
"""Share of a tick: 2 mm at 4 m/s."""
BISECTIONS = 4
"""Halvings of the segment between the braking and the proposed command."""
ALONG = 3
"""Commands along what is in the way: whole, and halved twice."""
CURVATURE = 0.001
"""m more than they keep at least: distances are not linear."""


class FilteredArm(NamedTuple):
    """An arm that keeps clear of itself, the floor and boxes."""

    scene: Scene
    bodies: NDArray[np.void]
    """(dof,) as in `armctl.kernels.arm_dynamics`."""
    motion: Array
    """(pairs, dof) m/rad: bound on how far each joint moves a pair."""
    margin: float
    """m that pairs keep."""
    caps: Array
    """(pairs,) m: the most that a pair has to keep."""
    to_positions: bool
    """True if commands are positions, else velocities."""
    following_error: float
    """rad by which joints may be behind their drives before these wait."""
    ticks: int
    """Ticks of the drives per period."""
    held: int
    """Periods of the second back-up, which holds a command before it brakes; the first brakes at once."""
    step: tuple[float, int]
    """s of a time step of the joints, and number of steps in a tick."""


class ArmState(NamedTuple):
    """State of an arm: (dof,) each, rad and rad/s."""

    position: Array
    """The drives', as `velocity`."""
    velocity: Array
    joints: Array
    joint_velocity: Array


class Plan(NamedTuple):
    """Back-up of the last safe command: it is held for so many further periods, and then all joints brake."""

    command: Array
    """(dof,)."""
    periods: NDArray[np.int64]
    """(1,)."""


class Memory(NamedTuple):
    """Memory of a rollout."""

    position: Array
    """(dof,) of the drives."""
    speeds: Array
    """(2 dof,) of the drives, as `drive_joints` has them."""
    joints: Joints
    equations: Equations
    brake: Array
    """(dof,) command that stops the drives."""
    moved: Array
    """(dof,) rad in a tick."""
    required: Array
    """(pairs,) m that a pair has to keep, at most its distance at the start if that is below the margin."""
    apart: Array
    """(pairs,) m: lower bounds on distances."""
    ends: Array
    origin: Array
    """(dof,) rad: the joints at the start of a tick."""
    between: Joints
    ends_between: Array


@compiled
def memory_of(arm):
    """Return memory for rollouts of an arm."""
    dof, num_pairs, num_links = len(arm.scene.joints), len(arm.scene.pairs), len(arm.scene.links)
    return Memory(
        np.empty(dof), np.empty(2 * dof), joints_of(dof), equations_of(dof), np.empty(dof), np.empty(dof),
        np.empty(num_pairs), np.empty(num_pairs), np.empty((num_links, 2, 3)), np.empty(dof), joints_of(dof),
        np.empty((num_links, 2, 3)),
    )  # fmt: skip


@compiled
def brake_commands(arm, q, velocity, commands):
    """Compute the `commands` (dof,) that stop drives at `q` with `velocity` (dof,) as soon as they can.

    Positions are where the joints come to rest if their speeds drop by the full acceleration in each tick.
    """
    tick = arm.step[0] * arm.step[1]
    for i in range(len(q)):
        commands[i] = 0.0
        if arm.to_positions:
            step = arm.scene.joints[i].acceleration * tick
            whole = np.floor(abs(velocity[i]) / step)
            braking = tick * (whole * abs(velocity[i]) - step * whole * (whole + 1) / 2)
            commands[i] = q[i] + np.sign(velocity[i]) * braking


@compiled
def advance(arm, command, memory):
    """Move drives and joints by a tick towards a command (dof,)."""
    joints, (timestep, steps) = memory.joints, arm.step
    drive_joints(
        arm.scene.joints, command, arm.to_positions, joints.q, memory.position, memory.speeds, arm.following_error,
        timestep * steps,
    )  # fmt: skip
    copy_to(joints.q, memory.origin)
    drives = memory.position, memory.speeds
    follow_drives(arm.scene.joints, arm.bodies, joints, drives, memory.equations, arm.step, memory.moved)


@compiled
def stays_apart(arm, memory, k, apart, bound):
    """Return True if pair k, which was so far `apart` (m) at the start of a tick, keeps its distance in the tick.

    From one place to the next where it is measured, it goes as far as the `bound` (m) on its way allows, but at least
    `FINEST` of the tick.
    """
    required, share, between = memory.required[k], 0.0, memory.between
    while apart + memory.apart[k] - bound * (1 - share) < 2 * required:
        share += max((apart - required) / bound, FINEST)
        if share >= 1:
            return True
        interpolate(memory.origin, memory.joints.q, share, between.q)
        place_joints(arm.scene.joints, between)
        place(arm.scene.links, between.rotations, between.origins, memory.ends_between)
        apart = distance(arm.scene.links, arm.scene.boxes, memory.ends_between, arm.scene.pairs[k])
        if apart < required:
            return False
    return True


@compiled
def keeps_clear(arm, memory):
    """Return True if no pair comes nearer than it has to keep, in the tick that has just been made or at its end.

    A pair is measured as soon as the next such tick may bring it too near.
    """
    _, links, pairs, boxes = arm.scene
    placed = False
    for k in range(len(pairs)):
        bound = 0.0
        for i in range(len(memory.moved)):
            bound += arm.motion[k, i] * memory.moved[i]
        required, previous = memory.required[k], memory.apart[k]
        memory.apart[k] = previous - bound
        if memory.apart[k] < required + 2 * bound:
            if not placed:
                place(links, memory.joints.rotations, memory.joints.origins, memory.ends)
                placed = True
            memory.apart[k] = distance(links, boxes, memory.ends, pairs[k])
            if memory.apart[k] < required or not stays_apart(arm, memory, k, previous, bound):
                return False
    return True


@compiled
def start(arm, state, apart, memory):
    """Begin a rollout at a state of the arm, with pairs `apart` (pairs,) m."""
    for i in range(len(state.position)):
        memory.speeds[i] = state.velocity[i]
    copy_to(state.position, memory.position)
    copy_to(state.joints, memory.joints.q)
    copy_to(state.joint_velocity, memory.joints.velocity)
    place_joints(arm.scene.joints, memory.joints)
    copy_to(apart, memory.apart)


@compiled
def is_at_rest(memory):
    """Return True if drives and joints rest."""
    for i in range(len(memory.moved)):  # noqa: SIM110 (generators cannot be compiled)
        if max(memory.moved[i], abs(memory.speeds[i])) > AT_REST:
            return False
    return True


@compiled
def stops_safely(arm, state, apart, command, periods, memory):
    """Return True if so many periods under a command (dof,), and the braking after them, keep clear."""
    start(arm, state, apart, memory)
    for tick in range(MAX_TICKS):
        if tick >= arm.ticks and is_at_rest(memory):
            return True
        if tick == periods * arm.ticks:
            brake_commands(arm, memory.position, memory.speeds, memory.brake)
        advance(arm, command if tick < periods * arm.ticks else memory.brake, memory)
        if not keeps_clear(arm, memory):
            return False
    return False


@compiled
def safe_periods(arm, state, apart, command, memory):
    """Return for how many periods a command (dof,) may be held before braking, of the back-ups' two; -1 if neither."""
    for periods in (0, arm.held):
        if stops_safely(arm, state, apart, command, 1 + periods, memory):
            return periods
    return -1


@compiled
def effective(arm, state, command, target):
    """Compute the `target` (dof,) of least size that moves drives in the next period as a command (dof,) does.

    It is where they stop if they brake after it, or their velocities then.
    """
    joints, tick = arm.scene.joints, arm.step[0] * arm.step[1]
    position, velocity = state.position.copy(), state.velocity.copy()
    if arm.to_positions:
        follow_all(joints, command, position, velocity, arm.ticks, tick)
        brake_commands(arm, position, velocity, target)
        return
    for i in range(len(command)):
        target[i] = limited(command[i], velocity[i], joints[i].top, joints[i].acceleration, arm.ticks * tick)


@compiled
def square_distance(first, second):
    """Return the squared distance of two commands (dof,)."""
    square = 0.0
    for i in range(len(first)):
        square += (first[i] - second[i]) ** 2
    return square


@compiled
def along(arm, target, brake, required, command):
    """Compute the `command` (dof,) that moves joints as to a target (dof,), but along what is in the way.

    Both are relative to the command that brakes: where joints come to rest, or no velocities.
    """
    for i in range(len(target)):
        command[i] = target[i] - brake[i]
    slide(arm.scene, arm.motion, brake, required, command)
    for i in range(len(target)):
        command[i] += brake[i]


@compiled
def alternative(number, aims, shares, tried):
    """Compute command `number` of those `tried` (dof,): between a target and the back-up, by one joint, or along.

    `aims` are the target, the back-up, the command that brakes, and the one along what is in the way, (dof,) each, and
    `shares` the bounds of the bisection.
    """
    (target, backup, brake, aside), dof = aims, len(tried)
    for i in range(dof):
        if number < BISECTIONS:
            tried[i] = backup[i] + (shares[0] + shares[1]) / 2 * (target[i] - backup[i])
        elif number < BISECTIONS + dof:
            tried[i] = brake[i] if i == number - BISECTIONS else target[i]
        elif number < BISECTIONS + 2 * dof:
            tried[i] = target[i] if i == number - BISECTIONS - dof else brake[i]
        else:
            tried[i] = brake[i] + 0.5 ** (number - BISECTIONS - 2 * dof) * (aside[i] - brake[i])


@compiled
def nearest_safe(arm, state, proposal, plan, command):
    """Compute the safe `command` (dof,) nearest to a `proposal`: the same, or one of some, by the distance of effects.

    These are on the segment between the proposal's effect and the back-up of the last command, the `plan`; or brake one
    joint, or all but one; or go along what is in the way. If none is safe, it is that back-up.
    """
    dof, memory, apart = len(proposal), memory_of(arm), np.empty(len(arm.scene.pairs))
    target, backup, brake, aside = np.empty(dof), np.empty(dof), np.empty(dof), np.empty(dof)
    tried, shares = proposal.copy(), np.array((0.0, 1.0))
    measure_all(arm.scene, state.joints, apart)
    for k in range(len(apart)):
        memory.required[k] = min(arm.margin, arm.caps[k], apart[k])
    brake_commands(arm, state.position, state.velocity, brake)
    copy_to(brake if plan.periods[0] == 0 else plan.command, backup)
    copy_to(backup, command)
    rest = max(plan.periods[0] - 1, 0)
    for number in range(-1, BISECTIONS + 2 * dof + ALONG):
        if number == 0:
            effective(arm, state, proposal, target)
            along(arm, target, brake, memory.required + CURVATURE, aside)
        if number >= 0:
            alternative(number, (target, backup, brake, aside), shares, tried)
        if number >= BISECTIONS and square_distance(tried, target) >= square_distance(command, target):
            continue
        periods = safe_periods(arm, state, apart, tried, memory)
        if periods >= 0:
            copy_to(tried, command)
            rest = periods
        if number < 0 and periods >= 0:
            break
        if 0 <= number < BISECTIONS:
            shares[0 if periods >= 0 else 1] = (shares[0] + shares[1]) / 2
    copy_to(command, plan.command)
    plan.periods[0] = rest
