import numpy as np
import pytest

from armctl.baselines import bridge_mpc, bridge_ompl
from armctl.baselines.bridge_controllers import MapAverage
from armctl.rollout import evaluate
from armctl.scene import BridgeMap, PedestrianTrajectories

from .driving import FAST, STATIC

CONTROLLERS = [bridge_ompl.BridgeOmpl, bridge_mpc.BridgeMpc]
BLOCKS = np.array([[10.0, 0.0, 0.3, 0.4, 0.4]])


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("place", [(5.0, 2.1), (-0.1, 0.0), (19.2, 0.0), (10.0, 0.0)])
def test_they_stand_still_where_no_way_begins(controller, place):
    asked = controller(BridgeMap(20.0, 2.0, BLOCKS), 19.0)
    assert asked.act(np.array([*place, 0.0]), np.zeros(2), 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_they_go_on_from_inside_a_lane(controller):
    lane = PedestrianTrajectories(np.array([[4.0, -1.0]]), np.array([[8.0, -1.0]]), np.array([0.5]), np.zeros(1), 0.25)
    asked = controller(BridgeMap(20.0, 2.0, BLOCKS, lane), 19.0)
    assert asked.act(np.array([7.0, -1.0, 0.0]), np.zeros(2), 0.0) != (0.0, 0.0)


@pytest.mark.one_case
@pytest.mark.parametrize(("expert", "crosses"), [("bridge_ompl", True), ("bridge_ompl:prepared=false", False)])
def test_delays_are_found_out_by_those_who_are_prepared(expert, crosses):
    options = {**FAST, "deck_length": 12.0, "blocks": 3, "disturbances": {"delay": 3}}
    results = evaluate(expert, STATIC, episodes=3, seed=100, worlds=3, env_options=options)
    assert results.success.tolist() == [crosses] * 3


def test_noise_on_maps_averages_out():
    rng, average, true = np.random.default_rng(0), MapAverage(), BridgeMap(20.0, 2.0, BLOCKS)
    for _ in range(100):
        mean = average.with_map(BridgeMap(20.0, 2.0, BLOCKS + 0.1 * rng.standard_normal(BLOCKS.shape)))
    assert np.abs(mean.blocks - true.blocks).max() < 0.04
