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
from armctl.scene import push_table, tabletop
from armctl.tasks.goals import Goals
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.push.options import PushOptions
from armctl.tasks.push.potentials import PushDistance
from armctl.tasks.push.state import PUSH_FEATURES, PUSH_OBSERVATION, PushState
from armctl.tasks.push.world import TOOL, furnish
from armctl.tasks.reach.observation import LENGTH_MARGIN, LENGTH_SCALE, Bounds
from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachTask
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.tabletop import ATTEMPTS, OBJECT_HIGH, OBJECT_LOW, TabletopTask
from armctl.tasks.task import Outcome, Potential

SHORTEST, LONGEST = 0.1, 0.4
"""m between an object and its target."""
LARGEST_MOVE = 0.1
"""rad: largest move of a joint in an action of a learner; at the speed of a push, joints move by 0.02 rad a step."""


class PushOutcome(Outcome):
    """Outcome of an episode of a push task."""

    TIMEOUT = 0
    PLACED = 1, True
    FELL = 2


class PushTask(TabletopTask):
    """n arms, each with an object on a table, and its target there."""

    options: PushOptions
    options_type: ClassVar[type[Any]] = PushOptions
    outcomes = PushOutcome
    possible_outcomes = tuple(PushOutcome)
    units: ClassVar[Mapping[str, str]] = {**TabletopTask.units, "tool_position": "m"}
    instruction = "Push the object to the target."
    default_policies = ("push_line", "push_bc", "random")
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        "distance": ReachTask.potentials["distance"],
        "push": PushDistance,
    }
    touching = push_table.TOOL_LENGTH + push_table.TOOL_RADIUS + float(np.linalg.norm(push_table.OBJECT_HALF_SIZES))

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

    @property
    def goals(self) -> Goals | None:
        """Object and target, (n, 3): x, y, m, and whether the object is, or has to be, at rest (1)."""
        return Goals(
            achieved=lambda state: np.column_stack((state.object_position[:, :2], state.at_rest & ~state.fell)),
            desired=lambda state: np.column_stack((state.target_position[:, :2], np.ones(len(state.fell)))),
            reached=lambda achieved, desired: (
                (np.hypot(*(achieved - desired)[:, :2].T) <= self.options.tolerance) & (achieved[:, 2] > 0)
            ),
            part="target_position",
            size=2,
        )

    def outcome(self) -> NDArray[np.int8]:
        """Return `FELL` or `PLACED`; `TIMEOUT` while the episode goes on."""
        placed = self.state.reached * np.int8(PushOutcome.PLACED)
        return np.where(self.state.fell, np.int8(PushOutcome.FELL), placed)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, _furnish)

    def _bind_arrays(self) -> None:
        super()._bind_arrays()
        tool = self.simulation.model.body(TOOL).id
        self._target_query = self._target_query._replace(body=tool)
        self._tool_positions = self._positions[:, tool]

    @functools.cached_property
    def _tool(self) -> VerticalTool:
        return VerticalTool(self._workspace.model, push_table.TOOL_LENGTH, tabletop.table())

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        yaw = self._draw_object(world, rng)
        place, self._targets[world, :2] = self._sample_line(rng)
        self._targets[world, 2] = push_table.TOOL_HEIGHT
        self._place_object(world, place, push_table.TOOL_HEIGHT, yaw)

    def _sample_line(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw places of object and target (2,) m between which the arm can push along a line."""
        low, high = tabletop.TABLE_LOW + tabletop.MARGIN, tabletop.TABLE_HIGH - tabletop.MARGIN
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
        features = PUSH_FEATURES
        return super()._part_bounds() | {
            PUSH_OBSERVATION["tool_position"]: (-arm, arm),
            **dict.fromkeys((features["tool_ahead"], features["object_ahead"], features["target_ahead"]), (-far, far)),
            **dict.fromkeys((features["tool_to_object"], features["object_to_target"]), (-2 * far, 2 * far)),
        }

    def _update_state(self, action: Array) -> None:
        super()._update_state(action)
        reached = (self.state.distance <= self.options.tolerance) & self.state.at_rest & ~self.state.fell
        self.state: PushState = PushState(
            **vars(self.state) | {"reached": reached}, tool_position=self._tool_positions
        )  # fmt: skip

    def _distances(self) -> Array:
        return np.asarray(np.hypot(*(self._object_positions - self._targets)[:, :2].T))


def _furnish(spec: Any, description: ArmDescription) -> None:
    furnish(spec, description, round(CONTROL_PERIOD / spec.option.timestep))
