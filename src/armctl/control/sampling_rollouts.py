"""Rollouts for `SamplingMpc` on models of an arm with its drives, and of a rover, for n candidates at once."""

from typing import NamedTuple

import numpy as np

from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, options
from armctl.kernels import rollouts as kernel
from armctl.kernels.edges import Scene
from armctl.kinematics import ArmShapes
from armctl.kinematics.records import box_records
from armctl.robot_description.joint_profiles import TICK
from armctl.scene import NO_BOXES, Boxes, BridgeMap

PASSING = 0.3
"""rad: largest joint error at which a configuration on the way is passed."""


@options
class ReachCosts:
    """Costs of reaching; a period outside the target's sphere costs 1."""

    distance: NonNegative = 1.0
    """Cost of a metre from the target in each period, 1/m."""
    final: NonNegative = 25.0
    """Cost of a metre from the target at the end, 1/m: of as many periods as the tip takes for it at 1 m/s."""
    touch: NonNegative = 100.0
    """Cost of a contact of the arm with itself, floor or boxes."""
    margin: NonNegative = 0.008
    """m: distance kept from these, as in `ImaginedArms`: the joints are off their drives by some mrad."""


class ArmState(NamedTuple):
    """The drives of an arm, and targets to come."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""
    targets: Array
    """(horizon, 3) m."""
    way: Array
    """(k, dof) rad: configurations to pass on the way to a target that is not reached straight; none if k is 0."""


class ArmRollouts:
    """Costs of the goals of an arm's drives, by their law: within `radius` (m), a target is reached, or `held`."""

    def __init__(self, shapes: ArmShapes, costs: ReachCosts, radius: float, held: bool, period: float) -> None:
        self._shapes, self._costs, self._radius, self._held = shapes, costs, radius, held
        self._period, self._ticks = period, max(1, round(period / TICK))
        self.surround(NO_BOXES)

    def surround(self, boxes: Boxes) -> None:
        """Keep clear of these boxes from now on."""
        pairs, self._motion = self._shapes.with_boxes(boxes)
        self._scene = Scene(self._shapes.model.joints, self._shapes.model.links, pairs, box_records(boxes))

    def __call__(self, state: ArmState, candidates: Array) -> Array:
        """Return the costs (n,) of goals (n, horizon, dof), rad."""
        prices, costs = self._costs, np.empty(len(candidates))
        scene = kernel.ReachScene(
            self._scene, self._motion, prices.margin, np.ascontiguousarray(state.targets), self._radius, self._held,
            prices.distance, prices.final, state.way, self._rest(state.way), PASSING, self._period, prices.touch,
            self._ticks, TICK,
        )  # fmt: skip
        kernel.reach(scene, state.position, state.velocity, np.ascontiguousarray(candidates), costs)
        return costs

    def _rest(self, way: Array) -> Array:
        """Return the periods (k,) from each configuration of a way to the last one at the velocity limits."""
        times = self._shapes.model.cruise_time(way[:-1], way[1:]) if len(way) else np.zeros(0)
        return np.append(np.cumsum(times[::-1])[::-1], 0.0)[: len(way)] / self._period


@options
class DriveCosts:
    """Costs of driving; a metre to go costs 1 in each period."""

    intrusion: NonNegative = 300.0
    """Cost of a metre within a clearance in each period, 1/m: more than any such shortcut saves."""
    turn_rate: NonNegative = 0.02
    """Cost of the squared turn rate in each period, s^2."""
    final: NonNegative = 10.0
    """Cost of a metre to go at the end, 1/m: of as many periods as the rover takes for twice as much."""


@options
class DriveModel:
    """A rover that follows commands within limits, and what it keeps clear of."""

    max_velocity: tuple[Positive, Positive]
    """m/s and rad/s."""
    max_acceleration: tuple[Positive, Positive]
    """m/s^2 and rad/s^2."""
    max_rim_speed: Positive
    """m/s: rim speed of the wheels."""
    half_track: NonNegative
    """m: effective half track, with skidding: rim speed = linear -+ this x angular velocity."""
    clearance: NonNegative
    """m: distance of the rover's centre from static obstacles."""
    distance: NonNegative
    """m: distance of the rover's centre from the centres of pedestrians."""
    period: Positive
    """s."""


class RoverState(NamedTuple):
    """A rover on a bridge, and people to come."""

    motion: Array
    """x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s), (5,)."""
    people: Array
    """(horizon + 1, w, 2) m."""


class RoverRollouts:
    """Costs of a rover's commands on a bridge, whose `lengths` (nx, ny) m to go are those of a lattice over the deck.

    The lattice's points are `spacings` (2,) m apart.
    """

    def __init__(
        self, model: DriveModel, costs: DriveCosts, bridge: BridgeMap, lengths: Array, spacings: Array
    ) -> None:
        self._model, self._costs, self._lengths, self._spacings = model, costs, np.ascontiguousarray(lengths), spacings
        self.surround(bridge)

    def surround(self, bridge: BridgeMap) -> None:
        """Keep clear of the blocks and sides of this map from now on."""
        self._blocks, self._half_width, _ = bridge.deck

    def __call__(self, state: RoverState, candidates: Array) -> Array:
        """Return the costs (n,) of velocities (n, horizon, 2), m/s and rad/s."""
        model, prices, costs = self._model, self._costs, np.empty(len(candidates))
        scene = kernel.DriveScene(
            np.array(model.max_velocity), model.period * np.array(model.max_acceleration), model.max_rim_speed,
            model.half_track, model.period, self._blocks, self._half_width, self._lengths, self._spacings,
            model.clearance, np.ascontiguousarray(state.people), model.distance, prices.intrusion, prices.turn_rate,
            prices.final,
        )  # fmt: skip
        kernel.cross(scene, state.motion, np.ascontiguousarray(candidates), costs)
        return costs
