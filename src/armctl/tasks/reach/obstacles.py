"""Reach around obstacles: boxes, posts and shelves between home and target, different ones in each episode.

A contact of the arm with an obstacle, the floor or itself ends the episode. A planner that no policy uses
has found a path in every layout.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl import planning
from armctl.core.arrays import Array
from armctl.core.options import options
from armctl.disturbances import episode_of
from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import Clearance
from armctl.robot_description import ArmDescription
from armctl.robots.arm import PREFIX, add_collision_pair, build_arm_world, collision_geom
from armctl.scene import BOX_NUMBERS, Boxes
from armctl.simulation.box_geoms import ABSENT_HALF_SIZE, BoxGeoms
from armctl.simulation.contacts import ContactSensors, add_contact_sensors
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.reach.layout_pool import LayoutPool, pool_for
from armctl.tasks.reach.observation import (
    FEATURES,
    HIDDEN,
    LENGTH_MARGIN,
    LENGTH_SCALE,
    OBSERVATION,
    Bounds,
    rotated,
)
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES, sample_certified_layout
from armctl.tasks.reach.options import ReachOptions, Terms
from armctl.tasks.reach.pose import first_axes
from armctl.tasks.reach.potentials import PathCostToGo
from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachOutcome, ReachTask
from armctl.tasks.reach.state import GOAL_REWARD, REWARD, STEP_REWARD, ReachState, Term
from armctl.tasks.task import Ids, OneTimeTerm, Potential

TOUCHED = ("floor", "obstacle", "itself")
"""Names of what the arm can touch."""
FARTHEST_BOX = 2.0
"""times the workspace's radius within which all obstacles are."""
AWAY = (0.0, 0.0, -9.0)
"""m, position of unused boxes."""


def boxes_ahead(state: "ObstaclesReachState") -> Array:
    """Return each box as its centre, its offset from the target, half sizes, and sine and cosine of twice its yaw.

    Of boxes that may be tilted, there are also the horizontal parts of their own vertical axis.
    """
    numbers = state.boxes
    centres, targets = numbers[..., :3], state.target_position[:, None]
    places = [rotated(points, -state.base_yaw) for points in (centres, centres - targets)]
    yaws, tilts = numbers[..., 6:7] - state.base_yaw[:, None, None], numbers[..., 7:]
    lean = np.sin(tilts) * np.cos(yaws), np.sin(tilts) * np.sin(yaws)
    lengths = LENGTH_SCALE * np.concatenate((*places, numbers[..., 3:6]), axis=-1)
    ahead = np.concatenate((lengths, np.sin(2 * yaws), np.cos(2 * yaws), *lean), axis=-1)
    return np.where((numbers[..., 3:6] > 0).all(axis=-1, keepdims=True), ahead, 0.0).reshape(len(numbers), -1)


BOXES: Term = lambda state: state.boxes.reshape(len(state.boxes), -1)  # noqa: E731
OBSTACLES_OBSERVATION: Mapping[str, Term] = {**OBSERVATION, "boxes": BOXES}
OBSTACLES_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": OBSTACLES_OBSERVATION,
    "features": {**FEATURES, "boxes_ahead": boxes_ahead},
    "full": {**OBSTACLES_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""


def obstacles_observation(
    model: ArmModel, positions: NDArray[Any], targets: NDArray[Any], boxes: NDArray[Any]
) -> NDArray[np.float32]:
    """Return the observations `paper` (n, k) of arms at joint `positions` (n, dof), rad, without a simulation.

    `targets` are (n, 3) m, or (n, 9) with the first two axes of poses, and `boxes` (n, ...).
    """
    places, axes = np.split(targets, [3], axis=1)
    parts = [model.positions(positions), positions, places]
    if axes.shape[1]:
        rotations = [model.pose(q)[:3, :3].ravel() for q in positions.astype(float)]
        parts += [first_axes(np.array(rotations).reshape(-1, 9)), axes]
    return np.concatenate((*parts, boxes.reshape(len(boxes), -1)), axis=1, dtype=np.float32)


COLLISION_REWARD = 200 * STEP_REWARD
"""Price of a collision: that of the 200 control steps of an episode. A collision never pays, at any discount."""
OBSTACLES_REWARD: Mapping[str, Term] = {
    **REWARD,
    "goal": OneTimeTerm(lambda state: GOAL_REWARD * (state.reached & ~state.collided), (0.0, GOAL_REWARD)),
    "collision": OneTimeTerm(lambda state: np.where(state.collided, COLLISION_REWARD, 0.0), (COLLISION_REWARD, 0.0)),
}
"""The terms of the reward, whose sum is the reward."""


@dataclass(frozen=True)
class ObstaclesReachState(ReachState):
    """The state, and obstacles and contacts."""

    boxes: Array
    """(n, `max_boxes`, `box_numbers`) of the task's options; zeros for absent boxes."""
    contacts: NDArray[np.bool_]
    """(n, `TOUCHED`) what the arm has touched since the last control step."""
    collided: NDArray[np.bool_]
    """(n,) whether the arm has touched anything."""


@options
class ReachObstaclesOptions(ReachOptions):
    """Options of `armctl/ArmReachObstacles-v0`. Raises `ConfigurationError` for invalid values."""

    solvable: bool = True
    """Sample layouts until one is certified to have a path. If False, the first is taken, and `info["feasible"]` says
    whether it is certified (see `PathCertificate`)."""
    target: Literal["reachable"] = "reachable"
    """The target is sampled within reach, together with the obstacles."""
    reward: Terms = field(default_factory=lambda: OBSTACLES_REWARD)

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = OBSTACLES_OBSERVATIONS
    has_goals: ClassVar[bool] = False
    max_boxes: ClassVar[int] = MAX_OBSTACLES
    box_numbers: ClassVar[int] = BOX_NUMBERS


class ReachObstaclesTask(ReachTask):
    """n arms, each with a target behind obstacles."""

    options: ReachObstaclesOptions
    options_type: ClassVar[type[Any]] = ReachObstaclesOptions
    state_type: ClassVar[type[Any]] = ObstaclesReachState
    state: ObstaclesReachState
    possible_outcomes = (ReachOutcome.REACHED, ReachOutcome.TIMEOUT, ReachOutcome.COLLIDED)
    units: ClassVar[Mapping[str, str]] = {**ReachTask.units, "boxes": "centres and half sizes, m; yaw, rad"}
    instruction = "Move the end-effector to the target without touching the obstacles."
    default_policies: ClassVar[tuple[str, ...]] = (
        "reach_ompl",
        "reach_ik",
        "obstacles_imagined",
        "obstacles_plan_bc",
        "random",
    )
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {**ReachTask.potentials, "ompl": PathCostToGo}
    geometry_features: ClassVar[str] = "links_among_boxes"
    """Name of the features that know the arm's geometry."""
    points_apart: ClassVar[float] = 0.15
    """m: largest distance of points along a link, for these features."""

    def __init__(self, n: int, options: ReachObstaclesOptions, threads: int = 0) -> None:
        self._boxes = np.zeros((n, options.max_boxes, options.box_numbers))
        super().__init__(n, options, threads)

    @property
    def learner_view(self) -> LearnerView:
        """Also features that know the arm's geometry, for the observation `paper`."""
        view, model = super().learner_view, self._workspace.model
        options = self.options
        if list(options.parts) != list(options.observations["paper"]) or not model.base_yaw_is_vertical:
            return view
        features = FeatureSpec(self.geometry_features, {"geometry": model.geometry(self.points_apart)})
        return replace(view, model_features=features)

    def boxes(self, world: int) -> Boxes:
        """Return the obstacles of a world."""
        return read_boxes(self._boxes[world], self.options.box_numbers)

    def static_map(self, world: int) -> Boxes:
        """Return a copy of a world's obstacles."""
        return read_boxes(self._boxes[world].copy(), self.options.box_numbers)

    def min_clearance(self, world: int, configurations: Array) -> float:
        """Return the least distance of the arm's links from boxes, floor and each other, m; see `Clearance`."""
        return float(self._clearance.min_distances(configurations, self._clearance.among(self.boxes(world))).min())

    def outcome(self) -> NDArray[np.int8]:
        """Return `COLLIDED` or `REACHED`; `TIMEOUT` while the episode goes on."""
        reached = self.state.reached * np.int8(ReachOutcome.REACHED)
        return np.where(self.state.collided, np.int8(ReachOutcome.COLLIDED), reached)

    def info(self) -> dict[str, Any]:
        """Return also `contacts`: whether the arm has touched floor, obstacle or itself since the last control step."""
        touched = {name: self.state.contacts[:, i].copy() for i, name in enumerate(TOUCHED)}
        return super().info() | {"contacts": touched}

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self._contacts.forget(ids)
        super().advance(ids)

    @functools.cached_property
    def _clearance(self) -> Clearance:
        return Clearance(self._workspace.model)

    @functools.cached_property
    def _certificate(self) -> "planning.PathCertificate":
        return planning.PathCertificate(self._workspace.model)

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control, furnish)

    def _bind_arrays(self) -> None:
        model, simulation = self.simulation.model, self.simulation
        names = [_name(i) for i in range(self.options.max_boxes)]
        self._bodies = np.array([model.body(name).id for name in names])
        self._geoms = BoxGeoms(simulation, np.array([model.geom(name).id for name in names]))
        self._box_positions, self._box_quaternions = (simulation.per_world(name) for name in ("body_pos", "body_quat"))
        self._contacts = ContactSensors(simulation, ("arm",), TOUCHED)
        self._contacts_part = self._contacts.part

    @functools.cached_property
    def _pool(self) -> LayoutPool | None:
        return pool_for(self.arm.description, self.options.tolerance)

    def _sample_episodes(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        self._contacts.forget(ids)
        rows = np.array([self._row(rng) for rng in rngs], dtype=int)
        if self._pool is not None and (pooled := rows >= 0).any():
            worlds, pool_rows = ids[pooled], rows[pooled]
            self._targets[worlds], self._boxes[worlds] = self._pool.targets[pool_rows], self._pool.boxes[pool_rows]
            self._feasible[worlds] = self._pool.feasible[pool_rows]
        for i in np.flatnonzero(rows < 0):
            self._sample_episode(int(ids[i]), rngs[i])
        self._place(ids)

    def _row(self, rng: np.random.Generator) -> int:
        """Return the row of the pool with the layout of a generator's episode; -1 if there is none."""
        if self._pool is None or (episode := episode_of(rng)) is None:
            return -1
        return self._pool.row(*episode, self.options.solvable)

    def _sample_episode(self, world: int, rng: np.random.Generator) -> None:
        layout, self._feasible[world] = sample_certified_layout(
            rng, self._workspace, self._certificate, self.options.tolerance, self.options.solvable
        )
        self._targets[world], boxes = layout.target, layout.boxes
        self._boxes[world] = 0.0
        self._boxes[world, : len(boxes)] = boxes.numbers

    def _contact(self) -> NDArray[np.bool_]:
        return self.state.collided

    def _place(self, ids: Ids) -> None:
        """Put the simulated boxes of worlds `ids` where `_boxes` has them."""
        boxes, worlds = self._boxes[ids], ids[:, None]
        present = (boxes[..., 3:6] > 0).all(axis=-1, keepdims=True)
        self._box_positions[worlds, self._bodies] = np.where(present, boxes[..., :3], AWAY)
        (cos, sin), tilts = (np.cos(boxes[..., 6] / 2), np.sin(boxes[..., 6] / 2)), boxes[..., 7:].sum(axis=-1) / 2
        turned = (cos * np.cos(tilts), -sin * np.sin(tilts), cos * np.sin(tilts), sin * np.cos(tilts))
        self._box_quaternions[worlds, self._bodies] = np.stack(turned, axis=-1)
        self._geoms.resize(ids, boxes[..., 3:6])

    def _part_bounds(self) -> dict[Term, Bounds]:
        far = FARTHEST_BOX * LENGTH_MARGIN * self._workspace.radius
        angles = self.options.box_numbers - 6
        directions = 2 * angles
        highest = np.array([far] * 6 + [2 * np.pi] * angles)
        lowest = -highest * ([1] * 3 + [0] * 3 + [1] * angles)
        highest_ahead = np.array([3 * LENGTH_SCALE * far] * 9 + [1.0] * directions)
        lowest_ahead = -highest_ahead * ([1] * 6 + [0] * 3 + [1] * directions)
        return super()._part_bounds() | {
            BOXES: np.tile((lowest, highest), self.options.max_boxes),
            boxes_ahead: np.tile((lowest_ahead, highest_ahead), self.options.max_boxes),
        }

    def _state_values(self, action: Array) -> dict[str, Any]:
        contacts = self._contacts.since_last_step()[:, 0]
        return super()._state_values(action) | {
            "boxes": self._boxes,
            "contacts": contacts,
            "collided": np.asarray(contacts.any(axis=1)),
        }


def read_boxes(numbers: NDArray[np.floating[Any]], box_numbers: int = BOX_NUMBERS) -> Boxes:
    """Parse boxes from an observation: any array with `box_numbers` numbers per box, zeros for absent boxes."""
    rows = np.asarray(numbers, dtype=float).reshape(-1, box_numbers)
    rows = rows[(rows[:, 3:6] > 0).all(axis=1)]
    return Boxes(rows[:, :3], rows[:, 3:6], rows[:, 6], *rows.T[7:])


def _name(box: int) -> str:
    return f"box_{box}"


def furnish(spec: Any, description: ArmDescription, max_boxes: int = MAX_OBSTACLES) -> None:
    """Add boxes, which are away, and sensors of the arm's contacts."""
    _add_boxes(spec, description, max_boxes)
    _add_sensors(spec, round(CONTROL_PERIOD / spec.option.timestep))


def _add_boxes(spec: Any, description: ArmDescription, max_boxes: int) -> None:
    parent = spec.worldbody.add_body(name="obstacles")
    for i in range(max_boxes):
        body = parent.add_body(name=_name(i), pos=AWAY)
        body.add_geom(
            name=_name(i),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[ABSENT_HALF_SIZE] * 3,
            contype=0,
            conaffinity=0,
            material="obstacle",
        )
        for capsule in description.capsules:
            add_collision_pair(spec, collision_geom(capsule.link), _name(i))


def _add_sensors(spec: Any, memory: int) -> None:
    root = next(body for body in spec.worldbody.bodies if body.name.startswith(PREFIX)).name
    arm = (mujoco.mjtObj.mjOBJ_XBODY, root)
    touched = ((mujoco.mjtObj.mjOBJ_GEOM, "floor"), (mujoco.mjtObj.mjOBJ_XBODY, "obstacles"), arm)
    add_contact_sensors(spec, {"arm": arm}, dict(zip(TOUCHED, touched, strict=True)), memory)
