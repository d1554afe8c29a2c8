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
from armctl.kernels.drives import drive_joints
from armctl.kernels.edges import Scene, distance, interpolate, measure_all

MAX_TICKS = 1000
"""Ticks after which joints that still move count as unsafe."""
SAG = 0.01
"""m by which pairs are nearer where joints rest than where drives do, at most."""
AT_REST = 1e-4
"""rad/s of drives, and rad by which joints move in a tick, at most, if they rest."""
FINEST = 1 / 16
"""Share of a tick: 2 mm at 4 m/s."""


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
def stopping_places(arm, q, velocity, places):
    """Compute where (dof,) drives at `q` with `velocity` (dof,) stop: by the full acceleration in each tick."""
    tick = arm.step[0] * arm.step[1]
    for i in range(len(q)):
        step = arm.scene.joints[i].acceleration * tick
        whole = np.floor(abs(velocity[i]) / step)
        braking = tick * (whole * abs(velocity[i]) - step * whole * (whole + 1) / 2)
        places[i] = q[i] + np.sign(velocity[i]) * braking


@compiled
def brake_commands(arm, q, velocity, commands):
    """Compute the `commands` (dof,) that stop drives at `q` with `velocity` (dof,) as soon as they can."""
    if arm.to_positions:
        stopping_places(arm, q, velocity, commands)
    else:
        for i in range(len(q)):
            commands[i] = 0.0


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
def after_period(arm, states, commands):
    """Move arms at `states` (n, 4, dof), the numbers of `ArmState`, by a period under `commands` (n, dof)."""
    memory, apart, dof = memory_of(arm), np.empty(len(arm.scene.pairs)), commands.shape[1]
    for row in range(len(states)):
        state = states[row]
        start(arm, ArmState(state[0], state[1], state[2], state[3]), apart, memory)
        for _ in range(arm.ticks):
            advance(arm, commands[row], memory)
        copy_to(memory.position, state[0])
        copy_to(memory.speeds[:dof], state[1])
        copy_to(memory.joints.q, state[2])
        copy_to(memory.joints.velocity, state[3])


@compiled
def drives_after_period(arm, states, commands):
    """Do the same for drives, in a fraction of the time: joints keep their velocities."""
    tick, dof = arm.step[0] * arm.step[1], commands.shape[1]
    speeds = np.empty(2 * dof)
    for row in range(len(states)):
        position, velocity, joints, joint_velocity = states[row, 0], states[row, 1], states[row, 2], states[row, 3]
        copy_to(velocity, speeds[:dof])
        for _ in range(arm.ticks):
            drive_joints(
                arm.scene.joints, commands[row], arm.to_positions, joints, position, speeds, arm.following_error, tick
            )
            for i in range(dof):
                position[i] += tick * speeds[i]
                joints[i] += tick * joint_velocity[i]
        copy_to(speeds[:dof], velocity)


@compiled
def is_at_rest(memory):
    """Return True if drives and joints rest."""
    for i in range(len(memory.moved)):  # noqa: SIM110 (generators cannot be compiled)
        if max(memory.moved[i], abs(memory.speeds[i])) > AT_REST:
            return False
    return True


@compiled
def keeps_clear_for(arm, ticks, command, memory):
    """Return True if an arm keeps clear in so many ticks under a command (dof,)."""
    for _ in range(ticks):
        advance(arm, command, memory)
        if not keeps_clear(arm, memory):
            return False
    return True


@compiled
def stops_safely(arm, periods, command, memory):
    """Return True if so many periods under a command (dof,), and the braking after them, keep clear."""
    for tick in range(MAX_TICKS):
        if is_at_rest(memory):
            return True
        if tick == periods * arm.ticks:
            brake_commands(arm, memory.position, memory.speeds, memory.brake)
        if not keeps_clear_for(arm, 1, command if tick < periods * arm.ticks else memory.brake, memory):
            return False
    return False


@compiled
def stops_apart(arm, periods, command, memory):
    """Return False if drives that brake after so many periods under a command (dof,) stop where a pair is too near.

    Joints rest beside their drives, so pairs may be nearer by `SAG` there. That is far less work than a rollout.
    """
    tick, dof, distances = arm.step[0] * arm.step[1], len(command), np.empty(len(arm.scene.pairs))
    place, speeds, stop = memory.position.copy(), memory.speeds.copy(), np.empty(dof)
    for _ in range(periods * arm.ticks):
        drive_joints(arm.scene.joints, command, arm.to_positions, place, place, speeds, arm.following_error, tick)
        for i in range(dof):
            place[i] += tick * speeds[i]
    stopping_places(arm, place, speeds, stop)
    measure_all(arm.scene, stop, distances)
    for k in range(len(distances)):  # noqa: SIM110 (generators cannot be compiled)
        if distances[k] < memory.required[k] - SAG:
            return False
    return True


@compiled
def safe_periods(arm, state, apart, command, memory):
    """Return for how many periods a command (dof,) may be held before braking, of the back-ups' two; -1 if neither."""
    start(arm, state, apart, memory)
    if not keeps_clear_for(arm, arm.ticks, command, memory):
        return -1
    dof, joints = len(command), memory.joints
    second = ArmState(memory.position.copy(), memory.speeds[:dof].copy(), joints.q.copy(), joints.velocity.copy())
    apart_then, moved = memory.apart.copy(), memory.moved.copy()
    for periods in (0, arm.held):
        start(arm, second, apart_then, memory)
        copy_to(moved, memory.moved)
        if stops_apart(arm, periods, command, memory) and stops_safely(arm, periods, command, memory):
            return periods
        if arm.held == 0:
            break
    return -1
