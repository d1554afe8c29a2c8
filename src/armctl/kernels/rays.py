"""Rays of a camera against convex shapes: see `armctl.simulation.ray_camera`.

A ray has length 1 along the optical axis, so that its length to a hit is the depth there. From inside a shape, it hits
the far side, as MuJoCo's do.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled

PLANE, SPHERE, CYLINDER, CAPSULE, BOX, POLYTOPE = range(6)
NONE = np.inf
NEAR = 1e-6
"""m: what is nearer to the camera along its axis is not looked for."""


class Shapes(NamedTuple):
    """Shapes that a camera can see."""

    rows: NDArray[np.int64]
    """(k, 4) kind, geom, first face and last face plus one."""
    faces: Array
    """(f, 4) outward normals and offsets of all polytopes' faces."""


class Geoms(NamedTuple):
    """All geoms of n worlds, as MuJoCo has them; sizes and bounding boxes may be one for all worlds."""

    sizes: Array
    """(n or 1, g, 3)."""
    aabbs: Array
    """(n or 1, g, 6)."""
    positions: Array
    """(n, g, 3)."""
    rotations: Array
    """(n, g, 9)."""


class Cameras(NamedTuple):
    """The cameras of n worlds."""

    positions: Array
    """(n, 3)."""
    rotations: Array
    """(n, 9)."""
    rays: Array
    """(rows, columns, 3) in the camera's frame."""
    pixel: float
    """Distance between two rays, at depth 1."""


@compiled
def first_of(enter, leave):
    """Return the length at which a ray that is inside from `enter` to `leave` first meets the surface."""
    if enter > leave or leave < 0:
        return NONE
    return enter if enter >= 0 else leave


@compiled
def hit_quadratic(a, b, c):
    """Return the least t >= 0 with a t^2 + 2 b t + c = 0."""
    discriminant = b * b - a * c
    if discriminant < 0 or a < 1e-15:
        return NONE
    root = math.sqrt(discriminant)
    return first_of((-b - root) / a, (-b + root) / a)


@compiled
def hit_plane(size, origin, direction):
    """Intersect the plane z = 0, seen from above, within its half sizes (0: unbounded)."""
    if direction[2] > -1e-15:
        return NONE
    t = -origin[2] / direction[2]
    for i in range(2):
        if size[i] > 0 and abs(origin[i] + t * direction[i]) > size[i]:
            return NONE
    return t if t >= 0 else NONE


@compiled
def hit_sphere(radius, centre_z, origin, direction):
    """Intersect a sphere on the z axis."""
    a = b = 0.0
    c = -radius * radius
    for i in range(3):
        offset = origin[i] - (centre_z if i == 2 else 0.0)
        a += direction[i] * direction[i]
        b += direction[i] * offset
        c += offset * offset
    return hit_quadratic(a, b, c)


@compiled
def hit_tube(radius, origin, direction):
    """Return the lengths at which a ray enters and leaves the endless cylinder around the z axis."""
    a = direction[0] ** 2 + direction[1] ** 2
    b = direction[0] * origin[0] + direction[1] * origin[1]
    c = origin[0] ** 2 + origin[1] ** 2 - radius * radius
    if a < 1e-15:
        return (-np.inf, np.inf) if c <= 0 else (np.inf, -np.inf)
    discriminant = b * b - a * c
    if discriminant < 0:
        return np.inf, -np.inf
    root = math.sqrt(discriminant)
    return (-b - root) / a, (-b + root) / a


@compiled
def hit_box(size, count, origin, direction):
    """Intersect a box with half sizes; of these, the last `count` axes bound it."""
    enter, leave = -np.inf, np.inf
    for i in range(3 - count, 3):
        if abs(direction[i]) < 1e-15:
            if abs(origin[i]) > size[i]:
                return np.inf, -np.inf
            continue
        near, far = (-size[i] - origin[i]) / direction[i], (size[i] - origin[i]) / direction[i]
        enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter, leave


@compiled
def hit_polytope(faces, origin, direction):
    """Intersect a convex polytope n x <= d, with `faces` (k, 4) of n and d."""
    enter, leave = -np.inf, np.inf
    for k in range(len(faces)):
        along = faces[k, 0] * direction[0] + faces[k, 1] * direction[1] + faces[k, 2] * direction[2]
        room = faces[k, 3] - faces[k, 0] * origin[0] - faces[k, 1] * origin[1] - faces[k, 2] * origin[2]
        if abs(along) < 1e-15:
            if room < 0:
                return NONE
        elif along < 0:
            enter = max(enter, room / along)
        else:
            leave = min(leave, room / along)
    return first_of(enter, leave)


@compiled
def hit(kind, size, faces, origin, direction):
    """Return the length of a ray, in a shape's frame, to its first hit; infinite for a miss."""
    if kind == BOX:
        enter, leave = hit_box(size, 3, origin, direction)
        return first_of(enter, leave)
    if kind == POLYTOPE:
        return hit_polytope(faces, origin, direction)
    if kind == PLANE:
        return hit_plane(size, origin, direction)
    if kind == SPHERE:
        return hit_sphere(size[0], 0.0, origin, direction)
    enter, leave = hit_tube(size[0], origin, direction)
    if kind == CYLINDER:
        low, high = hit_box(np.array((0.0, 0.0, size[1])), 1, origin, direction)
        return first_of(max(enter, low), min(leave, high))
    nearest = first_of(enter, leave)
    if abs(origin[2] + nearest * direction[2]) > size[1]:
        nearest = NONE
    for end in (-size[1], size[1]):
        cap = hit_sphere(size[0], end, origin, direction)
        if cap < nearest and (origin[2] + cap * direction[2]) * math.copysign(1.0, end) >= size[1]:
            nearest = cap
    return nearest


@compiled
def place_corners(aabb, turn, origin, corners):
    """Compute the `corners` (8, 3) of a bounding box in the camera's frame.

    `turn` (3, 3) leads from there to the shape's frame, and `origin` (3,) is the camera in the latter.
    """
    for corner in range(8):
        for j in range(3):
            corners[corner, j] = 0.0
        for i in range(3):
            sign = 1.0 if (corner >> i) & 1 else -1.0
            place = aabb[i] + sign * aabb[3 + i] - origin[i]
            for j in range(3):
                corners[corner, j] += turn[i, j] * place


@compiled
def seen_rectangle(corners, pixel, rows, columns):
    """Return rows and columns, first and last plus one, of the pixels that see anything between `corners` (8, 3)."""
    left = bottom = np.inf
    right = top = -np.inf
    for corner in range(8):
        x, y, z = corners[corner, 0], corners[corner, 1], corners[corner, 2]
        if z > -NEAR:
            continue
        left, right = min(left, -x / z), max(right, -x / z)
        bottom, top = min(bottom, -y / z), max(top, -y / z)
        for i in range(3):
            other = corners[corner ^ (1 << i)]
            if other[2] > -NEAR:
                share = (-NEAR - z) / (other[2] - z)
                across, up = (x + share * (other[0] - x)) / NEAR, (y + share * (other[1] - y)) / NEAR
                left, right = min(left, across), max(right, across)
                bottom, top = min(bottom, up), max(top, up)
    if left > right:
        return 0, 0, 0, 0
    first_row = max(0, math.ceil(rows / 2 - 0.5 - top / pixel - 1e-6))
    last_row = min(rows, math.floor(rows / 2 - 0.5 - bottom / pixel + 1e-6) + 1)
    first_column = max(0, math.ceil(left / pixel + columns / 2 - 0.5 - 1e-6))
    last_column = min(columns, math.floor(right / pixel + columns / 2 - 0.5 + 1e-6) + 1)
    return first_row, last_row, first_column, last_column


@compiled
def cast(shapes, geoms, cameras, world, depths, hits):
    """Compute depths (rows, columns) of one world's nearest hits, and the geoms hit; misses are infinite, and -1."""
    rows, columns = depths.shape
    depths[:], hits[:] = np.inf, -1
    sizes = geoms.sizes[world if len(geoms.sizes) > 1 else 0]
    aabbs = geoms.aabbs[world if len(geoms.aabbs) > 1 else 0]
    positions, rotations = geoms.positions[world], geoms.rotations[world]
    camera, camera_rotation, rays, faces = (
        cameras.positions[world],
        cameras.rotations[world],
        cameras.rays,
        shapes.faces,
    )
    turn, origin, direction, corners = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((8, 3))
    for kind, geom, first, last in shapes.rows:
        for i in range(3):
            origin[i] = 0.0
            for j in range(3):
                origin[i] += rotations[geom, 3 * j + i] * (camera[j] - positions[geom, j])
                turn[i, j] = 0.0
                for k in range(3):
                    turn[i, j] += rotations[geom, 3 * k + i] * camera_rotation[3 * k + j]
        top, bottom, left, right = 0, rows, 0, columns
        if kind != PLANE:
            place_corners(aabbs[geom], turn, origin, corners)
            top, bottom, left, right = seen_rectangle(corners, cameras.pixel, rows, columns)
        for row in range(top, bottom):
            for column in range(left, right):
                ray = rays[row, column]
                for i in range(3):
                    direction[i] = turn[i, 0] * ray[0] + turn[i, 1] * ray[1] + turn[i, 2] * ray[2]
                depth = hit(kind, sizes[geom], faces[first:last], origin, direction)
                if depth < depths[row, column]:
                    depths[row, column], hits[row, column] = depth, geom


@compiled
def cast_all(worlds, shapes, geoms, cameras, depths, hits):
    """Cast the rays of some worlds."""
    for i in range(len(worlds)):
        cast(shapes, geoms, cameras, worlds[i], depths[i], hits[i])
