"""The moving fields of the BARN challenge: discs on random polynomials in a square of 20 m, which come with armctl.

Nair et al., "DynaBARN: benchmarking metric ground navigation in dynamic environments", SSRR 2022; from
github.com/Daffan/the-barn-challenge, MIT licence. `tools/make_dynabarn.py` reads them out of the challenge's plugins.
"""

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.shipped import check_arrays, read_shipped
from armctl.scene.routes import Routes

Level = Literal["easy", "medium", "hard"]
LEVELS: tuple[Level, ...] = ("easy", "medium", "hard")
ROUTES, FIELDS = 200, 20
"""Numbers of routes and fields of each level."""
RADIUS = 0.5
"""m: radius of the discs."""
SIDE, AHEAD = 20.0, 1.0
"""m: side of the square, and distance from the start to it."""
COUNTS = {"easy": (5, 14), "medium": (15, 19), "hard": (20, 24)}
"""Lowest and highest number of discs in a field, by level."""
FASTEST = 2.0
"""m/s: no disc is faster."""
MAX_DISCS = max(high for _, high in COUNTS.values())
ABSENT = -SIDE
"""m: x of absent discs, far behind the start."""
LONGEST_DELAY = 60.0
"""s: longest time for which the discs of a field have moved when the rover starts."""
FORMAT = 1
FILE = Path(__file__).with_name("dynabarn.npz")


@dataclass(frozen=True, eq=False)
class DynaBarn:
    """Routes and fields, in read-only arrays. Raises `ConfigurationError` for arrays that do not fit together."""

    counts: NDArray[np.uint8]
    """(r,) number of corners of each route; `ROUTES` of each level."""
    packed: NDArray[np.float32]
    """(sum of `counts`, 3) time (s), x and y (m, from the square's middle, ahead and to the left) of all corners."""
    fields: NDArray[np.int16]
    """(f, `MAX_DISCS`) routes of each field, -1 for absent ones; `FIELDS` of each level."""

    def __post_init__(self) -> None:
        routes, fields = len(LEVELS) * ROUTES, len(LEVELS) * FIELDS
        check_arrays(
            self, counts=(np.uint8, (routes,)), packed=(np.float32, (self.counts.sum(), 3)),
            fields=(np.int16, (fields, MAX_DISCS)),
        )  # fmt: skip
        if self.counts.min() < 2 or np.abs(self.packed[:, 1:]).max() > SIDE / 2:
            raise ConfigurationError(f"routes should have two corners or more, in a square of {SIDE:g} m")
        if self.fields.max() >= routes:
            raise ConfigurationError(f"fields should have discs on the {routes} routes")

    @functools.cached_property
    def corners(self) -> tuple[Array, Array]:
        """Corners (r, k, 2) m and times (r, k) s of all routes; the last corner fills up shorter routes."""
        counts = self.counts.astype(int)
        ends = np.cumsum(counts)
        places = np.arange(counts.max()) + (ends - counts)[:, None]
        rows = self.packed[np.minimum(places, ends[:, None] - 1)].astype(float)
        return rows[..., 1:], rows[..., 0]


@functools.cache
def shipped_fields() -> DynaBarn:
    """Return the fields that come with armctl. Raises `ConfigurationError` if their file is missing or damaged."""
    return read_shipped(FILE, FORMAT, lambda values: DynaBarn(**values))


def sample_routes(
    rng: np.random.Generator, level: Level | Literal["all"], start_x: float, *, challenge: bool
) -> Routes:
    """Sample the discs of a field of a level, or of a level that is sampled too, for a rover that starts at `start_x`.

    With `challenge`, it is one of the challenge's, whose discs have moved for up to `LONGEST_DELAY` s. Discs of others
    are on routes of the level, each mirrored or not, and anywhere on it.
    """
    fields, chosen = shipped_fields(), LEVELS.index(LEVELS[rng.integers(len(LEVELS))] if level == "all" else level)
    if challenge:
        rows = fields.fields[chosen * FIELDS + rng.integers(FIELDS)]
        rows = rows[rows >= 0]
        signs, delays = np.ones(len(rows)), np.full(len(rows), rng.uniform(0.0, LONGEST_DELAY))
    else:
        low, high = COUNTS[LEVELS[chosen]]
        rows = chosen * ROUTES + rng.choice(ROUTES, rng.integers(low, high + 1), replace=False)
        signs, delays = rng.choice((-1.0, 1.0), len(rows)), rng.uniform(0.0, 2 * fields.corners[1][rows, -1])
    corners, times = (values[rows] for values in fields.corners)
    corners = corners * np.stack((np.ones(len(rows)), signs), axis=1)[:, None]
    corners[..., 0] += start_x + AHEAD + SIDE / 2
    count, absent = corners.shape[1], MAX_DISCS - len(rows)
    return Routes.through(
        np.concatenate((corners, np.broadcast_to((ABSENT, 0.0), (absent, count, 2)))),
        np.concatenate((times - delays[:, None], np.broadcast_to(np.arange(count, dtype=float), (absent, count)))),
        RADIUS,
    )
