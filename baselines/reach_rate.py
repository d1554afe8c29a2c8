"""The resolved-rate floor: the tip moves to the target by damped least squares (Whitney 1969, Wampler 1986).

    v = speed-limited gain (way to the target) + target's velocity        qd = J' (J J' + damping^2 I)^-1 v

The way leads around the base, where the straight line may lead through it. It sees no limits but those of joint
velocities, to which all of qd is scaled, no collisions and no singularities, which the damping only makes slow. It has
no memory, and filters nothing.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options, search_for, split
from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.policies import PerWorld, made_for, sees
from armctl.tasks import OBSERVATION, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

CONTROLS = ("position", "relative", "delta", "velocity")


@options
class ReachRateOptions:
    """Gains of the tip's velocity."""

    gain: Positive = 6.0
    """1/s."""
    speed: Positive = 1.5
    """m/s: largest speed of the tip."""
    damping: NonNegative = 0.05
    """m."""


@made_for(
    "armctl/ArmReach* armctl/ArmPose-v0 armctl/ArmScenes-v0",
    controls="arms: not torque",
    interface={"control": "velocity"},
)
@sees("model", family="resolved rate")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Resolved-rate control: the tip to the target around the base, by damped least squares; a floor."""
    task = checked_options("reach_rate", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, CONTROLS, poses=True)
    gains = changed_options(ReachRateOptions(), options, "option of reach_rate")
    search, moving = search_for(ArmModel(env.robot), task), "target_velocity" in task.parts
    return PerWorld([ReachRate(search, task.control, moving, gains) for _ in range(env.num_envs)])


class ReachRate:
    """Reaches with one arm."""

    def __init__(self, search: MinimumTimeReach, control: str, moving: bool, gains: ReachRateOptions) -> None:
        self._search, self._control, self._moving, self._gains = search, control, moving, gains

    def reset(self) -> None:
        """Do nothing: it has no memory."""

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return the action (dof,) for an observation: positions of end-effector, joints and target, and others."""
        model, limits = self._search.model, self._search.model.limits
        tip, q, target, extra = split(self._search, np.nan_to_num(observation))
        way = target - tip
        if model.base_yaw_is_vertical:
            way[:3] = way_around(tip[:3], target[:3])
        velocity = self._gains.gain * way
        velocity *= min(1.0, self._gains.speed / max(float(np.linalg.norm(velocity)), 1e-9))
        if self._moving:
            velocity = velocity + extra[:3]
        speeds = damped_step(self._search.place_jacobian(q), velocity, self._gains.damping**2)
        speeds = speeds / max(1.0, float(np.abs(speeds / limits.velocity).max()))
        if self._control == "velocity":
            return speeds
        if self._control == "delta":
            return CONTROL_PERIOD * speeds
        braking = speeds * np.abs(speeds) / (2 * limits.acceleration)  # drives stop at what is commanded
        ahead = CONTROL_PERIOD * speeds + braking
        return ahead if self._control == "relative" else np.clip(q + ahead, limits.lower, limits.upper)


def way_around(tip: Array, target: Array) -> Array:
    """Return the direction from tip to target around the vertical through the base, as long as the way, (3,) m."""
    start, end = complex(*tip[:2]), complex(*target[:2])
    outwards = start / abs(start) if start else 1.0
    way = outwards * (abs(end) - abs(start) + 1j * abs(start) * np.angle(end / outwards))
    return np.array((way.real, way.imag, target[2] - tip[2]))
