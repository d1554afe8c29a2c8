"""Paths over a bridge for a robot that hardly turns: dynamic programming over place and heading.

Time is that of driving or of turning, whichever takes longer in each stretch, as the robot does both at once. A path
leads forwards, so stretches of equal length along the bridge are the stages (Bellman, Dynamic Programming, 1957), and a
slope of a whole number of lattice spacings per stretch leads from point to point.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.options import Count, NonNegative, Positive, options
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
    costs = _stretch_costs(bridge, pose[0], y, stages, slopes, chosen)
    driving = chosen.stretch / np.cos(headings) / chosen.speed
    time_to_go, best = np.zeros((width, len(slopes))), np.empty((stages, width, len(slopes)), dtype=np.int8)
    ends = np.arange(width)[:, None] + slopes
    inside = (ends >= 0) & (ends < width)
    ends = np.clip(ends, 0, width - 1)
    for stage in range(stages - 1, -1, -1):
        total_time = np.where(inside, time_to_go[ends, np.arange(len(slopes))], np.inf) + costs[stage]
        time_to_go = np.full_like(total_time, np.inf)
        for turn in range(-chosen.turns, chosen.turns + 1):
            old = slice(max(0, -turn), len(slopes) - max(0, turn))
            new = slice(max(0, turn), len(slopes) - max(0, -turn))
            turning = np.abs(headings[new] - headings[old]) / chosen.turn_rate
            time = total_time[:, new] + np.maximum(driving[new], turning)
            better = time < time_to_go[:, old]
            time_to_go[:, old] = np.where(better, time, time_to_go[:, old])
            best[stage, :, old] = np.where(better, turn, best[stage, :, old])
    place = half + round(pose[1] / chosen.spacing)
    slope = int(np.abs(headings - pose[2]).argmin())
    if not 0 <= place < width or not np.isfinite(time := float(time_to_go[place, slope])):
        return np.zeros((0, 2)), np.inf
    path = [pose[:2]]
    for stage in range(stages):
        slope += int(best[stage, place, slope])
        place += int(slopes[slope])
        path.append(np.array((pose[0] + (stage + 1) * chosen.stretch, y[place])))
    return np.array(path), time


def _stretch_costs(
    bridge: BridgeMap, x: float, y: Array, stages: int, slopes: NDArray[np.integer], options: TurnPlannerOptions
) -> Array:
    """Return the discomfort (stages, width, slopes) s of stretches from each place: infinite if they are blocked."""
    shares = np.arange(1, CHECKS + 1) / CHECKS
    along = x + options.stretch * (np.arange(stages)[:, None] + shares)
    fine = options.spacing / CHECKS
    across = np.arange(y[0] - fine * CHECKS * options.slopes, y[-1] + fine * (CHECKS * options.slopes + 0.5), fine)
    points = np.stack(np.meshgrid(along.ravel(), across, indexing="ij"), axis=-1).reshape(-1, 2)
    clearance = bridge.with_lanes_blocked().clearance(points).reshape(stages, CHECKS, len(across))
    missing = np.clip(options.comfort - clearance, 0.0, None)
    cost = np.where(clearance < options.clearance, np.inf, options.discomfort * options.stretch / CHECKS * missing)
    places = CHECKS * (options.slopes + np.arange(len(y)))[:, None]
    total = np.zeros((stages, len(y), len(slopes)))
    for check in range(CHECKS):
        total += cost[:, check, places + (check + 1) * slopes]
    return total
