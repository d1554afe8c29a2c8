"""The scripted expert of pushing: comes down behind the object and pushes it along the line to the target.

While it pushes, it steers the tool back onto that line, which begins at the object and is new at each control step. If
the object has drifted off the tool, it lifts the tool and begins again. The tool always points down. Readings are
averaged (`armctl.control.tool_motion`).
"""

import math
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.baselines.reach_task import checked_options
from armctl.control.tool_motion import MotionWithoutMemory, ToolMotion
from armctl.core.arrays import Array
from armctl.core.options import Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.policies import PerWorld, made_for, sees
from armctl.scene import push_table
from armctl.tasks import PushOptions
from armctl.tasks.push.state import PUSH_OBSERVATION
from armctl.tasks.reach import CONTROL_PERIOD

NEAR = 0.01
"""m: a point so near has been reached."""
SLOWEST = 0.02
"""m/s of a push."""
LIFT_SPEED = 0.4
"""m/s of the tool in free space."""
TRUST = 0.3
"""Weight of a reading of the object's place, beside what its velocity predicts."""
DRAW_BACK_SPEED = 0.1
"""m/s away from an object that has arrived."""
LOW = push_table.TOOL_HEIGHT + 0.02
"""m: height of the tool below which one without memory pushes."""


@options
class PushLineOptions:
    """Options of the expert."""

    speed: Positive = 0.25
    """m/s of a push far from the target."""
    slowing: Positive = 3.0
    """1/s: nearer to the target, speed per distance."""
    steering: Positive = 8.0
    """1/s: speed towards the line per distance from it."""
    drift: Positive = 0.03
    """m from the line at which a push is given up."""
    enough: Annotated[float, Field(gt=0, lt=1)] = 0.4
    """Share of the tolerance within which the tool stops."""
    memory: bool = True
    """If False, actions are functions of the observation, which a network without a memory can learn."""


class Phase(Enum):
    """Phases of a push."""

    OVER = "over"
    """Motion to the point above the place behind the object."""
    DOWN = "down"
    PUSH = "push"
    UP = "up"


@made_for("armctl/ArmPush-v0", controls="arms: position")
@sees("model", family="scripted")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Scripted push: comes down behind the object, pushes along the line, and begins again if it drifts off."""
    task = checked_options("push_line", env, PushOptions, "armctl/ArmPush-v0", PUSH_OBSERVATION, ["position"])
    chosen = changed_options(PushLineOptions(), options, "option of push_line")
    tool = VerticalTool(ArmModel(env.robot), push_table.TOOL_LENGTH)
    kind = PushLine if chosen.memory else MemorylessPushLine
    return PerWorld([kind(tool, task.tolerance, chosen) for _ in range(env.num_envs)])


class PushLine:
    """Pushes with one arm."""

    motion_type: ClassVar[type[ToolMotion]] = ToolMotion

    def __init__(self, tool: VerticalTool, tolerance: float, options: PushLineOptions) -> None:
        self._tool, self._options, self._close = tool, options, options.enough * tolerance
        self.reset()

    def reset(self) -> None:
        """Begin with an approach, and forget all readings."""
        self._phase = Phase.OVER
        self._motion: ToolMotion | None = None
        self._readings, self._target = 0, np.zeros(3)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation: tool, joints, target, and the object."""
        dof = self._tool.model.dof
        tool, q, target, place, _, moving = np.split(
            observation[: 14 + dof].astype(float), np.cumsum((3, dof, 3, 3, 2))
        )
        if self._motion is None:
            self._motion, self._place = self.motion_type(self._tool, CONTROL_PERIOD, q, tool), place
        motion = self._motion
        believed = motion.read(q, tool)
        self._readings += 1
        self._target += (target - self._target) / self._readings
        self._place = self._place + CONTROL_PERIOD * np.append(moving[:2], 0.0)
        self._place += TRUST * (place - self._place)
        to_target = self._target[:2] - self._place[:2]
        distance = math.hypot(*to_target)
        motion.move(*self._aim(motion.at, believed, to_target / max(distance, 1e-9), distance))
        return motion.goal()

    def _aim(self, at: Array, tool: Array, way: Array, distance: float) -> tuple[Array, float]:
        """Return where the tool, commanded `at` a point, is to go (3,) m, and its speed, m/s."""
        place = self._place[:2]
        behind = place - push_table.STAND_OFF * way
        along, across = (tool[:2] - place) @ way, (tool[:2] - place) @ np.array((-way[1], way[0]))
        if self._phase is Phase.PUSH and (along > 0 or abs(across) > self._options.drift):
            self._phase = Phase.UP
        if self._phase is Phase.UP:
            if tool[2] < push_table.LIFTED_HEIGHT - NEAR:
                return np.append(at[:2], push_table.LIFTED_HEIGHT), LIFT_SPEED
            self._phase = Phase.OVER
        if self._phase is Phase.OVER:
            over = np.append(behind, push_table.LIFTED_HEIGHT)
            if np.linalg.norm(tool - over) > NEAR:
                return over, LIFT_SPEED
            self._phase = Phase.DOWN
        if self._phase is Phase.DOWN:
            down = np.append(behind, push_table.TOOL_HEIGHT)
            if np.linalg.norm(tool - down) > NEAR:
                return down, LIFT_SPEED
            self._phase = Phase.PUSH
        if distance < self._close:
            return at, LIFT_SPEED
        speed = min(self._options.speed, max(SLOWEST, self._options.slowing * distance))
        move = speed * way - self._options.steering * across * np.array((-way[1], way[0]))
        return np.append(at[:2] + move * CONTROL_PERIOD, push_table.TOOL_HEIGHT), LIFT_SPEED


class MemorylessPushLine(PushLine):
    """Pushes with one arm by the present observation alone: places decide the phase.

    It draws the tool back from an object that is near enough to its target: one that still touches it may not rest.
    """

    motion_type = MotionWithoutMemory

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation: tool, joints, target, and the object."""
        self.reset()
        return super().act(observation)

    def _aim(self, at: Array, tool: Array, way: Array, distance: float) -> tuple[Array, float]:
        behind = self._place[:2] - push_table.STAND_OFF * way
        if tool[2] > push_table.LIFTED_HEIGHT - NEAR:
            self._phase = Phase.OVER
        elif tool[2] < LOW:
            self._phase = Phase.PUSH
        else:
            self._phase = Phase.DOWN if math.hypot(*(tool[:2] - behind)) < 2 * NEAR else Phase.UP
        if self._phase is Phase.PUSH and distance < self._close:
            return np.append(behind, push_table.TOOL_HEIGHT), DRAW_BACK_SPEED
        return super()._aim(at, tool, way, distance)
