"""Contents of a viewer of one world: a copy of its model, its state, and decoration.

A viewer loads a model once. Boxes, barriers and people have positions in the model that differ between episodes. They
are hidden in the viewer's copy, and drawn as decoration.
"""

import copy
import itertools

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.simulation.simulation import Simulation

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
MAX_GEOMS = 2000
UNSEEN_GROUP = 5
"""A geom group that viewers hide by default."""
IN_WORLD = np.eye(3)
MAX_POINTS = 64
"""Limit on the points of a line; longer ones are thinned out."""


class Scenery:
    """Contents of one world of `simulation`, at first from the MJCF's `camera`."""

    def __init__(self, simulation: Simulation, camera: str, world: int = 0) -> None:
        self.simulation, self._world = simulation, world
        """What is shown; it can be changed for another simulation of the same model."""
        model = simulation.model
        robots = np.isin(model.body_rootid, model.body_rootid[model.body_weldid > 0])
        placed = simulation.worlds_differ & ~robots & (np.arange(model.nbody) > 0)
        self._placed = set(np.flatnonzero(placed[model.geom_bodyid]).tolist())
        self.model = copy.deepcopy(model)
        self.model.geom_group[list(self._placed)] = UNSEEN_GROUP
        self._scene = mujoco.MjvScene(model, maxgeom=MAX_GEOMS)
        self._options = mujoco.MjvOption()
        self._options.flags[mujoco.mjtVisFlag.mjVIS_CONTACTPOINT] = 1
        self._look_from(camera)

    def snapshot(self) -> tuple[Array, list[mujoco.MjvGeom]]:
        """Return the world's state, for `mj_setState` with `STATE`, and the geoms to draw besides `model`."""
        model, data = self.simulation.model, self.simulation.data(self._world)
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        everything, anywhere = mujoco.mjtCatBit.mjCAT_ALL, mujoco.MjvCamera()
        mujoco.mjv_updateScene(model, data, self._options, None, anywhere, everything, self._scene)
        geoms = self._scene.geoms[: self._scene.ngeom]
        missing = [copy.copy(geom) for geom in geoms if self._is_missing(geom)]
        return state, [part for geom in missing for part in _without_mesh(model, data, geom)]

    def _is_missing(self, geom: mujoco.MjvGeom) -> bool:
        """Return True if a viewer with `model` and the state would not show it."""
        decoration = geom.category == mujoco.mjtCatBit.mjCAT_DECOR
        return decoration or (geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in self._placed)

    def _look_from(self, camera: str) -> None:
        """Place the viewer's free camera at the MJCF's, orbiting the point of its axis nearest to the robot."""
        data = self.simulation.data(self._world)
        robot = self.model.body_weldid > 0
        ahead = -data.camera(camera).xmat.reshape(3, 3)[:, 2]
        position = data.camera(camera).xpos
        distance = float(ahead @ (data.xpos[robot].mean(axis=0) - position))
        self.model.stat.center[:] = position + distance * ahead
        self.model.stat.extent = distance / 1.5  # the free camera starts at 1.5 extents from the centre
        view = self.model.vis.global_
        view.azimuth, view.elevation = np.degrees((np.arctan2(ahead[1], ahead[0]), np.arcsin(ahead[2])))
        view.fovy = self.model.camera(camera).fovy[0]


def _without_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: mujoco.MjvGeom) -> list[mujoco.MjvGeom]:
    """Return the geom; a mesh as boxes between the levels of its corners: browsers cannot draw decorative meshes."""
    if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
        return [geom]
    mesh, body = model.geom_dataid[geom.objid], model.geom_bodyid[geom.objid]
    first = model.mesh_vertadr[mesh]
    corners = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    corners = corners @ data.geom_xmat[geom.objid].reshape(3, 3).T + data.geom_xpos[geom.objid]
    turn = data.xmat[body].reshape(3, 3)
    corners = (corners - data.xpos[body]) @ turn
    heights = corners[:, 2].round(3)
    levels = [corners[heights == height] for height in np.unique(heights)]
    boxes = []
    for lower, upper in itertools.pairwise(levels):
        low, high = ((lower.min(axis=0) + upper.min(axis=0)) / 2, (lower.max(axis=0) + upper.max(axis=0)) / 2)
        low[2], high[2] = lower[0, 2], upper[0, 2]
        centre = data.xpos[body] + turn @ (low + high) / 2
        boxes.append(_decoration(mujoco.mjtGeom.mjGEOM_BOX, (high - low) / 2, centre, geom.rgba, turn))
    return boxes


def polyline(points: ArrayLike, radius: float, rgba: ArrayLike, beads: bool = False) -> list[mujoco.MjvGeom]:
    """Return decoration along points (m, 3) m: a line of capsules, with `beads` at the points on demand."""
    corners = np.asarray(points, dtype=float)
    corners = corners[np.unique(np.linspace(0, len(corners) - 1, min(len(corners), MAX_POINTS)).round().astype(int))]
    lines = []
    for start, end in itertools.pairwise(corners):
        lines.append(_decoration(mujoco.mjtGeom.mjGEOM_CAPSULE, [radius] * 3, start, rgba))
        mujoco.mjv_connector(lines[-1], mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    return lines + [_decoration(sphere, [2 * radius] * 3, corner, rgba) for corner in corners if beads]


def _decoration(
    kind: mujoco.mjtGeom, size: ArrayLike, position: Array, rgba: ArrayLike, turn: ArrayLike = IN_WORLD
) -> mujoco.MjvGeom:
    geom = mujoco.MjvGeom()
    sizes, rotation = np.asarray(size, dtype=float), np.ravel(turn).astype(float)
    mujoco.mjv_initGeom(geom, kind, sizes, position, rotation, np.asarray(rgba, dtype=np.float32))
    return geom
