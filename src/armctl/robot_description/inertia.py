"""Masses and inertias of a URDF's links, repaired where a file's cannot be those of bodies.

Links that are fixed to each other form a rigid group, which one joint moves: only the group has to be a body.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio
import scipy

from armctl.core.arrays import Array
from armctl.robot_description.elements import Elements
from armctl.robot_description.meshes import thinness
from armctl.robot_description.shape import Shape
from armctl.robot_description.xml_file import Element

MIN_MASS = 1e-9
"""kg: least mass of a link that has one."""
LIGHT = 1e-3
"""kg: largest mass of a frame that may be left out."""
MIN_INERTIA = 1e-14
"""kg m^2: least principal moment; MuJoCo's own limit is near."""
MENDED, ROUND_OFF = 0.05, 1e-12
"""Shares of a principal moment that the two others may miss together: of a file, and of the digits of a float."""
DENSITY = 1000.0
"""kg/m^3: of the collision shapes of an arm whose file has no masses; 18 kg of a UR5 fill 0.018 m^3."""
ADVICE = "give a density, in kg/m^3 (`--set density=1000`, load_arm(density=1000))"

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class RigidGroup:
    """Links that are fixed to the first one, with their placements in it, and the joint that moves it (None: none)."""

    joint: str | None
    links: dict[str, pinocchio.SE3]


class Inertias:
    """The `<inertial>` elements of links, as libraries get them."""

    def __init__(
        self,
        elements: Elements,
        links: dict[str, Element],
        groups: list[RigidGroup],
        shapes: Callable[[str], list[Shape]],
        density: float | None,
    ) -> None:
        self._elements, self._links, self._shapes, self._density = elements, links, shapes, density
        self.notes: list[str] = []
        """Repairs, a sentence each."""
        self._replaced: dict[str, pinocchio.Inertia | None] = {}
        self._weighed: list[str] = []
        self._mass = {name: self._mass_of(name, link) for name, link in links.items()}
        moving = [group for group in groups if group.joint is not None]
        if moving and density is None and not any(self._mass[link] for group in moving for link in group.links):
            self._density = DENSITY
        for group in groups:
            self._repair(group)
        if self._weighed:
            self.notes.append(
                f"Masses of these links are those of their shapes, filled at {self._density:g} kg/m^3: "
                f"{', '.join(map(repr, self._weighed))}."
            )

    def element(self, link: str) -> Element | None:
        """Return the `<inertial>` of a link; None for a link without mass."""
        inertial = self._links[link].find("inertial")
        if link in self._replaced:
            body = self._replaced[link]
            return None if body is None else _element(body.mass, [body.lever, np.zeros(3)], _entries(body.inertia))
        if not self._mass[link] or inertial is None:
            return None
        owner, origin = f"origin of the inertia of link {link!r}", inertial.find("origin")
        numbers = self._elements.numbers
        place = [] if origin is None else [numbers(origin, name, owner, 3, "0 0 0") for name in ("xyz", "rpy")]
        return _element(self._mass[link], place, _possible(self._moments(link, inertial)))

    def _repair(self, group: RigidGroup) -> None:
        for link in group.links:
            if self._mass[link] and self._is_negligible(link, group):
                self.notes.append(f"Link {link!r} has no inertia that a body can have: it is taken to have no mass.")
                self._mass[link], self._replaced[link] = 0.0, None
        if group.joint is None:
            return
        if not any(self._mass[link] for link in group.links):
            self._weigh(group)
        impossible = {link: problem for link in group.links if self._mass[link] and (problem := self._problem_of(link))}
        first = next(iter(group.links))
        if impossible and self._density is not None:
            for link in impossible:
                self._reshape(link)
        elif impossible or (not self._mass[first] and first not in self._replaced):
            self._add_up(group, impossible)
        for link in group.links:
            if self._mass[link] and link not in self._replaced:
                self._note_on_mending(link)

    def _add_up(self, group: RigidGroup, impossible: dict[str, str]) -> None:
        """Give the first link of a group the sum of all, since single ones are no bodies."""
        first, massive = next(iter(group.links)), [link for link in group.links if self._mass[link]]
        total = sum((group.links[link].act(self._body(link)) for link in massive), pinocchio.Inertia.Zero())
        principal = _principal(total.inertia)
        if impossible and (len(massive) == 1 or principal[0] < MIN_INERTIA or _missing(principal) > MENDED):
            raise self._elements.error(f"{next(iter(impossible.values()))}: correct it, or {ADVICE}, for its shapes'")
        self._replaced |= dict.fromkeys(group.links) | {first: total}
        self.notes.append(
            f"Inertias of links that move as one are added up: {', '.join(map(repr, massive))}, to that of {first!r}."
        )

    def _weigh(self, group: RigidGroup) -> None:
        """Give the links of a group masses by the volume of their shapes."""
        bodies = {link: body for link in group.links if (body := self._solid(link)) is not None}
        first = next(iter(group.links))
        if self._density is None or not bodies:
            advice = ADVICE if self._density is None else "nor has it a shape, by which it could be weighed"
            raise self._elements.error(f"link {first!r} behind joint {group.joint!r} has no mass: {advice}")
        total = sum((group.links[link].act(body) for link, body in bodies.items()), pinocchio.Inertia.Zero())
        self._replaced |= dict.fromkeys(group.links) | {first: total}
        self._weighed += bodies

    def _reshape(self, link: str) -> None:
        """Give a link of an impossible inertia that of its shapes, for its own mass."""
        if (solid := self._solid(link)) is None:
            raise self._elements.error(f"{self._problem_of(link)}, and no shape that could give another")
        body = self._body(link)
        share = body.mass / solid.mass
        self._replaced[link] = pinocchio.Inertia(body.mass, body.lever, share * solid.inertia)
        self.notes.append(f"Link {link!r} has an impossible inertia: it has that of its shapes, filled, instead.")

    def _solid(self, link: str) -> pinocchio.Inertia | None:
        """Return the inertia of a link's shapes, each as its convex hull, at the density."""
        vertices = [shape.vertices for shape in self._shapes(link) if not thinness(shape.vertices)]
        if not vertices:
            return None
        return sum((solid_inertia(each, self._density or DENSITY) for each in vertices), pinocchio.Inertia.Zero())

    def _body(self, link: str) -> pinocchio.Inertia:
        """Return the inertia that a file states of a link, in its frame; principal moments are at least 0."""
        inertial = self._links[link].find("inertial")
        assert inertial is not None
        placement = self._elements.placement(inertial, f"origin of the inertia of link {link!r}")
        values, vectors = np.linalg.eigh(_matrix(self._moments(link, inertial)))
        matrix = vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
        return pinocchio.Inertia(
            self._mass[link], placement.translation, placement.rotation @ matrix @ placement.rotation.T
        )

    def _problem_of(self, link: str) -> str:
        inertial = self._links[link].find("inertial")
        assert inertial is not None
        principal = _principal(_matrix(self._moments(link, inertial)))
        if principal[0] >= MIN_INERTIA and _missing(principal) <= MENDED:
            return ""
        listed = ", ".join(f"{moment:.3g}" for moment in principal)
        return f"link {link!r} has an impossible inertia: its principal moments are {listed}"

    def _note_on_mending(self, link: str) -> None:
        inertial = self._links[link].find("inertial")
        assert inertial is not None
        principal = _principal(_matrix(self._moments(link, inertial)))
        if _missing(principal) > ROUND_OFF:
            listed = ", ".join(f"{moment:.7g}" for moment in principal)
            self.notes.append(
                f"Link {link!r} has principal moments {listed} kg m^2, which no body has: they were raised, so that "
                "two of them are together as large as the third."
            )

    def _is_negligible(self, link: str, group: RigidGroup) -> bool:
        """Return True if a link without a possible inertia is a light frame on another link, or belongs to the base."""
        inertial = self._links[link].find("inertial")
        inertia = None if inertial is None else inertial.find("inertia")
        if group.joint is None:
            return inertia is None or bool(self._problem_of(link))
        is_light = link != next(iter(group.links)) and self._mass[link] <= LIGHT
        if inertial is None or inertia is None:
            return is_light
        return is_light and bool(_principal(_matrix(self._moments(link, inertial)))[0] < MIN_INERTIA)

    def _mass_of(self, name: str, link: Element) -> float:
        mass = link.find("inertial/mass")
        value = 0.0 if mass is None else self._elements.number(mass.get("value", "0"), f"mass of link {name!r}")
        if value < 0:
            raise self._elements.error(f"link {name!r} has a mass of {value:g} kg")
        return value if value >= MIN_MASS else 0.0

    def _moments(self, link: str, inertial: Element) -> dict[str, float]:
        inertia = inertial.find("inertia")
        moments = {} if inertia is None else inertia.attrib
        if missing := [name for name in _MOMENTS if name not in moments]:
            raise self._elements.error(f"link {link!r} has a mass, but no {' and no '.join(missing)} in its <inertia>")
        return {name: self._elements.number(moments[name], f"inertia of link {link!r}") for name in _MOMENTS}


def solid_inertia(vertices: Array, density: float) -> pinocchio.Inertia:
    """Return the inertia of the convex hull of `vertices` (k, 3) m, filled at a density, kg/m^3.

    Sums over the tetrahedra from the hull's centre to its faces (Tonon, "Explicit exact formulas for the 3-D
    tetrahedron inertia tensor", Journal of Mathematics and Statistics 1, 2004).
    """
    hull = scipy.spatial.ConvexHull(vertices)
    centre = vertices[hull.vertices].mean(axis=0)
    corners = vertices[hull.simplices] - centre
    volumes = np.abs(np.linalg.det(corners)) / 6
    sums = corners.sum(axis=1)
    lever = (volumes @ sums) / (4 * volumes.sum())
    products = np.einsum("fci,fcj->fij", corners, corners) + np.einsum("fi,fj->fij", sums, sums)
    second = np.einsum("f,fij->ij", volumes, products) / 20 - volumes.sum() * np.outer(lever, lever)
    inertia = np.eye(3) * np.trace(second) - second
    return pinocchio.Inertia(density * volumes.sum(), centre + lever, density * inertia)


def _element(mass: float, place: list[Array], moments: dict[str, float]) -> Element:
    """Return an `<inertial>`, with an origin if `place` is position and angles."""
    inertial = Element("inertial")
    if place:
        words = (" ".join(repr(float(number)) for number in vector) for vector in place)
        inertial.append(Element("origin", dict(zip(("xyz", "rpy"), words, strict=True))))
    inertial.append(Element("mass", {"value": repr(mass)}))
    inertial.append(Element("inertia", {name: repr(value) for name, value in moments.items()}))
    return inertial


def _entries(matrix: Array) -> dict[str, float]:
    """Return the entries of a matrix (3, 3), raised to those of a body."""
    rows, columns = np.triu_indices(3)
    return _possible({name: float(matrix[i, j]) for name, i, j in zip(_MOMENTS, rows, columns, strict=True)})


def _possible(moments: dict[str, float]) -> dict[str, float]:
    """Return moments of which two are together as large as the third, which MuJoCo requires to the last digit."""
    small, medium, large = _principal(_matrix(moments))
    if (missing := float(large * (1 + ROUND_OFF) - small - medium)) > 0:
        moments = moments | {name: moments[name] + missing for name in ("ixx", "iyy", "izz")}
    return moments


def _matrix(moments: dict[str, float]) -> Array:
    xx, xy, xz, yy, yz, zz = (moments[name] for name in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _principal(matrix: Array) -> Array:
    """Return the principal moments (3,) kg m^2, the smallest first."""
    return np.asarray(np.linalg.eigvalsh(matrix))


def _missing(principal: Array) -> float:
    """Return the share of the largest moment that the two others miss together."""
    small, medium, large = principal
    return float(1 - (small + medium) / large) if large > 0 else 1.0
