"""Reads the triangles of a COLLADA file (`.dae`), as the specification 1.4.1 of the Khronos Group has them.

Only the shape is read. The axis that a file declares as up is left aside, as ROS does.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.core.arrays import Array

MAX_VERTICES = 5_000_000
"""Vertices of all instances of all geometries together."""
MAX_CORNERS = 10_000
"""Corners of a polygon."""

Element = ElementTree.Element
Mesh = tuple[Array, NDArray[np.int64]]
"""Vertices (k, 3) and triangles (m, 3)."""


def read_collada(content: bytes) -> Mesh:
    """Return the mesh of a file's scene, in its own unit of length. Raises `ValueError` if it cannot be read."""
    root = ElementTree.fromstring(content)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    geometries = {geometry.get("id"): geometry for geometry in root.iter("geometry")}
    meshes: dict[str, Mesh] = {}
    vertices, triangles, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for name, placement in _instances(root):
        if name not in meshes:
            meshes[name] = _mesh(geometries[name])
        points, corners = meshes[name]
        vertices.append(points @ placement[:3, :3].T + placement[:3, 3])
        triangles.append(corners + count)
        count += len(points)
        if count > MAX_VERTICES:
            raise ValueError(f"it has more than {MAX_VERTICES} vertices")
    return np.concatenate(vertices), np.concatenate(triangles)


def _instances(root: Element) -> Iterator[tuple[str, Array]]:
    """Yield the geometries of the first scene, by name, each with its placement (4, 4)."""
    scene = root.find("library_visual_scenes/visual_scene")
    waiting = [] if scene is None else [(node, np.eye(4)) for node in reversed(scene.findall("node"))]
    while waiting:
        node, above = waiting.pop()
        placement = above @ _placement(node)
        for instance in node.findall("instance_geometry"):
            yield instance.get("url", "").removeprefix("#"), placement
        waiting += [(child, placement) for child in reversed(node.findall("node"))]


def _placement(node: Element) -> Array:
    """Return the product (4, 4) of a node's transformations."""
    placement = np.eye(4)
    for element in node:
        step = np.eye(4)
        match element.tag:
            case "matrix":
                step = _floats(element).reshape(4, 4)
            case "translate":
                step[:3, 3] = _floats(element)
            case "scale":
                step[:3, :3] = np.diag(_floats(element))
            case "rotate":
                *axis, angle = _floats(element)
                step[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(
                    math.radians(angle) * np.array(axis) / np.linalg.norm(axis)
                ).as_matrix()
            case "lookat" | "skew":
                raise ValueError(f"it has <{element.tag}>, which armctl does not read")
        placement = placement @ step
    return placement


def _mesh(geometry: Element) -> Mesh:
    mesh = _child(geometry, "mesh")
    vertices = _child(mesh, "vertices")
    source = _source(mesh, _child(vertices, "input[@semantic='POSITION']"))
    accessor = _child(source, "technique_common/accessor")
    stride, offset = int(accessor.get("stride", "1")), int(accessor.get("offset", "0"))
    points = _floats(_child(source, "float_array"))[offset:]
    points = points[: len(points) // stride * stride].reshape(-1, stride)[:, :3]
    triangles = [triangle for group in mesh for triangle in _triangles(group)]
    corners = np.concatenate([np.empty((0, 3), dtype=np.int64), *triangles])
    if points.shape[1] != 3 or (corners < 0).any() or (corners >= len(points)).any():
        raise ValueError("its triangles have vertices that are missing")
    return points, corners


def _triangles(group: Element) -> Iterator[NDArray[np.int64]]:
    """Yield the triangles (n, 3) of a group of polygons, as indices of vertices."""
    if group.tag not in ("triangles", "polylist", "polygons"):
        return
    offsets = {element.get("semantic"): int(element.get("offset", "0")) for element in group.findall("input")}
    for polygons in group.findall("p"):
        corners = _integers(polygons).reshape(-1, 1 + max(offsets.values()))[:, offsets["VERTEX"]]
        sizes = np.array([len(corners)])
        if group.tag == "triangles":
            sizes = np.full(len(corners) // 3, 3)
        elif group.tag == "polylist":
            sizes = _integers(_child(group, "vcount"))
        if sizes.max(initial=0) > min(MAX_CORNERS, len(corners)) or sizes.min(initial=0) < 0:
            raise ValueError("a polygon of it has more corners than there are")
        ends = sizes.cumsum()
        for size in np.unique(sizes):
            polygon = corners[(ends - sizes)[sizes == size][:, None] + np.arange(size)]
            for second in range(1, size - 1):
                yield polygon[:, [0, second, second + 1]]


def _source(mesh: Element, element: Element) -> Element:
    name = element.get("source", "").removeprefix("#")
    return next(source for source in mesh.findall("source") if source.get("id") == name)


def _child(element: Element, path: str) -> Element:
    child = element.find(path)
    if child is None:
        raise ValueError(f"it has no <{path.partition('[')[0]}>")
    return child


def _floats(element: Element) -> Array:
    return np.fromstring((element.text or "").strip(), dtype=float, sep=" ")


def _integers(element: Element) -> NDArray[np.int64]:
    return np.fromstring((element.text or "").strip(), dtype=np.int64, sep=" ")
