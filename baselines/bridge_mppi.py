"""The sampling expert on the bridge: model predictive path integral control (MPPI) of the rover's velocities.

At each control step it draws commands around the last plan, rolls all candidates out by the rover's law, past blocks
and predicted pedestrians, and executes the first of their weighted mean (`armctl.control.sampling`). A table of the
lengths that remain to the goal line, around the blocks and beside lanes, says what the end of a plan is worth. It sees
the map and the true pose, which are privileged state.
"""

import functools
from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any

import numpy as np

from armctl.baselines.bridge_controllers import BridgePolicy
from armctl.control.sampling import SamplingMpc, SamplingOptions
from armctl.control.sampling_rollouts import DriveCosts, DriveModel, RoverRollouts, RoverState
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import TaskVectorEnv
from armctl.planning.cost_to_go import Lattice
from armctl.policies import made_for, sees
from armctl.robots.rover import MAX_VELOCITY, MAX_WHEEL_SPEED, RADIUS, TRACK, WHEEL_RADIUS, WHEEL_SEPARATION_MULTIPLIER
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

MARGIN, PEOPLE_MARGIN = 0.04, 0.15
"""m: distances between the rover and static obstacles, and pedestrians."""
MAX_REVERSE, MAX_TURN_RATE = 0.5, 2.5
"""m/s, rad/s."""
ACCELERATION = (4.0, 10.0)
"""m/s^2, rad/s^2, as in `bridge_mpc`: the rover does somewhat more."""


@options
class BridgeMppiOptions:
    """Options of `bridge_mppi`."""

    sampling: SamplingOptions = field(
        default_factory=lambda: SamplingOptions(
            samples=256, horizon=25, knots=5, noise=1.0, finest=0.1, temperature=0.02
        )
    )
    """Sampling; noise is in units of `MAX_VELOCITY`."""
    costs: DriveCosts = field(default_factory=DriveCosts)


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("state", family="sampling", foresight="pedestrians")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> BridgePolicy:
    """MPPI: samples velocities, rolled out past blocks and predicted pedestrians on the true map."""
    chosen = changed_options(BridgeMppiOptions(), options, "option of bridge_mppi")
    return BridgePolicy("bridge_mppi", env, functools.partial(BridgeMppi, options=chosen))


class BridgeMppi:
    """Crosses one bridge. Its random numbers are the same on each."""

    def __init__(self, bridge: BridgeMap, goal_x: float, options: BridgeMppiOptions) -> None:
        self._bridge, self._rng = bridge, np.random.default_rng(0)
        model = DriveModel(
            max_velocity=(float(MAX_VELOCITY[0]), MAX_TURN_RATE),
            max_acceleration=ACCELERATION,
            max_rim_speed=MAX_WHEEL_SPEED * WHEEL_RADIUS,
            half_track=TRACK * WHEEL_SEPARATION_MULTIPLIER / 2,
            clearance=RADIUS + MARGIN,
            distance=RADIUS + bridge.pedestrians.radius + PEOPLE_MARGIN,
            period=CONTROL_PERIOD,
        )
        lattice = Lattice(bridge.length, bridge.half_width)
        lengths = lattice.lengths(bridge, goal_x, model.clearance)
        self._rollouts = RoverRollouts(model, options.costs, bridge, lengths, lattice.spacings)
        fastest = np.array(model.max_velocity)
        self._mpc = SamplingMpc(self._rollouts, (-MAX_REVERSE, -MAX_TURN_RATE), fastest, options.sampling, fastest)
        self._clock = CONTROL_PERIOD * np.arange(options.sampling.horizon + 1)

    @property
    def failures(self) -> int:
        """Plans for which no candidate had a finite cost."""
        return self._mpc.failures

    def plans(self) -> dict[str, Array]:
        """Return nothing: the plan is a sequence of velocities."""
        return {}

    def see(self, bridge: BridgeMap) -> None:
        """Go by this map from now on; the lengths to go remain those of the first."""
        self._bridge = bridge
        self._rollouts.surround(bridge)

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear and angular velocity for a pose (x, y, yaw), current velocities (m/s, rad/s) and time (s)."""
        people = self._bridge.pedestrians.positions(time + self._clock)
        state = RoverState(np.concatenate((pose, velocity)).astype(float), people)
        linear, angular = self._mpc.plan(state, self._rng).actions[0]
        return float(linear), float(angular)
