"""Reads the URDF file of a reach arm, and explains what is wrong with an unsuitable one.

The libraries behind armctl get a URDF that is written again from checked numbers, never the file itself: some of them
crash on a malformed one.
"""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robot_description.file_notes import notes_on_file
from armctl.robot_description.meshes import PATH, MeshError, Meshes, rings
from armctl.robot_description.shape import Shape, colour_of
from armctl.robot_description.xml_file import Element, read_xml, short

FULL_TURN = 2 * math.pi

MAX_LINKS = 300
"""The largest robot of example-robot-data has 130; libraries recurse along a chain, and 5,000 overflow their stack."""
MAX_SHAPES = 1_000
"""Collision shapes of all links together."""
LARGEST = 1e9
"""Largest number, in SI units; files write it where they mean no limit."""
MIN_SIZE = 1e-9
"""m: least length or radius of a shape."""
MIN_AXIS = 1e-6
"""Least length of a joint's axis, which is then made 1."""
MIN_MASS = 1e-9
"""kg: least mass of a link that has one."""
LIGHT = 1e-3
"""kg: largest mass of a frame that may be left out."""
MIN_INERTIA = 1e-14
"""kg m^2: least principal moment; MuJoCo's own limit is near."""
MENDED, ROUND_OFF = 0.01, 1e-12
"""Shares of a principal moment that the two others may miss together: of a file's digits, and of those of a float."""

_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class Urdf:
    """A URDF file whose joints from the root to the link `tip` form a reach arm.

    Meshes are read only below the file's own package and below `package` (see `Meshes`).

    Raises `ConfigurationError`, naming the file and the culprit, if the file is unsuitable.
    """

    def __init__(self, path: Path, tip: str | None, package: Path) -> None:
        self.path, self._meshes, self._visual_meshes = path, Meshes(path, package), Meshes(path, package)
        self.notes: list[str] = []
        """Repairs, omissions and assumptions, a sentence each."""
        self._robot = read_xml(path)
        if not self._robot.get("name"):
            raise self._error("its <robot> has no name")
        self.name = self._robot.get("name", "")
        self._links = {name: link for link in self._robot.findall("link") if (name := link.get("name", ""))}
        self._joints = self._robot.findall("joint")
        self._check_tree()
        self._mass = {name: self._mass_of(name, link) for name, link in self._links.items()}
        self.tip = tip or self._only_leaf()
        self._chain = self._movable_chain()
        self.joints = tuple(joint.get("name", "") for joint in self._chain)
        self._check_inertia()
        self.notes += notes_on_file(self._robot, self._chain)

    def limits(self) -> Array:
        """Lower and upper position, velocity and effort limits of the chain's joints, (4, dof): rad, rad/s, N m."""
        return np.array([self._limits_of(joint) for joint in self._chain]).T

    def text(self) -> str:
        """Return the URDF without geometry, with all joints fixed except those of the chain."""
        bare = ElementTree.Element("robot", {"name": self.name})
        for name, link in self._links.items():
            copy = ElementTree.SubElement(bare, "link", {"name": name})
            if self._mass[name] > 0 and (inertial := link.find("inertial")) is not None:
                copy.append(self._copied_inertial(name, inertial))
        for joint in self._joints:
            movable = joint in self._chain
            kind = "revolute" if movable else "fixed"
            copy = ElementTree.SubElement(bare, "joint", {"name": joint.get("name", ""), "type": kind})
            self._copy_numbers(joint, copy, f"joint {joint.get('name')!r}", "origin", xyz="0 0 0", rpy="0 0 0")
            for end in ("parent", "child"):
                ElementTree.SubElement(copy, end, {"link": _end(joint, end)})
            if movable:
                self._copy_numbers(joint, copy, f"joint {joint.get('name')!r}", "axis", xyz="1 0 0")
                limits = zip(("lower", "upper", "velocity", "effort"), self._limits_of(joint), strict=True)
                ElementTree.SubElement(copy, "limit", {name: repr(value) for name, value in limits})
        return ElementTree.tostring(bare, encoding="unicode")

    def shapes(self) -> tuple[Shape, ...]:
        """Return all collision shapes."""
        collisions = [(name, element) for name, link in self._links.items() for element in link.findall("collision")]
        if len(collisions) > MAX_SHAPES:
            raise self._error(f"it has {len(collisions)} collision shapes; at most {MAX_SHAPES} are allowed")
        return tuple(self._shape(name, collision, self._meshes) for name, collision in collisions)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(self._links)

    def visuals(self, link: str) -> list[Shape]:
        """Return the visual shapes of a link."""
        visuals = self._links[link].findall("visual")
        if len(visuals) > MAX_SHAPES:
            raise self._error(f"it has {len(visuals)} visual shapes; at most {MAX_SHAPES} are allowed")
        return [
            replace(self._shape(link, visual, self._visual_meshes), colour=colour_of(visual, self._robot))
            for visual in visuals
        ]

    def _copied_inertial(self, link: str, inertial: Element) -> Element:
        copy = ElementTree.Element("inertial")
        self._copy_numbers(inertial, copy, f"the inertia of link {link!r}", "origin", xyz="0 0 0", rpy="0 0 0")
        ElementTree.SubElement(copy, "mass", {"value": repr(self._mass[link])})
        moments = self._possible_moments(link, inertial)
        ElementTree.SubElement(copy, "inertia", {name: repr(value) for name, value in moments.items()})
        return copy

    def _copy_numbers(self, source: Element, copy: Element, owner: str, tag: str, **defaults: str) -> None:
        """Copy an element of vectors, such as an origin, if there is one."""
        if (element := source.find(tag)) is not None:
            vectors = {name: self._numbers(element, name, f"{tag} of {owner}", 3, at) for name, at in defaults.items()}
            words = {name: " ".join(repr(float(number)) for number in vector) for name, vector in vectors.items()}
            ElementTree.SubElement(copy, tag, words)

    def _error(self, problem: str) -> ConfigurationError:
        return ConfigurationError(f"{self.path.name} is not an arm that armctl can use: {problem}")

    def _check_tree(self) -> None:
        for kind in ("link", "joint"):
            if (count := len(self._robot.findall(kind))) > MAX_LINKS:
                raise self._error(f"it has {count} {kind}s; at most {MAX_LINKS} are allowed")
            names = Counter(element.get("name", "") for element in self._robot.findall(kind))
            if repeated := [name for name, count in names.items() if count > 1 or not name]:
                raise self._error(f"it has several {kind}s, or one without a name, called {short(repeated[0])}")
        for joint in self._joints:
            for end in (_end(joint, "parent"), _end(joint, "child")):
                if end not in self._links:
                    raise self._error(f"joint {joint.get('name')!r} refers to a link {end!r} that does not exist")
        parents = {_end(joint, "child"): _end(joint, "parent") for joint in self._joints}
        if FLOOR in self._links or "world" in parents:
            raise self._error(
                f"a link is called {FLOOR!r}, or one that is not the root 'world': MuJoCo's are called so"
            )
        roots = self._links.keys() - parents.keys()
        reached = list(roots)
        for link in reached:
            reached += [child for child, parent in parents.items() if parent == link]
        if len(parents) != len(self._joints) or len(roots) > 1 or len(reached) != len(self._links):
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
            if joint.get("type") != "fixed" and (mimic := joint.find("mimic")) is not None:
                raise self._error(
                    f"joint {joint.get('name')!r} between root and tip mimics {short(mimic.get('joint', ''))}, and "
                    "armctl has a motor for each joint: choose a tip before it, or make it fixed"
                )
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
        limits = {} if limit is None else dict(limit.attrib)
        if joint.get("type") == "continuous":
            limits |= {"lower": str(-FULL_TURN), "upper": str(FULL_TURN)}
        missing = [key for key in ("lower", "upper", "velocity", "effort") if key not in limits]
        if missing:
            raise self._error(f"joint {name!r} has no {' and no '.join(missing)} limit")
        lower, upper, velocity, effort = (
            self._number(limits[key], f"joint {name!r}, {key} limit")
            for key in ("lower", "upper", "velocity", "effort")
        )
        if not (lower < upper and velocity > 0 and effort > 0):
            raise self._error(
                f"joint {name!r} cannot move: lower {lower:g} must be below upper {upper:g}, and velocity {velocity:g} "
                f"and effort {effort:g} above 0"
            )
        return [lower, upper, velocity, effort]

    def _mass_of(self, name: str, link: Element) -> float:
        mass = link.find("inertial/mass")
        value = 0.0 if mass is None else self._number(mass.get("value", "0"), f"mass of link {name!r}")
        if value < 0:
            raise self._error(f"link {name!r} has a mass of {value:g} kg")
        return value if value >= MIN_MASS else 0.0

    def _moments(self, link: str, inertial: Element) -> dict[str, float]:
        inertia = inertial.find("inertia")
        moments = {} if inertia is None else inertia.attrib
        if missing := [name for name in _INERTIA if name not in moments]:
            raise self._error(f"link {link!r} has a mass, but no {' and no '.join(missing)} in its <inertia>")
        return {name: self._number(moments[name], f"inertia of link {link!r}") for name in _INERTIA}

    def _possible_moments(self, link: str, inertial: Element) -> dict[str, float]:
        """Return moments of which two are together as large as the third, which MuJoCo requires to the last digit."""
        moments = self._moments(link, inertial)
        small, medium, large = _principal(moments)
        if (missing := float(large * (1 + ROUND_OFF) - small - medium)) > 0:
            moments |= {name: moments[name] + missing for name in ("ixx", "iyy", "izz")}
        return moments

    def _check_inertia(self) -> None:
        for joint in self._chain:
            name = joint.get("name")
            axis = joint.find("axis")
            if axis is not None:
                length = np.linalg.norm(self._numbers(axis, "xyz", f"axis of joint {name!r}", 3, "1 0 0"))
                if length < MIN_AXIS:
                    raise self._error(f"joint {name!r} has an axis of length {length:.1g}")
            moved = _end(joint, "child")
            if not self._mass[moved]:
                raise self._error(f"link {moved!r} behind joint {name!r} has no mass")
        for name, link in self._links.items():
            inertial = link.find("inertial")
            if not self._mass[name] or inertial is None:
                continue
            if self._is_negligible(name, inertial):
                self.notes.append(f"Link {name!r} has no inertia that a body can have: it is taken to have no mass.")
                self._mass[name] = 0.0
                continue
            small, medium, large = _principal(self._moments(name, inertial))
            if small < MIN_INERTIA or small + medium < large * (1 - MENDED):
                raise self._error(
                    f"link {name!r} has an impossible inertia: its principal moments are "
                    f"{small:.3g}, {medium:.3g}, {large:.3g}"
                )
            if small + medium < large * (1 - ROUND_OFF):
                self.notes.append(
                    f"Link {name!r} has principal moments {small:.7g}, {medium:.7g}, {large:.7g} kg m^2, which no body "
                    "has: they were raised, so that two of them are together as large as the third."
                )

    def _is_negligible(self, link: str, inertial: Element) -> bool:
        """Return True if a link without inertia is a light frame on another link, or belongs to the base."""
        inertia = inertial.find("inertia")
        if inertia is not None and _principal(self._moments(link, inertial))[0] >= MIN_INERTIA:
            return False
        joint_above = {_end(joint, "child"): joint for joint in self._joints}
        at = link
        while at in joint_above and joint_above[at] not in self._chain:
            at = _end(joint_above[at], "parent")
        return at not in joint_above or (at != link and self._mass[link] <= LIGHT)

    def _shape(self, link: str, element: Element, meshes: Meshes) -> Shape:
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            raise self._error(f"link {link!r} has a <{element.tag}> without a shape")
        description = f"<{shape.tag}> of link {link!r}"
        triangles = np.empty((0, 3), dtype=np.int32)
        if shape.tag == "mesh":
            vertices, triangles = self._mesh(shape, description, meshes)
        elif shape.tag == "box":
            size = self._numbers(shape, "size", description, 3)
            vertices = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * self._positive(size, description)
        elif shape.tag in ("cylinder", "sphere"):
            radius = self._positive(self._numbers(shape, "radius", description, 1), description)[0]
            length = 0.0
            if shape.tag == "cylinder":
                length = self._positive(self._numbers(shape, "length", description, 1), description)[0]
            vertices = np.array(list(rings(shape.tag, radius, length / 2)))
        else:
            raise self._error(f"it has a {description}; armctl supports mesh, box, cylinder and sphere")
        placement = pinocchio.SE3.Identity()
        if (origin := element.find("origin")) is not None:
            rotation = pinocchio.rpy.rpyToMatrix(self._numbers(origin, "rpy", description, 3, "0 0 0"))
            placement = pinocchio.SE3(rotation, self._numbers(origin, "xyz", description, 3, "0 0 0"))
        return Shape(link, vertices @ placement.rotation.T + placement.translation, triangles)

    def _mesh(self, shape: Element, description: str, meshes: Meshes) -> tuple[Array, NDArray[np.int32]]:
        filename = shape.get("filename", "")
        try:
            return meshes.read(filename, self._numbers(shape, "scale", description, 3, "1 1 1"))
        except MeshError as error:
            raise self._error(f"the mesh {short(filename, PATH)} of a {description} {error}") from error

    def _numbers(self, element: Element, attribute: str, owner: str, count: int, default: str | None = None) -> Array:
        words = element.get(attribute, default or "").split()
        if len(words) != count:
            raise self._error(f"{owner} needs {count} numbers as {attribute}, not {short(' '.join(words))}")
        return np.array([self._number(word, f"{attribute} of {owner}") for word in words])

    def _number(self, word: str, place: str) -> float:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not abs(number) <= LARGEST:
            raise self._error(f"{place}: {short(word)} is not a finite number between -{LARGEST:g} and {LARGEST:g}")
        return number

    def _positive(self, numbers: Array, description: str) -> Array:
        if not (numbers >= MIN_SIZE).all():
            raise self._error(f"{description} has a size of {numbers.min():g}")
        return numbers


def _principal(moments: dict[str, float]) -> Array:
    """Return the principal moments (3,) kg m^2, the smallest first."""
    xx, xy, xz, yy, yz, zz = (moments[name] for name in _INERTIA)
    return np.asarray(np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _end(joint: Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
