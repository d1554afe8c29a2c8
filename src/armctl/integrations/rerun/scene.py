"""A MuJoCo world in Rerun: its visible geoms and sites as shapes that move, and its contacts as points and forces."""

from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import blueprint as rrb

from armctl.core.arrays import Array
from armctl.simulation import Simulation

NUM_VISIBLE_GROUPS = 3
"""MuJoCo's viewers show the groups below it."""
INFINITE = 10.0
"""m: half the side of a plane without an end."""
THICKNESS = 1e-3
"""m: half that of a plane."""
FORCE_SCALE = 2e-3
"""m of an arrow for each N."""
CONTACT_RADIUS = 0.01
"""m."""
FORCE_COLOUR = (230, 40, 40)


class RerunScene:
    """Logs the first world of a simulation under `world/`: bodies, and in each its geoms and sites."""

    def __init__(self, stream: rr.RecordingStream, simulation: Simulation) -> None:
        self._stream, self._simulation = stream, simulation
        self._poses: dict[str, Array] = {}
        model = simulation.model
        self._shapes = [
            (kind, int(i))
            for kind, groups in (("geom", model.geom_group), ("site", model.site_group))
            for i in np.flatnonzero(groups < NUM_VISIBLE_GROUPS)
        ]
        self._bodies = sorted({int(getattr(model, f"{kind}_bodyid")[i]) for kind, i in self._shapes})
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def log(self, shapes: bool) -> None:
        """Log the present state; with `shapes`, which may differ between episodes, also these."""
        model, data = self._simulation.model, self._simulation.data(0)
        for kind, i in self._shapes if shapes else ():
            if (shape := _shape(model, kind, i)) is not None:
                turn = getattr(model, f"{kind}_quat")[i]
                pose = rr.Transform3D(translation=getattr(model, f"{kind}_pos")[i], quaternion=np.roll(turn, -1))
                name = getattr(model, kind)(i).name or f"{kind}_{i}"
                self._stream.log(f"{_path(model, getattr(model, f'{kind}_bodyid')[i])}/{_level(name)}", shape, pose)
        for body in self._bodies:
            self._move(_path(model, body), data.xpos[body], data.xmat[body].reshape(3, 3))
        self._log_contacts(model, data)

    def eye(self, camera: str) -> Any:
        """Return an eye at the MJCF's camera, which looks at the robot."""
        data = self._simulation.data(0)
        robot = self._simulation.model.body_weldid > 0
        ahead, position = -data.camera(camera).xmat.reshape(3, 3)[:, 2], data.camera(camera).xpos
        distance = float(ahead @ (data.xpos[robot].mean(axis=0) - position))
        return rrb.EyeControls3D(position=position, look_target=position + distance * ahead, eye_up=(0.0, 0.0, 1.0))

    def _move(self, path: str, position: Array, rotation: Array) -> None:
        pose = np.column_stack((rotation, position))
        if path not in self._poses or not np.array_equal(self._poses[path], pose):
            self._poses[path] = pose
            self._stream.log(path, rr.Transform3D(translation=position, mat3x3=rotation))

    def _log_contacts(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        forces = np.zeros((data.ncon, 6))
        for i, force in enumerate(forces):
            mujoco.mj_contactForce(model, data, i, force)
        frames = data.contact.frame.reshape(-1, 3, 3)
        # MuJoCo's force is the one on the second geom; shown is the one on what can move
        second = model.body_weldid[model.geom_bodyid[data.contact.geom[:, 1]]]
        signs = np.where(model.body_dofnum[second] > 0, 1.0, -1.0)
        vectors = FORCE_SCALE * signs[:, None] * np.einsum("nij,ni->nj", frames, forces[:, :3])
        points = data.contact.pos
        self._stream.log("world/contacts", rr.Points3D(points, radii=CONTACT_RADIUS, colors=[FORCE_COLOUR]))
        self._stream.log("world/contacts/forces", rr.Arrows3D(vectors=vectors, origins=points, colors=[FORCE_COLOUR]))
        self._stream.log("contact_force", rr.Scalars(np.linalg.norm(forces[:, :3], axis=1).sum()))


def _path(model: mujoco.MjModel, body: int) -> str:
    """Return the path under which a body is logged."""
    return f"world/{_level(model.body(body).name or f'body_{body}')}"


def _level(name: str) -> str:
    """Return a name as one level of a path: the pose of `rover` must not move `rover/wheel`, which has its own."""
    return name.replace("/", ".")


def _shape(model: mujoco.MjModel, kind: str, i: int) -> Any:
    """Return a geom or site as Rerun's archetype, in its own frame; None if it is invisible, or of another kind."""
    material = getattr(model, f"{kind}_matid")[i]
    rgba = _colour(model, material) if material >= 0 else getattr(model, f"{kind}_rgba")[i]
    if rgba[3] == 0:
        return None
    size = getattr(model, f"{kind}_size")[i]
    style: dict[str, Any] = {"colors": [rgba], "fill_mode": "solid"}
    match mujoco.mjtGeom(int(getattr(model, f"{kind}_type")[i])).name:
        case "mjGEOM_PLANE":
            sides = np.where(size[:2] > 0, size[:2], INFINITE)
            return rr.Boxes3D(half_sizes=[[*sides, THICKNESS]], centers=[[0, 0, -THICKNESS]], **style)
        case "mjGEOM_BOX":
            return rr.Boxes3D(half_sizes=[size], **style)
        case "mjGEOM_SPHERE":
            return rr.Ellipsoids3D(half_sizes=[size[[0, 0, 0]]], **style)
        case "mjGEOM_ELLIPSOID":
            return rr.Ellipsoids3D(half_sizes=[size], **style)
        case "mjGEOM_CYLINDER":
            return rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], **style)
        case "mjGEOM_CAPSULE":
            return rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[[0, 0, -size[1]]], **style)
        case "mjGEOM_MESH":
            return _mesh(model, int(model.geom_dataid[i]), rgba)
    return None


def _colour(model: mujoco.MjModel, material: int) -> NDArray[np.float32]:
    """RGBA of a material, with the mean of its texture, if it has one."""
    rgba: NDArray[np.float32] = model.mat_rgba[material].copy()
    texture = model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
    if texture >= 0:
        channels = int(model.tex_nchannel[texture])
        size = int(model.tex_height[texture] * model.tex_width[texture]) * channels
        texels = model.tex_data[model.tex_adr[texture] :][:size].reshape(-1, channels)
        rgba[: min(channels, 3)] *= texels.mean(axis=0)[:3] / 255
    return rgba


def _mesh(model: mujoco.MjModel, mesh: int, rgba: NDArray[np.float32]) -> rr.Mesh3D:
    corners = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    triangles = model.mesh_vert[corners][model.mesh_face[faces]]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    # Corners are not shared between faces, so that edges look sharp
    return rr.Mesh3D(
        vertex_positions=triangles.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=rgba
    )
