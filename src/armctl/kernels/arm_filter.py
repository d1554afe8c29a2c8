"""Choice of the safety filter of arms: see `armctl.control.arm_filter`. Rollouts are in `armctl.kernels.braking`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.braking import brake_commands, memory_of, safe_periods
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import follow_all, limited
from armctl.kernels.edges import measure_all
from armctl.kernels.sliding import slide

BISECTIONS = 4
"""Halvings of the segment between the braking and the proposed command."""
ALONG = 3
"""Commands along what is in the way: whole, and halved twice."""
CURVATURE = 0.001
"""m more than they keep at least: distances are not linear."""


class Plan(NamedTuple):
    """Back-up of the last safe command: it is held for so many further periods, and then all joints brake."""

    command: Array
    """(dof,)."""
    periods: NDArray[np.int64]
    """(1,)."""


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
def alternatives(target, brake, aside, commands):
    """Compute `commands` (2 dof + `ALONG`, dof): a target but for one joint, which brakes, or the reverse, or along.

    They are (dof,) each: the target, the command that brakes, and the one along what is in the way.
    """
    dof = len(target)
    for row in range(len(commands)):
        for i in range(dof):
            if row < dof:
                commands[row, i] = brake[i] if i == row else target[i]
            elif row < 2 * dof:
                commands[row, i] = target[i] if i == row - dof else brake[i]
            else:
                commands[row, i] = brake[i] + 0.5 ** (row - 2 * dof) * (aside[i] - brake[i])


@compiled
def nearest_safe(arm, state, proposal, plan, command):
    """Compute the safe `command` (dof,) nearest to a `proposal`: the same, or one of some, by the distance of effects.

    These are on the segment between the proposal's effect and the back-up of the last command, the `plan`; or brake one
    joint, or all but one; or go along what is in the way. If none is safe, it is that back-up.
    """
    memory, apart = memory_of(arm), np.empty(len(arm.scene.pairs))
    measure_all(arm.scene, state.joints, apart)
    for k in range(len(apart)):
        memory.required[k] = min(arm.margin, arm.caps[k], apart[k])
    periods = safe_periods(arm, state, apart, proposal, memory)
    if periods >= 0:
        copy_to(proposal, command)
    else:
        periods = nearest_alternative(arm, state, apart, (proposal, plan), memory, command)
    copy_to(command, plan.command)
    plan.periods[0] = periods


@compiled
def nearest_alternative(arm, state, apart, wish, memory, command):
    """Compute the `command` (dof,) nearest to an unsafe one; return for how many periods it is held before braking.

    The `wish` is the proposal, and the plan.
    """
    (proposal, plan), dof = wish, len(command)
    target, backup, brake, aside, tried = (np.empty(dof), np.empty(dof), np.empty(dof), np.empty(dof), np.empty(dof))
    brake_commands(arm, state.position, state.velocity, brake)
    copy_to(brake if plan.periods[0] == 0 else plan.command, backup)
    copy_to(backup, command)
    effective(arm, state, proposal, target)
    rest, low, high = max(plan.periods[0] - 1, 0), 0.0, 1.0
    for _ in range(BISECTIONS):
        for i in range(dof):
            tried[i] = backup[i] + (low + high) / 2 * (target[i] - backup[i])
        periods = safe_periods(arm, state, apart, tried, memory)
        if periods < 0:
            high = (low + high) / 2
        else:
            low, rest = (low + high) / 2, periods
            copy_to(tried, command)
    along(arm, target, brake, memory.required + CURVATURE, aside)
    others, farthest = np.empty((2 * dof + ALONG, dof)), square_distance(command, target)
    alternatives(target, brake, aside, others)
    distances = np.array([square_distance(other, target) for other in others])
    for number in np.argsort(distances, kind="mergesort"):
        if distances[number] >= farthest:
            break
        periods = safe_periods(arm, state, apart, others[number], memory)
        if periods >= 0:
            copy_to(others[number], command)
            return periods
    return rest
