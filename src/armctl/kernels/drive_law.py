"""Arithmetic of `armctl.estimation.drive_observer`: the law of robots driven by velocity commands, and its learning.

Velocities, commands and all parameters of a response are rows of two: linear and angular.
"""

import math
from typing import NamedTuple

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled
from armctl.kernels.planar import towards


class Nominal(NamedTuple):
    """Numbers of `DriveObserverOptions`, ready for use; rows (2,)."""

    period: float
    gain: Array
    acceleration: Array
    max_command: Array
    shortfall: Array
    clear_gap: Array
    """(2, 2): lowest and highest."""
    slow: Array
    turning: float
    learning: float
    stalled: float
    stall_command: float
    stall_share: float
    stall_drop: float
    min_change: float
    min_acceleration: Array
    recovery: float
    offset_gain: float
    max_deviation: Array
    max_offset: Array


class Response(NamedTuple):
    """Responses of m drives, changed in place; rows (m, 2)."""

    acceleration: Array
    speed: Array
    offset: Array
    stalled: Array
    """1 where the last step was a stall, else 0."""
    slow: Array
    """1 where the last step was slow, else 0: a push alone is none of the drives' doing."""


@compiled
def clipped(value, limit):
    """Return a value within +-limit."""
    return min(max(value, -limit), limit)


@compiled
def target(nominal, response, i, k, command):
    """Return the velocity that a command aims at, in channel k of drive i."""
    effective = clipped(command, nominal.max_command[k]) - response.offset[i, k]
    return clipped(nominal.gain[k] * effective, response.speed[i, k])


@compiled
def predict(nominal, response, new_share, states, commands, ahead):
    """Compute states `ahead` (m, 5) a period after `states` (n, 5), repeated, with commands (m, 2)."""
    for i in range(len(ahead)):
        x, y, yaw, linear, angular = states[i % len(states)]
        reach = response.acceleration[i]
        new_linear = towards(linear, target(nominal, response, i, 0, commands[i, 0]), reach[0] * nominal.period)
        new_angular = towards(angular, target(nominal, response, i, 1, commands[i, 1]), reach[1] * nominal.period)
        distance = nominal.period * ((1 - new_share) * linear + new_share * new_linear)
        ahead[i, 0], ahead[i, 1] = x + distance * math.cos(yaw), y + distance * math.sin(yaw)
        ahead[i, 2], ahead[i, 3], ahead[i, 4] = yaw + nominal.period * new_angular, new_linear, new_angular


@compiled
def learn(nominal, response, velocities, commands, responses):
    """Learn from `responses` (n, 2), a period after `velocities` (n, 2), repeated, with commands (m, 2)."""
    n = len(velocities)
    for i in range(len(commands)):
        j = i % n
        is_turning = max(abs(commands[i, 1]), abs(velocities[j, 1])) > nominal.turning
        slow_share, is_excused = nominal.slow[1] if is_turning else nominal.slow[0], False
        for k in (1, 0):
            if math.isfinite(responses[j, k] - velocities[j, k]):
                short = learn_channel(
                    nominal, response, (i, k), velocities[j, k], commands[i, k], responses[j, k],
                    0.0 if is_excused else slow_share,
                )  # fmt: skip
                is_excused = short and is_turning  # wheels that cannot turn the robot do not speed it up, either


@compiled
def learn_channel(nominal, response, place, velocity, command, reply, slow_share):
    """Learn from the reply to one command of one drive; return whether it falls short."""
    i, k = place
    aim, reach = target(nominal, response, i, k, command), response.acceleration[i, k] * nominal.period
    gap = aim - velocity
    direction, size = (gap > 0) - (gap < 0), abs(gap)
    expected = min(reach, size)
    change, deviation = direction * (reply - velocity), reply - velocity - direction * expected
    short = direction * (aim - reply) > nominal.shortfall[k] and change >= 0
    stalled = k == 1 and direction * command > nominal.stall_command and reply * direction > 0
    stalled = stalled and direction * (aim - reply) > nominal.stall_share * abs(aim)
    stalled = stalled and change < nominal.stalled * expected
    clear = size >= min(max(0.6 * reach, nominal.clear_gap[0, k]), nominal.clear_gap[1, k])
    slow = short and not stalled and clear and nominal.min_change * expected < change < slow_share * expected
    if (slow and response.slow[i, k]) or (size > reach and change > reach):
        response.acceleration[i, k] += nominal.learning * (change / nominal.period - response.acceleration[i, k])
    elif size > 0.75 * reach and change >= 0.9 * expected:
        response.acceleration[i, k] *= 1 + nominal.recovery
    response.acceleration[i, k] = min(
        max(response.acceleration[i, k], nominal.min_acceleration[k]), nominal.acceleration[k]
    )
    speed = response.speed[i, k]
    if stalled and response.stalled[i, k]:
        response.speed[i, k] = max(abs(reply), abs(velocity), nominal.stall_drop * speed)
    else:
        is_full = abs(aim) >= 0.95 * speed and direction * reply >= 0.95 * speed
        grown = max(speed * (1 + nominal.recovery if is_full else 1.0), abs(reply))
        response.speed[i, k] = min(grown, nominal.max_command[k])
    response.stalled[i, k], response.slow[i, k] = stalled, slow
    if size < reach or change < nominal.min_change * expected:
        offset = response.offset[i, k] - nominal.offset_gain * clipped(deviation, nominal.max_deviation[k])
        response.offset[i, k] = clipped(offset, nominal.max_offset[k])
    return short
