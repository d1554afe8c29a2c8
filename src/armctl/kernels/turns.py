"""Dynamic programming over place and heading: see `armctl.planning.turn_planner`."""

import numpy as np

from armctl.kernels.compiling import compiled


@compiled
def fastest_turns(costs, slopes, driving, max_turn, best):
    """Find the fastest way from each slope and place over all stretches, and return its time (slopes, width) s.

    `costs` (stages, checks, ...) s are those of each check in a stretch, at points that are closer across than places
    by the number of checks, and begin and end a stretch's largest shift beside the places. `slopes` are whole numbers
    of places per stretch, and `driving` (slopes, slopes) s is the time of a stretch of the second slope after the
    first, which differ by `max_turn` at most. `best` (stages, slopes, width) becomes the change of slope.
    """
    stages, count, width = best.shape
    checks, farthest = costs.shape[1], slopes[-1]
    time_to_go, total_time = np.zeros((count, width)), np.empty((count, width))
    change = np.empty(width, dtype=np.int64)
    for stage in range(stages - 1, -1, -1):
        total_time[:] = np.inf
        for new in range(count):
            for place in range(max(0, -slopes[new]), min(width, width - slopes[new])):
                cost = 0.0
                for check in range(checks):
                    cost += costs[stage, check, checks * (farthest + place) + (check + 1) * slopes[new]]
                total_time[new, place] = time_to_go[new, place + slopes[new]] + cost
        time_to_go[:] = np.inf
        for old in range(count):
            change[:] = 0
            for new in range(max(old - max_turn, 0), min(old + max_turn + 1, count)):
                for place in range(width):
                    time = total_time[new, place] + driving[old, new]
                    is_less = time < time_to_go[old, place]
                    time_to_go[old, place] = time if is_less else time_to_go[old, place]
                    change[place] = new - old if is_less else change[place]
            for place in range(width):
                best[stage, old, place] = change[place]
    return time_to_go
