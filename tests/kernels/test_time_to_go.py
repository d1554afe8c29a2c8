import numpy as np

from armctl.kernels.time_to_go import Grid, Moves, People, spread

STEPS = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 2)])
DURATIONS = np.array([0.1, 0.1, 0.13, 0.13, 0.17, 0.24], dtype=np.float32)
LAYERS, SHARES = np.array([1, 1, 1, 1, 1, 2]), np.array([0.0, 0.0, 0.3, 0.3, 0.7, 0.4], dtype=np.float32)
WAIT, SLOWDOWN, REACH, PAD, BLOCKED = 0.1, 7.0, 1.2, 2, 1e4
MOVES, AFTER = Moves(WAIT, STEPS, DURATIONS, LAYERS, SHARES), LAYERS.max()


def reference(last, goal, wall, people, y, x):
    """The dynamic programme as it is written down: at each moment and point, the best of all that can be done."""
    times = np.full((len(people), *last.shape), BLOCKED)
    times[-1] = last

    def at(layer, i, j):
        inside = 0 <= i < len(y) and 0 <= j < len(x)
        return times[min(layer, len(times) - 1), i, j] if inside else BLOCKED

    for k in range(len(times) - 2, -1, -1):
        for i, j in np.ndindex(last.shape):
            near = (np.hypot(*(people[k] - (x[j], y[i])).T) <= REACH).any()
            pace = SLOWDOWN if near else 1.0
            options = [pace * WAIT + at(k + 1, i, j)]
            for (left, ahead), duration, layers, share in zip(STEPS, DURATIONS, LAYERS, SHARES, strict=True):
                ends = (at(k + layers + late, i + left, j + ahead) for late in (0, 1))
                options.append(pace * duration + np.dot((1 - share, share), list(ends)))
            times[k, i, j] = 0.0 if goal[i, j] else max(min(options), wall[i, j])
    return times


def test_times_are_those_of_the_dynamic_programme():
    rng = np.random.default_rng(0)
    y, x = np.arange(5.0), np.arange(8.0)
    for _ in range(5):
        goal, blocked = np.zeros((5, 8), dtype=bool), rng.random((5, 8)) < 0.2
        goal[:, -1] = True
        wall = np.where(blocked & ~goal, BLOCKED, 0.0)
        last = np.where(goal, 0.0, rng.uniform(0.5, 3.0, (5, 8))) + wall
        people = rng.uniform((-1, -1), (8, 5), (9, 3, 2))
        times, bounds = (np.full((k, 5 + 2 * PAD, 8 + 2 * PAD), BLOCKED, np.float32) for k in (9 + AFTER, 2))
        times[8:, PAD:-PAD, PAD:-PAD] = last
        bounds[:, PAD:-PAD, PAD:-PAD] = wall, np.where(goal, 0.0, np.inf)
        spread(times, bounds, People(people, REACH, SLOWDOWN), Grid(y, x, PAD), MOVES)
        inside = times[:9, PAD:-PAD, PAD:-PAD].copy()
        expected = reference(last, goal, wall, people, y, x)
        open_ = expected < BLOCKED / 2
        np.testing.assert_allclose(inside[open_], expected[open_], rtol=1e-4)
        assert (inside[~open_] > BLOCKED / 3).all()
        times[:, PAD:-PAD, PAD:-PAD] = BLOCKED
        assert (times == BLOCKED).all()  # as they were around the lattice
