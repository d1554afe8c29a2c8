"""The torque floor: joint impedance about a configuration in the target, by computed torque with LQG gains.

    torque = M(q) a + C(q, qd) qd        a = stiffness sat(goal - q) + damping (goal's velocity - qd) - d

Gravity is compensated beneath it, as in the controllers of real arms. `M` and `C` are the model's (recursive
Newton-Euler), so each joint is a double integrator, for which the gains are the discrete-time linear-quadratic
regulator's. A Kalman filter estimates velocities, and accelerations `d` that the model does not explain (a payload's).
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from armctl.baselines.reach_task import checked_options
from armctl.core.arrays import Array
from armctl.core.options import Positive, Share, changed_options, options
from armctl.envs import ModelInterface
from armctl.estimation.kalman import EstimationOptions, KalmanFilter, constant_acceleration
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.policies import PerWorld, made_for, sees
from armctl.tasks import OBSERVATION, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

POWERS = np.array([[CONTROL_PERIOD**2 / 2], [CONTROL_PERIOD], [0.0]])
"""Change of position, velocity and unexplained acceleration by a period of acceleration."""
SMOOTHING, DAMPING = 0.1, 1e-4
"""Weight of the latest reading of the tip's offset; m^2, of joint velocities near singularities."""


@options
class ReachImpedanceOptions:
    """Weights of the regulator, relative to that of a joint's deviation, and of the filter."""

    velocity: Positive = 0.05
    """s^2, of velocities."""
    acceleration: Positive = 1e-4
    """s^4, of accelerations: the smaller, the stiffer."""
    speed: Share = 0.8
    """Fraction of the velocity limits at which joints cruise: deviations saturate there."""
    process_noise: Positive = 200.0
    """rad/s^3: change of unexplained accelerations."""
    reading_noise: Positive = 0.03
    """rad."""


@made_for("armctl/ArmReach*", controls="arms: torque", interface={"control": "torque"})
@sees("model", family="impedance")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Joint impedance in torques: computed torque with LQG gains to an IK configuration; a floor."""
    task = checked_options("reach_impedance", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, ["torque"])
    tuning = changed_options(ReachImpedanceOptions(), options, "option of reach_impedance")
    search, moving = MinimumTimeReach(ArmModel(env.robot)), "target_velocity" in task.parts
    return PerWorld([ReachImpedance(search, task.tolerance, moving, tuning) for _ in range(env.num_envs)])


class ReachImpedance:
    """Reaches with one arm."""

    def __init__(self, search: MinimumTimeReach, tolerance: float, moving: bool, tuning: ReachImpedanceOptions) -> None:
        self._search, self._model, self._tolerance, self._moving = search, search.model, tolerance, moving
        transition, cost = np.array([[1.0, CONTROL_PERIOD], [0.0, 1.0]]), np.array([[tuning.acceleration]])
        value = POWERS[:2].T @ solve_discrete_are(transition, POWERS[:2], np.diag([1.0, tuning.velocity]), cost)
        self._stiffness, self._damping = (value @ transition / (cost + value @ POWERS[:2]))[0]
        self._largest = tuning.speed * self._model.limits.velocity * self._damping / self._stiffness
        motion = constant_acceleration(self._model.dof, CONTROL_PERIOD, tuning.process_noise, tuning.reading_noise)
        self._filter = KalmanFilter(motion, options=EstimationOptions(noise_memory=25, prior_readings=5))
        self.reset()

    def reset(self) -> None:
        """Forget the goal and all readings."""
        self._goal: Array | None = None
        self._target, self._tip_offset, self._readings = np.zeros(3), np.zeros(3), 0
        self._acceleration = np.zeros(self._model.dof)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return torques (dof,) for an observation: positions of end-effector, joints and target, and others."""
        model, dof = self._model, self._model.dof
        tip, reading, target, extra = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if self._goal is None:  # an episode begins at rest
            self._filter.reset(np.concatenate((reading, np.zeros(2 * dof))), 1e-4 * np.eye(3 * dof))
        self._filter.predict((POWERS * self._acceleration).reshape(1, -1))
        self._filter.update(reading[None])
        q, velocity, unexplained = self._filter.mean[0].reshape(3, dof).copy()
        if np.isfinite(observation).all():
            self._readings = 1 if self._moving else self._readings + 1
            self._target += (target - self._target) / self._readings
            self._tip_offset += SMOOTHING * (tip - model.position(q) - self._tip_offset)
        aim = self._target - self._tip_offset
        if self._goal is None:
            goal = self._search.find(q, aim, self._tolerance / 2)
            self._goal = self._search.ik.position(aim, q).closest if goal is None else goal.q
        jacobian = model.jacobian(self._goal)[:3]
        self._goal = self._goal + damped_step(jacobian, aim - model.position(self._goal), DAMPING)
        deviation = np.clip(self._goal - q, -self._largest, self._largest)
        goal_velocity = damped_step(jacobian, np.nan_to_num(extra[:3]), DAMPING) if self._moving else 0.0
        self._acceleration = self._stiffness * deviation + self._damping * (goal_velocity - velocity) - unexplained
        torques = model.inertial_torques(q, velocity, self._acceleration)
        return np.clip(torques, -model.limits.effort, model.limits.effort)
