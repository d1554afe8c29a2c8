"""Capsules: the collision shape of armctl's arms, for simulator and controllers alike.

A capsule (all points within `radius` of a segment) fits an arm's link closely, and two capsules collide in closed form.
"""

from dataclasses import dataclass

import numpy as np

from armctl.core.arrays import Array


@dataclass(frozen=True)
class Capsule:
    """A capsule in the frame of its link; lengths in metres."""

    link: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    @property
    def volume(self) -> float:
        """Volume, m^3."""
        length = float(np.linalg.norm(np.subtract(self.end, self.start)))
        return float(np.pi * self.radius**2 * (length + 4 / 3 * self.radius))


def enclosing_capsule(link: str, vertices: Array) -> Capsule:
    """Return a small capsule that encloses all `vertices` (k, 3), m.

    Its direction is the principal or coordinate axis that gives the least volume.
    """
    centred = vertices - vertices.mean(axis=0)
    principal = np.linalg.svd(centred, full_matrices=False)[2]
    candidates = (_capsule_along(link, vertices, axis) for axis in np.vstack([principal, np.eye(3)]))
    return min(candidates, key=lambda capsule: capsule.volume)


def _capsule_along(link: str, vertices: Array, axis: Array) -> Capsule:
    """Return the enclosing capsule along the unit vector `axis` (3,)."""
    side = np.linalg.svd(axis[None])[2][1:]
    across = vertices @ side.T
    centre = _enclosing_circle_centre(across)
    offset = np.linalg.norm(across - centre, axis=1)
    radius = float(offset.max())
    along = vertices @ axis
    cap = np.sqrt(np.maximum(radius**2 - offset**2, 0.0))
    low, high = np.min(along + cap), np.max(along - cap)
    if low > high:
        low = high = (low + high) / 2
        radius = float(np.sqrt(np.max(offset**2 + (along - low) ** 2)))
    base = centre @ side
    start, end = (tuple(float(x) for x in base + t * axis) for t in (low, high))
    return Capsule(link, start, end, radius)  # type: ignore[arg-type]


def _enclosing_circle_centre(points: Array, iterations: int = 100) -> Array:
    """Return the centre of the smallest circle around `points` (k, 2).

    Badoiu and Clarkson, "Smaller core-sets for balls" (2003): ever smaller steps towards the farthest point.
    """
    centre, (x, y) = (points.min(axis=0) + points.max(axis=0)) / 2, np.ascontiguousarray(points.T)
    for i in range(1, iterations):
        farthest = points[np.argmax((x - centre[0]) ** 2 + (y - centre[1]) ** 2)]
        centre = centre + (farthest - centre) / (i + 1) * 0.5
    return np.asarray(centre)
