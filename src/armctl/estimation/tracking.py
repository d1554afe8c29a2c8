"""Tracks of people from points seen on their surfaces: each track is a Kalman filter of constant velocity.

A point belongs to the track of the nearest person (nearest neighbour: Blackman and Popoli, Design and analysis of
modern tracking systems, 1999, chapter 6). People are discs, so that each point on the near side tells the centre, also
when only a part of a person is in sight. Points of nobody begin new tracks, which count from their second sight on.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.options import Positive, options
from armctl.estimation.kalman import EstimationOptions, KalmanFilter, constant_velocity

SAME_BEARING = 0.998
"""Cosine of the angle between a ray and a person's bearing up to which the ray would meet the person's middle."""
ABSENCE = 5.0
"""Periods out of sight for which one counts in which a person would be seen."""


@options
class TrackerOptions:
    """Options of `PeopleTracker`."""

    period: Positive = 0.1
    """s between two pictures."""
    radius: Positive = 0.25
    """m: radius of a person."""
    turn: Positive = 1e3
    """m: people turn back where they are so far to either side."""
    noise: Positive = 0.05
    """m: standard deviation of a centre that is seen."""
    acceleration: Positive = 4.0
    """m/s^2: standard deviation in each period."""
    initial_speed: Positive = 0.8
    """m/s: standard deviation of each component of the velocity."""
    gate: Positive = 0.4
    """m: a point farther from a person's surface is of somebody else."""
    max_missed: Positive = 4.0
    """s out of sight after which a track ends."""
    capacity: Annotated[int, Field(ge=1, le=100)] = 16
    """Most tracks at a time."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """People as they are believed to walk."""

    positions: Array
    """(k, 2) m."""
    velocities: Array
    """(k, 2), m/s."""


class PeopleTracker:
    """Tracks people by points of their surfaces."""

    def __init__(self, options: TrackerOptions | None = None) -> None:
        self.options = options = options or TrackerOptions()
        model = constant_velocity(2, options.period, options.acceleration, options.noise)
        self._filter = KalmanFilter(model, options.capacity, EstimationOptions(gate=1.0))  # the gate is here
        self._prior = np.diag((options.noise,) * 2 + (options.initial_speed,) * 2) ** 2
        self._hits, self._missed = np.zeros(options.capacity, dtype=int), np.zeros(options.capacity)

    @property
    def tracks(self) -> Tracks:
        """Tracks of people who were seen at least twice."""
        mean = self._filter.mean[self._hits > 1]
        return Tracks(mean[:, :2].copy(), mean[:, 2:].copy())

    def predict(self) -> None:
        """Move on by a period."""
        mean = self._filter.predict()
        beyond = (np.abs(mean[:, 1]) > self.options.turn - self.options.noise) & (mean[:, 1] * mean[:, 3] > 0)
        mean[beyond, 3] *= -1
        self._missed += self.options.period
        self._hits[self._missed > self.options.max_missed] = 0

    def update(self, observer: Array, people: Array, anything: Array, ends: Array) -> None:
        """Correct the tracks by what is seen from `observer` (2,) m, along rays in the order of their bearings.

        `people` (m, 2) m are the points of people, which begin new tracks too. Those of `anything` (k, 2) count only
        for tracked people of whom no other point is seen, as from near, when their heads are out of sight. Points that
        are NaN are none. Sight is free up to `ends` (n, 2): people who would stand in between, and are not seen, are
        soon forgotten.
        """
        people, anything = (points[np.isfinite(points).all(axis=1)] for points in (people, anything))
        readings, is_new = self._centres(observer, people)
        others, _ = self._centres(observer, anything)
        readings = np.where(np.isnan(readings), others, readings)
        self._filter.update(readings)
        visible = np.isfinite(readings).all(axis=1)
        self._hits[visible] += 1
        self._missed[visible] = 0.0
        self._missed[~visible & self._is_absent(observer, ends)] += ABSENCE * self.options.period
        self._merge()
        self._begin(observer, people[is_new])

    def _is_absent(self, observer: Array, ends: Array) -> NDArray[np.bool_]:
        """Return which tracked people (n,) are where nobody is seen."""
        if not len(ends):
            return np.zeros(self.options.capacity, dtype=bool)
        rays, offsets = ends - observer, self._filter.mean[:, :2] - observer
        ranges, distances = np.linalg.norm(rays, axis=1), np.linalg.norm(offsets, axis=1)
        cosines = offsets @ rays.T / np.maximum(np.outer(distances, ranges), 1e-9)
        nearest = cosines.argmax(axis=1)
        within = (cosines.max(axis=1) > SAME_BEARING) & (distances > 2 * self.options.radius)
        return np.asarray(within & (ranges[nearest] > distances + 2 * self.options.radius))

    def _merge(self) -> None:
        """End tracks that have come to be of the same person as one that was seen more often."""
        active = np.flatnonzero(self._hits)
        active = active[np.argsort(-self._hits[active], kind="stable")]
        positions = self._filter.mean[active, :2]
        near = np.linalg.norm(positions[:, None] - positions, axis=-1) < self.options.radius
        self._hits[active[np.tril(near, -1).any(axis=1)]] = 0

    def _centres(self, observer: Array, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return each track's mean centre by its points (n, 2), NaN without, and which points (m,) are of no track."""
        readings, active = np.full((self.options.capacity, 2), np.nan), np.flatnonzero(self._hits)
        if not len(points) or not len(active):
            return readings, np.ones(len(points), dtype=bool)
        inwards = self._filter.mean[active, :2] - points[:, None]
        distances = np.linalg.norm(inwards, axis=-1)
        nearest, rows = distances.argmin(axis=1), np.arange(len(points))
        near = distances[rows, nearest] < self.options.radius + self.options.gate
        # only the side that faces the observer is seen: a centre in front of its surface is wrong
        away = points - observer
        inwards = inwards[rows, nearest]
        inwards = np.where(((inwards * away).sum(axis=1) > 0)[:, None], inwards, away)
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1), 1e-9)[:, None]
        for k in np.unique(nearest[near]):
            chosen = near & (nearest == k)
            readings[active[k]] = (points + self.options.radius * inwards)[chosen].mean(axis=0)
        return readings, np.asarray(~near)

    def _begin(self, observer: Array, points: Array) -> None:
        """Begin tracks at runs of points that are less than a person's diameter apart."""
        if not len(points):
            return
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        runs = np.split(points, np.flatnonzero(gaps > 2 * self.options.radius) + 1)
        for slot, run in zip(np.flatnonzero(self._hits == 0), runs, strict=False):
            surface = run.mean(axis=0) - observer
            centre = observer + surface * (1 + 0.8 * self.options.radius / max(float(np.linalg.norm(surface)), 1e-9))
            self._filter.reset((*centre, 0.0, 0.0), self._prior, slice(slot, slot + 1))
            self._hits[slot], self._missed[slot] = 1, 0.0
