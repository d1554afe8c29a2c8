"""An arm's capsules, the floor and boxes in MuJoCo, which shares no collision code with armctl's models."""

import mujoco
import numpy as np

from armctl.robot_description.collision_pairs import FLOOR, link_frame

FAR = 0.1
"""m from which on distances are not measured."""


class CapsuleWorld:
    def __init__(self, model, boxes):
        head, tail = model.description.urdf.split(">", 1)
        options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
        spec = mujoco.MjSpec.from_string(f"{head}>{options}{tail}")
        quiet = {"contype": 0, "conaffinity": 0}
        spec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **quiet)
        pairs, on_joint = [], lambda link: model.pinocchio.frames[link_frame(model.pinocchio, link)].parentJoint
        for first, second in model.description.collision_pairs:
            # A shoulder's near end is always a hair above the floor, which would hide all other distances.
            far_end = second == FLOOR and on_joint(first) == 2
            pairs.append((f"{first} (far end)" if far_end else first, second))
        for i in range(len(boxes)):
            turn = np.empty(4)
            mujoco.mju_mat2Quat(turn, boxes.rotations[i].ravel())
            spec.worldbody.add_geom(
                name=f"box {i}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=boxes.centres[i], quat=turn,
                size=boxes.half_sizes[i], **quiet,
            )  # fmt: skip
        for capsule in model.description.capsules:
            round_, ends = np.allclose(capsule.start, capsule.end, atol=1e-9), [*capsule.start, *capsule.end]
            shape = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "pos": capsule.start}
            if not round_:
                shape = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "fromto": ends}
            body = spec.body(capsule.link) or spec.worldbody
            body.add_geom(name=capsule.link, size=[capsule.radius, 0, 0], mass=0, **shape, **quiet)
            end = max(capsule.start, capsule.end, key=np.linalg.norm)
            ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "pos": end, "size": [capsule.radius, 0, 0]}
            body.add_geom(name=f"{capsule.link} (far end)", mass=0, **ball, **quiet)
            if on_joint(capsule.link) > 0:
                pairs += [(capsule.link, f"box {i}") for i in range(len(boxes))]
        for first, second in pairs:
            spec.add_pair(geomname1=first, geomname2=second, margin=FAR)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._arm = [self._model.geom(capsule.link).id for capsule in model.description.capsules]

    def distance(self, q):
        """Least signed distance (m) between all that may touch, at most `FAR`."""
        return self._contacts(q).dist.min(initial=FAR)

    def outer_distance(self, q):
        """The same without what the arm has from itself."""
        contacts = self._contacts(q)
        return contacts.dist[~np.isin(contacts.geom, self._arm).all(axis=-1)].min(initial=FAR)

    def _contacts(self, q):
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return self._data.contact
