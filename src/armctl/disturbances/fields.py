"""Disturbances of the simulated robot itself. The models of the controllers do not change."""

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


class Payload(Disturbance):
    """Attaches a ball of `level` kg to the task's `payload_body`, at `offset` (m), without gravity compensation."""

    def __init__(self, task: Disturbable, level: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        super().__init__(task, level)
        simulation, model = task.simulation, task.simulation.model
        body = model.body(task.payload_body).id
        mass, centre, quaternion, moments = (
            np.array(getattr(model, f"body_{name}")[body]) for name in ("mass", "ipos", "iquat", "inertia")
        )
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, quaternion)
        axes = rotation.reshape(3, 3)
        own = pinocchio.Inertia(float(mass), centre, axes @ np.diag(moments) @ axes.T)
        ball = pinocchio.Inertia.FromSphere(level, PAYLOAD_RADIUS).se3Action(pinocchio.SE3(np.eye(3), np.array(offset)))
        total = own + ball
        principal, vectors = np.linalg.eigh(total.inertia)
        vectors[:, 2] *= np.sign(np.linalg.det(vectors))
        mujoco.mju_mat2Quat(quaternion, vectors.ravel())
        for name, value in (
            ("mass", total.mass), ("ipos", total.lever), ("iquat", quaternion), ("inertia", principal),
            ("sameframe", int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)),
            ("gravcomp", model.body_gravcomp[body] * mass / total.mass),
        ):  # fmt: skip
            simulation.per_world(f"body_{name}")[:, body] = value
        simulation.derive()


class JointFriction(Disturbance):
    """Dry friction in each joint: the share `level` of its torque limit."""

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        assert task.joints is not None
        task.simulation.per_world("dof_frictionloss")[:] = level * task.joints.limits.torque
        task.simulation.per_world("dof_solimp")[..., :2] = STIFF


class Slipperiness(Disturbance):
    """Scales the friction of the tyres by `level`."""

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        tyres = [task.simulation.model.geom(ROVER + wheel).id for wheel in WHEELS]
        task.simulation.per_world("geom_friction")[:, tyres, 0] *= level


class Strength(Disturbance):
    """Scales the motors' torque and torque limits by `level`, including gravity compensation."""

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        for field in (
            "actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange", "body_gravcomp",
        ):  # fmt: skip
            task.simulation.per_world(field)[:] *= level
        task.simulation.derive()


class LinkMismatch(Disturbance):
    """Scales each link's mass and length by random factors from 1 - `level` to 1 + `level`, new in each episode.

    The first joint stays where it is mounted: lower down, some arms would stand in the floor. The drives compensate for
    the weight of the nominal links.
    """

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        model, simulation = task.simulation.model, task.simulation
        self._links = [i for i in range(model.nbody) if model.body(i).name.startswith(ARM)]
        self._mounted = np.array(self._links) <= min(model.jnt_bodyid)
        self._masses, self._inertias, self._held, self._places = (
            simulation.per_world(f"body_{name}") for name in ("mass", "inertia", "gravcomp", "pos")
        )
        self._nominal = [
            values[0, self._links].copy() for values in (self._masses, self._inertias, self._held, self._places)
        ]

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample the arms of worlds `ids`."""
        mass, inertia, held, place = self._nominal
        factors = np.array([self.rngs[i].uniform(-1.0, 1.0, (2, len(self._links))) for i in ids])
        heavier, longer = 1 + self.level * factors.transpose(1, 0, 2)
        rows = ids[:, None]
        self._masses[rows, self._links] = heavier * mass
        self._inertias[rows, self._links] = heavier[..., None] * inertia
        self._held[rows, self._links] = held / heavier
        self._places[rows, self._links] = np.where(self._mounted, 1.0, longer)[..., None] * place
        self.task.simulation.derive(ids)


class WheelMismatch(Disturbance):
    """Scales each wheel's radius and the rover's mass by random factors from 1 - `level` to 1 + `level`."""

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        model, simulation = task.simulation.model, task.simulation
        self._base = model.body(task.payload_body).id
        self._wheels = [model.geom(ROVER + wheel).id for wheel in WHEELS]
        self._sizes, self._bounds, self._reach = (
            simulation.per_world(f"geom_{name}") for name in ("size", "aabb", "rbound")
        )
        self._masses, self._inertias = (simulation.per_world(f"body_{name}") for name in ("mass", "inertia"))
        self._nominal = self._masses[0, self._base], self._inertias[0, self._base].copy()
        self._radius, self._half_width = model.geom_size[self._wheels[0], :2]

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample the rovers of worlds `ids`."""
        mass, inertia = self._nominal
        factors = 1 + self.level * np.array([self.rngs[i].uniform(-1.0, 1.0, 1 + len(WHEELS)) for i in ids])
        rows, radii = ids[:, None], factors[:, 1:] * self._radius
        self._sizes[rows, self._wheels, 0] = radii
        self._bounds[rows[..., None], np.array(self._wheels)[:, None], [3, 4]] = radii[..., None]
        self._reach[rows, self._wheels] = np.hypot(radii, self._half_width)
        self._masses[ids, self._base] = factors[:, 0] * mass
        self._inertias[ids, self._base] = factors[:, :1] * inertia
        self.task.simulation.derive(ids)
