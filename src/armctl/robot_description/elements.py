"""Checked numbers of the elements of a robot's file: errors name the file, the place and the value."""

import math
from pathlib import Path

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.robot_description.xml_file import Element, short

LARGEST = 1e9
"""Largest number, in SI units; files write it where they mean no limit."""


class Elements:
    """Reads numbers of a file's elements; each method raises `ConfigurationError` for what is no number."""

    def __init__(self, path: Path) -> None:
        self.file = path.name

    def error(self, problem: str) -> ConfigurationError:
        """Return the error that the file is unsuitable."""
        return ConfigurationError(f"{self.file} is not an arm that armctl can use: {problem}")

    def number(self, word: str, place: str) -> float:
        """Return a finite number."""
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not abs(number) <= LARGEST:
            raise self.error(f"{place}: {short(word)} is not a finite number between -{LARGEST:g} and {LARGEST:g}")
        return number

    def numbers(self, element: Element, attribute: str, owner: str, count: int, default: str | None = None) -> Array:
        """Return the numbers (count,) of an attribute."""
        words = element.get(attribute, default or "").split()
        if len(words) != count:
            raise self.error(f"{owner} needs {count} numbers as {attribute}, not {short(' '.join(words))}")
        return np.array([self.number(word, f"{attribute} of {owner}") for word in words])

    def placement(self, element: Element, owner: str) -> pinocchio.SE3:
        """Return the placement that the `<origin>` of an element states."""
        if (origin := element.find("origin")) is None:
            return pinocchio.SE3.Identity()
        rotation = pinocchio.rpy.rpyToMatrix(self.numbers(origin, "rpy", owner, 3, "0 0 0"))
        return pinocchio.SE3(rotation, self.numbers(origin, "xyz", owner, 3, "0 0 0"))


def end_of(joint: Element, tag: str) -> str:
    """Return the name of a joint's `parent` or `child`."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
