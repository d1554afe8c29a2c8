"""The OMPL expert among obstacles: plans a path, and goes where it sees the end of it.

From the observed joints, it moves towards the farthest point of its path that a straight collision-free motion reaches
(as in pure pursuit, but in joint space), however the joints got there: so it can be asked anywhere. Nearer to something
than its drives need to stop, it goes back to the nearest point of the path. It plans once per episode, from the
observation alone, which includes the boxes, and again if it sees nothing of its path. A plan that failed is not asked
for again as it was.

Prepared, it goes by estimates instead of readings, with a model whose links have the estimated lengths, and waits until
noisy boxes are known.

With the option `jerk_limited`, it executes the path by the clock instead, as one trajectory within limits of jerk.
"""

import functools
import itertools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import CLEARANCES, checked_options, planning, search_for, split
from armctl.control.streaming import CommandStream, follow
from armctl.control.trajectory import Trajectory, smooth
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface
from armctl.estimation.arm_observer import WELL_KNOWN, ArmObserver, StandingObjects
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.policies import PerWorld, made_for, sees
from armctl.robot_description.joint_profiles import towards
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesOptions
from armctl.tasks.reach import CONTROL_PERIOD, read_boxes
from armctl.tasks.reach.obstacles import OBSTACLES_OBSERVATION

GOALS = 32
"""Number of goals of the first plan, and added after each failure: the earliest ones may all be shut in."""
SIGHT, BRAKING = 0.9, 0.6
"""Shares of it that are kept by the straight motion ahead, and by the joints' own motion until they rest, in which they
do not move in proportion."""
SIGHT_NEARER, BRAKING_NEARER = 0.95, 0.7
"""Shares of their distances that pairs nearer than that must keep: braking may use what the motion ahead leaves."""
LARGEST_MOVE = 0.5
"""rad: a command is at most so far from the observed joints: more than a joint needs to stop, less than would take the
drives, each of which is as fast as it can be, far off the straight motion. Proportionally less on paths nearer to
things than `WIDE`: the joints' lag behind their drives grows with the speed."""
WIDE = CLEARANCES[0]
"""m."""
SHARES = 0.6 ** np.arange(13)
"""Shares of the move to command: the first is taken after which the drives stop freely."""
LOST = 0.1
"""rad: beyond, the joints do not follow this expert's commands. Servos are off by 0.08 at most."""
REPLAN_STEPS = 5
"""Control steps after a plan until the next; none while there are clearances left."""
SMOOTHING = 0.3
"""Weight of the latest reading of the joints' lag behind a trajectory: a tremble of readings is not lost."""
SAMPLE = 0.02
"""s: time between the configurations from which to which a trajectory is checked."""
RESERVED, RESERVED_FOR_LINKS = 2.0, 0.1
"""Distance to keep in addition: standard deviations of the boxes, or m for a relative error of links."""
NO_RESERVE, LARGEST_RESERVE = 0.001, 0.03
"""m."""
WRONG, ARRIVED = 0.015, 0.03
"""m by which a box, the target or a link was believed elsewhere when a plan was made, if it is made again; rad from its
end at which the arm has arrived."""
SAME_LENGTH, LENGTH_SHARES = 0.005, (1.0, 0.5, 0.0)
"""Relative error below which links are the model's; shares of the errors to plan with, the next after each few
failures: with those believed at first, a target can seem out of reach."""
NARROWER = 0.7
"""Factor of the target's radius after each arrival beside it."""


@options
class ReachOmplOptions:
    """Options of the expert."""

    prepared: bool = True
    """Estimate joints, links, load, target, boxes and delay. False: believe every reading, and the model."""
    jerk_limited: bool = False
    """Execute paths as trajectories within limits of jerk: smoother and slower, best with control=velocity,
    and without estimates."""


@made_for("armctl/ArmReachObstacles-v0 armctl/ArmScenes-v0", controls="arms: position")
@sees("model", family="OMPL")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """OMPL path around the obstacles, towards its farthest point in sight of the observed joints."""
    env_id = "armctl/ArmReachObstacles-v0"
    choice = changed_options(ReachOmplOptions(), options, "option of reach_ompl")
    controls = ["position", "velocity"] if choice.jerk_limited else ["position"]
    task = checked_options(
        "reach_ompl", env, ReachObstaclesOptions, env_id, OBSTACLES_OBSERVATION, controls, poses=True
    )
    setting = ArmModel(env.robot), task, CONTROL_PERIOD
    if choice.jerk_limited:
        return PerWorld([JerkLimitedReachOmpl(*setting) for _ in range(env.num_envs)])
    if not choice.prepared:
        return PerWorld([ReachOmpl(*setting) for _ in range(env.num_envs)])
    clocks = (functools.partial(env.control_step, i) for i in range(env.num_envs))
    return PerWorld([PreparedReachOmpl(*setting, clock) for clock in clocks], prepared=True)


class ReachOmpl:
    """Reaches with one arm."""

    def __init__(self, model: ArmModel, task: ReachObstaclesOptions, period: float) -> None:
        self._model, self._task, self._period = model, task, period
        self._shapes, self._search = ArmShapes(model), search_for(model, task)
        self._usual_clearances, self._effort = planning(task)
        self.reset()

    def reset(self) -> None:
        """Forget the plan, and the own commands."""
        self._sight: EdgeChecker | None = None
        self._braking: EdgeChecker | None = None
        self._path = np.zeros((0, self._model.dof))
        self._since_plan, self._failures = REPLAN_STEPS, 0
        self._clearances: tuple[float, ...] = self._usual_clearances
        self._radius = self._task.tolerance
        self._drives: tuple[Array, Array] | None = None

    def plans(self) -> dict[str, Array]:
        """Return the end-effector's path, (m, 3) m."""
        if len(self._path) < 2:
            return {}
        shares = np.linspace(0, 1, 9)[:, None, None]
        points = (1 - shares) * self._path[:-1] + shares * self._path[1:]
        return {"path": self._model.positions(points.transpose(1, 0, 2).reshape(-1, self._model.dof))}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation (k,), which has the boxes last."""
        _, q, target, boxes = split(self._search, observation)
        limits = self._model.limits
        return self._step(np.clip(q, limits.lower, limits.upper), target, self._read(boxes))

    def _read(self, numbers: Array) -> Boxes:
        return read_boxes(numbers, self._task.box_numbers)

    def _step(self, q: Array, target: Array, boxes: Boxes) -> Array:
        """Return what to command (dof,) from `q` (dof,) to the place `target`, and take note of it."""
        goal = self._goal(q, target, boxes)
        position, velocity = self._driven(q)
        command = self._command(q, goal, position, velocity)
        self._observed, self._commanded = q, command
        self._drives = follow(self._model.limits, position, velocity, command, self._period)
        return command

    def _goal(self, q: Array, target: Array, boxes: Boxes) -> Array:
        """Return where to go on the path (dof,), which is planned again if none of it is in sight; `q` if no path."""
        self._since_plan += 1
        goal = self._on_path(q)
        if goal is None and (self._since_plan > REPLAN_STEPS or 0 < self._failures < len(self._clearances)):
            self._plan(q, target, boxes)
            goal = self._on_path(q)
        return q if goal is None else goal

    def _plan(self, q: Array, target: Array, boxes: Boxes) -> None:
        """Plan a path from `q` (dof,): after each failure nearer to things, to more goals, and with another seed."""
        clearance, self._since_plan = self._clearances[min(self._failures, len(self._clearances) - 1)], 0
        self._clearance = clearance
        tries = 1 + self._failures
        options = ArmPlannerOptions(clearance=clearance, goals=GOALS * tries, seed=tries, **self._effort)
        plan = self._planner(options, target, boxes).plan(q, target, self._radius, boxes)
        self._path, self._failures = plan.path, 0 if plan.solved else self._failures + 1
        self._sight, self._braking = (
            EdgeChecker(self._shapes, boxes, share * clearance, q) for share in (SIGHT, BRAKING)
        )

    def _planner(self, options: ArmPlannerOptions, target: Array, boxes: Boxes) -> ArmPlanner:
        """Return a planner of a path to the place `target` among boxes."""
        return ArmPlanner(self._model, options, self._search)

    def _on_path(self, q: Array) -> Array | None:
        """Return the farthest point (dof,) of the path in sight, or the nearest if too near to something; or None."""
        if self._sight is None or self._braking is None:
            return None
        self._sight.relax(q, SIGHT_NEARER)
        nearest = self._nearest(q, self._sight) if self._braking.relax(q, BRAKING_NEARER) else None
        return self._sight.farthest_goal(self._path, q) if nearest is None else nearest

    def _nearest(self, q: Array, sight: EdgeChecker) -> Array | None:
        """Return the nearest point (dof,) of the path to which the straight motion from `q` (dof,) is free, if any."""
        steps = np.diff(self._path, axis=0)
        lengths = np.maximum((steps**2).sum(axis=1), 1e-12)
        shares = np.clip(((q - self._path[:-1]) * steps).sum(axis=1) / lengths, 0.0, 1.0)
        points = self._path[:-1] + shares[:, None] * steps
        points = points[np.argsort(((points - q) ** 2).sum(axis=1))]
        return next((point for point in points if sight.is_edge_free(q, point)), None)

    def _driven(self, q: Array) -> tuple[Array, Array]:
        """Return position and velocity (dof,) of the drives, which are not observed: those that follow own commands.

        If the joints do not follow these, they are as observed.
        """
        if self._drives is None:
            return q, np.zeros_like(q)
        if np.abs(self._drives[0] - q).max() > LOST:
            return q, (q - self._observed) / self._period
        return self._drives

    def _command(self, q: Array, goal: Array, position: Array, velocity: Array) -> Array:
        """Return the joint positions (dof,) to command: `goal`, or as far on the straight motion there as is safe."""
        assert self._braking is not None
        largest = LARGEST_MOVE * min(1.0, self._clearance / WIDE)
        move = (goal - q) * min(1.0, largest / max(float(np.abs(goal - q).max()), largest))
        for share in SHARES:
            if self._stops_freely(q, position, velocity, q + share * move):
                return np.asarray(q + share * move)
        still_free = self._drives is not None and self._braking.is_edge_free(q, self._commanded)
        return self._commanded if still_free else np.asarray(q + SHARES[-1] * move)

    def _stops_freely(self, q: Array, position: Array, velocity: Array, goal: Array) -> bool:
        """Return True if the arm keeps clear until it rests at `goal` (dof,).

        The joints are off their drives, and fall back to them meanwhile: both the drives' motion, and the same motion
        from the joints observed are checked.
        """
        assert self._braking is not None
        return all(self._braking.stops_freely(position - lag, velocity, goal - lag) for lag in (0.0, position - q))


class PreparedReachOmpl(ReachOmpl):
    """Goes by estimates instead of readings: of joints, target, boxes, links, load and delay.

    It waits at home until boxes and target are known well enough, keeps the farther from boxes the less well they are,
    and plans again when it knows better, and where it has arrived without reaching the target.
    """

    def __init__(self, model: ArmModel, task: ReachObstaclesOptions, period: float, clock: Callable[[], int]) -> None:
        self._belief = ArmObserver(model, period, clock=clock)
        self._nominal = model, ArmShapes(model), search_for(model, task)
        super().__init__(model, task, period)

    def reset(self) -> None:
        """Forget the plan, and all readings."""
        super().reset()
        self._belief.reset()
        self._model, self._shapes, self._search = self._nominal
        self._axes, self._boxes, self._planned_for = StandingObjects(), StandingObjects(), np.zeros(0)
        self._arrivals, self._errors = 0, np.zeros(self._model.num_segments)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation (k,), which has the boxes last."""
        belief = self._belief
        tip, q, target, boxes = split(self._search, observation)
        belief.read(tip[:3], q, target[:3])
        self._axes.read(target[3:])
        self._boxes.read(boxes)
        if len(self._path) == 0 and self._spread > WELL_KNOWN:
            command = belief.commanded
        else:
            self._reconsider(belief.joints_ahead)
            command = self._step(belief.joints_ahead, self._target, self._read(self._boxes.mean))
        command = command - belief.load_offset
        belief.send(command)
        return np.asarray(command)

    @property
    def _target(self) -> Array:
        """The place to go to: a position, or a pose's."""
        return np.concatenate((self._belief.target, self._axes.mean))

    @property
    def _spread(self) -> float:
        """Standard deviation (m) of the means of what stands still."""
        return self._boxes.deviation(self._belief.noise)

    def _reconsider(self, q: Array) -> None:
        """Drop a plan that was made with too wrong beliefs, or that has ended beside the target."""
        belief, end = self._belief, self._path[-1] if len(self._path) else q
        facts = np.concatenate((self._target, self._boxes.mean))
        if len(self._planned_for) and self._since_plan > REPLAN_STEPS:
            moved = np.cumsum((belief.length_errors - self._errors)[:, None] * self._model.segments(end), axis=0)
            has_arrived = len(self._path) > 0 and np.abs(q - end).max() < ARRIVED
            if has_arrived or max(np.abs(facts - self._planned_for).max(), np.abs(moved).max()) > WRONG:
                self._arrivals += has_arrived
                self._sight, self._failures = None, 0
        if self._sight is None or self._failures:
            self._planned_for, self._errors = facts, belief.length_errors.copy()
            self._prepare()

    def _prepare(self) -> None:
        """Set model, distances and the target's radius for the next plan."""
        largest = float(np.abs(self._errors).max())
        if largest > SAME_LENGTH:
            share = LENGTH_SHARES[self._failures // len(self._clearances) % len(LENGTH_SHARES)]
            self._model = self._nominal[0].with_lengths(share * self._errors)
            self._shapes, self._search = ArmShapes(self._model), search_for(self._model, self._task)
        reserve = min(max(RESERVED * self._spread, RESERVED_FOR_LINKS * largest), LARGEST_RESERVE)
        usual = self._usual_clearances
        farther = usual[0] + reserve, usual[0] + reserve / 2
        self._clearances = (*farther, *usual) if reserve > NO_RESERVE else usual
        self._radius = self._task.tolerance * NARROWER**self._arrivals

    def _driven(self, q: Array) -> tuple[Array, Array]:
        """Return position and velocity (dof,) of the drives when the next command acts."""
        return self._belief.commanded, self._belief.commanded_velocity


class JerkLimitedReachOmpl(ReachOmpl):
    """Executes the first plan as a jerk-limited trajectory, by the clock; goes on as `ReachOmpl` if the arm leaves it.

    It is as fast as is free of collisions, since it cuts the path's corners.
    """

    def reset(self) -> None:
        """Forget the plan, and the own commands."""
        super().reset()
        self._trajectory: Trajectory | None = None
        self._elapsed, self._lag = 0.0, np.zeros(self._model.dof)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, or velocities, for an observation (k,) with the boxes last."""
        limits = self._model.limits
        _, q, target, boxes = split(self._search, observation)
        q = np.clip(q, limits.lower, limits.upper)
        if self._elapsed == 0.0:
            self._plan(q, target, self._read(boxes))
            if len(self._path) > 1:
                self._trajectory = smooth(limits, np.clip(self._path, limits.lower, limits.upper), self._is_free)
                self._stream = CommandStream(limits, self._period, q)
        self._elapsed += self._period
        if self._trajectory is not None:
            is_late = self._elapsed > self._trajectory.duration + REPLAN_STEPS * self._period
            self._lag += SMOOTHING * (q - self._stream.position - self._lag)
            if is_late or np.abs(self._lag).max() > LOST:
                self._trajectory = None
        if self._trajectory is None:
            goal = super().act(observation)
            return goal if self._task.control == "position" else towards(goal, q, limits, self._period)
        state = self._trajectory.at(self._elapsed), self._trajectory.velocity_at(self._elapsed)
        through = self._stream.goal_through if self._task.control == "position" else self._stream.velocity_through
        return through(*state)

    def _is_free(self, trajectory: Trajectory) -> bool:
        """Return True if a trajectory keeps the distance of the motions ahead."""
        assert self._sight is not None
        places = trajectory.at(np.arange(0.0, trajectory.duration + SAMPLE, SAMPLE))
        return all(self._sight.is_edge_free(*edge) for edge in itertools.pairwise(places))
