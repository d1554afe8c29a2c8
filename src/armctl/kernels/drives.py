"""Motion profiles of an arm's drives: see `armctl.robot_description.joint_profiles`.

Joints are records with the fields of `DRIVE`: position limits `lower` and `upper` (rad), the velocity limit `top`
(rad/s) and the limit of `acceleration` (rad/s^2). A tick is in s.
"""

import math

import numpy as np

from armctl.kernels.compiling import compiled

DRIVE = np.dtype([(name, float) for name in ("lower", "upper", "top", "acceleration")])


@compiled
def highest_stoppable(distance, acceleration, tick):
    """Return the highest speed for one tick from which a joint, braking at a constant rate, stops at `distance`.

    Over this tick and `k` further ones: distance = (k + 1) speed tick - acceleration tick^2 k (k + 1) / 2.
    """
    unit = acceleration * tick * tick
    further_ticks = math.floor((math.sqrt(1 + 8 * distance / unit) - 1) / 2)
    return (distance / (further_ticks + 1) + unit * further_ticks / 2) / tick


@compiled
def towards(goal, position, acceleration, tick):
    """Return the velocity for the next tick on the minimum-time profile from `position` to rest at `goal`."""
    displacement = goal - position
    return math.copysign(highest_stoppable(abs(displacement), acceleration, tick), displacement)


@compiled
def limited(target, velocity, top, acceleration, tick):
    """Return the velocity nearest to `target` that the limits allow after the last tick's `velocity`."""
    change = acceleration * tick
    return min(max(target, max(velocity - change, -top)), min(velocity + change, top))


@compiled
def within_range(target, position, lower, upper, acceleration, tick):
    """Return the velocity nearest to `target` after which the joint can still stop within its position limits."""
    to_upper = highest_stoppable(max(upper - position, 0.0), acceleration, tick)
    to_lower = highest_stoppable(max(position - lower, 0.0), acceleration, tick)
    return min(max(target, -to_lower), to_upper)


@compiled
def drive_joints(joints, setpoints, to_positions, positions, commands, velocities, following_error, tick):
    """Set the velocities of `commands` (dof,) for the next tick, towards `setpoints` positions or velocities (dof,).

    Commands wait for `positions` (dof,) that are more than `following_error` (rad) behind. `velocities` (2 dof,) are
    given twice: to the servos' position and to their velocity.
    """
    dof = len(positions)
    for i in range(dof):
        joint, position, velocity = joints[i], positions[i], setpoints[i]
        command = min(max(commands[i], position - following_error), position + following_error)
        if to_positions:
            velocity = towards(velocity, command, joint.acceleration, tick)
        velocity = within_range(velocity, command, joint.lower, joint.upper, joint.acceleration, tick)
        commands[i] = command
        velocities[i] = limited(velocity, velocities[i], joint.top, joint.acceleration, tick)
        velocities[dof + i] = velocities[i]


@compiled
def follow(joint, goal, position, velocity, ticks, tick):
    """Return position and velocity of one joint after some ticks towards a goal within its limits."""
    for _ in range(ticks):
        velocity = limited(
            towards(goal, position, joint.acceleration, tick), velocity, joint.top, joint.acceleration, tick
        )
        position += velocity * tick
    return position, velocity


@compiled
def follow_all(joints, goals, positions, velocities, ticks, tick):
    """Move `positions` and `velocities` (dof,) on by some ticks towards `goals` (dof,)."""
    for i in range(len(goals)):
        positions[i], velocities[i] = follow(joints[i], goals[i], positions[i], velocities[i], ticks, tick)


@compiled
def goals_for(joints, positions, velocities, displacements, shares, ticks, tick, goals):
    """Compute goals (dof,) at which joints move by `displacements` (dof,) within some ticks, or as nearly as they can.

    The displacement increases with the goal. Goals are tried at which a joint stops after it has gained each of the
    `shares` (m,) of its largest change of speed; between the two that enclose the displacement, it is interpolated.
    """
    period = ticks * tick
    for i in range(len(goals)):
        joint, position, velocity = joints[i], positions[i], velocities[i]
        low = high = low_displacement = high_displacement = 0.0
        for k in range(len(shares)):
            end = velocity + shares[k] * (joint.acceleration * period)
            goal = position + (velocity + end) / 2 * period + end * abs(end) / (2 * joint.acceleration)
            low, low_displacement = high, high_displacement
            high = min(max(goal, joint.lower), joint.upper)
            high_displacement = follow(joint, high, position, velocity, ticks, tick)[0] - position
            if k > 0 and high_displacement >= displacements[i]:
                break
        share = (displacements[i] - low_displacement) / max(high_displacement - low_displacement, 1e-12)
        goals[i] = low + min(max(share, 0.0), 1.0) * (high - low)


@compiled
def travel_time(displacement, velocity, top, acceleration):
    """Return the minimum time (s) for a joint with initial `velocity` to move by `displacement`, at any final speed."""
    ahead = -velocity if displacement < 0 else velocity
    distance = abs(displacement)
    run_up = (top * top - ahead * ahead) / (2 * acceleration)
    speeding_up = (math.sqrt(ahead * ahead + 2 * acceleration * min(distance, run_up)) - ahead) / acceleration
    return speeding_up + max(distance - run_up, 0.0) / top


@compiled
def min_time(joints, start, velocity, goal):
    """Return the minimum time (s) for all joints to move from `start` with `velocity` to `goal`, (dof,) each."""
    time = 0.0
    for i in range(len(goal)):
        time = max(time, travel_time(goal[i] - start[i], velocity[i], joints[i].top, joints[i].acceleration))
    return time


@compiled
def min_times(joints, start, velocity, goals, times):
    """Compute the minimum `times` (n,) s from one state to many `goals` (n, dof)."""
    for row in range(len(goals)):
        times[row] = min_time(joints, start, velocity, goals[row])


@compiled
def trapezoidal_displacement(time, displacement, top, acceleration):
    """Return the displacement at `time` (s) on the trapezoidal profile from rest to rest at `displacement`."""
    distance = abs(displacement)
    speed = min(top, math.sqrt(acceleration * distance))
    ramp = speed / acceleration
    end = 2 * ramp + (distance - speed * ramp) / max(speed, 1e-12)
    speeding_up = min(max(time, 0.0), ramp)
    braking = min(max(time - (end - ramp), 0.0), ramp)
    cruising = min(max(time, 0.0), end) - speeding_up - braking
    moved = acceleration * speeding_up**2 / 2 + speed * cruising + braking * (speed - acceleration * braking / 2)
    return math.copysign(moved, displacement)


@compiled
def profiles(joints, times, displacements, moved):
    """Compute the trapezoidal profiles of all joints: `moved` (n, dof) at `times` (n,), to `displacements` (dof,)."""
    for row in range(len(times)):
        for i in range(len(displacements)):
            moved[row, i] = trapezoidal_displacement(
                times[row], displacements[i], joints[i].top, joints[i].acceleration
            )


@compiled
def fly_by(joints, start, positions, time, overruns, commands):
    """Compute `commands` (dof,) with which joints at rest at `start` (dof,) are at `positions` (dof,) by `time` (s).

    A joint that would be late if it stopped there overruns it, by the least of the fractions `overruns` of its braking
    distance with which it is in time.
    """
    for i in range(len(start)):
        joint, displacement = joints[i], positions[i] - start[i]
        speed = min(joint.top, math.sqrt(2 * joint.acceleration * abs(displacement)))
        braking = math.copysign(speed * speed / (2 * joint.acceleration), displacement)
        further = displacement
        for share in overruns:
            further = displacement + share * braking
            moved = trapezoidal_displacement(time, further, joint.top, joint.acceleration)
            if abs(moved) >= abs(displacement) - 1e-9:
                break
        commands[i] = min(max(start[i] + further, joint.lower), joint.upper)
