"""The shapes of a URDF's links: meshes, boxes and round shapes, as vertices in the frame of their link."""

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.robot_description.elements import Elements
from armctl.robot_description.meshes import PATH, MeshError, Meshes, round_points
from armctl.robot_description.shape import Shape, colour_of
from armctl.robot_description.xml_file import Element, short

MAX_SHAPES = 1_000
"""Collision shapes of all links together."""
MIN_SIZE = 1e-9
"""m: least length or radius of a shape."""


class LinkShapes:
    """Reads the shapes of links; raises `ConfigurationError` for those that cannot be read."""

    def __init__(self, elements: Elements, meshes: Meshes, robot: Element) -> None:
        self._elements, self._meshes, self._robot = elements, meshes, robot

    def of(self, link: Element, tag: str) -> list[Shape]:
        """Return the shapes of a link, those of its `collision` or its `visual` elements."""
        parts = link.findall(tag)
        if len(parts) > MAX_SHAPES:
            raise self._elements.error(f"it has {len(parts)} {tag} shapes; at most {MAX_SHAPES} are allowed")
        return [
            replace(self._shape(link.get("name", ""), element), colour=colour_of(element, self._robot))
            for element in parts
        ]

    def _shape(self, link: str, element: Element) -> Shape:
        elements, geometry = self._elements, element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            raise elements.error(f"link {link!r} has a <{element.tag}> without a shape")
        description = f"<{shape.tag}> of link {link!r}"
        triangles = np.empty((0, 3), dtype=np.int32)
        if shape.tag == "mesh":
            vertices, triangles = self._mesh(shape, description)
        elif shape.tag == "box":
            size = elements.numbers(shape, "size", description, 3)
            vertices = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * self._positive(size, description)
        elif shape.tag in ("cylinder", "sphere", "capsule"):
            radius = self._positive(elements.numbers(shape, "radius", description, 1), description)[0]
            length = 0.0
            if shape.tag != "sphere":
                length = self._positive(elements.numbers(shape, "length", description, 1), description)[0]
            vertices = round_points(shape.tag, radius, length / 2)
        else:
            raise elements.error(f"it has a {description}; armctl supports mesh, box, cylinder, capsule and sphere")
        placement = elements.placement(element, description)
        return Shape(link, vertices @ placement.rotation.T + placement.translation, triangles)

    def _mesh(self, shape: Element, description: str) -> tuple[Array, NDArray[np.int32]]:
        filename = shape.get("filename", "")
        try:
            return self._meshes.read(filename, self._elements.numbers(shape, "scale", description, 3, "1 1 1"))
        except MeshError as error:
            raise self._elements.error(f"the mesh {short(filename, PATH)} of a {description} {error}") from error

    def _positive(self, numbers: Array, description: str) -> Array:
        if not (numbers >= MIN_SIZE).all():
            raise self._elements.error(f"{description} has a size of {numbers.min():g}")
        return numbers
