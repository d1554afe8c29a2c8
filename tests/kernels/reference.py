"""What the kernels compute, in NumPy: for reading, and for holding the kernels to."""

import math

import numpy as np
import pinocchio

from .joint_profiles import max_displacement, travel_time


def damped_step(jacobian, error, damping):
    """J^T (J J^T + damping I)^-1 error."""
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(len(error)), error)


def approach(model, q, centre, iterations, largest=0.5):
    """Levenberg-Marquardt from q towards an end-effector position."""
    for _ in range(iterations):
        error = centre - model.position(q)
        step = damped_step(model.jacobian(q)[:3], error, 0.5 * error @ error + 1e-6)
        q = q + step * min(1.0, largest / (np.abs(step).max() + 1e-12))
    return q


def step_into_sphere(model, q, start, centre, radius, velocity, max_step):
    """One linear program towards a sphere: the step, the time of arrival at q, and the distance there."""
    limits, offset = model.limits, centre - model.position(q)
    distance = np.linalg.norm(offset) + 1e-12
    gain = model.jacobian(q)[:3].T @ (offset / distance)
    arrival = time = travel_time(q - start, velocity, limits).max()
    needed, travel = distance - radius + 5e-5, q - start
    moves, sign = np.abs(gain) >= 1e-9, np.where(gain > 0, 1.0, -1.0)
    room = np.where(gain > 0, limits.upper - q, q - limits.lower)
    for _ in range(2):
        reach, speed = max_displacement(np.array(time), sign * velocity, limits)
        length = np.minimum(np.minimum(reach - sign * travel, room), max_step)
        missing = needed - (np.abs(gain) * length)[moves].sum()
        slope = (np.abs(gain) * speed)[moves & (length < max_step)].sum()
        time = max(time + np.clip(missing / max(slope, 0.05), -0.1, 0.1), 1e-3)
    back = np.clip(start - q, -max_step, max_step)
    return np.where(moves, sign * np.clip(length, -max_step, max_step), back), arrival, distance


def min_time_into_sphere(model, q, velocity, centre, goals, excess, radius, tip_speed, inside, iterations, max_steps):
    """The time of `ReachTimes` into one sphere."""

    def time_to(goal, late):
        return travel_time(goal - q, velocity, model.limits).max() + late

    def late(at):
        return max(np.linalg.norm(model.position(at) - centre) - radius, 0.0) / tip_speed

    offset = model.position(q) - centre
    distance = np.linalg.norm(offset)
    if distance <= radius:
        return 0.0
    straight = approach(model, q, centre + offset * inside * radius / distance, iterations)
    straight = np.clip(straight, model.limits.lower, model.limits.upper)
    goals = [straight, *model.nearest_turn(goals, q)]
    times = [time_to(goal, by) for goal, by in zip(goals, (late(straight), *excess), strict=True)]
    goal, least = goals[int(np.argmin(times))], min(times)
    for max_step in max_steps:
        step, time, at = step_into_sphere(model, goal, q, centre, radius, velocity, max_step)
        least, goal = min(least, time + max(at - radius, 0.0) / tip_speed), goal + step
    return least


def segment_to_box(segment, centre, half_size, rotation, samples=20001):
    """Least distance of points on a segment (2, 3) from a box; 0 inside."""
    points = segment[0] + np.linspace(0, 1, samples)[:, None] * (segment[1] - segment[0])
    beyond = np.maximum(np.abs((points - centre) @ rotation) - half_size, 0.0)
    return np.linalg.norm(beyond, axis=1).min()


def twist_length(rotation, position, pose):
    """Length of the twist from a frame to a pose, by Pinocchio."""
    return np.linalg.norm(pinocchio.log6(pinocchio.SE3(rotation, position).actInv(pinocchio.SE3(pose))))


def rolled_out(period, position, velocities):
    """Positions and accelerations of a motion with these velocities, linear within each period."""
    moves = (velocities[:-1] + velocities[1:]) * (period / 2)
    positions = np.concatenate((position[None], position + np.cumsum(moves, axis=0)))
    return positions, np.diff(velocities, axis=0) / period


def fastest_to_stop(room, period, acceleration):
    """The highest velocity at the end of a period from which a joint stops within `room`."""
    return acceleration * (np.sqrt(period**2 + 2 * np.maximum(room, 0.0) / acceleration) - period)


def projected(limits, period, position, velocity, wanted):
    """The velocities near `wanted` that keep the limits."""
    change = limits.acceleration * period
    velocities = velocity + np.cumsum(np.clip(np.diff(wanted, axis=0), -change, change), axis=0)
    velocities = np.vstack((velocity, np.clip(velocities, -limits.velocity, limits.velocity)))
    positions, last = rolled_out(period, position, velocities)[0], velocities[-1]
    stops = positions[-1] + last * (np.abs(last) / (2 * limits.acceleration) + period / 2)
    extremes = np.vstack((positions, stops))
    if (extremes >= limits.lower).all() and (extremes <= limits.upper).all():
        return velocities
    for k in range(len(wanted) - 1):
        now = velocities[k]
        fastest = fastest_to_stop(limits.upper - position - now * period / 2, period, limits.acceleration)
        slowest = -fastest_to_stop(position + now * period / 2 - limits.lower, period, limits.acceleration)
        then = np.clip(np.clip(velocities[k + 1], slowest, fastest), -limits.velocity, limits.velocity)
        velocities[k + 1] = np.clip(then, now - change, now + change)
        position = position + (now + velocities[k + 1]) * period / 2
    return velocities


def straight(limits, period, horizon, position, velocity, goal):
    """Velocities with which joints move to a goal in minimum time, and stop there."""
    velocities = [velocity]
    for _ in range(horizon):
        distance = goal - position - velocity * period / 2
        fastest = np.minimum(fastest_to_stop(np.abs(distance), period, limits.acceleration), limits.velocity)
        change = limits.acceleration * period
        then = np.clip(np.copysign(fastest, distance), velocity - change, velocity + change)
        position, velocity = position + (velocity + then) * period / 2, then
        velocities.append(then)
    return np.array(velocities)


def cost(weights, posture, positions, velocities, accelerations, errors):
    """Cost of a motion."""
    total = (errors**2).sum() + weights[0] * ((positions[1:] - posture) ** 2).sum()
    return total + weights[1] * (velocities[1:] ** 2).sum() + weights[2] * (accelerations**2).sum()


def quadratic_model(q, errors, axes, gradients, exact, weight, posture):
    """Convexified Hessians and gradients at q = 0 of the cost of the knots' positions."""
    hessians, slopes = [], []
    for at, error, axis, gradient in zip(q, errors, axes, gradients, strict=True):
        hessian = gradient @ gradient.T
        if exact:
            bend = axis @ np.cross(gradient, error).T
            values, vectors = np.linalg.eigh(hessian + np.triu(bend) + np.triu(bend, 1).T)
            hessian = (vectors * np.maximum(values, 0.0)) @ vectors.T
        slopes.append(2 * gradient @ error - 2 * hessian @ at - 2 * weight * posture)
        hessians.append(2 * hessian + 2 * weight * np.eye(len(at)))
    return np.array(hessians), np.array(slopes)


def turns_near(q, seed, lower, upper):
    """Joint positions shifted by whole turns to be near a seed."""
    near = q + 2 * math.pi * np.round((seed - q) / (2 * math.pi))
    return near + 2 * math.pi * ((near < lower).astype(float) - (near > upper))
