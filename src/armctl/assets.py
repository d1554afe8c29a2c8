"""Where arms and worlds are found, and what is known of an arm before any software models it.

`load_arm` reads one URDF into an `ArmDescription`. Pinocchio and MuJoCo both build on it, so that they cannot disagree.
"""

import functools
import itertools
import sysconfig
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.capsules import Capsule, enclosing_capsule
from armctl.errors import ConfigurationError, unknown_name

Array = NDArray[np.float64]

FLOOR = "floor"


@dataclass(frozen=True)
class BuiltinArm:
    """What armctl adds to the URDF of an arm from example-robot-data."""

    urdf: str
    srdf: str
    tip: str
    home: tuple[float, ...]
    max_acceleration: float
    max_jerk: float


_UR_HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)

# The URDF has neither. 15 rad/s^2 is about what the UR5's effort limits allow its stretched-out shoulder (150 N m at
# 4 kg m^2, gravity taken off); the jerk reaches it within 50 ms.
BUILTIN_ARMS = {
    name: BuiltinArm(
        f"ur_description/urdf/{name}_robot.urdf", "ur_description/srdf/ur5.srdf", "ee_link", _UR_HOME, 15.0, 300.0
    )
    for name in ("ur3", "ur5", "ur10")
}


@dataclass(frozen=True)
class JointLimits:
    """Limits of each joint, all (dof,): rad, rad/s, N m, rad/s^2, rad/s^3."""

    lower: Array
    upper: Array
    velocity: Array
    effort: Array
    acceleration: Array
    jerk: Array


@dataclass(frozen=True)
class LinkMesh:
    """A triangle mesh in its link's frame, for the eye only: vertices (k, 3) m, triangles (m, 3)."""

    link: str
    vertices: Array
    triangles: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ArmDescription:
    """A serial arm: one URDF text for every library, and what no URDF says.

    `urdf` has the joints from root to `tip` movable, all others fixed, and no geometry. `collision_pairs` are the pairs
    of links (or link and `FLOOR`) worth testing: not those that are neighbours, touch at home, or whose joints the SRDF
    rules out.
    """

    name: str
    source: str
    urdf: str
    joints: tuple[str, ...]
    tip: str
    home: Array
    limits: JointLimits
    capsules: tuple[Capsule, ...]
    meshes: tuple[LinkMesh, ...]
    collision_pairs: tuple[tuple[str, str], ...]

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joints)


def world_path(name: str) -> Path:
    """Path of one of armctl's own MJCF worlds, such as `arm_reach`."""
    return Path(str(resources.files("armctl.models") / f"{name}.xml"))


@functools.cache
def _robot_data() -> Path:
    relative = Path("cmeel.prefix/share/example-robot-data/robots")
    for site in (sysconfig.get_path("platlib"), sysconfig.get_path("purelib"), *pinocchio.__path__):
        for folder in (Path(site), *Path(site).parents):
            if (folder / relative).is_dir():
                return folder / relative
    raise ConfigurationError("example-robot-data is not installed beside armctl: pip install example-robot-data")


def load_arm(
    robot: "str | Path | ArmDescription",
    *,
    tip: str | None = None,
    home: Sequence[float] | Array | None = None,
    srdf: str | Path | None = None,
    max_acceleration: float | None = None,
    max_jerk: float | None = None,
) -> ArmDescription:
    """Read an arm by name (`ur3`, `ur5`, `ur10`) or from the path of a URDF file.

    `tip` names the link that is the end-effector; without it a file's only leaf link is taken. `home` (dof,) is where
    episodes start, rad; without it zero, or the middle of the range where zero is out of range. `srdf` names the file
    whose `<disable_collisions>` rule out pairs of links that cannot touch.

    Raises `ConfigurationError` for an unknown name, and for a file that lacks what a reach arm needs: at least one
    revolute joint between root and tip, with position, velocity and effort limits, and mass behind each joint.
    """
    if isinstance(robot, ArmDescription):
        return robot
    fixed_home = None if home is None else tuple(float(angle) for angle in home)
    if robot in BUILTIN_ARMS:
        builtin = BUILTIN_ARMS[str(robot)]
        return _read_arm(
            _robot_data() / builtin.urdf,
            tip or builtin.tip,
            fixed_home or builtin.home,
            Path(srdf or _robot_data() / builtin.srdf),
            max_acceleration or builtin.max_acceleration,
            max_jerk or builtin.max_jerk,
        )
    if Path(robot).suffix.lower() not in (".urdf", ".xml"):
        raise unknown_name("robot", robot, [*BUILTIN_ARMS, "path/to/your.urdf"])
    if not Path(robot).is_file():
        raise ConfigurationError(f"there is no URDF file {str(robot)!r}")
    return _read_arm(
        Path(robot).resolve(),
        tip,
        fixed_home,
        Path(srdf) if srdf else None,
        max_acceleration or 15.0,
        max_jerk or 300.0,
    )


@functools.lru_cache(maxsize=16)
def _read_arm(
    path: Path,
    tip: str | None,
    home: tuple[float, ...] | None,
    srdf: Path | None,
    max_acceleration: float,
    max_jerk: float,
) -> ArmDescription:
    robot = _robot_element(path)
    tip = tip or _only_leaf(robot, path)
    chain = _movable_chain(robot, tip, path)
    limits = _joint_limits(chain, path, max_acceleration, max_jerk)
    home_position = _home_position(home, limits)
    geometry = {link.get("name", ""): _link_geometry(link, path) for link in robot.iter("link")}
    meshes = tuple(
        LinkMesh(link, vertices, triangles)
        for link, parts in geometry.items()
        for vertices, triangles in parts
        if len(triangles)
    )
    capsules = tuple(
        enclosing_capsule(link, np.vstack([vertices for vertices, _ in parts]))
        for link, parts in geometry.items()
        if parts
    )
    urdf = _bare_urdf(robot, chain)
    return ArmDescription(
        name=str(robot.get("name", path.stem)),
        source=path.name,
        urdf=urdf,
        joints=tuple(joint.get("name", "") for joint in chain),
        tip=tip,
        home=home_position,
        limits=limits,
        capsules=capsules,
        meshes=meshes,
        collision_pairs=_collision_pairs(urdf, capsules, home_position, _impossible_pairs(srdf)),
    )


def _robot_element(path: Path) -> ElementTree.Element:
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise ConfigurationError(f"{path.name} cannot be read as XML: {error}") from error
    if root.tag != "robot":
        raise ConfigurationError(f"{path.name} is not a URDF or SRDF: its root element is <{root.tag}>, not <robot>")
    return root


def _impossible_pairs(srdf: Path | None) -> set[frozenset[str]]:
    if srdf is None:
        return set()
    pairs = _robot_element(srdf).iter("disable_collisions")
    return {frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs}


def _named(element: ElementTree.Element, child: str, attribute: str) -> str:
    found = element.find(child)
    return "" if found is None else found.get(attribute, "")


def _only_leaf(robot: ElementTree.Element, path: Path) -> str:
    parents = {_named(joint, "parent", "link") for joint in robot.findall("joint")}
    leaves = [name for link in robot.findall("link") if (name := link.get("name", "")) not in parents]
    if len(leaves) != 1:
        raise ConfigurationError(
            f"{path.name} has {len(leaves)} leaf links ({', '.join(leaves)}): say which is the end-effector, "
            f"load_arm({path.name!r}, tip=...)"
        )
    return leaves[0]


def _movable_chain(robot: ElementTree.Element, tip: str, path: Path) -> list[ElementTree.Element]:
    """Revolute joints from the root to `tip`, in order."""
    links = [link.get("name", "") for link in robot.findall("link")]
    if tip not in links:
        raise unknown_name(f"link in {path.name}", tip, links)
    joint_above = {_named(joint, "child", "link"): joint for joint in robot.findall("joint")}
    chain: list[ElementTree.Element] = []
    link = tip
    while link in joint_above:
        joint = joint_above[link]
        if joint.get("type") in ("revolute", "continuous"):
            chain.insert(0, joint)
        elif joint.get("type") != "fixed":
            raise ConfigurationError(
                f"joint {joint.get('name')!r} of {path.name} is {joint.get('type')}: "
                "a reach arm has revolute, continuous and fixed joints"
            )
        link = _named(joint, "parent", "link")
    if not chain:
        raise ConfigurationError(f"{path.name} has no revolute joint between its root and {tip!r}")
    return chain


def _joint_limits(
    chain: list[ElementTree.Element], path: Path, max_acceleration: float, max_jerk: float
) -> JointLimits:
    rows = []
    for joint in chain:
        limit = joint.find("limit")
        numbers = {} if limit is None else {key: float(value) for key, value in limit.attrib.items()}
        if joint.get("type") == "continuous":
            numbers = {"lower": -2 * np.pi, "upper": 2 * np.pi} | numbers
        missing = [key for key in ("lower", "upper", "velocity", "effort") if key not in numbers]
        if missing:
            raise ConfigurationError(
                f"joint {joint.get('name')!r} of {path.name} has no {' and no '.join(missing)} limit"
            )
        if not (numbers["lower"] < numbers["upper"] and numbers["velocity"] > 0 and numbers["effort"] > 0):
            raise ConfigurationError(
                f"joint {joint.get('name')!r} of {path.name} cannot move: its limits are {numbers}; "
                "lower must be below upper, velocity and effort above 0"
            )
        rows.append([numbers[key] for key in ("lower", "upper", "velocity", "effort")])
    lower, upper, velocity, effort = np.array(rows).T
    return JointLimits(
        lower, upper, velocity, effort, np.full(len(rows), max_acceleration), np.full(len(rows), max_jerk)
    )


def _home_position(home: tuple[float, ...] | None, limits: JointLimits) -> Array:
    if home is None:
        zero_allowed = (limits.lower <= 0) & (limits.upper >= 0)
        return np.where(zero_allowed, 0.0, (limits.lower + limits.upper) / 2)
    position = np.array(home, dtype=float)
    if position.shape != limits.lower.shape:
        raise ConfigurationError(f"home has shape {position.shape}, and the arm {len(limits.lower)} joints")
    if not np.all((position >= limits.lower) & (position <= limits.upper)):
        raise ConfigurationError(f"home {position} is outside the joint limits {limits.lower} to {limits.upper}")
    return position


def _bare_urdf(robot: ElementTree.Element, chain: list[ElementTree.Element]) -> str:
    """The URDF without geometry, and with all joints but the chain's fixed."""
    bare = ElementTree.Element("robot", robot.attrib)
    for link in robot.findall("link"):
        copy = ElementTree.SubElement(bare, "link", link.attrib)
        inertial = link.find("inertial")
        if inertial is not None and float(_named(inertial, "mass", "value") or 0) > 0:
            copy.append(inertial)
    for joint in robot.findall("joint"):
        kind = "revolute" if joint in chain else "fixed"
        copy = ElementTree.SubElement(bare, "joint", {"name": joint.get("name", ""), "type": kind})
        for tag in ("origin", "parent", "child", "axis", "limit"):
            if (part := joint.find(tag)) is not None and not (kind == "fixed" and tag in ("axis", "limit")):
                copy.append(part)
        if kind == "revolute" and joint.get("type") == "continuous":
            limit = copy.find("limit")
            assert limit is not None
            limit.attrib.update(lower=str(-2 * np.pi), upper=str(2 * np.pi))
    return ElementTree.tostring(bare, encoding="unicode")


def _link_geometry(link: ElementTree.Element, path: Path) -> list[tuple[Array, NDArray[np.int32]]]:
    """Vertices and triangles of each collision shape, in the link's frame; a primitive has vertices only."""
    return [_shape(collision, path) for collision in link.findall("collision")]


def _shape(collision: ElementTree.Element, path: Path) -> tuple[Array, NDArray[np.int32]]:
    geometry = collision.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise ConfigurationError(f"{path.name} has a <collision> without a shape")
    triangles = np.empty((0, 3), dtype=np.int32)
    if shape.tag == "mesh":
        mesh = coal.MeshLoader().load(
            str(_mesh_path(shape.get("filename", ""), path)), _numbers(shape, "scale", "1 1 1")
        )
        vertices = np.array(mesh.vertices())
        triangles = np.array([[mesh.tri_indices(i)[k] for k in range(3)] for i in range(mesh.num_tris)], dtype=np.int32)
    elif shape.tag == "box":
        vertices = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * _numbers(shape, "size", "")
    elif shape.tag in ("cylinder", "sphere"):
        radius = float(shape.get("radius", 0))
        half_length = float(shape.get("length", 0)) / 2
        vertices = np.array([(*circle, z) for circle, z in _rings(shape.tag, radius, half_length)])
    else:
        raise ConfigurationError(f"{path.name} has a collision shape <{shape.tag}>: use mesh, box, cylinder or sphere")
    origin = collision.find("origin")
    placement = pinocchio.SE3.Identity()
    if origin is not None:
        placement = pinocchio.SE3(
            pinocchio.rpy.rpyToMatrix(_numbers(origin, "rpy", "0 0 0")), _numbers(origin, "xyz", "0 0 0")
        )
    return vertices @ placement.rotation.T + placement.translation, triangles


def _rings(
    shape: str, radius: float, half_length: float, points: int = 24
) -> Iterator[tuple[tuple[float, float], float]]:
    """Points on rings around z: the two rims of a cylinder, or parallels of a sphere."""
    levels = [(radius, -half_length), (radius, half_length)]
    if shape == "sphere":
        levels = [(radius * np.cos(a), radius * np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, points)]
    for ring_radius, z in levels:
        for angle in np.linspace(0, 2 * np.pi, points, endpoint=False):
            yield (ring_radius * np.cos(angle), ring_radius * np.sin(angle)), z


def _numbers(element: ElementTree.Element, attribute: str, default: str) -> Array:
    return np.array([float(word) for word in element.get(attribute, default).split()])


def _mesh_path(filename: str, urdf: Path) -> Path:
    """File of a mesh named relative to the URDF, as `file://`, or as `package://` in a folder around the URDF."""
    if filename.startswith("package://example-robot-data/robots/"):
        return _robot_data() / filename.removeprefix("package://example-robot-data/robots/")
    relative = filename.removeprefix("file://").removeprefix("package://")
    for folder in urdf.parents:
        if (folder / relative).is_file():
            return folder / relative
    raise ConfigurationError(f"{urdf.name} names a mesh {filename!r} that is not beside it or in a folder above it")


def _collision_pairs(
    urdf: str, capsules: tuple[Capsule, ...], home: Array, impossible: set[frozenset[str]]
) -> tuple[tuple[str, str], ...]:
    model = pinocchio.buildModelFromXML(urdf)
    geometry = capsule_geometry(model, capsules)
    joint_of = {frame.name: frame.parentJoint for frame in model.frames} | {FLOOR: None}
    ruled_out = {frozenset(joint_of.get(link) for link in pair) for pair in impossible}
    pairs = [
        (first.name, second.name)
        for first, second in itertools.combinations(geometry.geometryObjects, 2)
        if frozenset(joints := (joint_of[first.name], joint_of[second.name])) not in ruled_out
        and _may_touch(model, *joints)
    ]
    add_collision_pairs(geometry, pairs)
    data = geometry.createData()
    pinocchio.computeCollisions(model, model.createData(), geometry, data, home, False)
    return tuple(pair for pair, result in zip(pairs, data.collisionResults, strict=True) if not result.isCollision())


def add_collision_pairs(geometry: pinocchio.GeometryModel, pairs: Iterable[tuple[str, str]]) -> None:
    """Make Pinocchio's collision checks look at these pairs of links."""
    for pair in pairs:
        geometry.addCollisionPair(pinocchio.CollisionPair(*(geometry.getGeometryId(name) for name in pair)))


def _may_touch(model: pinocchio.Model, first: int | None, second: int | None) -> bool:
    """Whether bodies on two joints (None: the floor) can move against each other without being neighbours."""
    if first is None or second is None:
        return (first or second or 0) > 1  # what turns on the spot stays off the floor
    return first != second and model.parents[max(first, second)] != min(first, second)


def capsule_geometry(model: pinocchio.Model, capsules: tuple[Capsule, ...]) -> pinocchio.GeometryModel:
    """Pinocchio's collision geometry: the capsules, and the floor as the half-space below z = 0."""
    geometry = pinocchio.GeometryModel()
    for capsule in capsules:
        frame = model.frames[model.getFrameId(capsule.link)]
        start, end = np.array(capsule.start), np.array(capsule.end)
        axis, length = end - start, float(np.linalg.norm(end - start))
        rotation = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), axis).matrix() if length else np.eye(3)
        placement = frame.placement * pinocchio.SE3(rotation, (start + end) / 2)
        shape = coal.Capsule(capsule.radius, length)
        geometry.addGeometryObject(pinocchio.GeometryObject(capsule.link, frame.parentJoint, placement, shape))
    floor = coal.Halfspace(np.array([0.0, 0, 1]), 0.0)
    geometry.addGeometryObject(pinocchio.GeometryObject(FLOOR, 0, pinocchio.SE3.Identity(), floor))
    return geometry
