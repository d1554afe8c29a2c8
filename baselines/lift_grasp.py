"""The scripted expert of lifting: opens the hand above the object, comes down, closes the fingers, and lifts.

The fingers are aligned with the object's nearer pair of sides, and the hand always points down. If the object does not
follow the hand, it begins again. Readings are averaged (`armctl.control.tool_motion`).
"""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options
from armctl.control.tool_motion import MotionWithoutMemory, ToolMotion
from armctl.core.arrays import Array
from armctl.core.options import Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel
from armctl.kinematics.grasp import grasp_turn, hand_turn
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.policies import PerWorld, made_for, sees
from armctl.scene import lift_table
from armctl.tasks import LiftOptions
from armctl.tasks.lift.state import LIFT_OBSERVATION
from armctl.tasks.reach import CONTROL_PERIOD

NEAR, ALIGNED = 0.01, 0.05
"""m and rad: a place and a turn that are so near have been reached."""
TURN_SPEED = 1.5
"""rad/s of the hand."""
SLOWEST = 0.03
"""m/s of a hand that is on its way."""
LONGEST_MEAN = 20
"""Readings over which the object's place is averaged until the fingers close."""
TRUST = 0.3
"""Weight of a reading of how far the object is behind the hand."""
INSIDE = 0.015
"""m by which a hand without memory is beside or above the centre of an object that is between its fingers, at most."""
STEEPNESS, TURN_STEEPNESS = 8.0, 0.3
"""m/m and m/rad: it comes down in a funnel, the lower the nearer it is to the object's place and sides."""
DECISIVE_SPEED = 0.08
"""m/s: it is never slower before it lifts, so that a clone's errors do not stop it."""
UP = np.array((0.0, 0.0, 1.0))
LOST = 0.03
"""m: an object that is so far behind the hand has not been grasped."""


@options
class LiftGraspOptions:
    """Options of the expert."""

    speed: Positive = 0.4
    """m/s of the hand in free space."""
    lift_speed: Positive = 0.3
    """m/s of the hand with the object."""
    slowing: Positive = 5.0
    """1/s: nearer to a point, speed per distance."""
    closing: Positive = 0.4
    """s for which the fingers close before the hand lifts."""
    memory: bool = True
    """If False, actions are functions of the observation, which a network without a memory can learn."""


class Phase(Enum):
    """Phases of a grasp."""

    OVER = "over"
    """Motion to the point above the object."""
    DOWN = "down"
    CLOSE = "close"
    LIFT = "lift"


@made_for("armctl/ArmLift-v0", controls="panda: position")
@sees("model", family="scripted")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Scripted grasp: comes down over the object with the fingers along its sides, closes them, and lifts."""
    checked_options("lift_grasp", env, LiftOptions, "armctl/ArmLift-v0", LIFT_OBSERVATION, ["position"])
    chosen = changed_options(LiftGraspOptions(), options, "option of lift_grasp")
    tool = VerticalTool(ArmModel(env.robot), 0.0)
    kind = LiftGrasp if chosen.memory else MemorylessLiftGrasp
    return PerWorld([kind(tool, chosen) for _ in range(env.num_envs)])


class LiftGrasp:
    """Grasps and lifts with one arm."""

    motion_type: ClassVar[type[ToolMotion]] = ToolMotion

    def __init__(self, tool: VerticalTool, options: LiftGraspOptions) -> None:
        self._tool, self._options = tool, options
        self.reset()

    def reset(self) -> None:
        """Begin with an approach, and forget all readings."""
        self._motion: ToolMotion | None = None
        self._readings, self._height = 0, 0.0
        self._turn, self._turn_goal = 0.0, np.nan
        self._approach()

    def _approach(self) -> None:
        """Begin to go to the object, and to average where it is: place (3,), and cosine and sine of its yaw."""
        self._phase, self._sightings, self._object = Phase.OVER, 0, np.zeros(5)
        self._closing_steps, self._behind = 0, 0.0

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to and the hand's opening, for the parts of `LIFT_OBSERVATION`."""
        dof = self._tool.model.dof
        point, q, _, _, height, place, axis = np.split(
            observation[: 16 + dof].astype(float), np.cumsum((3, dof, 1, 6, 1, 3))
        )
        if self._motion is None:
            self._motion = self.motion_type(self._tool, CONTROL_PERIOD, q, point)
        hand = self._motion.read(q, point)
        self._readings += 1
        self._height += (float(height[0]) - self._height) / self._readings
        if self._phase in (Phase.OVER, Phase.DOWN):
            self._sight(np.append(place, axis))
        at = self._motion.at
        point = self._aim(at, hand, float(place[2]))
        self._motion.move(point, self._speed(at, float(np.linalg.norm(point - at))))
        step = TURN_SPEED * CONTROL_PERIOD
        self._turn += float(np.clip(self._turn_goal - self._turn, -step, step))
        opened = self._phase in (Phase.OVER, Phase.DOWN)
        return np.append(self._motion.goal(self._turn), lift_table.OPENING if opened else 0.0)

    def _speed(self, at: Array, distance: float) -> float:
        """Return the hand's speed, m/s, at a point (3,) m with a distance (m) to go."""
        fastest = self._options.lift_speed if self._phase is Phase.LIFT else self._options.speed
        return min(fastest, SLOWEST + self._options.slowing * distance)

    def _sight(self, reading: Array) -> None:
        """Average a reading of the object, and keep to the pair of sides that was chosen first."""
        self._sightings += 1
        self._object += (reading - self._object) / min(self._sightings, LONGEST_MEAN)
        yaw, quarter = float(np.arctan2(self._object[4], self._object[3])), np.pi / 2
        turn = grasp_turn(self._tool, self._object[:2], yaw)
        if np.isfinite(self._turn_goal):
            turn -= quarter * round((turn - self._turn_goal) / quarter)
        self._turn_goal = turn

    def _aim(self, at: Array, hand: Array, object_height: float) -> Array:
        """Return where the hand, commanded `at` a point, is to go (3,) m."""
        place = self._object[:2]
        over, grasp = np.append(place, lift_table.APPROACH_HEIGHT), np.append(place, lift_table.GRASP_HEIGHT)
        if self._phase is Phase.OVER:
            if hand[2] < over[2] - NEAR and np.hypot(*(hand - over)[:2]) > NEAR:
                return np.append(at[:2], over[2])
            if np.linalg.norm(hand - over) > NEAR or abs(self._turn - self._turn_goal) > ALIGNED:
                return over
            self._phase = Phase.DOWN
        if self._phase is Phase.DOWN:
            if np.linalg.norm(hand - grasp) > NEAR / 2:
                return grasp
            self._phase = Phase.CLOSE
        if self._phase is Phase.CLOSE:
            self._closing_steps += 1
            if self._closing_steps * CONTROL_PERIOD <= self._options.closing:
                return grasp
            self._phase = Phase.LIFT
        behind = (hand[2] - grasp[2]) - (object_height - self._object[2])
        self._behind += TRUST * (behind - self._behind)
        if self._behind > LOST:
            self._approach()
            return at
        rise = self._height - self._object[2] + self._behind
        return np.append(place, lift_table.GRASP_HEIGHT + rise)


class MemorylessLiftGrasp(LiftGrasp):
    """Grasps and lifts with one arm by the present observation alone: places and the opening decide the phase."""

    motion_type = MotionWithoutMemory

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to and the hand's opening, for the parts of `LIFT_OBSERVATION`."""
        self.reset()
        _, self._finger_opening, axes = np.split(
            observation[: 10 + self._tool.model.dof].astype(float), (3 + self._tool.model.dof, 4 + self._tool.model.dof)
        )
        self._turn = self._turn_goal = hand_turn(self._tool, axes[3:])
        return super().act(observation)

    def _aim(self, at: Array, hand: Array, object_height: float) -> Array:
        place, above = self._object[:2], hand[2] - object_height
        aside, turn = float(np.hypot(*(hand[:2] - place))), abs(self._turn - self._turn_goal)
        is_open = self._finger_opening > lift_table.GRIPPED
        if aside < INSIDE and -INSIDE < above < (INSIDE if is_open else 2 * INSIDE):
            self._phase = Phase.CLOSE if is_open else Phase.LIFT
            return np.append(place, lift_table.GRASP_HEIGHT) if is_open else hand + (self._height - object_height) * UP
        if not is_open or (aside > 2 * INSIDE and hand[2] < lift_table.APPROACH_HEIGHT - NEAR):
            return np.append(hand[:2], lift_table.APPROACH_HEIGHT)
        funnel = STEEPNESS * max(0.0, aside - NEAR / 2) + TURN_STEEPNESS * max(0.0, turn - ALIGNED)
        return np.append(place, min(lift_table.APPROACH_HEIGHT, lift_table.GRASP_HEIGHT - 2 * NEAR + funnel))

    def _speed(self, at: Array, distance: float) -> float:
        if self._phase is not Phase.LIFT:
            return max(DECISIVE_SPEED, super()._speed(at, distance))
        gripping = 2 * SLOWEST + self._options.slowing * abs(float(at[2]) - lift_table.GRASP_HEIGHT)
        return min(super()._speed(at, distance) + SLOWEST, gripping)
