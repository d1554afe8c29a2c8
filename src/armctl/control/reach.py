"""Reaching with a real arm: set-points for its own controller, at 125 or 500 Hz.

`ReachController` takes a measurement and a target, and returns the position, velocity and acceleration to command in
the next period. Ruckig interpolates them within limits of velocity, acceleration and jerk; `GuardedMotion` sends none
after which the arm could not stop safely; `Watchdog` stops it if measurements end or contradict it. The configuration
at the target is that of `MinimumTimeReach`, as for the expert `reach_ik`, or a learned agent chooses it.

Loading this module loads neither a simulator nor Gymnasium.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import ArrayLike

from armctl.control.guarded_motion import GuardedMotion, Workspace
from armctl.control.trajectory import scaled
from armctl.control.watchdog import Watchdog, finite, within
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, described
from armctl.core.options import Positive, options
from armctl.kinematics.minimum_time_reach import MinimumTimeReach
from armctl.kinematics.model import ArmModel
from armctl.kinematics.room import moved_along
from armctl.robot_description import ArmDescription
from armctl.scene import NO_BOXES, Boxes

Fraction = Annotated[float, Gt(0), Le(1)]
JUMP = 0.03
"""m: a target that moves farther from one period to the next is a new one. Until then the arm moves along with it."""
TRIES = 16
"""Configurations to which the motion is examined, the earliest."""
OFF_CENTRE = 0.5
"""Fraction of the tolerance by which the end-effector may miss the target if it cannot reach the very place."""
PATIENCE = 0.5
"""s at rest until it plans again for a target that it did not get to."""
ACT_PERIOD = 0.04
"""s between two decisions of a learned agent, as in its training."""
FAR = 100.0
"""m: coordinates of a place that no arm reaches."""
STILL = 0.05
"""rad/s: largest speed of a joint at the beginning."""


@options
class ReachControllerOptions:
    """Options of `ReachController`."""

    rate: Positive = 500.0
    """Set-points per second: 500 for a UR of the e-Series, 125 for an older one."""
    velocity: Fraction = 0.5
    """Fraction of the joints' velocity limits that is used."""
    acceleration: Fraction = 0.25
    """Fraction of their acceleration limits."""
    jerk: Fraction = 0.25
    """Fraction of their jerk limits."""
    tolerance: Positive = 0.05
    """m: largest distance of the end-effector from a target that counts as reached."""
    workspace: Workspace | None = None
    """Lowest and highest corner (x, y, z) of a box that the end-effector stays in, m; None: all above the floor."""
    margin: Positive = 0.02
    """m that links keep from each other, the floor and boxes; half of their distance at home if that is less."""
    max_age: Positive = 0.05
    """s without a new measurement after which the arm stops."""
    following_error: Positive = 0.1
    """rad between a measured joint and all set-points of the last `delay` after which the arm stops."""
    delay: Positive = 0.2
    """s by which the arm may follow its set-points late."""
    background: bool = True
    """Plan in a thread, so that no set-point waits for a plan. False: plan between two set-points."""


class State(Enum):
    """Condition of the motion; `SetPoint.reason` says why."""

    WAITING = "waiting"
    """Rest without a target, or until there is a plan."""
    MOVING = "moving"
    ARRIVED = "arrived"
    """The measured end-effector is within the tolerance of the target; the motion goes on to its middle."""
    STOPPING = "stopping"
    """Braking, since measurements have ended, or there is no target, or no safe motion to it."""
    BLOCKED = "blocked"
    """Rest, since there is no safe motion to the target; it plans again from time to time."""


@dataclass(frozen=True, eq=False)
class SetPoint:
    """Command for the next period: (dof,) rad, rad/s and rad/s^2."""

    position: Array
    velocity: Array
    acceleration: Array
    state: State
    reason: str = ""
    """Reason that the arm does not move to the target; empty if it does."""


@dataclass(frozen=True, eq=False)
class _Plan:
    aim: Array
    """(3,) m."""
    goal: Array | None
    """(dof,) rad; None: there is no motion."""
    reason: str = ""


class ReachController:
    """Moves one arm to targets, period by period.

    `act` is a learned agent in place of the search: a function from the observation of `armctl/ArmReach-v0` (positions
    of end-effector, joints and target, (6 + dof,)) to joint positions (dof,) to move to, called every `ACT_PERIOD`.
    """

    def __init__(
        self,
        arm: str | Path | ArmDescription = "ur5",
        options: ReachControllerOptions | None = None,
        *,
        boxes: Boxes = NO_BOXES,
        act: Callable[[Array], ArrayLike] | None = None,
    ) -> None:
        self.options = chosen = options or ReachControllerOptions()
        self.model, self.period = ArmModel(arm).among(boxes), 1 / chosen.rate
        limits = scaled(self.model.limits, chosen.velocity, chosen.acceleration, chosen.jerk)
        self._motion = GuardedMotion(self.model, limits, self.period, chosen.workspace, chosen.margin)
        self._watchdog = Watchdog(
            self.model.limits, self.period,
            max_age=chosen.max_age, following_error=chosen.following_error, delay=chosen.delay,
        )  # fmt: skip
        self._act = act
        planner = self.model.among(boxes)  # of its own: models are not thread-safe
        self._search = MinimumTimeReach(planner)
        self._preview = GuardedMotion(planner, limits, self.period, chosen.workspace, chosen.margin)
        self._executor: Executor | None = ThreadPoolExecutor(1, "planner") if chosen.background else None
        for place in (self.model.position(self.model.home), np.full(3, FAR)):  # compiles what a plan needs
            self._choose(self._motion.state, place)
        self.acknowledge()

    def acknowledge(self) -> None:
        """Begin anew with the next measurement, after a fault. The arm has to be at rest."""
        self.fault = ""
        """The fault for which the arm stops, until `acknowledge`; empty if there is none."""
        self._is_running, self._ticks, self._retry = False, 0, 0
        self._plan: _Plan | None = None
        self._pending: Future[_Plan] | None = None
        self._refused = ""

    def begin(self, q: ArrayLike, qd: ArrayLike) -> None:
        """Begin at rest at the measured joint positions `q` (dof,) rad; `step` does so with its first measurement.

        Raises `ConfigurationError` for an arm that moves, or whose joints are beyond their limits.
        """
        position, velocity = finite(q, self.model.dof), finite(qd, self.model.dof)
        if position is None or velocity is None or not within(self.model.limits, position):
            raise ConfigurationError(f"the joints should begin within their limits, not at {q!r}")
        if np.abs(velocity).max() > STILL:
            raise ConfigurationError(f"the arm should begin at rest; its joints move at {velocity} rad/s")
        position = np.clip(position, self.model.limits.lower, self.model.limits.upper)
        for motion in (self._motion, self._preview):
            motion.restart(position)
        self._watchdog.restart(position)
        self._is_running = True

    def step(
        self, q: ArrayLike | None, qd: ArrayLike | None, target: ArrayLike | None, stamp: float | None = None
    ) -> SetPoint | None:
        """Return the next set-point towards a `target` (3,) m in the arm's base frame; None is no target: it stops.

        `q` and `qd` (dof,) are the measured joint positions and velocities, None if there is no measurement. A `stamp`
        (s, of any clock) that does not change says that they are not new. Call it once a period.

        None says that nothing is to be sent: until there is a measurement of an arm at rest, and after a `fault`. If no
        measurements come, the motion brakes first; an arm that does not follow its set-points gets no more of them, so
        that its own controller stops it. Raises `ConfigurationError` as `begin` does, and nothing after it.
        """
        return self._step(q, qd, stamp, lambda: self._towards_target(target), target)

    def step_to(
        self, q: ArrayLike | None, qd: ArrayLike | None, posture: ArrayLike, stamp: float | None = None
    ) -> SetPoint | None:
        """Return the next set-point towards joint positions `posture` (dof,) rad; otherwise as `step`."""
        return self._step(q, qd, stamp, lambda: self._towards_posture(posture), None)

    def close(self) -> None:
        """End the planner's thread."""
        if self._executor is not None:
            self._executor.shutdown()

    def _step(
        self, q: ArrayLike | None, qd: ArrayLike | None, stamp: float | None,
        goal_of: Callable[[], tuple[Array | None, str]], target: ArrayLike | None,
    ) -> SetPoint | None:  # fmt: skip
        if not self._is_running:
            velocity = finite(qd, self.model.dof)
            if q is None or finite(q, self.model.dof) is None or velocity is None or np.abs(velocity).max() > STILL:
                return None
            self.begin(q, velocity)
        self._ticks += 1
        problem = self._watchdog.problem(q, qd, stamp)
        self.fault = self.fault or problem
        if self.fault and (self._motion.is_at_rest or not self._watchdog.is_followed):
            return None
        if self._motion.is_at_rest and self._ticks >= self._retry:
            self._refused = ""
        reason = self.fault or self._refused
        goal, reason = (None, reason) if reason else goal_of()
        if goal is None:
            self._motion.brake()
        elif not self._motion.towards(goal):
            goal = None
            reason = "the motion is no longer safe: the arm would leave its limits or come too near to something"
            self._refused, self._plan, self._retry = reason, None, self._ticks + round(PATIENCE / self.period)
        self._watchdog.commanded(self._motion.state[0])
        return SetPoint(*self._motion.state, *self._state(goal, reason, target))

    def _state(self, goal: Array | None, reason: str, target: ArrayLike | None) -> tuple[State, str]:
        if goal is None:
            if not self._motion.is_at_rest:
                return State.STOPPING, reason
            return State.BLOCKED if reason else State.WAITING, reason
        point = finite(target, 3)
        if point is None:
            return (State.ARRIVED if self._motion.is_at_rest else State.MOVING), ""
        distance = float(np.linalg.norm(self.model.position(self._watchdog.measured) - point))
        return (State.ARRIVED if distance <= self.options.tolerance else State.MOVING), ""

    def _towards_posture(self, posture: ArrayLike) -> tuple[Array | None, str]:
        """Return joint positions (dof,) to move to, or None and the reason."""
        goal = finite(posture, self.model.dof)
        if goal is None or not self.model.within_limits(goal):
            return None, f"the posture is not {self.model.dof} joint positions within their limits"
        self._plan = None
        return goal, ""

    def _towards_target(self, target: ArrayLike | None) -> tuple[Array | None, str]:
        """Return joint positions (dof,) to move to, or None and the reason."""
        point = finite(target, 3)
        if target is None:
            self._plan = None
            return None, ""
        if point is None:
            return None, "the target is no finite position"
        return self._planned(point) if self._act is None else self._acted(self._act, point)

    def _acted(self, act: Callable[[Array], ArrayLike], point: Array) -> tuple[Array | None, str]:
        """Return what the agent decides, or decided last."""
        if self._ticks % max(1, round(ACT_PERIOD / self.period)) == 0 or self._plan is None:
            q = self._watchdog.measured
            try:
                goal = finite(act(np.concatenate((self.model.position(q), q, point))), self.model.dof)
                reason = "" if goal is not None else "the agent gives no finite joint positions"
            except Exception as error:  # of an agent, which must not end the control loop
                goal, reason = None, f"the agent failed: {described(error)}"
            self._plan = _Plan(point, goal, reason)
        return self._plan.goal, self._plan.reason

    def _planned(self, point: Array) -> tuple[Array | None, str]:
        """Return the planned joint positions, moved along with the target; plan anew if it is another."""
        plan = self._received()
        if plan is None or self._is_outdated(plan, point):
            self._request(point)
            plan = self._received()
        if plan is None:
            return None, ""
        if plan.goal is not None and not np.array_equal(plan.aim, point) and self._is_near(plan.aim, point):
            self._plan = plan = _Plan(point, moved_along(self.model, plan.goal, point, self.period))
        return plan.goal, plan.reason

    def _is_outdated(self, plan: _Plan, point: Array) -> bool:
        """Return True if a plan is for another target, has lost it, or there was none and it is time to try again."""
        if not self._is_near(plan.aim, point):
            return True
        if plan.goal is None:
            return self._ticks >= self._retry
        return float(np.linalg.norm(self.model.position(plan.goal) - plan.aim)) > self.options.tolerance

    def _is_near(self, aim: Array, point: Array) -> bool:
        return float(np.linalg.norm(aim - point)) <= JUMP

    def _request(self, point: Array) -> None:
        """Have a plan made from the present state, unless one is being made."""
        if self._pending is None and self._executor is not None:
            self._pending = self._executor.submit(self._safe_plan, self._motion.state, point)
        elif self._pending is None:
            self._pending = Future()
            self._pending.set_result(self._safe_plan(self._motion.state, point))

    def _received(self) -> _Plan | None:
        """Return the latest plan, if any."""
        if self._pending is not None and self._pending.done():
            self._plan, self._pending = self._pending.result(), None
            self._retry = self._ticks + round(PATIENCE / self.period)
        return self._plan

    def _safe_plan(self, state: tuple[Array, Array, Array], point: Array) -> _Plan:
        try:
            return self._choose(state, point)
        except Exception as error:  # of a planner, which must not end the control loop
            return _Plan(point, None, f"planning failed: {described(error)}")

    def _choose(self, state: tuple[Array, Array, Array], point: Array) -> _Plan:
        """Return the earliest safe motion from a state to a target, one of some configurations there."""
        start, guard = state[0], self._preview
        if not guard.is_in_workspace(point):
            return _Plan(point, None, "the target is outside the workspace")
        choices: list[Any] = [
            lambda: self._search.at_centre(start, point),
            lambda: self._search.candidates(start, point, OFF_CENTRE * self.options.tolerance),
        ]
        reachable = False
        for configurations in (choice() for choice in choices):
            for q in configurations[self.model.within_limits(configurations)][:TRIES]:
                reachable = True
                if guard.is_allowed(guard.preview(state, q)):
                    return _Plan(point, q)
        return _Plan(
            point, None, "no safe motion to the target was found" if reachable else "the target is out of reach"
        )
