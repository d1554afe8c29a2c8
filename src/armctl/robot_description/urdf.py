"""Reads the URDF file of a reach arm, and explains what is wrong with an unsuitable one."""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.errors import ConfigurationError, unknown_name

Array = NDArray[np.float64]
Element = ElementTree.Element

FULL_TURN = 2 * math.pi


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision shape in its link's frame: vertices (k, 3) m, and triangles (m, 3) if it is a mesh."""

    link: str
    vertices: Array
    triangles: NDArray[np.int32]


class Urdf:
    """A URDF file whose joints from the root to the link `tip` form a reach arm.

    Meshes named as `package://` are searched in the folders above the file, and in `packages`.

    Raises `ConfigurationError`, naming the file and the culprit, if the file is unsuitable.
    """

    def __init__(self, path: Path, tip: str | None, packages: Path) -> None:
        self.path, self._packages = path, packages
        self._robot = read_xml(path)
        if not self._robot.get("name"):
            raise self._error("its <robot> has no name")
        self.name = self._robot.get("name", "")
        self._links = {name: link for link in self._robot.findall("link") if (name := link.get("name", ""))}
        self._joints = self._robot.findall("joint")
        self._check_tree()
        self.tip = tip or self._only_leaf()
        self._chain = self._movable_chain()
        self.joints = tuple(joint.get("name", "") for joint in self._chain)
        self._check_inertia()

    def limits(self) -> Array:
        """Lower and upper position, velocity and effort limits of the chain's joints, (4, dof): rad, rad/s, N m."""
        return np.array([self._limits_of(joint) for joint in self._chain]).T

    def text(self) -> str:
        """The URDF without geometry, with all joints fixed except those of the chain."""
        bare = ElementTree.Element("robot", {"name": self.name})
        for name, link in self._links.items():
            copy = ElementTree.SubElement(bare, "link", {"name": name})
            if _mass(link) > 0:
                copy.extend(link.findall("inertial"))
        for joint in self._joints:
            movable = joint in self._chain
            kind = "revolute" if movable else "fixed"
            copy = ElementTree.SubElement(bare, "joint", {"name": joint.get("name", ""), "type": kind})
            copy.extend(part for tag in ("origin", "parent", "child") for part in joint.findall(tag))
            if movable:
                copy.extend(joint.findall("axis"))
                limits = zip(("lower", "upper", "velocity", "effort"), self._limits_of(joint), strict=True)
                ElementTree.SubElement(copy, "limit", {name: repr(value) for name, value in limits})
        return ElementTree.tostring(bare, encoding="unicode")

    def shapes(self) -> tuple[Shape, ...]:
        """All collision shapes."""
        return tuple(
            self._shape(name, collision)
            for name, link in self._links.items()
            for collision in link.findall("collision")
        )

    def _error(self, what: str) -> ConfigurationError:
        return ConfigurationError(f"{self.path.name} is not an arm that armctl can use: {what}")

    def _check_tree(self) -> None:
        for kind in ("link", "joint"):
            names = Counter(element.get("name", "") for element in self._robot.findall(kind))
            if repeated := [name for name, count in names.items() if count > 1 or not name]:
                raise self._error(f"it has several {kind}s, or one without a name, called {repeated[0]!r}")
        for joint in self._joints:
            for end in (_end(joint, "parent"), _end(joint, "child")):
                if end not in self._links:
                    raise self._error(f"joint {joint.get('name')!r} refers to a link {end!r} that does not exist")
        children = Counter(_end(joint, "child") for joint in self._joints)
        if len(children) != len(self._joints) or len(children) != max(len(self._links) - 1, 0):
            raise self._error("its links and joints are not a tree with one root")

    def _only_leaf(self) -> str:
        parents = {_end(joint, "parent") for joint in self._joints}
        leaves = [name for name in self._links if name not in parents]
        if len(leaves) != 1:
            raise self._error(
                f"it has {len(leaves)} leaf links ({', '.join(leaves)}); say which is the end-effector, its tip: "
                "`--set tip=LINK` on the command line, tip=LINK as an option of the environment or of load_arm"
            )
        return leaves[0]

    def _movable_chain(self) -> list[Element]:
        if self.tip not in self._links:
            raise unknown_name(f"link of {self.path.name} called", self.tip, self._links)
        joint_above = {_end(joint, "child"): joint for joint in self._joints}
        chain: list[Element] = []
        link = self.tip
        for _ in self._joints:
            if link not in joint_above:
                break
            joint = joint_above[link]
            if joint.get("type") in ("revolute", "continuous"):
                chain.insert(0, joint)
            elif joint.get("type") != "fixed":
                raise self._error(
                    f"joint {joint.get('name')!r} is {joint.get('type')}; joints should be revolute, "
                    "continuous or fixed"
                )
            link = _end(joint, "parent")
        if not chain:
            raise self._error(f"it has no revolute joint between its root and {self.tip!r}")
        return chain

    def _limits_of(self, joint: Element) -> list[float]:
        name, limit = joint.get("name"), joint.find("limit")
        found = {} if limit is None else dict(limit.attrib)
        if joint.get("type") == "continuous":
            found |= {"lower": str(-FULL_TURN), "upper": str(FULL_TURN)}
        missing = [key for key in ("lower", "upper", "velocity", "effort") if key not in found]
        if missing:
            raise self._error(f"joint {name!r} has no {' and no '.join(missing)} limit")
        lower, upper, velocity, effort = (
            self._number(found[key], f"joint {name!r}, {key} limit") for key in ("lower", "upper", "velocity", "effort")
        )
        if not (lower < upper and velocity > 0 and effort > 0):
            raise self._error(
                f"joint {name!r} cannot move: lower {lower:g} must be below upper {upper:g}, and velocity {velocity:g} "
                f"and effort {effort:g} above 0"
            )
        return [lower, upper, velocity, effort]

    def _check_inertia(self) -> None:
        for joint in self._chain:
            name = joint.get("name")
            axis = joint.find("axis")
            if axis is not None and not np.any(self._numbers(axis, "xyz", f"axis of joint {name!r}", 3, "1 0 0")):
                raise self._error(f"joint {name!r} has an axis of length 0")
            moved = _end(joint, "child")
            if not _mass(self._links[moved]) > 0:
                raise self._error(f"link {moved!r} behind joint {name!r} has no mass")
        for name, link in self._links.items():
            inertia = link.find("inertial/inertia")
            if not _mass(link) > 0 or inertia is None:
                continue
            xx, yy, zz, xy, xz, yz = (
                self._number(inertia.get(f"i{part}", "0"), f"inertia of link {name!r}")
                for part in ("xx", "yy", "zz", "xy", "xz", "yz")
            )
            small, medium, large = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if small <= 0 or small + medium < large * (1 - 1e-6):
                raise self._error(
                    f"link {name!r} has an impossible inertia: its principal moments are "
                    f"{small:.3g}, {medium:.3g}, {large:.3g}"
                )

    def _shape(self, link: str, collision: Element) -> Shape:
        geometry = collision.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            raise self._error(f"link {link!r} has a <collision> without a shape")
        what = f"<{shape.tag}> of link {link!r}"
        triangles = np.empty((0, 3), dtype=np.int32)
        if shape.tag == "mesh":
            vertices, triangles = self._mesh(shape, what)
        elif shape.tag == "box":
            size = self._numbers(shape, "size", what, 3)
            vertices = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * self._positive(size, what)
        elif shape.tag in ("cylinder", "sphere"):
            radius = self._positive(self._numbers(shape, "radius", what, 1), what)[0]
            length = 0.0
            if shape.tag == "cylinder":
                length = self._positive(self._numbers(shape, "length", what, 1), what)[0]
            vertices = np.array(list(_rings(shape.tag, radius, length / 2)))
        else:
            raise self._error(f"it has a {what}; armctl supports mesh, box, cylinder and sphere")
        placement = pinocchio.SE3.Identity()
        if (origin := collision.find("origin")) is not None:
            rotation = pinocchio.rpy.rpyToMatrix(self._numbers(origin, "rpy", what, 3, "0 0 0"))
            placement = pinocchio.SE3(rotation, self._numbers(origin, "xyz", what, 3, "0 0 0"))
        return Shape(link, vertices @ placement.rotation.T + placement.translation, triangles)

    def _mesh(self, shape: Element, what: str) -> tuple[Array, NDArray[np.int32]]:
        path = self._mesh_path(shape.get("filename", ""))
        scale = self._numbers(shape, "scale", what, 3, "1 1 1")
        try:
            mesh = coal.MeshLoader().load(str(path), scale)
        except ValueError as error:
            raise self._error(f"the mesh {path.name} of a {what} cannot be read") from error
        triangles = [[mesh.tri_indices(i)[corner] for corner in range(3)] for i in range(mesh.num_tris)]
        return np.array(mesh.vertices()), np.array(triangles, dtype=np.int32)

    def _mesh_path(self, filename: str) -> Path:
        relative = filename.removeprefix("file://").removeprefix("package://")
        for folder in (*self.path.parents, self._packages):
            if (folder / relative).is_file():
                return folder / relative
        raise self._error(f"its mesh {filename!r} was not found beside it, nor in a folder above")

    def _numbers(self, element: Element, attribute: str, what: str, count: int, default: str | None = None) -> Array:
        words = element.get(attribute, default or "").split()
        if len(words) != count:
            raise self._error(f"{what} needs {count} numbers as {attribute}, not {' '.join(words)!r}")
        return np.array([self._number(word, f"{attribute} of {what}") for word in words])

    def _number(self, word: str, what: str) -> float:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self._error(f"{what}: {word!r} is not a finite number")
        return number

    def _positive(self, numbers: Array, what: str) -> Array:
        if not (numbers > 0).all():
            raise self._error(f"{what} has a size of {numbers.min():g}")
        return numbers


def read_xml(path: Path) -> Element:
    """Root element of a URDF or SRDF file; raises `ConfigurationError` if it is neither."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError, ValueError) as error:
        raise ConfigurationError(f"{path.name} cannot be read as XML: {error}") from error
    if root.tag != "robot":
        raise ConfigurationError(f"{path.name} is not a URDF or SRDF: its root element is <{root.tag}>, not <robot>")
    return root


def impossible_pairs(srdf: Path) -> set[frozenset[str]]:
    """Pairs of links that cannot touch, according to an SRDF."""
    pairs = read_xml(srdf).iter("disable_collisions")
    return {frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs}


def _end(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def _mass(link: Element) -> float:
    mass = link.find("inertial/mass")
    try:
        return 0.0 if mass is None else float(mass.get("value", 0))
    except ValueError:
        return math.nan


def _rings(shape: str, radius: float, half_length: float, points: int = 24) -> Iterator[tuple[float, float, float]]:
    """Points on rings around z that enclose a shape: the two rims of a cylinder, or parallels of a sphere."""
    radius /= math.cos(math.pi / points)
    levels = [(radius, -half_length), (radius, half_length)]
    if shape == "sphere":
        levels = [(radius * math.cos(a), radius * math.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, points)]
    for ring_radius, z in levels:
        for angle in np.linspace(0, FULL_TURN, points, endpoint=False):
            yield ring_radius * math.cos(angle), ring_radius * math.sin(angle), z
