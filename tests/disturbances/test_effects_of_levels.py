"""Each level of a disturbance changes something that is observed, or it does not apply."""

from typing import Any

import numpy as np
import pytest

from armctl.disturbances import available
from armctl.envs import make_worlds
from tests.disturbances.disturbed import BRIDGE, REACH, arrays

OBSERVED: list[Any] = [
    *((REACH, {"observation": kind}) for kind in ("paper", "features", "full")),
    ("armctl/ArmReachMoving-v0", {}), ("armctl/ArmReachObstacles-v0", {}), ("armctl/BridgeCrossMoving-v0", {}),
    *((BRIDGE, {"observation": kind, "camera": camera, "image_format": pixels})
      for kind in ("paper", "image") for camera in ("depth", "classes") for pixels in ("float", "uint8")),
    *((BRIDGE, {"observation": kind}) for kind in ("features", "state")),
    (BRIDGE, {"observation": "ranges", "dynamics": "kinematic"}),
    ("Pendulum-v1", {}), ("CartPole-v1", {}), ("FrozenLake-v1", {}),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("env", "options"), OBSERVED)
def test_the_strongest_level_changes_all_that_it_says_it_reaches(env, options):
    """Or else it does not apply: no policy survives what never was."""
    plain = make_worlds(env, 2, options)
    before = observed(plain)
    for name, spec in available(plain.task.disturbances, plain.task).items():
        level = max(spec.levels, key=lambda level: abs(level - spec.neutral))
        after = observed(make_worlds(env, 2, options | {"disturbances": {name: level}}))
        changed = {part for part, values in before.items() if not np.array_equal(values, after[part])}
        assert changed, name
        assert name not in ("noise", "noise_on_state") or changed == set(before)


def observed(env, decisions=30):
    """Return what is observed of the same actions: by part, (decisions, 2, ...)."""
    observations, _ = env.reset(seed=[3, 4])
    env.single_action_space.seed(0)
    seen = {part: [np.copy(values)] for part, values in arrays(observations).items()}
    for _ in range(decisions):
        observations, *_ = env.step(np.array([env.single_action_space.sample() for _ in range(2)]))
        for part, values in arrays(observations).items():
            seen[part].append(np.copy(values))
    return {part: np.array(values) for part, values in seen.items()}
