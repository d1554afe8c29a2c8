"""Reach around obstacles: boxes, posts and shelves between home and target, others in each episode.

Touching any of them, the floor, or the arm itself ends the episode. A planner finds a way in every layout that is used.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.assets import ArmDescription
from armctl.boxes import Boxes
from armctl.errors import ConfigurationError
from armctl.kinematics.clearance import Clearance
from armctl.planning import ArmPlanner
from armctl.robots.arm import PREFIX, build_arm_world, collision_geom
from armctl.simulation.contacts import ContactSensors, add_contact_sensors
from armctl.tasks.reach import DECISION_PERIOD, OBSERVATION, ReachOptions, ReachState, ReachTask
from armctl.tasks.reach_layout import MOST_OBSTACLES, draw_layout
from armctl.tasks.task import Outcome

Array = NDArray[np.float64]

NUMBERS = 7
"""That tell a box: centre and half sizes, m, and yaw, rad."""
ATTEMPTS = 50
"""Layouts that are drawn until one is solvable."""
TOUCHED = ("floor", "obstacle", "itself")
"""What the arm can touch."""
HIDDEN = (0.0, 0.0, -9.0)
"""m, where boxes are that an episode has no use for."""

OBSTACLES_OBSERVATION: Mapping[str, Any] = {**OBSERVATION, "boxes": lambda state: state.boxes}
"""The parts of an observation, in order."""

OBSTACLES_REWARD: Mapping[str, Any] = {
    "step": lambda state: np.full(len(state.reached), -1.0),
    "goal": lambda state: 100.0 * (state.reached & ~state.collided),
    "collision": lambda state: np.where(state.collided, -100.0, 0.0),
}
"""The terms of the reward, whose sum is the reward."""


@dataclass(frozen=True)
class ObstaclesReachState(ReachState):
    """What terms may use besides."""

    boxes: Array
    """(n, `MOST_OBSTACLES` * `NUMBERS`), box by box; zeros for those that there are not."""
    contacts: NDArray[np.bool_]
    """(n, `TOUCHED`) what the arm has touched since the last decision."""
    collided: NDArray[np.bool_]
    """(n,) whether that is anything."""


@dataclass(frozen=True)
class ReachObstaclesOptions(ReachOptions):
    """Options of `armctl/ArmReachObstacles-v0`; raises `ConfigurationError` for values it cannot take."""

    solvable: bool = True
    """Draw layouts until the planner finds a way. If not, the first is taken, and `info["feasible"]` tells."""
    reward: Mapping[str, Any] = field(default_factory=lambda: OBSTACLES_REWARD)
    observation: Mapping[str, Any] = field(default_factory=lambda: OBSTACLES_OBSERVATION)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.target != "reachable":
            raise ConfigurationError("a target among obstacles is drawn with them: target is 'reachable'")


class ReachObstaclesTask(ReachTask):
    """n arms, each with a target behind obstacles."""

    options: ReachObstaclesOptions

    def __init__(self, n: int, options: ReachObstaclesOptions, threads: int = 0) -> None:
        self._boxes = np.zeros((n, MOST_OBSTACLES, NUMBERS))
        self._planner: ArmPlanner | None = None
        self._ways = [np.zeros((0, 0))] * n
        super().__init__(n, options, threads)

    def boxes(self, world: int) -> Boxes:
        """What stands in a world's way."""
        return read_boxes(self._boxes[world])

    def way(self, world: int) -> Array:
        """Corners (m, dof) of the way that the planner has found in a world; none, if it found no way."""
        return self._ways[world]

    def least_clearance(self, world: int, configurations: Array) -> float:
        """Least distance, m, of the arm's links from boxes, floor and each other, as `Clearance` takes them."""
        frames = self._workspace.model.joint_frames(configurations)
        return min(float(distances.min()) for distances, _ in self._clearance.parts(frames, self.boxes(world)))

    def outcome(self) -> NDArray[np.int8]:
        """`COLLIDED`, `REACHED`, or `TIMEOUT` as long as it is neither."""
        reached = self.state.reached * np.int8(Outcome.REACHED)
        return np.where(self.state.collided, np.int8(Outcome.COLLIDED), reached)

    def details(self) -> dict[str, Any]:
        """`contacts` besides: whether the arm has touched floor, obstacle, or itself since the last decision."""
        touched = {name: self.state.contacts[:, i].copy() for i, name in enumerate(TOUCHED)}
        return super().details() | {"contacts": touched}

    @functools.cached_property
    def _clearance(self) -> Clearance:
        return Clearance(self._workspace.model)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        def furnish(spec: Any) -> None:
            _add_boxes(spec, description)
            _add_sensors(spec, round(DECISION_PERIOD / spec.option.timestep))

        return build_arm_world(description, self.options.control, furnish)

    def _attach(self) -> None:
        model, simulation = self.simulation.model, self.simulation
        self._bodies = np.array([model.body(_name(i)).id for i in range(MOST_OBSTACLES)])
        self._geoms = np.array([model.geom(_name(i)).id for i in range(MOST_OBSTACLES)])
        self._positions, self._turns, self._sizes, self._bounds, self._radii = (
            simulation.per_world(name) for name in ("body_pos", "body_quat", "geom_size", "geom_aabb", "geom_rbound")
        )
        self._touches = ContactSensors(simulation, ("arm",), TOUCHED)

    def _draw(self, world: int, rng: np.random.Generator) -> None:
        if self._planner is None:
            self._planner = ArmPlanner(self._workspace.model)
        home = _as_observed(self._workspace.model.home)
        for _ in range(ATTEMPTS):
            layout = draw_layout(rng, self._workspace, self.options.tolerance)
            target, drawn = _as_observed(layout.target), layout.boxes
            boxes = Boxes(_as_observed(drawn.centres), _as_observed(drawn.half_sizes), _as_observed(drawn.yaws))
            plan = self._planner.plan(home, target, self.options.tolerance, boxes)
            if plan.found or not self.options.solvable:
                break
        else:
            raise ConfigurationError(f"the planner found no way in {ATTEMPTS} layouts")
        self._targets[world], self._feasible[world], self._ways[world] = target, plan.found, plan.path
        self._place(world, boxes)

    def _contact(self) -> NDArray[np.bool_]:
        return self.state.collided

    def _place(self, world: int, boxes: Boxes) -> None:
        count = len(boxes)
        self._boxes[world] = 0.0
        self._boxes[world, :count] = np.column_stack((boxes.centres, boxes.half_sizes, boxes.yaws))
        bodies, geoms = self._bodies[:count], self._geoms[:count]
        self._positions[world, self._bodies] = HIDDEN
        self._positions[world, bodies] = boxes.centres
        self._turns[world, bodies] = 0.0
        self._turns[world, bodies, 0], self._turns[world, bodies, 3] = np.cos(boxes.yaws / 2), np.sin(boxes.yaws / 2)
        self._sizes[world, geoms] = self._bounds[world, geoms, 3:] = boxes.half_sizes
        self._radii[world, geoms] = np.linalg.norm(boxes.half_sizes, axis=1)

    def _look(self, action: Array) -> None:
        super()._look(action)
        contacts = self._touches.lately()[:, 0]
        boxes = self._boxes.reshape(len(contacts), -1)
        self.state: ObstaclesReachState = ObstaclesReachState(
            **vars(self.state), boxes=boxes, contacts=contacts, collided=np.asarray(contacts.any(axis=1))
        )


def read_boxes(numbers: NDArray[np.floating[Any]]) -> Boxes:
    """Boxes from what is observed of them: any array of `NUMBERS` for each, zeros for those that there are not."""
    rows = np.asarray(numbers, dtype=float).reshape(-1, NUMBERS)
    rows = rows[(rows[:, 3:6] > 0).all(axis=1)]
    return Boxes(rows[:, :3], rows[:, 3:6], rows[:, 6])


def _as_observed(numbers: Array) -> Array:
    """Rounded as in an observation, so that who plans on that has the very problem that was found solvable."""
    return numbers.astype(np.float32).astype(float)


def _name(box: int) -> str:
    return f"box_{box}"


def _add_boxes(spec: Any, description: ArmDescription) -> None:
    parent = spec.worldbody.add_body(name="obstacles")
    for i in range(MOST_OBSTACLES):
        body = parent.add_body(name=_name(i), pos=HIDDEN)
        body.add_geom(
            name=_name(i), type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1] * 3, contype=0, conaffinity=0, material="obstacle"
        )
        for capsule in description.capsules:
            spec.add_pair(geomname1=collision_geom(capsule.link), geomname2=_name(i))


def _add_sensors(spec: Any, memory: int) -> None:
    root = next(body for body in spec.worldbody.bodies if body.name.startswith(PREFIX)).name
    arm = (mujoco.mjtObj.mjOBJ_XBODY, root)
    touched = ((mujoco.mjtObj.mjOBJ_GEOM, "floor"), (mujoco.mjtObj.mjOBJ_XBODY, "obstacles"), arm)
    add_contact_sensors(spec, {"arm": arm}, dict(zip(TOUCHED, touched, strict=True)), memory)
