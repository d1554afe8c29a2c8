"""The scripted expert of pushing: comes down behind the object and pushes it along the line to the target.

While it pushes, it steers the tool back onto that line, which begins at the object and is new at each control step. If
the object has drifted off the tool, it lifts the tool and begins again. The tool always points down. Readings are
averaged; the tool is believed to be where it is commanded to, with their mean offset from the arm's model.
"""

import math
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.control.streaming import CommandStream
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
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
LONGEST_MEAN = 20
"""Readings over which the mean offset of the tool from the arm's model is taken: it changes with the configuration."""


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
    if not isinstance(env.options, PushOptions) or env.options.control != "position":
        raise ConfigurationError(
            "push_line cannot play this task: use it with armctl/ArmPush-v0 and control 'position'"
        )
    if (parts := list(env.options.parts))[: len(PUSH_OBSERVATION)] != list(PUSH_OBSERVATION):
        raise ConfigurationError(
            f"push_line reads the observation {', '.join(PUSH_OBSERVATION)}, not {', '.join(parts)}"
        )
    chosen = changed_options(PushLineOptions(), options, "option of push_line")
    tool = VerticalTool(ArmModel(env.robot), push_table.TOOL_LENGTH)
    kind = PushLine if chosen.memory else MemorylessPushLine
    return PerWorld([kind(tool, env.options.tolerance, chosen) for _ in range(env.num_envs)])


class PushLine:
    """Pushes with one arm."""

    def __init__(self, tool: VerticalTool, tolerance: float, options: PushLineOptions) -> None:
        self._tool, self._options, self._close = tool, options, options.enough * tolerance
        self.reset()

    def reset(self) -> None:
        """Begin with an approach, and forget all readings."""
        self._phase = Phase.OVER
        self._stream: CommandStream | None = None
        self._readings, self._target = 0, np.zeros(3)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation: tool, joints, target, and the object."""
        dof = self._tool.model.dof
        tool, q, target, place, _, moving = np.split(
            observation[: 14 + dof].astype(float), np.cumsum((3, dof, 3, 3, 2))
        )
        if self._stream is None:
            self._stream = CommandStream(self._tool.model.limits, CONTROL_PERIOD, q)
            self._at, self._q, self._place, self._offset = tool, q, place, tool - self._tool.point(q)
        self._readings += 1
        self._target += (target - self._target) / self._readings
        self._place = self._place + CONTROL_PERIOD * np.append(moving[:2], 0.0)
        self._place += TRUST * (place - self._place)
        self._offset += (tool - self._tool.point(q) - self._offset) / min(self._readings, LONGEST_MEAN)
        to_target = self._target[:2] - self._place[:2]
        distance = math.hypot(*to_target)
        believed = self._tool.point(self._stream.position) + self._offset
        self._move(*self._aim(believed, self._place[:2], to_target / max(distance, 1e-9), distance))
        q = self._tool.configuration(self._at - self._offset, self._q)
        velocity, self._q = self._velocity(q), q
        return np.asarray(self._stream.goal_through(q, velocity))

    def _aim(self, tool: Array, place: Array, way: Array, distance: float) -> tuple[Array, float]:
        """Return where the tool is to go (3,) m, and its speed, m/s."""
        behind = place - push_table.STAND_OFF * way
        along, across = (tool[:2] - place) @ way, (tool[:2] - place) @ np.array((-way[1], way[0]))
        if self._phase is Phase.PUSH and (along > 0 or abs(across) > self._options.drift):
            self._phase = Phase.UP
        if self._phase is Phase.UP:
            if tool[2] < push_table.LIFTED_HEIGHT - NEAR:
                return np.append(self._at[:2], push_table.LIFTED_HEIGHT), LIFT_SPEED
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
            return self._at, LIFT_SPEED
        speed = min(self._options.speed, max(SLOWEST, self._options.slowing * distance))
        move = speed * way - self._options.steering * across * np.array((-way[1], way[0]))
        return np.append(self._at[:2] + move * CONTROL_PERIOD, push_table.TOOL_HEIGHT), LIFT_SPEED

    def _move(self, point: Array, speed: float) -> None:
        """Move the tool's next place towards a point at a speed."""
        step = point - self._at
        self._at = self._at + step * min(1.0, speed * CONTROL_PERIOD / max(float(np.linalg.norm(step)), 1e-9))

    def _velocity(self, q: Array) -> Array:
        """Return the velocity (dof,) of the way to `q` (dof,), rad/s."""
        return (q - self._q) / CONTROL_PERIOD


class MemorylessPushLine(PushLine):
    """Pushes with one arm by the present observation alone: places decide the phase.

    It draws the tool back from an object that is near enough to its target: one that still touches it may not rest.
    """

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation: tool, joints, target, and the object."""
        self.reset()
        return super().act(observation)

    def _aim(self, tool: Array, place: Array, way: Array, distance: float) -> tuple[Array, float]:
        behind = place - push_table.STAND_OFF * way
        if tool[2] > push_table.LIFTED_HEIGHT - NEAR:
            self._phase = Phase.OVER
        elif tool[2] < LOW:
            self._phase = Phase.PUSH
        else:
            self._phase = Phase.DOWN if math.hypot(*(tool[:2] - behind)) < 2 * NEAR else Phase.UP
        if self._phase is Phase.PUSH and distance < self._close:
            return np.append(behind, push_table.TOOL_HEIGHT), DRAW_BACK_SPEED
        return super()._aim(tool, place, way, distance)

    def _move(self, point: Array, speed: float) -> None:
        super()._move(point, speed)
        if self._tool.configuration(self._at - self._offset, self._q) is self._q:  # beside what the arm reaches
            self._at = point

    def _velocity(self, q: Array) -> Array:
        velocity = super()._velocity(q)
        is_fast = (np.abs(velocity) > self._tool.model.limits.velocity).any()
        return np.zeros_like(velocity) if is_fast else velocity  # it is to stop in a posture that is far away
