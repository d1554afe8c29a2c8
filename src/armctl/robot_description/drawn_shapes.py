"""The shapes of an arm's links as they are drawn: as its file has them, and not as the capsules that collide."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import scipy

from armctl.core.errors import ConfigurationError
from armctl.robot_description.meshes import thinness
from armctl.robot_description.shape import Shape
from armctl.robot_description.urdf import Urdf


def drawn_shapes(source: Urdf, collisions: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Return the visual shapes of each link; of one without, or with unreadable ones, its `collisions`."""
    by_link = {link: list(shapes) for link, shapes in groupby(collisions, key=lambda shape: shape.link)}
    all_shapes: list[Shape] = []
    for link in source.links:
        try:
            shapes = source.visuals(link)
        except ConfigurationError as error:
            problem = str(error).rpartition("armctl can use: ")[2]
            source.notes.append(f"Link {link!r} is drawn as it collides, since {problem}.")
            shapes = []
        all_shapes += [shape for shape in map(_triangulated, shapes or by_link.get(link, [])) if len(shape.triangles)]
    return tuple(all_shapes)


def _triangulated(shape: Shape) -> Shape:
    """Return a shape with the triangles of its convex hull, if it is no mesh and not too thin."""
    if len(shape.triangles) or thinness(shape.vertices):
        return shape
    hull = scipy.spatial.ConvexHull(shape.vertices)
    corners, numbers = np.unique(hull.simplices, return_inverse=True)
    vertices, triangles = shape.vertices[corners], numbers.reshape(-1, 3).astype(np.int32)
    first, second, third = vertices[triangles].swapaxes(0, 1)
    inward = (np.cross(second - first, third - first) * hull.equations[:, :3]).sum(axis=1) < 0
    triangles[inward] = triangles[inward, ::-1]
    return replace(shape, vertices=vertices, triangles=triangles)
