"""The geoms of a model as convex shapes that `armctl.kernels.rays` knows."""

from collections.abc import Iterable

import mujoco
import numpy as np

from armctl.core.arrays import Array
from armctl.kernels import rays

KINDS = {
    mujoco.mjtGeom.mjGEOM_PLANE: rays.PLANE,
    mujoco.mjtGeom.mjGEOM_SPHERE: rays.SPHERE,
    mujoco.mjtGeom.mjGEOM_CYLINDER: rays.CYLINDER,
    mujoco.mjtGeom.mjGEOM_CAPSULE: rays.CAPSULE,
    mujoco.mjtGeom.mjGEOM_BOX: rays.BOX,
    mujoco.mjtGeom.mjGEOM_MESH: rays.POLYTOPE,
}
FLAT = 1e-6
"""m: a mesh is convex if no vertex is farther than this beyond the plane of any of its faces."""


def ray_shapes(model: mujoco.MjModel, geoms: Iterable[int]) -> rays.Shapes | None:
    """Return geoms as shapes; None if there is one of another kind, or a mesh that is not convex."""
    shapes, faces, spans = [], [np.zeros((0, 4))], {}
    for geom in geoms:
        kind = KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
        mesh = int(model.geom_dataid[geom]) if kind == rays.POLYTOPE else -1
        if mesh >= 0 and mesh not in spans:
            planes = _planes(model, mesh)
            first = sum(map(len, faces))
            spans[mesh] = None if planes is None else (first, first + len(planes))
            faces.append(np.zeros((0, 4)) if planes is None else planes)
        span = spans.get(mesh, (0, 0))
        if kind is None or span is None:
            return None
        shapes.append((kind, geom, *span))
    return rays.Shapes(np.array(shapes, dtype=np.int64).reshape(-1, 4), np.concatenate(faces))


def _planes(model: mujoco.MjModel, mesh: int) -> Array | None:
    """Return outward normals and offsets (k, 4) of a convex mesh's faces."""
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
    triangles = vertices[model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (normals * triangles[:, 0]).sum(axis=1)
    if (vertices @ normals.T > offsets + FLAT).any():
        return None
    return np.unique(np.column_stack((normals, offsets)).round(9), axis=0)
