"""A safety filter of a rover: it changes a command after which there would be no safe way to go on.

Model predictive shielding (Bastani, "Safe reinforcement learning with nonlinear dynamics via model predictive
shielding", ACC 2021) with a library of back-ups. A command is safe if the rover, by a model of its sliding wheels,
keeps clear of the deck's sides and ends, of blocks and of people for a period under it, and then under one of the
back-ups: it brakes, or goes on for a while, as before or along the bridge, and then brakes, to where nobody walks by.
The rest of that back-up is carried out if later nothing is safe.
"""

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
                    [-0.6, 1.2], [-0.6, -1.2], [1.2, 0.3], [1.2, -0.3], [-1.2, 0.3], [-1.2, -0.3]])  # fmt: skip
"""Other commands (n, 2) that are tried, m/s and rad/s."""
SHARES = (0.4, 0.1)
"""Shares of the margins that are kept in turn while a rover gets away from what it is too near to; of the present
distance, if that is less."""
STEEP, LIFTING = 0.15, 0.2
"""rad and m/s: a rover on two wheels is not to speed up or brake by more, which would lift the others further."""
TICKS = kernel.SUBSTEPS // kernel.CHECKED
HORIZON = TICKS * (2 + max(periods for _, periods, _ in BACKUPS) + kernel.MAX_PERIODS)


def lifts(command: Array, ahead: float, pitch: float) -> bool:
    """Return True if a command (2,) lifts the wheels further of a rover that pitches, at `ahead` m/s."""
    change = command[0] - ahead
    return abs(pitch) > STEEP and abs(change) > LIFTING and bool(change * pitch < 0)


class RoverFilter:
    """Filters commands of one rover: linear and angular velocities, m/s and rad/s.

    `margin` (m) is kept from all that stands, `people_margin` (m) from people, from these by `drift` (m/s) more the
    farther ahead.
    """

    def __init__(self, rover: kernel.Rover, *, margin: float, people_margin: float, drift: float) -> None:
        self._rover, self._margin, self._people_margin, self._drift = rover, margin, people_margin, drift
        self._backups = tuple(np.array(values) for values in zip(*BACKUPS, strict=True))
        self._ahead = rover.period / TICKS * np.arange(HORIZON)
        self._backup, self._step = kernel.Backup(kernel.BRAKE, 0, 0.0, 0.0), 0
        self._number = 0

    def __call__(
        self, bridge: BridgeMap, state: Array, pitch: float, time: float, proposal: Array, further: float = 0.0
    ) -> Array:
        """Return the proposed command (2,) if it is safe, or else a near one that is; `state` (10,) at a time (s).

        The `pitch` (rad) is positive if the nose is down. `further` (m) is kept from all, since the state may be wrong.
        """
        world = self._surroundings(bridge, time, further)
        fallback = np.array(kernel.command_of(self._backup, self._step, state[2]))
        ahead = float(state[3] * np.cos(state[2]) + state[4] * np.sin(state[2]))
        chosen = None if lifts(proposal, ahead, pitch) else self._choose(world, state, proposal[None])
        if chosen is None:
            mixed = [share * proposal + (1 - share) * fallback for share in MIXED]
            others = np.vstack((mixed, ESCAPES, (ahead, proposal[1]), (ahead, 0.0)))
            others = others[[not lifts(other, ahead, pitch) for other in others]]
            distances = np.linalg.norm((others - proposal) / self._rover.max_velocity, axis=1)
            others = others[np.argsort(distances, kind="stable")]
            chosen = self._choose(world, state, others)
            if chosen is None:
                chosen = self._get_away(world, state, others)
        if chosen is None:
            chosen, self._step = fallback, self._step + 1
        return proposal if np.array_equal(chosen, proposal) else chosen

    def _get_away(self, world: kernel.Surroundings, state: Array, actions: Array) -> Array | None:
        """Return the action, and keep the back-up, that keep clear best, with the largest share of margins possible."""
        row, present = np.empty(10), np.hstack((world.people[0], world.people[0]))
        still = float(kernel.clearance(self._rover, world, state, row))
        apart = float(kernel.people_clearance(self._rover, state, present, world.radius, row))
        for share in SHARES:
            less = world._replace(
                margin=share * min(world.margin, max(still, 0.0)),
                people_margin=share * min(world.people_margin, max(apart, 0.0)), drift=share * self._drift,
            )  # fmt: skip
            chosen = self._choose(less, state, actions, is_first=False)
            if chosen is not None:
                return chosen
        return None

    def _choose(
        self, world: kernel.Surroundings, state: Array, actions: Array, *, is_first: bool = True
    ) -> Array | None:
        """Return the first safe action, or the one that keeps clear best, and keep its back-up."""
        a, b = kernel.choose(self._rover, world, state, actions, self._backups, self._number, is_first)
        if a < 0:
            return None
        linear, angular = actions[a]
        way, periods, speed = (values[b] for values in self._backups)
        speed = linear if way == kernel.HOLD else speed
        self._backup = kernel.Backup(int(way), int(periods), float(speed), float(angular))
        self._step, self._number = 0, b
        return np.asarray(actions[a])

    def _surroundings(self, bridge: BridgeMap, time: float, further: float = 0.0) -> kernel.Surroundings:
        people = bridge.pedestrians
        blocks, half_width, length = bridge.deck
        positions = np.ascontiguousarray(people.positions(time + self._ahead))
        lanes = np.ascontiguousarray(people.lanes)
        return kernel.Surroundings(
            blocks, half_width, length, positions, lanes, people.radius, self._margin + further,
            self._people_margin + further, self._drift,
        )  # fmt: skip
