"""The arithmetic of `armctl.estimation.delay`: errors of a bank of models, and the decision for one of them."""

import math

from armctl.kernels.compiling import compiled


@compiled
def weigh(predictions, states, precision, forgetting, threshold, errors, readings, delays):
    """Add the errors of predictions (k, n, s) of states (n, s) to sums `errors` (k, n), and choose `delays` (n,).

    `readings` (n,) count the states that are finite. Another candidate is chosen if the error of the present one
    exceeds the smallest by `threshold` times the mean smallest error plus 1.
    """
    candidates, n, size = predictions.shape
    for i in range(n):
        usable = True
        for k in range(candidates):
            for a in range(size):
                usable = usable and math.isfinite(predictions[k, i, a] - states[i, a])
        best = 0
        for k in range(candidates):
            if usable:
                squares = 1.0
                for a in range(size):
                    squares += ((predictions[k, i, a] - states[i, a]) * precision[a]) ** 2
                errors[k, i] = forgetting * errors[k, i] + math.sqrt(squares) - 1
            if errors[k, i] < errors[best, i]:
                best = k
        if usable:
            readings[i] = forgetting * readings[i] + 1
        needed = threshold * (1 + errors[best, i] / max(readings[i], 1.0))
        if errors[delays[i], i] - errors[best, i] > needed:
            delays[i] = best
