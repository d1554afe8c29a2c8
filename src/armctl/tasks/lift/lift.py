"""Lift: the arm grasps an object on a table with a hand of two fingers, and lifts it to a height.

An episode is won when both fingers touch the object, its centre is within the tolerance of the height, and it is at
rest. It is lost when the object falls off the table or on another side.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kinematics.grasp import grasp_path
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.robot_description import ArmDescription
from armctl.robots.arm import PREFIX, build_arm_world
from armctl.robots.hand import FINGERS, Hand, add_finger_motors, worlds_with_hands
from armctl.scene import lift_table, tabletop
from armctl.simulation.box_geoms import BoxGeoms
from armctl.simulation.contacts import ContactSensors
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.lift.options import LiftOptions
from armctl.tasks.lift.potentials import LiftDistance
from armctl.tasks.lift.state import LIFT_FEATURES, LIFT_OBSERVATION, OPENING_SCALE, LiftState
from armctl.tasks.lift.world import RUBBING, TARGET_RADIUS, furnish
from armctl.tasks.reach.observation import LENGTH_MARGIN, LENGTH_SCALE, Bounds
from armctl.tasks.reach.pose import first_axes
from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachTask
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.tabletop import ATTEMPTS, OBJECT_HIGH, OBJECT_LOW, UNIT, TabletopTask
from armctl.tasks.tabletop.world import OBJECT
from armctl.tasks.task import Outcome, Potential

LARGEST_MOVE = 0.2
"""rad: largest move of a joint in an action of a learner."""
OPENING_MARGIN = 0.01
"""m beyond its limits within which the hand's opening always stays."""


class LiftOutcome(Outcome):
    """Outcome of an episode of a lift task."""

    TIMEOUT = 0
    LIFTED = 1, True
    FELL = 2


class LiftTask(TabletopTask):
    """n arms with hands, each with an object on a table."""

    options: LiftOptions
    options_type: ClassVar[type[Any]] = LiftOptions
    outcomes = LiftOutcome
    possible_outcomes = tuple(LiftOutcome)
    units: ClassVar[Mapping[str, str]] = {
        **TabletopTask.units, "finger_opening": "m", "end_effector_axes": "", "target_height": "m",
        **{
            control: f"{ReachTask.units[control]}; the hand's opening, m"
            for control in ("position", "relative", "delta", "velocity", "torque")
        },
    }  # fmt: skip
    instruction = "Grasp the object, and lift it to the target's height."
    default_policies = ("lift_grasp", "lift_cloned_ppo", "random")
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        "distance": ReachTask.potentials["distance"],
        "lift": LiftDistance,
    }
    rubbing = RUBBING
    touching = 0.085 + lift_table.LARGEST * 3**0.5 / 2

    def __init__(self, n: int, options: LiftOptions, threads: int = 0) -> None:
        super().__init__(n, options, threads)
        self.simulation.model.geom("target").size[0] = TARGET_RADIUS
        self._action = np.zeros((n, self.arm.description.dof + 1))
        arm = self.action_space
        low, high = np.append(arm.low, np.float32(0)), np.append(arm.high, np.float32(lift_table.OPENING))
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.rollout_worlds = functools.partial(worlds_with_hands, arms=self.arm.rollout_worlds)

    @property
    def idle_action(self) -> Array:
        """Stay at home, with the hand open."""
        arm = self.arm
        home = arm.description.home if arm.control == "position" else np.zeros(arm.description.dof)
        return np.append(home, lift_table.OPENING)

    @property
    def learner_view(self) -> LearnerView:
        """Features of the observation `paper`, and actions of the arm relative to its joint positions."""
        dof = self.arm.description.dof
        if list(self.options.parts) != list(LIFT_OBSERVATION) or self.arm.control != "position":
            return LearnerView()
        features = FeatureSpec("lift", {"dof": dof})
        return LearnerView(relative_to=slice(3, 3 + dof), largest_move=LARGEST_MOVE, features=features)

    def command(self, actions: Array) -> None:
        """Command actions (n, dof + 1): those of the arm, and the hand's opening, m."""
        super().command(actions[:, :-1])
        self._hand.command(actions[:, -1])
        self._action = actions

    def outcome(self) -> NDArray[np.int8]:
        """Return `FELL` or `LIFTED`; `TIMEOUT` while the episode goes on."""
        lifted = self.state.reached * np.int8(LiftOutcome.LIFTED)
        return np.where(self.state.fell, np.int8(LiftOutcome.FELL), lifted)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, _furnish, add_finger_motors)

    def _bind_arrays(self) -> None:
        super()._bind_arrays()
        model, simulation = self.simulation.model, self.simulation
        self._hand, self._grips = Hand(simulation), ContactSensors(simulation, FINGERS, (OBJECT,))
        self._object_geom = BoxGeoms(simulation, np.array([model.geom(OBJECT).id]))
        self._tip_rotations = self._rotations[:, model.body(PREFIX + self.arm.description.tip).id]

    @functools.cached_property
    def _tool(self) -> VerticalTool:
        return VerticalTool(self._workspace.model, 0.0, tabletop.table())

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        yaw, half_sizes = self._draw_object(world, rng), rng.uniform(*self.options.size, 3) / 2
        self._resize(world, half_sizes)
        self._targets[world] = self._sample_target(rng, yaw)
        self._place_object(world, self._targets[world, :2], tabletop.TOP + half_sizes[2], yaw)
        self._hand.open(world)

    def _resize(self, world: int, half_sizes: Array) -> None:
        """Give the object other half sizes (3,) m, and the inertia of its mass in them."""
        self._object_geom.resize(np.array([world], dtype=np.int32), half_sizes[None, None])
        squares = half_sizes**2
        self._inertias[world, self._object] = self._masses[world, self._object] * (squares.sum() - squares) / 3

    def _sample_target(self, rng: np.random.Generator, yaw: float) -> Array:
        """Draw a place (3,) m above the table, for whose grasp and lift of an object below there is a path."""
        low = tabletop.TABLE_LOW + tabletop.MARGIN, tabletop.TOP + lift_table.LIFT_LOWEST
        high = tabletop.TABLE_HIGH - tabletop.MARGIN, tabletop.TOP + lift_table.LIFT_HIGHEST
        for _ in range(ATTEMPTS):
            target = rng.uniform(np.append(*low), np.append(*high))
            highest = max(lift_table.APPROACH_HEIGHT, target[2] + self.options.tolerance)
            points, turns = grasp_path(self._tool, target[:2], yaw, highest)
            if self._tool.line(points, self.arm.description.home, turns) is not None:
                return np.asarray(target)
        raise ConfigurationError(f"{self.arm.description.name} can lift from none of {ATTEMPTS} places on the table")

    def _part_bounds(self) -> dict[Term, Bounds]:
        room = LENGTH_MARGIN * self._workspace.radius + np.abs(self._workspace.centre)
        far = LENGTH_SCALE * float(np.linalg.norm(np.maximum(room, np.abs((OBJECT_LOW, OBJECT_HIGH)).max(axis=0))))
        paper, features = LIFT_OBSERVATION, LIFT_FEATURES
        opening = np.array((-OPENING_MARGIN, lift_table.OPENING + OPENING_MARGIN))
        return super()._part_bounds() | {
            paper["finger_opening"]: opening,
            paper["end_effector_axes"]: UNIT,
            paper["target_height"]: (tabletop.TOP, tabletop.TOP + lift_table.LIFT_HIGHEST),
            features["finger_opening_scaled"]: OPENING_SCALE * opening,
            **dict.fromkeys((features["end_effector_axes_ahead"], features["faces"]), UNIT),
            features["object_ahead"]: (-far, far),
            **dict.fromkeys((features["hand_to_object"], features["height_to_go"]), (-2 * far, 2 * far)),
        }

    def _update_state(self, action: Array) -> None:
        super()._update_state(action)
        state, grasped = self.state, np.asarray(self._grips.current()[:, :, 0].all(axis=1))
        reached = (state.distance <= self.options.tolerance) & state.at_rest & grasped & ~state.fell
        self.state: LiftState = LiftState(
            **vars(state) | {"reached": reached},
            end_effector_axes=first_axes(self._tip_rotations),
            finger_opening=self._hand.openings,
            grasped=grasped,
        )

    def _distances(self) -> Array:
        return np.abs(self._object_positions[:, 2] - self._targets[:, 2])


def _furnish(spec: Any, description: ArmDescription) -> None:
    furnish(spec, description, round(CONTROL_PERIOD / spec.option.timestep))
