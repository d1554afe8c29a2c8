"""Paths over a bridge for a robot that hardly turns: dynamic programming over place and heading.

Time is that of driving or of turning, whichever takes longer in each stretch, as the robot does both at once. A path
leads forwards, so stretches of equal length along the bridge are the stages (Bellman, Dynamic Programming, 1957), and a
slope of a whole number of lattice spacings per stretch leads from point to point.
"""

import numpy as np

from armctl.core.arrays import Array
from armctl.core.options import Count, NonNegative, Positive, options
from armctl.kernels import turns as kernel
from armctl.scene import BridgeMap

CHECKS = 4
"""Points of each stretch at which the clearance is looked up."""


@options
class TurnPlannerOptions:
    """Options of `plan_turns`."""

    speed: Positive = 0.85
    """m/s: speed along the path."""
    turn_rate: Positive = 0.2
    """rad/s: largest turn rate."""
    clearance: Positive = 0.33
    """m: least distance from obstacles."""
    comfort: NonNegative = 0.4
    """m: distance from obstacles that would be better."""
    discomfort: NonNegative = 8.0
    """s per m of path and per m of missing comfort."""
    stretch: Positive = 0.4
    """m: length of a stretch along the bridge."""
    spacing: Positive = 0.02
    """m: distance between places across the bridge."""
    slopes: Count = 20
    """Slopes to either side, of one spacing per stretch each."""
    turns: Count = 8
    """Most slopes by which the heading changes from a stretch to the next."""


def plan_turns(
    bridge: BridgeMap, pose: Array, goal_x: float, options: TurnPlannerOptions | None = None
) -> tuple[Array, float]:
    """Return the fastest path from a pose x, y (m), yaw (rad) to the line x = `goal_x`, and its time (s).

    The path is points (m, 2) m; (0, 2) and infinity if there is none.
    """
    chosen = options or TurnPlannerOptions()
    stages = max(int(np.ceil((goal_x - pose[0]) / chosen.stretch)), 1)
    slopes = np.arange(-chosen.slopes, chosen.slopes + 1)
    headings = np.arctan(slopes * chosen.spacing / chosen.stretch)
    half = int(bridge.half_width / chosen.spacing)
    width = 2 * half + 1
    y = pose[1] + chosen.spacing * (np.arange(width) - half - round(pose[1] / chosen.spacing))
    turning = np.abs(headings[:, None] - headings) / chosen.turn_rate
    driving = np.maximum(chosen.stretch / np.cos(headings) / chosen.speed, turning)
    costs = _check_costs(bridge, pose[0], y, stages, chosen)
    best = np.empty((stages, len(slopes), width), dtype=np.int8)
    time_to_go = kernel.fastest_turns(costs, slopes, driving, chosen.turns, best)
    place = half + round(pose[1] / chosen.spacing)
    slope = int(np.abs(headings - pose[2]).argmin())
    if not 0 <= place < width or not np.isfinite(time := float(time_to_go[slope, place])):
        return np.zeros((0, 2)), np.inf
    path = [pose[:2]]
    for stage in range(stages):
        slope += int(best[stage, slope, place])
        place += int(slopes[slope])
        path.append(np.array((pose[0] + (stage + 1) * chosen.stretch, y[place])))
    return np.array(path), time


def _check_costs(bridge: BridgeMap, x: float, y: Array, stages: int, options: TurnPlannerOptions) -> Array:
    """Return the discomfort (stages, `CHECKS`, ...) s of each check, infinite if it is blocked, at points across."""
    shares = np.arange(1, CHECKS + 1) / CHECKS
    along = x + options.stretch * (np.arange(stages)[:, None] + shares)
    fine = options.spacing / CHECKS
    across = np.arange(y[0] - fine * CHECKS * options.slopes, y[-1] + fine * (CHECKS * options.slopes + 0.5), fine)
    points = np.empty((*along.shape, len(across), 2))
    points[..., 0], points[..., 1] = along[..., None], across
    clearance = bridge.with_lanes_blocked().clearance(points.reshape(-1, 2)).reshape(points.shape[:-1])
    costs = options.discomfort * options.stretch / CHECKS * np.maximum(options.comfort - clearance, 0.0)
    costs[clearance < options.clearance] = np.inf
    return np.asarray(costs)
