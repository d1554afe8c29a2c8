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
PARALLEL = 1e-15
"""Rays whose direction has so small a part along a face's normal are parallel to the face."""
TOGETHER = 256
"""Rays that are computed together, in a rectangle as wide as what is seen of a shape."""
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
    across: Array
    """(columns,) parts of rays to the right, in the camera's frame."""
    up: Array
    """(rows,) and upwards; they have length 1 along the optical axis."""
    pixel: float
    """Distance between two rays, at depth 1."""


class Rays(NamedTuple):
    """Rays of some pixels, (`TOGETHER`,) each: directions in a shape's frame, and lengths."""

    x: Array
    y: Array
    z: Array
    enter: Array
    leave: Array
    lengths: Array


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
def hit_plane(size, origin, x, y, z):
    """Intersect the plane z = 0, seen from above, within its half sizes (0: unbounded)."""
    t = -origin[2] / z
    within_x = size[0] <= 0 or abs(origin[0] + t * x) <= size[0]
    within_y = size[1] <= 0 or abs(origin[1] + t * y) <= size[1]
    return t if z <= -PARALLEL and within_x and within_y and t >= 0 else NONE


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
def hit_slab(half, origin, direction):
    """Return the lengths at which a ray enters and leaves the slab within `half` of 0 along an axis."""
    first, second = (-half - origin) / direction, (half - origin) / direction
    if abs(direction) < PARALLEL:
        return (np.inf, -np.inf) if abs(origin) > half else (-np.inf, np.inf)
    return min(first, second), max(first, second)


@compiled
def hit_box(size, origin, x, y, z):
    """Intersect a box with half sizes."""
    enter_x, leave_x = hit_slab(size[0], origin[0], x)
    enter_y, leave_y = hit_slab(size[1], origin[1], y)
    enter_z, leave_z = hit_slab(size[2], origin[2], z)
    return first_of(max(enter_x, enter_y, enter_z), min(leave_x, leave_y, leave_z))


@compiled
def hit_round(kind, size, origin, direction):
    """Intersect a sphere, cylinder or capsule along the z axis."""
    if kind == SPHERE:
        return hit_sphere(size[0], 0.0, origin, direction)
    enter, leave = hit_tube(size[0], origin, direction)
    if kind == CYLINDER:
        low, high = hit_slab(size[1], origin[2], direction[2])
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
def hit_polytope(faces, origin, rays, count):
    """Intersect a convex polytope n x <= d, with `faces` (k, 4) of n and d, with the first `count` of `rays`."""
    rays.enter[:count], rays.leave[:count] = -np.inf, np.inf
    for k in range(len(faces)):
        n_x, n_y, n_z, offset = faces[k]
        room = offset - n_x * origin[0] - n_y * origin[1] - n_z * origin[2]
        outside = np.inf if room < 0 else -np.inf
        for i in range(count):
            along = n_x * rays.x[i] + n_y * rays.y[i] + n_z * rays.z[i]
            length = room / along
            near = length if along <= -PARALLEL else outside if along < PARALLEL else -np.inf
            far = length if along >= PARALLEL else np.inf
            rays.enter[i], rays.leave[i] = max(rays.enter[i], near), min(rays.leave[i], far)
    for i in range(count):
        rays.lengths[i] = first_of(rays.enter[i], rays.leave[i])


@compiled
def hit_all(kind, size, faces, origin, rays, count):
    """Compute the lengths of `count` rays, in a shape's frame, to their first hits; infinite for a miss."""
    x, y, z, lengths = rays.x, rays.y, rays.z, rays.lengths
    if kind == BOX:
        for i in range(count):
            lengths[i] = hit_box(size, origin, x[i], y[i], z[i])
    elif kind == POLYTOPE:
        hit_polytope(faces, origin, rays, count)
    elif kind == PLANE:
        for i in range(count):
            lengths[i] = hit_plane(size, origin, x[i], y[i], z[i])
    else:
        for i in range(count):
            lengths[i] = hit_round(kind, size, origin, (x[i], y[i], z[i]))


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
def aim(turn, cameras, pixels, rays):
    """Compute the directions, in a shape's frame, of the rays through a rectangle of `pixels`; return their number."""
    (top, bottom, left, right), count = pixels, 0
    for j in range(top, bottom):
        up = cameras.up[j]
        for i in range(right - left):
            across = cameras.across[left + i]
            rays.x[count + i] = turn[0, 0] * across + turn[0, 1] * up - turn[0, 2]
            rays.y[count + i] = turn[1, 0] * across + turn[1, 1] * up - turn[1, 2]
            rays.z[count + i] = turn[2, 0] * across + turn[2, 1] * up - turn[2, 2]
        count += right - left
    return count


@compiled
def keep_nearer(lengths, geom, pixels, depths, hits):
    """Write those `lengths` of rays to a geom that are less than the depths in a rectangle of `pixels`."""
    (top, bottom, left, right), count = pixels, 0
    for j in range(top, bottom):
        nearest, nearest_geoms = depths[j, left:right], hits[j, left:right]
        for i in range(right - left):
            is_nearer = lengths[count + i] < nearest[i]
            nearest[i] = lengths[count + i] if is_nearer else nearest[i]
            nearest_geoms[i] = geom if is_nearer else nearest_geoms[i]
        count += right - left


@compiled
def cast(shapes, geoms, cameras, world, depths, hits):
    """Compute depths (rows, columns) of one world's nearest hits, and the geoms hit; misses are infinite, and -1."""
    rows, columns = depths.shape
    depths[:], hits[:] = np.inf, -1
    sizes = geoms.sizes[world if len(geoms.sizes) > 1 else 0]
    aabbs = geoms.aabbs[world if len(geoms.aabbs) > 1 else 0]
    positions, rotations = geoms.positions[world], geoms.rotations[world]
    camera, camera_rotation, faces = cameras.positions[world], cameras.rotations[world], shapes.faces
    turn, origin, corners = np.empty((3, 3)), np.empty(3), np.empty((8, 3))
    values = np.empty((6, max(TOGETHER, columns)))
    rays = Rays(values[0], values[1], values[2], values[3], values[4], values[5])
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
        size, place = (sizes[geom, 0], sizes[geom, 1], sizes[geom, 2]), (origin[0], origin[1], origin[2])
        height = max(1, TOGETHER // max(1, right - left))
        for row in range(top, bottom, height):
            pixels = row, min(bottom, row + height), left, right
            count = aim(turn, cameras, pixels, rays)
            hit_all(kind, size, faces[first:last], place, rays, count)
            keep_nearer(rays.lengths, geom, pixels, depths, hits)


@compiled
def cast_all(worlds, shapes, geoms, cameras, depths, hits):
    """Cast the rays of some worlds."""
    for i in range(len(worlds)):
        cast(shapes, geoms, cameras, worlds[i], depths[i], hits[i])
