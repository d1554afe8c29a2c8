"""A shape of a link, and the colour in which a URDF draws it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.robot_description.xml_file import Element

Colour = tuple[float, ...]
"""Red, green, blue and opacity, each from 0 to 1."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in its link's frame: vertices (k, 3) m, and triangles (m, 3) if it is a mesh."""

    link: str
    vertices: Array
    triangles: NDArray[np.int32]
    colour: Colour | None = None
    """None: that of all arms."""


def colour_of(visual: Element, robot: Element) -> Colour | None:
    """Return the colour of a `<visual>`: its material's own, or that of the robot's material of the same name.

    None without one, and for one that is not four numbers from 0 to 1.
    """
    material = visual.find("material")
    if material is None:
        return None
    namesakes = (other for other in robot.findall("material") if other.get("name") == material.get("name"))
    colours = (element.find("color") for element in (material, *namesakes))
    words = next((colour.get("rgba", "").split() for colour in colours if colour is not None), [])
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        return None
    return numbers if len(numbers) == 4 and all(0 <= number <= 1 for number in numbers) else None
