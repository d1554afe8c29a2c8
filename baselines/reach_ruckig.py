"""The jerk-limited expert: to a configuration in the target sphere, by Ruckig, replanned at every control step.

Of the configurations that are reached early, it takes the one with the earliest collision-free jerk-limited motion into
the sphere, among the observed boxes if there are any. The motion goes on from the commanded state, not from the
readings, to a goal that is corrected by these: by the mean of the observed targets, and by the offset of the observed
tip from the model's. It passes a moving target at the target's velocity.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.baselines.reach_task import boxes_reader, checked_options, search_for, split
from armctl.control.streaming import CommandStream
from armctl.control.trajectory import JerkLimitedMotion, scaled
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.kinematics.room import ROOM, with_room
from armctl.policies import PerWorld, made_for, sees
from armctl.robot_description.joint_profiles import fly_by_setpoint
from armctl.tasks import OBSERVATION, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

CONTROLS = ("position", "relative", "delta", "velocity")
MARGIN = 0.95
"""Fraction of the tolerance to aim at, as a reserve for servo errors."""
SAMPLE = 0.01
"""s: time between the points of a motion at which entry and collisions are checked."""
SMOOTHING = 0.1
"""Weight of the latest reading, of the tip's offset and of the joints' lag."""
BLOCKED = 0.2
"""rad: the same for joints that are not where they are thought to be."""
ACCELERATION_SMOOTHING = 0.5
"""The same of a moving target's acceleration, the difference of its velocities."""
LARGEST_LAG = 0.05
"""rad: mean lag of joints behind their commands beyond which something blocks or pulls them, if they had time."""
LAG = 0.01
"""s that joints are behind the drives."""
DAMPING = 1e-4
"""m^2, of joint velocities near singularities."""
PATIENCE = 0.4
"""s until it looks again for a free motion among boxes, and so much longer each time."""
REPLAN_STEPS = 5
"""Control steps after the planned arrival until it chooses a configuration again."""

Fraction = Annotated[float, Field(gt=0, le=1)]


@options
class ReachRuckigOptions:
    """Fractions of the joints' limits that are used."""

    velocity: Fraction = 1.0
    acceleration: Fraction = 1.0
    jerk: Fraction = 1.0


@made_for(
    "armctl/ArmReach* armctl/ArmPose-v0 armctl/ArmScenes-v0",
    controls="arms: not torque",
    interface={"control": "velocity"},
)
@sees("model", family="Ruckig")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Jerk-limited minimum-time motion to the configuration that gets there first, replanned on line by Ruckig."""
    task = checked_options("reach_ruckig", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, CONTROLS, poses=True)
    shares = changed_options(ReachRuckigOptions(), options, "option of reach_ruckig")
    search = search_for(ArmModel(env.robot), task)
    return PerWorld([ReachRuckig(search, task, shares) for _ in range(env.num_envs)])


class ReachRuckig:
    """Reaches with one arm."""

    def __init__(self, search: MinimumTimeReach, task: ReachOptions, shares: ReachRuckigOptions) -> None:
        self._search, self._tolerance, self._control = search, task.tolerance, task.control
        self._moving, self._read_boxes = "target_velocity" in task.parts, boxes_reader(task)
        self._limits = scaled(search.model.limits, shares.velocity, shares.acceleration, shares.jerk)
        self.reset()

    def reset(self) -> None:
        """Forget the motion and all readings."""
        self._model = self._search.model
        self._motion: JerkLimitedMotion | None = None
        self._target, self._tip_offset = np.zeros((2, len(self._search.place(self._model.home))))
        self._target_velocity, self._target_acceleration = np.zeros((2, 3))
        self._lag, self._correction = np.zeros(self._model.dof), np.zeros(self._model.dof)
        self._readings = self._choices = self._steps_to_choice = 0

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return the action (dof,) for an observation: positions of end-effector, joints and target, and others."""
        dof, readable = self._model.dof, bool(np.isfinite(observation).all())
        tip, q, target, extra = split(self._search, observation)
        if self._motion is None and not readable:
            return self._model.home if self._control == "position" else np.zeros(dof)
        if self._motion is None:
            self._motion = JerkLimitedMotion(self._limits, CONTROL_PERIOD, q)
            self._stream = CommandStream(self._model.limits, CONTROL_PERIOD, q)
            if self._read_boxes:
                self._model = self._model.among(self._read_boxes(extra))
        if readable:
            self._read(tip, q, target, extra)
        if self._steps_to_choice <= 0 and (self._choices == 0 or self._is_astray()):
            self._choose(self._motion)
        self._steps_to_choice -= 1
        goal, velocity = self._beside() if self._moving else (self._corrected_goal(), None)
        self._motion.step(goal - self._correction, velocity)
        return self._action(self._motion.position, self._motion.velocity)

    def _read(self, tip: Array, q: Array, target: Array, extra: Array) -> None:
        """Take in readings: of a static target, their mean."""
        self._readings += 1
        self._tip, self._q = tip, q
        self._target += (target - self._target) / (1 if self._moving else self._readings)
        if self._moving:
            change = (extra[:3] - self._target_velocity) / CONTROL_PERIOD if self._readings > 1 else np.zeros(3)
            self._target_acceleration += ACCELERATION_SMOOTHING * (change - self._target_acceleration)
            self._target_velocity = extra[:3]
        self._tip_offset += SMOOTHING * (tip - self._search.place(q) - self._tip_offset)
        self._lag += SMOOTHING * (q - self._stream.position - self._lag)

    def _is_astray(self) -> bool:
        """Return True if a static target was missed, or a moving one is lost or leads into a collision."""
        is_far = float(np.linalg.norm(self._tip - self._target)) > self._tolerance
        return not self._moving or is_far or not self._model.is_free(self._goal)

    def _choose(self, motion: JerkLimitedMotion) -> None:
        """Choose where to go: in a sphere that becomes smaller with each choice that did not suffice."""
        self._choices += 1
        if self._choices > 1:
            self._catch_up(motion)
        self._aim = self._target - self._tip_offset
        radius = MARGIN * self._tolerance / (1 if self._moving else self._choices)
        start, search = motion.position + self._correction, self._search
        posture = with_room(search.ik, self._aim, start, ROOM) if self._moving else None
        early = search.candidates(start, self._aim, radius) if posture is None else posture[None]
        entry = self._earliest(motion, early, radius)
        if entry is None:
            entry = self._earliest(motion, search.at_centre(start, self._aim), radius)
        if entry is None:
            entry = self._last_resort(motion, early, radius)
        self._goal, time = entry
        self._jacobian = self._search.place_jacobian(self._goal)
        self._steps_to_choice = REPLAN_STEPS + math.ceil(time / CONTROL_PERIOD)

    def _last_resort(self, motion: JerkLimitedMotion, early: Array, radius: float) -> "Entry":
        """Return a motion where none is free of collisions: among boxes none, elsewhere the earliest or nearest."""
        if self._read_boxes:
            return Entry(motion.position, PATIENCE * self._choices)
        if len(early):
            return self._entry(motion, early[0], radius)[0]
        return Entry(self._search.closest(self._aim, motion.position), 0.0)

    def _catch_up(self, motion: JerkLimitedMotion) -> None:
        """Command beyond the goal what joints lag behind, as under a payload; begin anew where they are blocked."""
        self._correction = np.where(np.abs(self._lag) > LARGEST_LAG, self._lag, 0.0)
        if np.abs(self._lag).max() > BLOCKED:
            motion.restart(motion.position + self._lag)
            self._stream = CommandStream(self._model.limits, CONTROL_PERIOD, motion.position)
            self._lag, self._correction = np.zeros((2, self._model.dof))

    def _earliest(self, motion: JerkLimitedMotion, configurations: Array, radius: float) -> "Entry | None":
        """Return the earliest collision-free entry by way of `configurations` (k, dof); None if there is none.

        Without a limit of jerk they would be reached earlier, one after the other: later ones need not be tried.
        """
        best, start = None, motion.position + self._correction
        for q, earliest in zip(configurations, self._model.min_time(start, configurations), strict=True):
            if best is not None and earliest >= best.time:
                break
            entry, is_free = self._entry(motion, q, radius)
            if is_free and (best is None or entry.time < best.time):
                best = entry
        return best

    def _entry(self, motion: JerkLimitedMotion, q: Array, radius: float) -> tuple["Entry", bool]:
        """Return the entry by way of `q` (dof,), braking beyond it if need be, and whether it is free of collisions."""
        start = motion.position + self._correction
        beyond = fly_by_setpoint(start, q, float(self._model.min_time(start, q)), self._limits)
        for goal in (beyond, q):
            path = self._correction + motion.preview(goal - self._correction, SAMPLE)
            inside = np.linalg.norm(self._search.places(path) - self._aim, axis=1) <= radius
            if inside.any():
                break
        last = int(inside.argmax()) if inside.any() else len(path) - 1
        return Entry(goal, SAMPLE * last), bool(self._model.are_free(path[: last + 1]).all())

    def _corrected_goal(self) -> Array:
        """Return the goal (dof,), shifted by what the readings have told of target and tip since it was chosen."""
        return self._goal + damped_step(self._jacobian, self._target - self._tip_offset - self._aim, DAMPING)

    def _beside(self) -> tuple[Array, Array]:
        """Return position and velocity (dof,) of joints that are at the moving target after the next control step."""
        ahead = CONTROL_PERIOD + LAG
        velocity = self._target_velocity + ahead * self._target_acceleration
        point = self._target - self._tip_offset + ahead * (self._target_velocity + velocity) / 2
        for _ in range(2):
            jacobian = self._model.jacobian(self._goal)[:3]
            self._goal = self._goal + damped_step(jacobian, point - self._model.position(self._goal), DAMPING)
        return self._goal, damped_step(jacobian, velocity, DAMPING)

    def _action(self, position: Array, velocity: Array) -> Array:
        """Return the action with which the drives have this state, (dof,) each, after the next control step."""
        if self._control in ("position", "relative"):
            goal = self._stream.goal_through(position, velocity)
            return goal if self._control == "position" else goal - self._q
        goal = self._stream.velocity_through(position, velocity)
        return goal if self._control == "velocity" else CONTROL_PERIOD * goal


class Entry(NamedTuple):
    """A motion into the target sphere."""

    goal: Array
    """(dof,) rad, to which the motion leads, maybe through the sphere."""
    time: float
    """s until it enters the sphere."""
