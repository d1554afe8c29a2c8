"""Push: the arm brings an object to a target on a table by a straight tool, without a gripper.

An episode is won when the object's centre is within the tolerance and the object is at rest: one that only passes
through the target has been hit, not brought. It is lost when the object falls off the table or on another side.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.robot_description import ArmDescription
from armctl.robots.arm import build_arm_world
from armctl.scene import Boxes, push_table
from armctl.simulation.contacts import ContactSensors
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.push.options import PushOptions
from armctl.tasks.push.potentials import PushDistance
from armctl.tasks.push.state import PUSH_FEATURES, PUSH_OBSERVATION, PushState
from armctl.tasks.push.world import OBJECT, SLIDING, TOOL, TOUCHED, furnish
from armctl.tasks.reach.observation import LENGTH_MARGIN, LENGTH_SCALE, Bounds
from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachTask
from armctl.tasks.reach.state import Term
from armctl.tasks.task import Ids, Outcome, Potential

AT_REST = 0.01
"""m/s: a slower object is at rest."""
UPRIGHT = 0.8
"""Cosine of the tilt beyond which an object falls on another side."""
SHORTEST, LONGEST = 0.1, 0.4
"""m between an object and its target."""
LARGEST_MOVE = 0.1
"""rad: largest move of a joint in an action of a learner; at the speed of a push, joints move by 0.02 rad a step."""
ATTEMPTS = 200
OBJECT_LOW, OBJECT_HIGH = np.array((-1.0, -1.5, -0.1)), np.array((2.0, 1.5, 1.0))
"""m: box to which the observed place of an object is clipped that has been hit hard."""
OBJECT_SPEED = np.array((5.0, 5.0, 50.0))
"""m/s, m/s and rad/s: the same of its velocity."""


class PushOutcome(Outcome):
    """Outcome of an episode of a push task."""

    TIMEOUT = 0
    PLACED = 1, True
    FELL = 2


class PushTask(ReachTask):
    """n arms, each with an object on a table, and its target there."""

    options: PushOptions
    options_type: ClassVar[type[Any]] = PushOptions
    outcomes = PushOutcome
    possible_outcomes = tuple(PushOutcome)
    units: ClassVar[Mapping[str, str]] = {
        **ReachTask.units, "tool_position": "m", "object_position": "m", "object_axis": "",
        "object_velocity": "m/s, m/s, rad/s",
    }  # fmt: skip
    instruction = "Push the object to the target."
    default_policies = ("push_line", "push_bc", "random")
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        "distance": ReachTask.potentials["distance"],
        "push": PushDistance,
    }
    stops_at_target = False

    def __init__(self, n: int, options: PushOptions, threads: int = 0) -> None:
        super().__init__(n, options, threads)
        self.simulation.model.geom("target").size[1:] = 0.001  # a disc

    @property
    def learner_view(self) -> LearnerView:
        """Features of the observation `paper`, and actions relative to its joint positions."""
        dof = self.arm.description.dof
        if list(self.options.parts) != list(PUSH_OBSERVATION) or self.arm.control != "position":
            return LearnerView()
        features = FeatureSpec("push", {"dof": dof}) if self._workspace.model.base_yaw_is_vertical else None
        return LearnerView(relative_to=slice(3, 3 + dof), largest_move=LARGEST_MOVE, features=features)

    def outcome(self) -> NDArray[np.int8]:
        """Return `FELL` or `PLACED`; `TIMEOUT` while the episode goes on."""
        placed = self.state.reached * np.int8(PushOutcome.PLACED)
        return np.where(self.state.fell, np.int8(PushOutcome.FELL), placed)

    def min_time(self, world: int) -> float:
        """Return a lower bound on the time to success, s: that until the tool can touch the object."""
        q, velocity = self.arm.joint_positions[world], self.arm.joint_velocities[world]
        touching = push_table.TOOL_LENGTH + push_table.TOOL_RADIUS + float(np.linalg.norm(push_table.OBJECT_HALF_SIZES))
        return self._minimum_time.min_time(q, self.state.object_position[world], touching, velocity)

    def static_map(self, world: int) -> Boxes:
        """Return the table."""
        return push_table.table()

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self._contacts.forget(ids)
        super().advance(ids)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, _furnish)

    def _bind_arrays(self) -> None:
        simulation, model = self.simulation, self.simulation.model
        self._object, tool = model.body(OBJECT).id, model.body(TOOL).id
        self._target_query = self._target_query._replace(body=tool)
        positions, rotations = simulation.array("xpos"), simulation.array("xmat").reshape(self.n, -1, 9)
        self._tool_positions, self._object_positions = positions[:, tool], positions[:, self._object]
        self._object_rotations = rotations[:, self._object]
        joint = model.joint(OBJECT)
        self._object_qpos = simulation.array("qpos")[:, joint.qposadr[0] :]
        self._object_qvel = simulation.array("qvel")[:, joint.dofadr[0] :]
        self._masses, self._inertias = simulation.per_world("body_mass"), simulation.per_world("body_inertia")
        self._unit_inertia = model.body_inertia[self._object] / model.body_mass[self._object]
        self._frictions, self._pair = simulation.per_world("pair_friction"), model.pair(SLIDING).id
        self._contacts = ContactSensors(simulation, ("arm",), TOUCHED)
        self._contacts_part = self._contacts.part

    @functools.cached_property
    def _tool(self) -> VerticalTool:
        return VerticalTool(self._workspace.model, push_table.TOOL_LENGTH, push_table.table())

    def _contact(self) -> NDArray[np.bool_]:
        return np.asarray(self._contacts.since_last_step()[:, 0].any(axis=1))

    def _sample_episodes(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        self._contacts.forget(ids)
        super()._sample_episodes(ids, rngs)
        self.simulation.derive(ids)

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        mass, friction, yaw = (
            rng.uniform(*self.options.mass),
            rng.uniform(*self.options.friction),
            rng.uniform(0, np.pi),
        )
        self._masses[world, self._object], self._frictions[world, self._pair, :2] = mass, friction
        self._inertias[world, self._object] = mass * self._unit_inertia
        place, self._targets[world, :2] = self._sample_line(rng)
        self._targets[world, 2] = push_table.TOOL_HEIGHT
        self._object_qpos[world] = (*place, push_table.TOOL_HEIGHT, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))

    def _sample_line(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw places of object and target (2,) m between which the arm can push along a line."""
        low, high = push_table.TABLE_LOW + push_table.MARGIN, push_table.TABLE_HIGH - push_table.MARGIN
        for _ in range(ATTEMPTS):
            place, target = rng.uniform(low, high, (2, 2))
            if not SHORTEST <= np.hypot(*(target - place)) <= LONGEST:
                continue
            if self._tool.line(push_table.line_points(place, target), self.arm.description.home) is not None:
                return place, target
        raise ConfigurationError(f"{self.arm.description.name} can push along none of {ATTEMPTS} lines on the table")

    def _part_bounds(self) -> dict[Term, Bounds]:
        room = LENGTH_MARGIN * self._workspace.radius + push_table.TOOL_LENGTH
        arm = room + np.abs(self._workspace.centre)
        far = LENGTH_SCALE * float(np.linalg.norm(np.maximum(arm, np.abs((OBJECT_LOW, OBJECT_HIGH)).max(axis=0))))
        paper, features, unit = PUSH_OBSERVATION, PUSH_FEATURES, (-1.0 - 1e-6, 1.0 + 1e-6)
        return super()._part_bounds() | {
            paper["tool_position"]: (-arm, arm),
            paper["object_position"]: (OBJECT_LOW, OBJECT_HIGH),
            paper["object_axis"]: unit,
            paper["object_velocity"]: (-OBJECT_SPEED, OBJECT_SPEED),
            features["object_axis_ahead"]: unit,
            features["object_velocity_ahead"]: (-2 * OBJECT_SPEED, 2 * OBJECT_SPEED),
            **dict.fromkeys((features["tool_ahead"], features["object_ahead"], features["target_ahead"]), (-far, far)),
            **dict.fromkeys((features["tool_to_object"], features["object_to_target"]), (-2 * far, 2 * far)),
        }

    def _update_state(self, action: Array) -> None:
        super()._update_state(action)
        positions, rotations, velocities = self._object_positions, self._object_rotations, self._object_qvel
        yaws = np.arctan2(rotations[:, 3], rotations[:, 0])
        fell = (positions[:, 2] < push_table.TOP) | (rotations[:, 8] < UPRIGHT)
        at_rest = np.linalg.norm(velocities[:, :3], axis=1) < AT_REST
        values = vars(self.state) | {"reached": (self.state.distance <= self.options.tolerance) & at_rest & ~fell}
        self.state: PushState = PushState(
            **values,
            tool_position=self._tool_positions,
            object_position=np.clip(positions, OBJECT_LOW, OBJECT_HIGH),
            object_axis=np.column_stack((np.cos(yaws), np.sin(yaws))),
            object_velocity=np.clip(velocities[:, [0, 1, 5]], -OBJECT_SPEED, OBJECT_SPEED),
            fell=np.asarray(fell),
        )

    def _distances(self) -> Array:
        return np.asarray(np.hypot(*(self._object_positions - self._targets)[:, :2].T))


def _furnish(spec: Any, description: ArmDescription) -> None:
    furnish(spec, description, round(CONTROL_PERIOD / spec.option.timestep))
