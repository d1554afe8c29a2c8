"""Reads the triangles of a binary glTF file (`.glb`), as the specification 2.0 of the Khronos Group has them.

Only the shape is read, of the file's own scene. The axis that is up in a glTF file, y, is left aside, as that of a
COLLADA file is.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.core.arrays import Array

MAX_CORNERS = 10_000_000
"""Vertices and corners of triangles, of all instances of all meshes together."""
HEADER = 12
"""Bytes before the first chunk."""
SHAPELESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""Beginnings of the names of extensions that do not change a shape."""
NUMBERS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Types of indices and coordinates, by their codes."""
TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have triangles; the others are points and lines."""

Json = dict[str, Any]


def read_glb(content: bytes) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices (k, 3) m and triangles (m, 3) of a file's scene. Raises `ValueError` if it cannot be read."""
    root, data = _chunks(content)
    try:
        with np.errstate(all="ignore"):
            return _scene(root, data)
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:
        raise ValueError("its description is not as glTF has it") from error


def _scene(root: Json, data: bytes) -> tuple[Array, NDArray[np.int64]]:
    required = [name for name in root.get("extensionsRequired", []) if not name.startswith(SHAPELESS)]
    if required:
        raise ValueError(f"it needs the extension {required[0][:60]!r}, which armctl does not read")
    vertices, triangles = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)]
    count = corners = 0
    for number, placement in _instances(root):
        for primitive in root["meshes"][number]["primitives"]:
            if (mode := primitive.get("mode", TRIANGLES)) not in (TRIANGLES, STRIP, FAN):
                continue
            points = _accessor(root, data, primitive["attributes"]["POSITION"], 3)
            indices = np.arange(len(points))
            if "indices" in primitive:
                indices = _accessor(root, data, primitive["indices"], 1)[:, 0]
            corners += len(points) + len(indices)
            if corners > MAX_CORNERS:
                raise ValueError(f"it has more than {MAX_CORNERS} vertices and corners")
            if len(indices) and not indices.max() < len(points):
                raise ValueError("its triangles have vertices that are missing")
            vertices.append(points.astype(float) @ placement[:3, :3].T + placement[:3, 3])
            triangles.append(_triangles(indices.astype(np.int64), mode) + count)
            count += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def _chunks(content: bytes) -> tuple[Json, bytes]:
    """Return the description in a file, and the numbers behind it."""
    if content[:8] != b"glTF\x02\0\0\0":
        raise ValueError("it is no binary glTF of version 2")
    parts: dict[bytes, bytes] = {}
    start = HEADER
    while start + 8 <= len(content):
        end = start + 8 + int.from_bytes(content[start : start + 4], "little")
        parts.setdefault(content[start + 4 : start + 8], content[start + 8 : end])
        start = end
    try:
        root = json.loads(parts.get(b"JSON", b""))
    except RecursionError as error:
        raise ValueError("its elements are too deep within each other") from error
    if not isinstance(root, dict):
        raise ValueError("its description is no object")
    return root, parts.get(b"BIN\0", b"")


def _instances(root: Json) -> Iterator[tuple[int, Array]]:
    """Yield the meshes of the scene, by number, each with its placement (4, 4); of no scene, those of all roots."""
    nodes, reached = root["nodes"], set()
    if "scenes" in root:
        roots = root["scenes"][root.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [number for number in range(len(nodes)) if number not in children]
    waiting = [(number, np.eye(4)) for number in reversed(roots)]
    while waiting:
        number, above = waiting.pop()
        if number in reached:
            raise ValueError("its nodes are not a tree")
        reached.add(number)
        node = nodes[number]
        placement = above @ _placement(node)
        if "mesh" in node:
            yield node["mesh"], placement
        waiting += [(child, placement) for child in reversed(node.get("children", []))]


def _placement(node: Json) -> Array:
    """Return where a node puts what is in it, (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    placement = np.eye(4)
    rotation = scipy.spatial.transform.Rotation.from_quat(node.get("rotation", [0, 0, 0, 1]))
    placement[:3, :3] = rotation.as_matrix() * np.array(node.get("scale", [1, 1, 1]), dtype=float)
    placement[:3, 3] = node.get("translation", [0, 0, 0])
    return placement


def _accessor(root: Json, data: bytes, number: int, width: int) -> NDArray[Any]:
    """Return the numbers (k, width) that an accessor names: three floats of a vertex, or one index."""
    accessor = root["accessors"][number]
    kind = np.dtype(NUMBERS[accessor["componentType"]])
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ValueError("it has an accessor without a buffer, or a sparse one, which armctl does not read")
    if accessor["type"] != ("SCALAR" if width == 1 else "VEC3") or (kind.kind == "f") != (width == 3):
        raise ValueError("a vertex of it is not three floats, or an index is not a whole number")
    if accessor["count"] > MAX_CORNERS:
        raise ValueError(f"it has more than {MAX_CORNERS} vertices and corners")
    view = root["bufferViews"][accessor["bufferView"]]
    buffer = root["buffers"][view["buffer"]]
    if view["buffer"] != 0 or "uri" in buffer:
        raise ValueError("its numbers are in another file: write them into the .glb")
    first, size = view.get("byteOffset", 0) + accessor.get("byteOffset", 0), width * kind.itemsize
    stride = view.get("byteStride", size)
    if first < 0 or stride < size:
        raise ValueError("its numbers overlap, or are before the first")
    if first + (accessor["count"] - 1) * stride + size > len(data):
        raise ValueError("it is cut off")
    shape, strides = (accessor["count"], width), (stride, kind.itemsize)
    return np.ndarray(shape, kind, data, first, strides)


def _triangles(indices: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (m, 3) of the corners of one primitive."""
    if mode == TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    corners = np.lib.stride_tricks.sliding_window_view(indices, 3) if len(indices) >= 3 else indices[:0].reshape(0, 3)
    if mode == FAN:
        return np.column_stack((np.full(len(corners), indices[:1].sum()), corners[:, 1:]))
    odd = (np.arange(len(corners)) % 2 == 1)[:, None]
    return np.where(odd, corners[:, [1, 0, 2]], corners)
