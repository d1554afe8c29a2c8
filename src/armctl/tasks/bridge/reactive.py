"""Pedestrians who give way: a social force changes how they walk their lines, in all worlds at once.

Helbing and Molnar: Social force model for pedestrian dynamics, Physical Review E 51, 1995, with the constants for
bodies that have a size of Helbing, Farkas and Vicsek: Simulating dynamical features of escape panic, Nature 407, 2000
(2000 N for 80 kg). The velocity of a pedestrian differs by w from the one, u, with which it walks its line:

    dw/dt = -w / T - sum of grad V(b),   V(b) = A B exp(-(b - r) / B)

b is the semi-minor axis of an ellipse through the pedestrian: its foci are where another one, or the rover, is now and
would be in `STRIDE` s. r is the sum of the radii; others behind count less. Nobody walks back or faster than usual: w
slows a pedestrian down, which puts it behind its schedule, or moves it aside, whence it returns to its line. With
nobody near, w is 0, and all walk as if they did not react, bit for bit. Forces are those at the beginning of a control
step. Whoever would come nearer to the rover than `PERSONAL_SPACE` stands still, so nobody walks into a rover that
stands.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.robots.rover import RADIUS
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.layout import turning_y
from armctl.tasks.bridge.options import CONTROL_PERIOD, BridgeOptions
from armctl.tasks.bridge.pedestrians import Pedestrians
from armctl.tasks.bridge.world import free_half_width
from armctl.tasks.task import Ids

RELAXATION = 0.5
"""s: time T in which a pedestrian returns to its usual velocity."""
STRENGTH, REACH = 25.0, 0.08
"""m/s^2 and m: A and B."""
STRIDE = 2.0
"""s for which others are expected to go on as they do."""
IN_SIGHT, BEHIND = float(np.cos(np.radians(100.0))), 0.5
"""Cosine of the largest angle from the direction of walking at which others are seen, and the weight of others."""
RETURN_TIME = 3.0
"""s in which a pedestrian returns from beside its line: `MAX_ASIDE` by it is less than the slowest walk."""
MAX_ASIDE = 0.8
"""m beside a line: layouts leave more room to blocks there."""
PERSONAL_SPACE = 0.05
"""m between a pedestrian and the rover's turning disc."""
FAR = 1.0
"""m of b - r from which on others do not count."""
MAX_FORCE = 20.0
"""m/s^2."""
TINY = 1e-9


class ReactivePedestrians(Pedestrians):
    """Pedestrians (n, w) who walk `lines`, and give way. They go no farther than `max_y` m from the bridge's middle."""

    def __init__(self, lines: PedestrianTrajectories, max_y: float) -> None:
        super().__init__(lines)
        self._max_y = max_y
        self._lag, self._aside, self._slowing, self._sideways = np.zeros((4, *lines.speed.shape))
        """s behind the schedule, m to the left of the line, and the parts of w along the line and to its left, m/s."""
        self._closest = np.full(len(lines.speed), np.inf)

    def reset(self, ids: Ids) -> None:
        """Let those of worlds `ids` be on their lines and in time."""
        for values in (self._lag, self._aside, self._slowing, self._sideways):
            values[ids] = 0.0
        self._closest[ids] = np.inf

    def trajectories(self) -> PedestrianTrajectories:
        """Return how they would go on from where they are if they met nobody any more."""
        lines, aside = self.lines, self._aside[..., None] * self._to_the_left
        phase = lines.phase - lines.speed * self._lag
        return replace(lines, start=lines.start + aside, end=lines.end + aside, phase=phase)

    def on(self, bridge: BridgeMap, world: int) -> BridgeMap:
        """Return the map of a world's bridge, with the pedestrians as they would go on if they met nobody any more."""
        everywhere = self.trajectories()
        of_world: dict[str, Any] = {name: values[world].copy() for name, values in everywhere.arrays.items()}
        return replace(bridge, pedestrians=replace(everywhere, **of_world))

    def positions(self, times: Array) -> Array:
        """Return present positions (n, w, 2) m at the present times (n,) s."""
        return self._places(times[:, None] - self._lag, self._aside)

    def velocities(self, times: Array) -> Array:
        """Return present velocities (n, w, 2) m/s at the present times (n,) s."""
        usual, aside = self.lines.velocities_of_each(times[:, None] - self._lag), self._rate_aside()[..., None]
        return np.asarray((1 + self._slowing / self._speeds)[..., None] * usual + aside * self._to_the_left)

    def walk(self, times: Array, rovers: Array, rover_speeds: Array) -> Array:
        """Return positions (m, n, w, 2) m over a control step, by the forces at its beginning."""
        elapsed, present = (times[1:] - times[0])[..., None], times[0]
        self._feel(present, rovers, rover_speeds, elapsed[-1] > 0)
        lags = self._lag - self._slowing / self._speeds * elapsed
        asides = self._within(self._aside + self._rate_aside() * elapsed)
        places, origins = self._places(times[1:, :, None] - lags, asides), self.positions(present)
        distances, gaps = (np.linalg.norm(at - rovers[:, None, :2], axis=-1) for at in (places, origins))
        too_near = np.minimum(gaps, RADIUS + self.lines.radius + PERSONAL_SPACE)
        if (stops := (distances < too_near).any(axis=0)).any():
            self._slowing[stops], self._sideways[stops] = -self.lines.speed[stops], self._aside[stops] / RETURN_TIME
            lags, asides = np.where(stops, self._lag + elapsed, lags), np.where(stops, self._aside, asides)
            places = self._places(times[1:, :, None] - lags, asides)
        self._lag, self._aside = lags[-1], asides[-1]
        return places

    def note(self, times: Array, rovers: Array) -> None:
        """Keep the least distance from a rover in each episode."""
        distances = np.linalg.norm(self.positions(times) - rovers[:, None, :2], axis=-1) - self.lines.radius
        self._closest = np.minimum(self._closest, distances.min(axis=1, initial=np.inf))

    def closest(self, bridge: BridgeMap, world: int, times: ArrayLike, points: Array) -> float:
        """Return the least distance (m) from the rover in the episode, whatever the points."""
        return float(self._closest[world])

    def _feel(self, times: Array, rovers: Array, rover_speeds: Array, moving: NDArray[np.bool_]) -> None:
        """Change the velocities in the worlds that are `moving` (n, 1) by the forces over a control step."""
        usual = self.lines.velocities_of_each(times[:, None] - self._lag)
        heading = usual / self._speeds[..., None]
        x, y, yaw = rovers.T
        rover_velocities = rover_speeds[:, None] * np.column_stack((np.cos(yaw), np.sin(yaw)))
        places = np.concatenate((self.positions(times), np.column_stack((x, y))[:, None]), axis=1)
        velocities = np.concatenate((self.velocities(times), rover_velocities[:, None]), axis=1)
        radii = np.append(np.full(usual.shape[1], self.lines.radius), RADIUS) + self.lines.radius
        force = social_force(places, velocities, radii, heading)
        for rates, axis, highest in (
            (self._slowing, heading, 0.0 * self.lines.speed),
            (self._sideways, self._to_the_left, self.lines.speed),
        ):
            pull = np.einsum("nwi,nwi->nw", force, axis)
            changed = np.clip(rates + CONTROL_PERIOD * (pull - rates / RELAXATION), -self.lines.speed, highest)
            np.copyto(rates, changed, where=moving)

    def _places(self, times: Array, aside: Array) -> Array:
        """Return positions (..., n, w, 2) m at times of their own schedules and offsets to the left, (..., n, w)."""
        return self.lines.positions_of_each(times) + aside[..., None] * self._to_the_left

    @property
    def _speeds(self) -> Array:
        """(n, w) m/s, by which can be divided."""
        return np.maximum(self.lines.speed, TINY)

    def _rate_aside(self) -> Array:
        """Return the velocities (n, w) m/s to the left of the lines."""
        speeds = self.lines.speed
        return np.asarray(np.clip(self._sideways - self._aside / RETURN_TIME, -speeds, speeds))

    def _within(self, aside: Array) -> Array:
        """Return the offsets (n, w) m to the left within `MAX_ASIDE`, and before the barriers."""
        lines, left_y = self.lines, self._to_the_left[..., 1]
        lane = lines.start[..., 1]
        before_barriers = (np.clip(lane + aside * left_y, -self._max_y, self._max_y) - lane) * left_y
        return np.clip(np.where(lines.along, before_barriers, aside), -MAX_ASIDE, MAX_ASIDE)

    @property
    def _to_the_left(self) -> Array:
        """(n, w, 2) unit vectors to the left of the lines."""
        way = self.lines.end - self.lines.start
        length = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), TINY)
        return np.asarray(np.stack((-way[..., 1], way[..., 0]), axis=-1) / length)


def make_pedestrians(lines: PedestrianTrajectories, options: BridgeOptions) -> Pedestrians:
    """Return the pedestrians of n bridges that their options ask for, on lines (n, w)."""
    if options.pedestrians == "scripted":
        return Pedestrians(lines)
    return ReactivePedestrians(lines, turning_y(free_half_width(options.deck_width)))


def social_force(places: Array, velocities: Array, radii: Array, heading: Array) -> Array:
    """Return the forces (n, w, 2) m/s^2 on the first w of those at `places` (n, m, 2) m.

    `radii` (m,) m are sums of radii of the pedestrians' and the others', and `heading` (n, w, 2) unit vectors.
    """
    count = heading.shape[1]
    offset = places[:, :count, None] - places[:, None]
    stride = STRIDE * velocities[:, None]
    from_now, from_then = (np.linalg.norm(vectors, axis=-1) for vectors in (offset, offset - stride))
    axis = np.sqrt(np.maximum((from_now + from_then) ** 2 - (stride**2).sum(axis=-1), TINY)) / 2
    directions = offset / np.maximum(from_now, TINY)[..., None]
    directions = directions + (offset - stride) / np.maximum(from_then, TINY)[..., None]
    slope = ((from_now + from_then) / (4 * axis))[..., None] * directions
    gap = axis - radii
    counts: NDArray[np.bool_] = (gap < FAR) & ~np.eye(count, places.shape[1], dtype=bool)
    visible = np.einsum("nwmi,nwi->nwm", -offset, heading) >= IN_SIGHT * from_now
    strength = np.where(counts, STRENGTH * np.exp(-np.minimum(gap, FAR) / REACH) * np.where(visible, 1.0, BEHIND), 0.0)
    forces = strength[..., None] * slope
    forces *= np.minimum(1.0, MAX_FORCE / np.maximum(np.linalg.norm(forces, axis=-1), TINY))[..., None]
    return np.asarray(forces.sum(axis=2))
