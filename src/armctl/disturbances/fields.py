"""Disturbances of the simulated robot itself. The models of the controllers do not change."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.disturbances.disturbance import Disturbable, Disturbance
from armctl.robots.arm import PREFIX as ARM
from armctl.robots.rover import PREFIX as ROVER
from armctl.robots.rover import WHEELS

PAYLOAD_RADIUS = 0.05
"""m; the payload is a ball."""
STIFF = 0.999
"""Constraint impedance of dry friction: with MuJoCo's default of 0.9, light joints creep."""


class FieldDisturbance(Disturbance):
    """Changes entries of fields of the simulation's model in `apply`, from what they are then.

    `entries` are the changed entries (k,) of each field. They are applied once, and again in each episode if the
    levels are drawn, or if the changes themselves are (`random`).
    """

    per_episode = True
    random: ClassVar[bool] = False

    def __init__(self, task: Disturbable, level: float, entries: Mapping[str, Sequence[int]]) -> None:
        super().__init__(task, level)
        self.fields = {name: task.simulation.per_world(name) for name in entries}
        self._undisturbed = {name: (chosen, self.fields[name][:, chosen].copy()) for name, chosen in entries.items()}
        if not self.random:
            self.apply(self.worlds)

    @property
    def renewed(self) -> bool:  # type: ignore[override]
        """True if `apply` has to be called again in each episode."""
        return self.random or self.drawn_from is not None

    def undo(self, ids: NDArray[np.int32]) -> None:
        """Restore the undisturbed entries."""
        for name, (chosen, undisturbed) in self._undisturbed.items():
            self.fields[name][ids[:, None], chosen] = undisturbed[ids]


class Payload(FieldDisturbance):
    """Attaches a ball of `level` kg to the task's `payload_body`, at `offset` (m), without gravity compensation."""

    def __init__(self, task: Disturbable, level: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self._body = task.simulation.model.body(task.payload_body).id
        self._offset = np.array(offset)
        names = ("mass", "ipos", "iquat", "inertia", "sameframe", "gravcomp")
        super().__init__(task, level, {f"body_{name}": [self._body] for name in names})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Attach the balls."""
        for i in ids:
            self._attach({name: values[i, self._body : self._body + 1] for name, values in self.fields.items()}, i)
        self.task.simulation.derive(ids)

    def _attach(self, body: dict[str, NDArray[Any]], world: int) -> None:
        mass, centre, moments = (body[f"body_{name}"][0] for name in ("mass", "ipos", "inertia"))
        rotation, quaternion = np.zeros(9), body["body_iquat"][0].copy()
        mujoco.mju_quat2Mat(rotation, quaternion)
        axes = rotation.reshape(3, 3)
        inertia = pinocchio.Inertia(float(mass), centre, axes @ np.diag(moments) @ axes.T)
        ball = pinocchio.Inertia.FromSphere(self.levels[world], PAYLOAD_RADIUS)
        total = inertia + ball.se3Action(pinocchio.SE3(np.eye(3), self._offset))
        principal, vectors = np.linalg.eigh(total.inertia)
        vectors[:, 2] *= np.sign(np.linalg.det(vectors))
        mujoco.mju_mat2Quat(quaternion, vectors.ravel())
        body["body_gravcomp"][0] = body["body_gravcomp"][0] * mass / total.mass
        body["body_mass"][0], body["body_ipos"][0] = total.mass, total.lever
        body["body_iquat"][0], body["body_inertia"][0] = quaternion, principal
        body["body_sameframe"][0] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


class JointFriction(FieldDisturbance):
    """Dry friction in each joint: the share `level` of its torque limit."""

    def __init__(self, task: Disturbable, level: float) -> None:
        assert task.joints is not None
        self._dofs = task.joints.part.dofs.tolist()
        super().__init__(task, level, {"dof_frictionloss": self._dofs, "dof_solimp": self._dofs})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Set the friction."""
        assert self.task.joints is not None
        friction = self.levels[ids, None] * self.task.joints.limits.torque
        self.fields["dof_frictionloss"][ids[:, None], self._dofs] = friction
        self.fields["dof_solimp"][ids[:, None], self._dofs, :2] = STIFF


class Slipperiness(FieldDisturbance):
    """Scales the friction of the tyres by `level`."""

    def __init__(self, task: Disturbable, level: float) -> None:
        self._tyres = [task.simulation.model.geom(ROVER + wheel).id for wheel in WHEELS]
        super().__init__(task, level, {"geom_friction": self._tyres})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Scale the friction."""
        self.fields["geom_friction"][ids[:, None], self._tyres, 0] *= self.levels[ids, None]


class Strength(FieldDisturbance):
    """Scales the motors' torque and torque limits by `level`, including gravity compensation."""

    def __init__(self, task: Disturbable, level: float) -> None:
        simulation, names = task.simulation, (
            "actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange", "body_gravcomp",
        )  # fmt: skip
        super().__init__(task, level, {name: range(simulation.per_world(name).shape[1]) for name in names})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Scale the motors."""
        for values in self.fields.values():
            values[ids] *= self.levels[ids].reshape(-1, *[1] * (values.ndim - 1))
        self.task.simulation.derive(ids)


class LinkMismatch(FieldDisturbance):
    """Scales each link's mass and length by random factors from 1 - `level` to 1 + `level`, new in each episode.

    The first joint stays where it is mounted: lower down, some arms would stand in the floor. The drives compensate for
    the weight of the nominal links.
    """

    random = True

    def __init__(self, task: Disturbable, level: float) -> None:
        model = task.simulation.model
        self._links = [i for i in range(model.nbody) if model.body(i).name.startswith(ARM)]
        self._mounted = np.array(self._links) <= min(model.jnt_bodyid)
        super().__init__(task, level, {f"body_{name}": self._links for name in ("mass", "inertia", "gravcomp", "pos")})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Sample the arms of worlds `ids`."""
        factors = np.array([self.rngs[i].uniform(-1.0, 1.0, (2, len(self._links))) for i in ids])
        heavier, longer = 1 + self.levels[ids, None] * factors.transpose(1, 0, 2)
        chosen = ids[:, None], self._links
        self.fields["body_mass"][chosen] *= heavier
        self.fields["body_inertia"][chosen] *= heavier[..., None]
        self.fields["body_gravcomp"][chosen] /= heavier
        self.fields["body_pos"][chosen] *= np.where(self._mounted, 1.0, longer)[..., None]
        self.task.simulation.derive(ids)


class WheelMismatch(FieldDisturbance):
    """Scales each wheel's radius and the rover's mass by random factors from 1 - `level` to 1 + `level`."""

    random = True

    def __init__(self, task: Disturbable, level: float) -> None:
        model = task.simulation.model
        self._base = model.body(task.payload_body).id
        self._wheels = [model.geom(ROVER + wheel).id for wheel in WHEELS]
        self._radius, self._half_width = model.geom_size[self._wheels[0], :2]
        entries = {f"geom_{name}": self._wheels for name in ("size", "aabb", "rbound")}
        super().__init__(task, level, entries | {f"body_{name}": [self._base] for name in ("mass", "inertia")})

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Sample the rovers of worlds `ids`."""
        factors = np.array([self.rngs[i].uniform(-1.0, 1.0, 1 + len(WHEELS)) for i in ids])
        factors = 1 + self.levels[ids, None] * factors
        rows, radii = ids[:, None], factors[:, 1:] * self._radius
        self.fields["geom_size"][rows, self._wheels, 0] = radii
        self.fields["geom_aabb"][rows[..., None], np.array(self._wheels)[:, None], [3, 4]] = radii[..., None]
        self.fields["geom_rbound"][rows, self._wheels] = np.hypot(radii, self._half_width)
        self.fields["body_mass"][ids, self._base] *= factors[:, 0]
        self.fields["body_inertia"][ids, self._base] *= factors[:, :1]
        self.task.simulation.derive(ids)
