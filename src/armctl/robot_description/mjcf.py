"""Reads an MJCF robot as the tree of links and joints that a URDF is, by MuJoCo's own compiler.

A link's frame is that of its body, moved to the anchor of its joint; joint positions are those of MuJoCo's `qpos`.
"""

from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import SubElement

import mujoco
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.robot_description.elements import Elements
from armctl.robot_description.meshes import round_points
from armctl.robot_description.mjcf_file import read_mjcf_file
from armctl.robot_description.shape import Shape
from armctl.robot_description.tips import usual_tips
from armctl.robot_description.xml_file import Element

WORLD = "world"
DRAWN_GROUPS = 3
"""Groups of geoms that MuJoCo's viewer draws: 0, 1 and 2."""
GEOM, JOINT = mujoco.mjtGeom, mujoco.mjtJoint
ROUND = {
    int(GEOM.mjGEOM_SPHERE): "sphere", int(GEOM.mjGEOM_CYLINDER): "cylinder", int(GEOM.mjGEOM_CAPSULE): "capsule",
}  # fmt: skip
KINDS = {int(JOINT.mjJNT_HINGE): "revolute", int(JOINT.mjJNT_SLIDE): "prismatic", int(JOINT.mjJNT_BALL): "ball"}


@dataclass
class MjcfRobot:
    """A robot from an MJCF, as a `<robot>`, and what a URDF does not contain."""

    robot: Element
    collisions: dict[str, list[Shape]] = field(default_factory=dict)
    """Shapes by link."""
    drawings: dict[str, list[Shape]] = field(default_factory=dict)
    home: dict[str, float] = field(default_factory=dict)
    """Positions by joint in the keyframe `home`, or the first one."""
    armature: dict[str, float] = field(default_factory=dict)
    """Inertia of each joint's motor, kg m^2 (kg of one that slides)."""
    apart: set[frozenset[str]] = field(default_factory=set)
    """Pairs of links that the file excludes from contacts."""
    notes: list[str] = field(default_factory=list)

    def of(self, link: Element, tag: str) -> list[Shape]:
        """Return the `collision` or `visual` shapes of a link."""
        return (self.collisions if tag == "collision" else self.drawings).get(link.get("name", ""), [])


def read_mjcf(path: Path, root: Element, tip: str | None) -> MjcfRobot:
    """Return the robot whose root element has been read from `path`.

    It has the sites that are called like an end-effector, or as `tip` says, as links of their own. Trees of bodies that
    no joint moves, and free objects, are left out. Raises `ConfigurationError` for what MuJoCo does not compile.
    """
    file = read_mjcf_file(path, root)
    try:
        model = mujoco.MjModel.from_xml_string(file.text(), file.assets)
    except (ValueError, mujoco.FatalError) as error:
        lines = [line for line in str(error).splitlines() if line.strip()] or ["without a reason"]
        raise Elements(path).error(f"MuJoCo does not compile it: {' '.join(lines)[:300]}") from error
    reader = _Reader(model, file.root.get("model") or path.stem, tip)
    reader.result.notes[:0] = file.notes
    return reader.result


class _Reader:
    """Builds a robot from a compiled model."""

    def __init__(self, model: Any, name: str, tip: str | None) -> None:
        self.model = model
        self.result = MjcfRobot(Element("robot", {"name": name}))
        self.names = _unique(model, mujoco.mjtObj.mjOBJ_BODY, "body", model.nbody, [WORLD])
        self.joint_names = _unique(model, mujoco.mjtObj.mjOBJ_JOINT, "joint", model.njnt, [])
        moving = {int(model.body_rootid[model.jnt_bodyid[j]]) for j in range(model.njnt) if self._kind(j) != "free"}
        if tip in self.names[1:]:
            moving.add(int(model.body_rootid[self.names.index(tip)]))
        self.bodies = [b for b in range(1, model.nbody) if int(model.body_rootid[b]) in moving]
        SubElement(self.result.robot, "link", {"name": WORLD})
        for body in self.bodies:
            self._add_link(body)
            self._add_joint(body)
        self._add_sites(tip)
        self._add_shapes()
        self._read_home()
        for i in range(model.nexclude):
            pair = divmod(int(model.exclude_signature[i]), 1 << 16)
            self.result.apart.add(frozenset(self.names[body] for body in pair))
        others = [name for b, name in enumerate(self.names) if b and b not in self.bodies]
        if others:
            self.result.notes.append(f"Bodies that no joint moves are not part of the arm: {', '.join(others[:12])}.")

    def _kind(self, joint: int) -> str:
        return KINDS.get(int(self.model.jnt_type[joint]), "free")

    def _joint_of(self, body: int) -> int | None:
        """Return the joint that moves a body against its parent, if it has one; the first of several."""
        first = int(self.model.body_jntadr[body])
        return None if first < 0 or self._kind(first) == "free" else first

    def _anchor(self, body: int) -> Array:
        """Return the place of a link's frame in its body's, (3,) m."""
        joint = self._joint_of(body) if body else None
        return np.zeros(3) if joint is None else np.array(self.model.jnt_pos[joint])

    def _placed(self, body: int, position: Array, quaternion: Array) -> pinocchio.SE3:
        """Return a placement in a body's frame as one in its link's."""
        return _placement(position - self._anchor(body), quaternion)

    def _add_link(self, body: int) -> None:
        model, link = self.model, SubElement(self.result.robot, "link", {"name": self.names[body]})
        if model.body_mass[body] > 0:
            inertial = SubElement(link, "inertial")
            placement = self._placed(body, model.body_ipos[body], model.body_iquat[body])
            matrix = placement.rotation @ np.diag(model.body_inertia[body]) @ placement.rotation.T
            _add_origin(inertial, pinocchio.SE3(np.eye(3), placement.translation))
            SubElement(inertial, "mass", {"value": repr(float(model.body_mass[body]))})
            entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(matrix[i, j])) for i in range(3) for j in range(i, 3)}
            SubElement(inertial, "inertia", entries)

    def _add_joint(self, body: int) -> None:
        model, joint, parent = self.model, self._joint_of(body), int(self.model.body_parentid[body])
        name = f"{self.names[body]}_fixed" if joint is None else self.joint_names[joint]
        kind = "fixed" if joint is None else self._kind(joint)
        if joint is not None and model.body_jntnum[body] > 1:
            kind = f"one of {model.body_jntnum[body]} joints of one body"
        placement = self._placed(parent, model.body_pos[body], model.body_quat[body])
        placement = placement * pinocchio.SE3(np.eye(3), self._anchor(body))
        element = SubElement(self.result.robot, "joint", {"name": name, "type": kind})
        SubElement(element, "parent", {"link": self.names[parent]})
        SubElement(element, "child", {"link": self.names[body]})
        if joint is not None:
            axis, reference = np.array(model.jnt_axis[joint]), float(model.qpos0[model.jnt_qposadr[joint]])
            if kind == "revolute":
                back = pinocchio.SE3(pinocchio.AngleAxis(-reference, axis).matrix(), np.zeros(3))
            else:
                back = pinocchio.SE3(np.eye(3), -reference * axis)
            placement = placement * back if kind in ("revolute", "prismatic") else placement
            SubElement(element, "axis", {"xyz": _words(axis)})
            self._add_limits(element, joint, kind)
        _add_origin(element, placement)

    def _add_limits(self, element: Element, joint: int, kind: str) -> None:
        model, limits = self.model, {}
        if model.jnt_limited[joint]:
            limits = {name: repr(float(x)) for name, x in zip(("lower", "upper"), model.jnt_range[joint], strict=True)}
        elif kind == "revolute":
            element.set("type", "continuous")
        velocity, effort = self._motor_limits(joint)
        SubElement(element, "limit", {**limits, "velocity": repr(velocity), "effort": repr(effort)})
        dof = int(model.jnt_dofadr[joint])
        resistance = {"damping": model.dof_damping[dof], "friction": model.dof_frictionloss[dof]}
        SubElement(element, "dynamics", {name: repr(float(value)) for name, value in resistance.items()})
        self.result.armature[self.joint_names[joint]] = float(model.dof_armature[dof])

    def _motor_limits(self, joint: int) -> tuple[float, float]:
        """Return the largest velocity and effort of a joint's actuators; 0 where they have no limit."""
        model, velocity, efforts = self.model, 0.0, []
        for a in range(model.nu):
            if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_JOINT or model.actuator_trnid[a, 0] != joint:
                continue
            gear, bias = abs(float(model.actuator_gear[a, 0])), model.actuator_biasprm[a]
            command = float(np.abs(model.actuator_ctrlrange[a]).min()) if model.actuator_ctrllimited[a] else 0.0
            is_motor = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
            if model.actuator_forcelimited[a]:
                efforts.append(gear * float(np.abs(model.actuator_forcerange[a]).min()))
            elif is_motor and command:
                efforts.append(gear * abs(float(model.actuator_gainprm[a, 0])) * command)
            if not is_motor and bias[1] == 0 and bias[2] < 0 and command:
                velocity = command / gear
        effort = sum(efforts)
        if model.jnt_actfrclimited[joint]:
            largest = float(np.abs(model.jnt_actfrcrange[joint]).min())
            effort = min(effort, largest) if effort else largest
        return velocity, effort

    def _add_sites(self, tip: str | None) -> None:
        """Add sites that may be the end-effector as links."""
        model = self.model
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, i) or "" for i in range(model.nsite)]
        likely = {tip, *usual_tips(names)}
        for i, name in enumerate(names):
            body = int(model.site_bodyid[i])
            if name not in likely or body not in self.bodies or name in self.names:
                continue
            SubElement(self.result.robot, "link", {"name": name})
            element = SubElement(self.result.robot, "joint", {"name": f"{name}_fixed", "type": "fixed"})
            _add_origin(element, self._placed(body, model.site_pos[i], model.site_quat[i]))
            SubElement(element, "parent", {"link": self.names[body]})
            SubElement(element, "child", {"link": name})

    def _add_shapes(self) -> None:
        model, result = self.model, self.result
        collide = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        bodies = np.isin(model.geom_bodyid, self.bodies)
        if not (collide & bodies).any():
            collide[:] = True
            result.notes.append("The file has no geoms that collide: those that are drawn do.")
        for geom in np.flatnonzero(bodies):
            shape = self._shape(int(geom))
            if shape is None:
                continue
            if collide[geom]:
                result.collisions.setdefault(shape.link, []).append(shape)
            if model.geom_group[geom] < DRAWN_GROUPS:
                result.drawings.setdefault(shape.link, []).append(shape)

    def _shape(self, geom: int) -> Shape | None:
        """Return a geom in its link's frame; None for one without an end."""
        model, triangles = self.model, np.empty((0, 3), dtype=np.int32)
        if model.geom_type[geom] == GEOM.mjGEOM_MESH:
            vertices, triangles = _mesh(model, int(model.geom_dataid[geom]))
        else:
            vertices = _primitive(int(model.geom_type[geom]), np.array(model.geom_size[geom]))
        if not len(vertices):
            return None
        body, material = int(model.geom_bodyid[geom]), int(model.geom_matid[geom])
        placement = self._placed(body, model.geom_pos[geom], model.geom_quat[geom])
        colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        vertices = vertices @ placement.rotation.T + placement.translation
        return Shape(self.names[body], vertices, triangles, tuple(float(x) for x in colour))

    def _read_home(self) -> None:
        model = self.model
        keys = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_KEY, i) for i in range(model.nkey)]
        if keys:
            qpos = model.key_qpos[keys.index("home") if "home" in keys else 0]
            self.result.home = {name: float(qpos[model.jnt_qposadr[j]]) for j, name in enumerate(self.joint_names)}


def _unique(model: Any, kind: Any, word: str, count: int, first: list[str]) -> list[str]:
    """Return the names of a model's objects, with numbers for those without."""
    names = [mujoco.mj_id2name(model, kind, i) or f"{word}_{i}" for i in range(len(first), count)]
    return [*first, *(name if name not in first else f"{name}_{word}" for name in names)]


def _placement(position: Array, quaternion: Array) -> pinocchio.SE3:
    w, x, y, z = (float(number) for number in quaternion)
    return pinocchio.SE3(pinocchio.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def _add_origin(element: Element, placement: pinocchio.SE3) -> None:
    angles = pinocchio.rpy.matrixToRpy(placement.rotation)
    SubElement(element, "origin", {"xyz": _words(placement.translation), "rpy": _words(angles)})


def _words(vector: Array) -> str:
    return " ".join(repr(float(number)) for number in vector)


def _mesh(model: Any, mesh: int) -> tuple[Array, NDArray[np.int32]]:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertices = np.array(model.mesh_vert[first : first + count], dtype=float)
    return vertices, np.array(model.mesh_face[face : face + faces], dtype=np.int32)


def _primitive(kind: int, size: Array) -> Array:
    """Return points that enclose a geom, (k, 3) m in its frame; none of one without an end."""
    if kind == GEOM.mjGEOM_BOX:
        return np.array(list(product((-1, 1), repeat=3))) * size
    if kind == GEOM.mjGEOM_ELLIPSOID:
        return round_points("sphere", 1.0, 0.0) * size
    shape = ROUND.get(kind)
    if shape is not None:
        return round_points(shape, size[0], size[1])
    return np.empty((0, 3))
