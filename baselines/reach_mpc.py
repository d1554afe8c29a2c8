"""The MPC expert: receding-horizon control of the arm's joints, with the target's motion predicted.

It looks up a posture once per episode in a table of configurations, since the optimisation is local. Among boxes, if
the straight motion there is not free, it looks up a way of one or two straight joint motions that are, and tracks the
end-effector's positions on them. Each control step then plans 0.8 s and commands the first period. Where it gets stuck,
it looks up another posture. It sees only the observation, which includes the boxes if there are any.
"""

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import boxes_reader, checked_options, planning, search_for, split
from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.control.reach_problem import JointTrajectory
from armctl.control.streaming import CommandStream
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface
from armctl.estimation.arm_observer import ArmObserver, ArmReadings, StandingObjects
from armctl.kinematics import ArmModel, MinimumTimeReach, ReachabilityMap
from armctl.kinematics.room import ROOM, moved_along, with_room
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.policies import PerWorld, made_for, sees
from armctl.tasks import OBSERVATION, ReachOptions


@options
class ReachMpcExpertOptions(ReachMpcOptions):
    """Options of the expert: those of its MPC, and of its estimation."""

    prepared: bool = True
    """Estimate joints, links, load, target and delay. False: believe every reading, and the model."""


STUCK_STEPS, MIN_PROGRESS = 12, 0.005
"""Control steps in which the tip came less than so many m nearer to the target, or the joints so many rad nearer to the
end of a way, after which another posture is looked up; without boxes, the arm goes there first."""
PASSING = 0.3
"""rad: largest joint error at which a posture on the way counts as passed."""
WAY_POINTS = 25
"""Configurations on each straight motion of a way at which distances are measured."""
ON_WAY = 0.05
"""Weight of a joint's distance from the posture ahead on a way, m^2/rad^2."""
POSTURE_TOLERANCE = 0.02
"""rad: largest joint error at which a posture counts as reached."""
FARTHEST_AHEAD = 0.5
"""s: a moving target is met so far ahead at most."""
AMONG_BOXES = ReachMpcExpertOptions()
WITHOUT_BOXES = ReachMpcExpertOptions(margin=0.01, influence_distance=0.06)
"""Nearer to the floor and to itself than an arm goes to boxes."""


@made_for("armctl/ArmReach* armctl/ArmPose-v0 armctl/ArmScenes-v0", controls="arms: position")
@sees("model", family="MPC")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """MPC with OSQP on Pinocchio's kinematics: keeps joint limits and predicts the target's motion."""
    task = checked_options("reach_mpc", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, ["position"], poses=True)
    configurations, usual = ReachabilityMap(ArmModel(env.robot)), AMONG_BOXES if boxes_reader(task) else WITHOUT_BOXES
    search, mpc = search_for(configurations.model, task), changed_options(usual, options, "option of reach_mpc")
    clocks = (functools.partial(env.control_step, i) for i in range(env.num_envs))
    experts = [ReachWithMpc(configurations, search, task, mpc, clock) for clock in clocks]
    return PerWorld(experts, prepared=mpc.prepared)


class ReachWithMpc:
    """Reaches with one arm."""

    def __init__(
        self,
        reachability_map: ReachabilityMap,
        search: MinimumTimeReach,
        task: ReachOptions,
        options: ReachMpcExpertOptions,
        clock: Callable[[], int],
    ) -> None:
        self._model, self._map, self._tolerance = reachability_map.model, reachability_map, task.tolerance
        self._moving, self._read_boxes = "target_velocity" in task.parts, boxes_reader(task)
        self._clearances, self._effort = planning(task)
        self.mpc = ReachMpc(self._model, options)
        period = self.mpc.problem.period
        observer = ArmObserver(self._model, period, self._moving, clock)
        self._belief = observer if options.prepared else ArmReadings(period)
        self._search, self._tracks = search, self._moving and options.prepared
        self._ahead = self.mpc.problem.period * np.arange(1, self.mpc.problem.horizon + 1)[:, None]

    @property
    def failures(self) -> int:
        """Control steps without a solution, in which the arm braked."""
        return self.mpc.failures

    def reset(self) -> None:
        """Forget the plan."""
        self.mpc.reset()
        self._belief.reset()
        self._posture: Array | None = None
        self._stream: CommandStream | None = None
        self._plan: JointTrajectory | None = None
        self._way: list[Array] = []
        self._guided = False
        self._nearest, self._waited = np.inf, 0
        self._searches, self._axes = 0, StandingObjects()

    def plans(self) -> dict[str, Array]:
        """Return planned end-effector positions at the end of each period of the horizon, (N + 1, 3) m."""
        return {} if self._plan is None else {"horizon": self._model.positions(self._plan.positions)}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation (6 + dof + k,)."""
        tip, q, target, extra = split(self._search, observation)
        self._tip_axes = tip[3:]
        self._axes.read(target[3:])
        self._belief.read(tip[:3], q, target[:3], extra[:3] if self._moving else None)
        command = self._goal(extra) - self._belief.load_offset
        self._belief.send(command)
        return np.asarray(command)

    def _goal(self, extra: Array) -> Array:
        """Return the joint positions (dof,) to move to without a load."""
        belief = self._belief
        offset = np.concatenate((belief.tip - belief.target, self._tip_axes - self._axes.mean))
        distance = float(np.linalg.norm(offset))
        if self._posture is None:
            return self._first_goal(extra)
        if self._is_stuck(distance):
            self._posture = self._chosen()
            if not self._read_boxes:
                self._stream = self._plan = None
        if self._stream is None and not self._is_there(distance):
            return self._posture
        assert self._stream is not None
        if len(self._way) and np.abs(belief.joints - self._posture).max() < PASSING:
            self._posture, self._way = self._way[0], self._way[1:]
        posture = None if distance < self._tolerance else self._posture
        targets = self._places(belief.target_ahead(self._ahead[:, 0]) - belief.tip_offset(self._arrival()))
        if self._guided:
            ahead = self._ahead_on_way(self._stream.position, self._posture)
            targets, posture = self._search.places(ahead), ahead[-1]
        self._plan = self.mpc.plan(self._stream.position, self._stream.velocity, targets, posture)
        return self._stream.goal(self._plan)

    def _places(self, positions: Array) -> Array:
        """Return target places (..., 3 or 12) m from positions (..., 3) m, with the axes of a target that has some."""
        axes = np.broadcast_to(self._axes.mean, (*positions.shape[:-1], len(self._axes.mean)))
        return np.concatenate((positions, axes), axis=-1)

    def _is_there(self, distance: float) -> bool:
        """Start the MPC in the posture, or at a target that moves along with it; return whether the arm is there."""
        belief, limits, period = self._belief, self._model.limits, self.mpc.problem.period
        assert self._posture is not None
        if self._tracks:
            assert isinstance(belief, ArmObserver)
            ahead = np.clip(self._model.min_time(belief.joints_ahead, self._posture), period, FARTHEST_AHEAD)
            meeting = belief.target_ahead(ahead) - belief.tip_offset(self._posture)
            self._posture = moved_along(self._model, self._posture, meeting, period)
            if distance > self._tolerance:
                return False
            self._stream = CommandStream(limits, period, belief.commanded, belief.commanded_velocity)
        elif np.abs(belief.joints_ahead - self._posture).max() > POSTURE_TOLERANCE:
            return False
        else:
            self._stream = CommandStream(limits, period, self._posture)
        self.mpc.reset()
        return True

    def _arrival(self) -> Array:
        """Return the joint positions (dof,) at the end of the last plan, or the posture without one."""
        assert self._posture is not None
        return self._posture if self._plan is None else self._plan.positions[-1]

    def _first_goal(self, extra: Array) -> Array:
        """Start towards a posture, without a full plan: looking the posture up takes time."""
        if self._read_boxes:
            self.mpc.surround(self._read_boxes(extra))
        q, self._posture = self._belief.joints_ahead, self._chosen()
        self._stream = CommandStream(self._model.limits, self.mpc.problem.period, q)
        self._plan = self.mpc.begin(q, np.zeros_like(q), self._posture)
        return self._stream.goal(self._plan)

    def _chosen(self) -> Array:
        """Return the posture (dof,) to go to.

        Among boxes it is the first of a way, if one is found, unless at first, the straight motion to the posture
        reached earliest is free: then the target itself is tracked, which is faster.
        """
        q, target = self._belief.joints_ahead, self._belief.target
        if self._posture is not None:
            target = target - self._belief.tip_offset(self._arrival())
        if self._tracks:
            posture = with_room(self._search.ik, target, q, ROOM)
            if posture is not None:
                return posture
        if len(self._axes.mean):
            place = self._places(target)
            entry = self._search.find(q, place, self._tolerance / 2)
            goal = self._search.closest(place, q) if entry is None else entry.q
        else:
            goal = self._map.towards(target, q, self.mpc.model)
        self._guided, self._way = False, []
        straight = self._posture is None and self.mpc.model.are_free(np.linspace(q, goal, WAY_POINTS)).all()
        if not self._read_boxes or straight:
            return goal
        way = self._way_to(self._places(target), q)
        if not len(way):
            return goal
        if self._posture is not None:
            self.mpc.reset()  # a plan that does not move is a local optimum: begin with the straight motion
        self._guided, self._way = True, list(way[1:])
        corners, shares = np.vstack((q, way)), np.linspace(0, 1, WAY_POINTS)[:, None, None]
        self.mpc.follow((corners[:-1] + shares * np.diff(corners, axis=0)).reshape(-1, len(q)), ON_WAY)
        return np.asarray(way[0])

    def _way_to(self, target: Array, q: Array) -> Array:
        """Return a way (k, dof) from `q` (dof,) of the table, or a planned one where it has none; (0, dof) if none."""
        boxes, limits = self.mpc.model.boxes, self._model.limits
        if not self._searches and len(target) == 3 and len(way := self._map.way(target, q, boxes)):
            return way
        clearance, self._searches = self._clearances[min(self._searches, len(self._clearances) - 1)], self._searches + 1
        choice = ArmPlannerOptions(clearance=clearance, seed=self._searches, **self._effort)
        planner = ArmPlanner(self._model, choice, self._search)
        return planner.plan(np.clip(q, limits.lower, limits.upper), target, self._tolerance, boxes).path[1:]

    def _ahead_on_way(self, q: Array, posture: Array) -> Array:
        """Return the configurations (N, dof) of the straight motion from `q` (dof,) to `posture` (dof,)."""
        time = max(float(self._model.cruise_time(q, posture)), self.mpc.problem.period)
        return np.asarray(q + np.minimum(self._ahead / time, 1.0) * (posture - q))

    def _is_stuck(self, distance: float) -> bool:
        """Return True if the tip has not come nearer to the target, or the joints to the end of a way, for long."""
        remaining = self._remaining() if self._guided else distance
        if remaining < self._nearest - MIN_PROGRESS:
            self._nearest, self._waited = remaining, 0
        self._waited += 1
        if distance < self._tolerance or self._waited <= STUCK_STEPS or (self._tracks and self._stream is None):
            return False
        self._nearest, self._waited = np.inf, 0
        return True

    def _remaining(self) -> float:
        """Return the length of the rest of the way, rad of the joint that moves most."""
        assert self._posture is not None
        corners = np.array((self._belief.joints, self._posture, *self._way))
        return float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
