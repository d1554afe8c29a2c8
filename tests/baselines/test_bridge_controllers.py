import numpy as np
import pytest

from armctl.baselines import bridge_mpc, bridge_ompl
from armctl.scene import BridgeMap, PedestrianTrajectories

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
