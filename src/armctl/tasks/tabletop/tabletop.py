"""An arm, and an object on a table: what pushing and lifting share.

Mass and friction of the object are new in each episode, and hidden. An object that leaves the table or turns over is
lost.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.scene import Boxes, tabletop
from armctl.simulation.contacts import ContactSensors
from armctl.tasks.reach.observation import Bounds
from armctl.tasks.reach.reach import ReachTask
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.options import TabletopOptions
from armctl.tasks.tabletop.state import OBJECT_FEATURES, OBJECT_OBSERVATION, TabletopState
from armctl.tasks.tabletop.world import OBJECT, SLIDING, TOUCHED
from armctl.tasks.task import Ids

AT_REST = 0.01
"""m/s: a slower object is at rest."""
UPRIGHT = 0.8
"""Cosine of the tilt beyond which an object falls on another side."""
ATTEMPTS = 200
OBJECT_LOW, OBJECT_HIGH = np.array((-1.0, -1.5, -0.1)), np.array((2.0, 1.5, 1.0))
"""m: box to which the observed place of an object is clipped that has been hit hard."""
OBJECT_SPEED = np.array((5.0, 5.0, 50.0))
"""m/s, m/s and rad/s: the same of its velocity."""
UNIT = (-1.0 - 1e-6, 1.0 + 1e-6)
"""Bounds of cosines and sines."""


class TabletopTask(ReachTask):
    """n arms, each with an object on a table."""

    options: TabletopOptions
    units: ClassVar[Mapping[str, str]] = {
        **ReachTask.units, "object_position": "m", "object_axis": "", "object_velocity": "m/s, m/s, rad/s",
    }  # fmt: skip
    stops_at_target = False
    rubbing: ClassVar[tuple[str, ...]] = (SLIDING,)
    """Names of the contacts whose friction each episode draws."""
    touching: ClassVar[float]
    """m: farther from the end-effector than this, the object's centre is not touched."""

    def min_time(self, world: int) -> float:
        """Return a lower bound on the time to success, s: that until the robot can touch the object."""
        q, velocity = self.arm.joint_positions[world], self.arm.joint_velocities[world]
        return self._minimum_time.min_time(q, self.state.object_position[world], self.touching, velocity)

    def static_map(self, world: int) -> Boxes:
        """Return the table."""
        return tabletop.table()

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self._contacts.forget(ids)
        super().advance(ids)

    def _bind_arrays(self) -> None:
        simulation, model = self.simulation, self.simulation.model
        self._object = model.body(OBJECT).id
        self._positions, self._rotations = simulation.array("xpos"), simulation.array("xmat").reshape(self.n, -1, 9)
        self._object_positions = self._positions[:, self._object]
        self._object_rotations = self._rotations[:, self._object]
        joint = model.joint(OBJECT)
        self._object_qpos = simulation.array("qpos")[:, joint.qposadr[0] :]
        self._object_qvel = simulation.array("qvel")[:, joint.dofadr[0] :]
        self._masses, self._inertias = simulation.per_world("body_mass"), simulation.per_world("body_inertia")
        self._unit_inertia = model.body_inertia[self._object] / model.body_mass[self._object]
        self._frictions = simulation.per_world("pair_friction")
        self._pairs = [model.pair(name).id for name in self.rubbing]
        self._contacts = ContactSensors(simulation, ("arm",), TOUCHED)
        self._contacts_part = self._contacts.part

    def _contact(self) -> NDArray[np.bool_]:
        return np.asarray(self._contacts.since_last_step()[:, 0].any(axis=1))

    def _sample_episodes(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        self._contacts.forget(ids)
        super()._sample_episodes(ids, rngs)
        self.simulation.derive(ids)

    def _draw_object(self, world: int, rng: np.random.Generator) -> float:
        """Draw the object's mass and friction, and return its yaw, rad."""
        mass, friction, yaw = (
            rng.uniform(*self.options.mass),
            rng.uniform(*self.options.friction),
            rng.uniform(0, np.pi),
        )
        self._masses[world, self._object] = mass
        self._frictions[world, self._pairs, :2] = friction
        self._inertias[world, self._object] = mass * self._unit_inertia
        return float(yaw)

    def _place_object(self, world: int, place: Array, height: float, yaw: float) -> None:
        """Put the object's centre at a place (2,) m and a height (m)."""
        self._object_qpos[world] = (*place, height, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))

    def _part_bounds(self) -> dict[Term, Bounds]:
        return super()._part_bounds() | {
            OBJECT_OBSERVATION["object_position"]: (OBJECT_LOW, OBJECT_HIGH),
            OBJECT_OBSERVATION["object_axis"]: UNIT,
            OBJECT_OBSERVATION["object_velocity"]: (-OBJECT_SPEED, OBJECT_SPEED),
            OBJECT_FEATURES["object_axis_ahead"]: UNIT,
            OBJECT_FEATURES["object_velocity_ahead"]: (-2 * OBJECT_SPEED, 2 * OBJECT_SPEED),
        }

    def _update_state(self, action: Array) -> None:
        super()._update_state(action)
        positions, rotations, velocities = self._object_positions, self._object_rotations, self._object_qvel
        yaws = np.arctan2(rotations[:, 3], rotations[:, 0])
        fell = (positions[:, 2] < tabletop.TOP) | (rotations[:, 8] < UPRIGHT)
        self.state: TabletopState = TabletopState(
            **vars(self.state),
            object_position=np.clip(positions, OBJECT_LOW, OBJECT_HIGH),
            object_axis=np.column_stack((np.cos(yaws), np.sin(yaws))),
            object_velocity=np.clip(velocities[:, [0, 1, 5]], -OBJECT_SPEED, OBJECT_SPEED),
            at_rest=np.linalg.norm(velocities[:, :3], axis=1) < AT_REST,
            fell=np.asarray(fell),
        )
