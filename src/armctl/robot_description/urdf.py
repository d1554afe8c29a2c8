"""The tree of links and joints of a reach arm, and what is wrong with an unsuitable one.

The libraries behind armctl get a URDF that is written again from checked numbers, never the file itself: some of them
crash on a malformed one.
"""

import functools
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import Protocol

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robot_description.elements import Elements, end_of
from armctl.robot_description.file_notes import notes_on_file
from armctl.robot_description.followers import followers_in, notes_on_followers, with_followers
from armctl.robot_description.inertia import Inertias, RigidGroup
from armctl.robot_description.joint_limits import (
    SPEEDS,
    Overrides,
    assumed_efforts,
    lowered,
    notes_on_limits,
    stated_limits,
)
from armctl.robot_description.link_shapes import MAX_SHAPES
from armctl.robot_description.shape import Shape
from armctl.robot_description.tips import usual_tips
from armctl.robot_description.xml_file import Element, short

MAX_LINKS = 300
"""The largest robot of example-robot-data has 130; libraries recurse along a chain, and 5,000 overflow their stack."""
MIN_AXIS = 1e-6
"""Least length of a joint's axis, which is then made 1."""
TYPES = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
"""Types of joints that may be in the chain, and as what libraries get them."""
MIN_ARM_JOINTS = 4
"""Joints before a gripper without which it is a hand of its own, and not that of an arm."""
TIP_ADVICE = (
    "say which is the end-effector, its tip: `--set tip=LINK` on the command line, tip=LINK as an option of the "
    "environment or of load_arm"
)


class Shapes(Protocol):
    """Source of the shapes of links."""

    def of(self, link: Element, tag: str) -> list[Shape]:
        """Return the `collision` or `visual` shapes of a link. Raises `ConfigurationError`."""
        ...


class Urdf:
    """A `<robot>` whose joints from the root to the link `tip` form a reach arm.

    `collisions` and `drawings` read the shapes of links. Raises `ConfigurationError`, naming the file and the culprit,
    if the robot is unsuitable.
    """

    def __init__(
        self, path: Path, robot: Element, shapes: tuple[Shapes, Shapes], tip: str | None, overrides: Overrides
    ) -> None:
        self.path, self._robot, self._overrides = path, robot, overrides
        self._elements = Elements(path)
        self._collisions, self._drawings = shapes
        self.notes: list[str] = []
        """Repairs, omissions and assumptions, a sentence each."""
        self.home: dict[str, float] = {}
        """Positions of joints where the file has the arm begin."""
        self.armature: dict[str, float] = {}
        """Inertia of joints' motors, kg m^2."""
        self.apart: set[frozenset[str]] = set()
        """Pairs of links that cannot touch, as the file has it."""
        self.name = robot.get("name") or path.stem
        if not robot.get("name"):
            self.notes.append(f"The robot has no name: it is called {self.name!r}, as its file.")
        self._links = {name: link for link in robot.findall("link") if (name := link.get("name", ""))}
        self._joints = robot.findall("joint")
        self._check_tree()
        self.tip = tip or self._likely_tip()
        self._moving = self._movable_chain()
        self.followers = followers_in(self._elements, self._moving)
        """Joints of the chain without a motor."""
        self._chain = [joint for joint in self._moving if joint.find("mimic") is None]
        self.joints = tuple(joint.get("name", "") for joint in self._chain)
        self._check_axes()
        density = None if overrides.density is None else float(overrides.density[0])
        self._inertias = Inertias(self._elements, self._links, self._rigid_groups(), self._solids, density)
        stated = stated_limits(self._elements, self._chain)
        stated = with_followers(self._elements, self._moving, self.followers, self.joints, stated)
        self.limits = self._completed(stated)
        """Lower and upper position, velocity and effort limits of the chain's joints, (4, dof): rad, rad/s, N m; of
        joints that slide m, m/s, N."""
        self.notes += [*self._inertias.notes, *notes_on_limits(self._chain, stated, self.limits, overrides)]
        self.notes += [*notes_on_followers(self.followers), *notes_on_file(robot, self._moving)]

    @property
    def sliding(self) -> tuple[str, ...]:
        """Names of the chain's joints that slide."""
        return tuple(joint.get("name", "") for joint in self._moving if joint.get("type") == "prismatic")

    def text(self) -> str:
        """Return the URDF without geometry, with all joints fixed except those of the chain."""
        return self._text(self.limits)

    def _text(self, limits: Array) -> str:
        bare = ElementTree.Element("robot", {"name": self.name})
        for name in self._links:
            copy = ElementTree.SubElement(bare, "link", {"name": name})
            if (inertial := self._inertias.element(name)) is not None:
                copy.append(inertial)
        for joint in self._joints:
            movable = joint in self._moving
            kind = TYPES[joint.get("type", "")] if movable else "fixed"
            copy = ElementTree.SubElement(bare, "joint", {"name": joint.get("name", ""), "type": kind})
            self._copy_numbers(joint, copy, f"joint {joint.get('name')!r}", "origin", xyz="0 0 0", rpy="0 0 0")
            for end in ("parent", "child"):
                ElementTree.SubElement(copy, end, {"link": end_of(joint, end)})
            if movable:
                self._copy_numbers(joint, copy, f"joint {joint.get('name')!r}", "axis", xyz="1 0 0")
                numbers = self._limits_of(joint, limits)
                named = zip(("lower", "upper", "velocity", "effort"), numbers, strict=True)
                ElementTree.SubElement(copy, "limit", {name: repr(value) for name, value in named})
            for follower in self.followers:
                if follower.joint == joint.get("name"):
                    words = {"multiplier": repr(follower.ratio), "offset": repr(follower.offset)}
                    ElementTree.SubElement(copy, "mimic", {"joint": follower.leader, **words})
        return ElementTree.tostring(bare, encoding="unicode")

    def _limits_of(self, joint: Element, limits: Array) -> list[float]:
        """Return the limits of a joint by those (4, dof) of the chain; of a follower, those that its leader's imply."""
        name = joint.get("name", "")
        follower = next((each for each in self.followers if each.joint == name), None)
        if follower is None:
            return [float(number) for number in limits[:, self._chain.index(joint)]]
        lower, upper, velocity, effort = limits[:, self.joints.index(follower.leader)].tolist()
        ends = sorted(follower.ratio * end + follower.offset for end in (lower, upper))
        return [*ends, velocity * abs(follower.ratio), effort / abs(follower.ratio)]

    @functools.cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """All collision shapes."""
        count = sum(len(link.findall("collision")) for link in self._links.values())
        if count > MAX_SHAPES:
            raise self._error(f"it has {count} collision shapes; at most {MAX_SHAPES} are allowed")
        return tuple(shape for link in self._links.values() for shape in self._collisions.of(link, "collision"))

    def _solids(self, link: str) -> list[Shape]:
        """Return the collision shapes of a link, or those that are drawn if the file has none that collide."""
        return [shape for shape in self.shapes if shape.link == link] if self.shapes else self.visuals(link)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(self._links)

    def visuals(self, link: str) -> list[Shape]:
        """Return the visual shapes of a link."""
        return self._drawings.of(self._links[link], "visual")

    def _completed(self, stated: Array) -> Array:
        """Return the limits (4, dof) with those of options, and with assumed ones where the file has none."""
        lower, upper, velocity, effort = stated
        dof = len(self._chain)
        speeds = np.array([SPEEDS[TYPES[joint.get("type", "")]] for joint in self._chain])
        velocity = lowered(velocity, self._overrides.limit("max_velocity", dof), speeds)
        max_effort, assumed = self._overrides.limit("max_effort", dof), np.ones(dof)
        if max_effort is None and not effort.all():
            try:
                assumed = assumed_efforts(self._text(np.array([lower, upper, velocity, assumed])))
            except (ValueError, RuntimeError) as error:
                raise self._error(f"Pinocchio cannot model it: {error}") from error
        return np.array([lower, upper, velocity, lowered(effort, max_effort, assumed)])

    def _copy_numbers(self, source: Element, copy: Element, owner: str, tag: str, **defaults: str) -> None:
        """Copy an element of vectors, such as an origin, if there is one."""
        if (element := source.find(tag)) is not None:
            numbers = self._elements.numbers
            vectors = {name: numbers(element, name, f"{tag} of {owner}", 3, at) for name, at in defaults.items()}
            words = {name: " ".join(repr(float(number)) for number in vector) for name, vector in vectors.items()}
            ElementTree.SubElement(copy, tag, words)

    def _error(self, problem: str) -> ConfigurationError:
        return self._elements.error(problem)

    def _check_tree(self) -> None:
        for kind in ("link", "joint"):
            if (count := len(self._robot.findall(kind))) > MAX_LINKS:
                raise self._error(f"it has {count} {kind}s; at most {MAX_LINKS} are allowed")
            names = Counter(element.get("name", "") for element in self._robot.findall(kind))
            if repeated := [name for name, count in names.items() if count > 1 or not name]:
                raise self._error(f"it has several {kind}s, or one without a name, called {short(repeated[0])}")
        for joint in self._joints:
            for end in (end_of(joint, "parent"), end_of(joint, "child")):
                if end not in self._links:
                    raise self._error(f"joint {joint.get('name')!r} refers to a link {end!r} that does not exist")
        parents = {end_of(joint, "child"): end_of(joint, "parent") for joint in self._joints}
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

    def _likely_tip(self) -> str:
        """Return the only leaf, the link that is called most like an end-effector, or what carries all fingers."""
        parents = {end_of(joint, "parent") for joint in self._joints}
        leaves = [name for name in self._links if name not in parents]
        if len(leaves) == 1:
            return leaves[0]
        likely = usual_tips(name for name in self._links if self._joints_above(name))
        lineages = [self._lineage(name) for name in likely]
        last = max(lineages, key=len, default=[])
        carrier = self._carrier([name for name in leaves if self._joints_above(name)])
        tip, reason = carrier, "all other links that move are behind it"
        if likely:
            tip, reason = (last[0] if all(set(links) <= set(last) for links in lineages) else None), "by its name"
        if tip is not None:
            self.notes.append(
                f"The end-effector is taken to be {tip!r}, {reason}: the file has {len(leaves)} leaf links, and tip= "
                "gives another."
            )
            return tip
        candidates = f"{len(likely)} likely end-effectors" if likely else f"{len(leaves)} leaf links"
        raise self._error(f"it has {candidates} ({', '.join(likely or leaves)}); {TIP_ADVICE}")

    def _lineage(self, link: str) -> list[str]:
        """Return a link and all before it, back to the root."""
        parents = {end_of(joint, "child"): end_of(joint, "parent") for joint in self._joints}
        links = [link]
        while links[-1] in parents:
            links.append(parents[links[-1]])
        return links

    def _carrier(self, links: list[str]) -> str | None:
        """Return the last link that all of some are behind, if that is the end of an arm."""
        lineages = [self._lineage(link) for link in links]
        shared = (link for link in (lineages[0] if lineages else []) if all(link in lineage for lineage in lineages))
        carrier = next(shared, None)
        return carrier if carrier and len(self._joints_above(carrier)) >= MIN_ARM_JOINTS else None

    def _joints_above(self, link: str) -> list[Element]:
        """Return the joints from the root to a link that are not fixed."""
        joint_above = {end_of(joint, "child"): joint for joint in self._joints}
        joints: list[Element] = []
        for _ in self._joints:
            if link not in joint_above:
                break
            joint = joint_above[link]
            if joint.get("type") != "fixed":
                joints.insert(0, joint)
            link = end_of(joint, "parent")
        return joints

    def _movable_chain(self) -> list[Element]:
        if self.tip not in self._links:
            raise unknown_name(f"link of {self.path.name} called", self.tip, self._links)
        chain = self._joints_above(self.tip)
        for joint in chain:
            if joint.get("type") not in TYPES:
                raise self._error(
                    f"joint {joint.get('name')!r} is {joint.get('type')}; joints should be revolute, "
                    "continuous, prismatic or fixed"
                )
        if all(joint.get("type") == "prismatic" for joint in chain):
            raise self._error(f"it has no revolute joint between its root and {self.tip!r}")
        return chain

    def _check_axes(self) -> None:
        for joint in self._moving:
            name, axis = joint.get("name"), joint.find("axis")
            if axis is not None:
                length = np.linalg.norm(self._elements.numbers(axis, "xyz", f"axis of joint {name!r}", 3, "1 0 0"))
                if length < MIN_AXIS:
                    raise self._error(f"joint {name!r} has an axis of length {length:.1g}")

    def _rigid_groups(self) -> list[RigidGroup]:
        """Return the groups of links that move as one, the root's first."""
        children = {end_of(joint, "child") for joint in self._joints}
        (root,) = self._links.keys() - children
        groups = [RigidGroup(None, {root: pinocchio.SE3.Identity()})]
        groups += [
            RigidGroup(joint.get("name"), {end_of(joint, "child"): pinocchio.SE3.Identity()}) for joint in self._moving
        ]
        below: dict[str, list[Element]] = {}
        for joint in self._joints:
            if joint not in self._moving:
                below.setdefault(end_of(joint, "parent"), []).append(joint)
        for group in groups:
            for link in (reached := list(group.links)):
                for joint in below.get(link, []):
                    placement = self._elements.placement(joint, f"origin of joint {joint.get('name')!r}")
                    group.links[end_of(joint, "child")] = group.links[link] * placement
                    reached.append(end_of(joint, "child"))
        return groups
