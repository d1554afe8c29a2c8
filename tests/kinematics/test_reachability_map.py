"""The table of configurations."""

import numpy as np
import pytest

from armctl.kinematics import ArmModel, ReachabilityMap
from armctl.kinematics.reachability_map import ON_TARGET
from armctl.scene import NO_BOXES


@pytest.mark.slow
def test_ways_end_at_the_target():
    """Refined candidates may miss it: the arm would go there and stay."""
    model = ArmModel("z1")
    reachability_map, rng = ReachabilityMap(model), np.random.default_rng(0)
    targets = model.positions(model.random_configurations(rng, 60))
    ways = [reachability_map.way(target, model.home, NO_BOXES) for target in targets]
    misses = [
        np.linalg.norm(model.position(way[-1]) - target) for way, target in zip(ways, targets, strict=True) if len(way)
    ]
    assert len(misses) > 20
    assert max(misses) < ON_TARGET
