"""Least times from all over a bridge to the goal line, at all times, among people whose courses are known.

A dynamic programme in space and time (as in Silver, "Cooperative pathfinding", AIIDE 2005): from each point of a
lattice and each moment, the rover waits, or goes to one of the neighbours at a constant speed. Near a person, time
passes dearly. After the horizon, people are left out of account. The time that people cost is kept at every second
point and a quarter of the moments: it varies less than the times themselves.
"""

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import time_to_go as kernel
from armctl.planning.cost_to_go import OFF_CLEARANCE, STEPS, Indices, Lattice
from armctl.scene import BridgeMap
from armctl.scene.pedestrians import NO_PEDESTRIANS

SLOWDOWN = 20.0
"""Factor by which everything takes longer near a person: it is quicker to wait than to run through him."""
BLOCKED = 1e4
"""s: more than any time to go."""
PAD = max(max(abs(right), abs(left)) for right, left in STEPS)
"""Points around the lattice, blocked, so that moves need no check."""
ROUNDING = 1e-9
EVERY, EVERY_LAYER = 2, 4
"""Strides of what is kept of the time that people cost: every second point, every fourth moment."""


@dataclass(frozen=True, eq=False)
class TimesToGo:
    """Least times over one bridge."""

    unhindered: Array
    """(nx, ny) s without people."""
    extra: NDArray[np.float32]
    """(m, nx / 2, ny / 2) s more because of people, in intervals of `SpaceTime.interval`."""


@dataclass(frozen=True)
class SpaceTime:
    """All points of a lattice at all moments up to a horizon."""

    lattice: Lattice
    speed: float = 1.6
    """m/s"""
    horizon: float = 30.0
    """s"""

    @property
    def step(self) -> float:
        """Seconds between two moments: for the shortest move."""
        return float(self.lattice.spacings.min() / self.speed)

    @property
    def interval(self) -> float:
        """Seconds between two of the moments that are kept."""
        return EVERY_LAYER * self.step

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of `TimesToGo.extra`."""
        nx, ny = self.lattice.shape
        return 1 + self._layers // EVERY_LAYER, 1 + (nx - 1) // EVERY, 1 + (ny - 1) // EVERY

    def times(self, bridge: BridgeMap, goal_x: float, clearance: float) -> TimesToGo:
        """Return minimum times to x = `goal_x` (m) from time 0 on, with a `clearance` (m) from blocks and people."""
        people, (x, y) = bridge.pedestrians, self.lattice.axes
        paths = self.lattice.paths(dataclasses.replace(bridge, pedestrians=NO_PEDESTRIANS), goal_x, clearance)
        reachable = np.isfinite(paths)
        nearest, off = self.lattice.nearest(reachable)
        unhindered = np.where(reachable, paths / self.speed, BLOCKED)
        moves = self._moves
        times = np.full((1 + self._layers + moves.layers.max(), *self._padded), BLOCKED, dtype=np.float32)
        inside = times[:, PAD:-PAD, PAD:-PAD]
        inside[self._layers :] = unhindered.T
        bounds = np.full((2, *self._padded), BLOCKED, dtype=np.float32)
        bounds[:, PAD:-PAD, PAD:-PAD] = np.where(reachable, 0.0, BLOCKED).T, np.where(unhindered == 0, 0.0, np.inf).T
        positions = people.positions(self.step * np.arange(self._layers))
        vicinities = kernel.People(positions, people.radius + clearance, SLOWDOWN)
        kernel.spread(times, bounds, vicinities, kernel.Grid(y, x, PAD), moves)
        i, j = (index[::EVERY, ::EVERY] for index in nearest)
        extra = inside[: 1 + self._layers : EVERY_LAYER, j, i] - unhindered[i, j].astype(np.float32)
        return TimesToGo(unhindered[nearest] + OFF_CLEARANCE / self.speed * off, extra)

    def interpolate(
        self, unhindered: Array, extra: NDArray[np.float32], bridges: Indices, points: Array, times: Array
    ) -> Array:
        """Return times to go (m,) s at points (m, 2) and times (m,) s on `bridges` (m,).

        These are indices of `unhindered` (n, nx, ny) and `extra` (n, *shape).
        """
        moments = np.clip(times / self.interval, 0, extra.shape[1] - 1)
        first = np.minimum(moments.astype(int), extra.shape[1] - 2)
        share = moments - first
        earlier, later = (self.lattice.interpolate(extra, points, EVERY, (bridges, first + k)) for k in (0, 1))
        without_people = self.lattice.interpolate(unhindered, points, tables=(bridges,))
        return np.asarray(without_people + (1 - share) * earlier + share * later)

    @property
    def _layers(self) -> int:
        return EVERY_LAYER * round(self.horizon / self.interval)

    @property
    def _padded(self) -> tuple[int, int]:
        """Shape of a layer of times."""
        nx, ny = self.lattice.shape
        return ny + 2 * PAD, nx + 2 * PAD

    @cached_property
    def _moves(self) -> kernel.Moves:
        steps = np.array([sign * np.array(step[::-1]) for step in STEPS for sign in (1, -1)])
        durations = np.hypot(*(steps * self.lattice.spacings[::-1]).T) / self.speed
        order = np.argsort(durations, kind="stable")
        steps, durations = steps[order], durations[order]
        layers = np.floor(durations / self.step + ROUNDING).astype(int)
        shares = np.maximum(durations / self.step - layers, 0.0)
        return kernel.Moves(self.step, steps, durations.astype(np.float32), layers, shares.astype(np.float32))
