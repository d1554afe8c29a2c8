"""Episodes that were never played."""

import math
from typing import Any

import numpy as np

from armctl.episodes.metrics import Metrics
from armctl.episodes.record import EpisodeResult

OWN: dict[str, Any] = {"env": "armctl/ArmReach-v0", "seed": 3, "policies": ["b", "a"]}
"""As much of a comparison's identity as its episodes are checked by."""


def played(episodes, policies=("a",), steps=30):
    rng = np.random.default_rng(0)
    for policy in policies:
        for k in range(episodes):
            contacts, missed = (int(x) if x >= 0 else None for x in rng.integers(-1, 3, 2))
            use, jerk = rng.random(6), [900.0 + k, 200.0, 90.0, 20.0]
            numbers: list[Any] = [
                *use[:2],
                *jerk,
                *use[2:],
                math.nan,
                contacts,
                0,
                missed,
                0.1,
                0.2,
                0.3,
                math.nan if k else 7.0,
            ]
            metrics = Metrics(*numbers)
            length = int(rng.integers(1, steps + 1))
            terms = {"step": -1.0 * length} | ({"goal": rng.random()} if k % 3 else {})
            success, earned = [None, False, True][k % 3], sum(terms.values())
            times = np.round(rng.random(length), 4)
            times[1::4] = math.nan
            yield EpisodeResult(
                policy, OWN["env"], k, 3, ["lost", "won"][k % 2], success, bool(k % 5), earned, terms, length,
                max(1.0, length - 2.0), math.nan, metrics, 1, 1, times,
            )  # fmt: skip


def told(results):
    return [(one.row(), one.decision_ms.tolist()) for one in results]


def same(one, other):
    np.testing.assert_equal(told(one), told(other))
