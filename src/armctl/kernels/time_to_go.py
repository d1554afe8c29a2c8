"""Least times to go among people who move: see `armctl.planning.time_to_go`.

Lattices have the points across the bridge first: loops along it are long, and run on vectors.
"""

from armctl.kernels.compiling import compiled


@compiled
def spread(times, goal, wall, people, reach, y, x, slower, wait, moves, durations, shares, layers, pad):
    """Set `times` (layers, ny + 2 pad, nx + 2 pad) from the last layer, which is given, back to the first.

    From each point, one waits for the time `wait` between layers, or goes by one of `moves` (k, 2) points, which takes
    its duration: so many whole `layers` and a share of one more. Within `reach` of a person, of `people` (layers, w,
    2), everything takes `slower` times as long. Where `goal` (ny, nx), times are 0, and at least `wall` (ny, nx).
    """
    last, ny, nx = len(times) - 1, len(y), len(x)
    for k in range(last - 1, -1, -1):
        layer, next_layer = times[k], times[k + 1]
        for i in range(pad, ny + pad):
            for j in range(pad, nx + pad):
                layer[i, j] = wait + next_layer[i, j]
        for e in range(len(moves)):
            first, second = times[min(k + layers[e], last)], times[min(k + layers[e] + 1, last)]
            left, ahead = moves[e, 0] + pad, moves[e, 1] + pad
            for i in range(ny):
                before_share, after_share = first[i + left, ahead : ahead + nx], second[i + left, ahead : ahead + nx]
                improve(layer[i + pad, pad : pad + nx], before_share, after_share, durations[e], shares[e])
        detain(layer, times, k, people[k], reach, y, x, slower, wait, moves, durations, shares, layers, pad)
        for i in range(ny):
            for j in range(nx):
                time = max(layer[i + pad, j + pad], wall[i, j])
                layer[i + pad, j + pad] = 0.0 if goal[i, j] else time


@compiled
def improve(row, first, second, duration, share):
    """Take the times (n,) of a move where they are less; without `min`, which does not run on vectors."""
    for j in range(len(row)):
        time = duration + first[j] + share * (second[j] - first[j])
        if time < row[j]:
            row[j] = time


@compiled
def detain(layer, times, k, people, reach, y, x, slower, wait, moves, durations, shares, layers, pad):
    """Set the times of layer `k` at the points within `reach` of people (w, 2), where everything takes longer."""
    last = len(times) - 1
    for w in range(len(people)):
        for i in range(len(y)):
            if abs(y[i] - people[w, 1]) > reach:
                continue
            for j in range(len(x)):
                if (x[j] - people[w, 0]) ** 2 + (y[i] - people[w, 1]) ** 2 > reach * reach:
                    continue
                min_time = slower * wait + times[k + 1, i + pad, j + pad]
                for e in range(len(moves)):
                    at, to = i + pad + moves[e, 0], j + pad + moves[e, 1]
                    first, second = times[min(k + layers[e], last), at, to], times[min(k + layers[e] + 1, last), at, to]
                    min_time = min(min_time, slower * durations[e] + first + shares[e] * (second - first))
                layer[i + pad, j + pad] = min_time
