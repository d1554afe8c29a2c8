"""A safety filter of a rover: it changes a command after which there would be no safe way to go on.

Model predictive shielding (Bastani, "Safe reinforcement learning with nonlinear dynamics via model predictive
shielding", ACC 2021) with a library of back-ups. A command is safe if the rover, by a model of its sliding wheels,
keeps clear of the deck's sides and ends, of blocks and of people for a period under it, and then under one of the
back-ups: it brakes, or goes on for a while, as before or along the bridge, and then brakes, to where nobody walks by.
The rest of that back-up is carried out if later nothing is safe.
"""

import math

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels import rover_filter as kernel
from armctl.scene import BridgeMap

BACKUPS = (
    (kernel.BRAKE, 0, 0.0), (kernel.HOLD, 4, 0.0), (kernel.ALONG, 6, 1.6), (kernel.ALONG, 6, -1.2),
    (kernel.HOLD, 8, 0.0), (kernel.ALONG, 10, 2.0), (kernel.ALONG, 12, -1.2),
)  # fmt: skip
"""Way, number of periods, and linear velocity (m/s) of each back-up."""
MIXED = (0.75, 0.5, 0.25, 0.0)
"""Shares of the proposal in commands between it and the back-up."""
ESCAPES = np.array([[0.0, 0.0], [0.6, 0.0], [1.4, 0.0], [-0.6, 0.0], [0.0, 1.5], [0.0, -1.5], [0.6, 1.2], [0.6, -1.2],
                    [-0.6, 1.2], [-0.6, -1.2]])  # fmt: skip
"""Other commands (n, 2) that are tried, m/s and rad/s."""
SHARES = (1.0, 0.5, 0.1)
"""Shares of the margins that are tried in turn, when a rover has slid farther than the model says."""
RECOVERY = 0.5
"""Share of the margin below which a rover first gets away, whatever is proposed."""
STEEP, LIFTING = 0.15, 0.2
"""rad and m/s: a rover on two wheels is not to speed up or brake by more, which would lift the others further."""
TICKS = kernel.SUBSTEPS // kernel.CHECKED
HORIZON = TICKS * (2 + max(periods for _, periods, _ in BACKUPS) + kernel.MAX_PERIODS)


def tightened(world: kernel.Surroundings, share: float) -> kernel.Surroundings:
    """Return surroundings to which a share of the margins is kept."""
    return world._replace(
        margin=share * world.margin, people_margin=share * world.people_margin, drift=share * world.drift
    )


def lifts(command: Array, ahead: float, pitch: float) -> bool:
    """Return True if a command (2,) lifts the wheels further of a rover that pitches, at `ahead` m/s."""
    change = command[0] - ahead
    return abs(pitch) > STEEP and abs(change) > LIFTING and bool(change * pitch < 0)


class RoverFilter:
    """Filters commands of one rover: linear and angular velocities, m/s and rad/s.

    `margin` (m) is kept from all that stands and from people, from these by `drift` (m/s) more the farther ahead.
    """

    def __init__(self, rover: kernel.Rover, *, margin: float, drift: float) -> None:
        self._rover, self._margin, self._drift = rover, margin, drift
        self._ways, self._periods, self._speeds = (np.array(values) for values in zip(*BACKUPS, strict=True))
        self._ahead = rover.period / TICKS * np.arange(HORIZON)
        self._backup, self._step = kernel.Backup(kernel.BRAKE, 0, 0.0, 0.0), 0

    def __call__(self, bridge: BridgeMap, state: Array, pitch: float, time: float, proposal: Array) -> Array:
        """Return the proposed command (2,) if it is safe, or else a near one that is; `state` (10,) at a time (s).

        The `pitch` (rad) is positive if the nose is down.
        """
        world = self._surroundings(bridge, state, time)
        fallback = np.array(kernel.command_of(self._backup, self._step, state[2]))
        ahead = float(state[3] * np.cos(state[2]) + state[4] * np.sin(state[2]))
        is_near = min(world.margin, world.people_margin) < RECOVERY * self._margin
        risky = is_near or lifts(proposal, ahead, pitch)
        chosen = None if risky else self._choose(world, state, proposal[None])
        if chosen is None:
            mixed = [share * proposal + (1 - share) * fallback for share in MIXED]
            others = np.vstack((mixed, ESCAPES, (ahead, proposal[1]), (ahead, 0.0)))
            distances = np.linalg.norm((others - proposal) / self._rover.max_velocity, axis=1)
            if is_near:
                distances = -np.array([self._clearance_after(world, state, other) for other in others])
            distances += 10.0 * np.array([lifts(other, ahead, pitch) for other in others])
            others = others[np.argsort(distances, kind="stable")]
            tried = (self._choose(tightened(world, share), state, others) for share in SHARES)
            chosen = next((command for command in tried if command is not None), None)
        if chosen is None:
            chosen, self._step = fallback, self._step + 1
        return proposal if np.array_equal(chosen, proposal) else chosen

    def _choose(self, world: kernel.Surroundings, state: Array, actions: Array) -> Array | None:
        """Return the first safe action, and keep its back-up."""
        a, b = kernel.first_safe(self._rover, world, state, actions, self._ways, self._periods, self._speeds)
        if a < 0:
            return None
        linear, angular = actions[a]
        speed = linear if self._ways[b] == kernel.HOLD else self._speeds[b]
        self._backup = kernel.Backup(int(self._ways[b]), int(self._periods[b]), float(speed), float(angular))
        self._step = 0
        return np.asarray(actions[a])

    def _clearance_after(self, world: kernel.Surroundings, start: Array, command: Array) -> float:
        """Return the distance (m) from everything after a period under a command."""
        state, rims, row = start.copy(), np.empty(2), np.empty(10)
        kernel.rims_of(self._rover, command[0], command[1], rims)
        kernel.move(self._rover, state, rims, kernel.SUBSTEPS)
        people = np.hstack((world.people[TICKS], world.people[TICKS]))
        apart = kernel.people_clearance(self._rover, state, people, world.radius, row)
        return float(min(kernel.clearance(self._rover, world, state, row), apart))

    def _surroundings(self, bridge: BridgeMap, state: Array, time: float) -> kernel.Surroundings:
        people, row = bridge.pedestrians, np.empty(10)
        blocks, half_width, length = bridge.deck
        positions = np.ascontiguousarray(people.positions(time + self._ahead))
        lanes = np.ascontiguousarray(np.hstack((people.start, people.end)))
        world = kernel.Surroundings(
            blocks, half_width, length, positions, lanes, people.radius, self._margin, self._margin, self._drift
        )
        present = np.hstack((positions[0], positions[0]))
        apart = kernel.people_clearance(self._rover, state, present, people.radius, row)
        return world._replace(
            margin=min(self._margin, float(kernel.clearance(self._rover, world, state, row))),
            people_margin=min(self._margin, max(float(apart), 0.0) if math.isfinite(apart) else self._margin),
        )
