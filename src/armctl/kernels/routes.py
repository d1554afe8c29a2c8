"""Obstacles that move back and forth on polylines: see `armctl.scene.Routes`."""

from armctl.kernels.compiling import compiled


@compiled
def move(corners, times, clocks, positions, velocities):
    """Write positions (m, 2) m and velocities (m, 2) m/s of obstacles at times `clocks` (m,) s.

    Obstacle i is on route i modulo r, which is at `corners` (r, k, 2) m first at `times` (r, k) s, in order.
    """
    last = times.shape[1] - 1
    for i in range(len(clocks)):
        route = i % len(times)
        whole = times[route, last] - times[route, 0]
        clock = (clocks[i] - times[route, 0]) % (2 * whole)
        sign = 1.0
        if clock > whole:
            clock, sign = 2 * whole - clock, -1.0
        clock += times[route, 0]
        k = 0
        while k < last - 1 and times[route, k + 1] <= clock:
            k += 1
        while k > 0 and times[route, k + 1] <= times[route, k]:
            k -= 1
        duration = times[route, k + 1] - times[route, k]
        share = min((clock - times[route, k]) / duration, 1.0)
        for axis in range(2):
            step = corners[route, k + 1, axis] - corners[route, k, axis]
            positions[i, axis] = corners[route, k, axis] + share * step
            velocities[i, axis] = sign * step / duration
