import numpy as np
import torch

from armctl.envs import make_worlds
from armctl.kernels import planar
from armctl.rl.networks.bridge_scans import AHEAD, BEAMS, NEAR, ROVER, Surroundings, people_after
from armctl.rl.networks.view import view_of
from armctl.tasks.bridge.layout import TURNING_MARGIN
from armctl.tasks.bridge.options import WALKER_RADIUS

MOVING = "armctl/BridgeCrossMoving-v0"


def test_scans_are_those_of_the_map_and_of_people_who_walk_on():
    n = 20
    worlds = make_worlds(MOVING, n, {"observation": "state", "dynamics": "kinematic"})
    worlds.reset(seed=3)
    for _ in range(10):
        states = worlds.step(np.tile((1.2, 0.1), (n, 1)))[0]
    view = view_of(worlds)
    assert view.features is Surroundings
    features = view.extractor(worlds.single_observation_space)(torch.as_tensor(states)).numpy()
    task = worlds.task
    angles = np.arange(BEAMS) * 2 * np.pi / BEAMS
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    blocks = np.array([task.map(i).blocks for i in range(n)])
    rows = np.concatenate((blocks[..., :2], np.cos(blocks[..., 2:3]), np.sin(blocks[..., 2:3]), blocks[..., 3:]), -1)
    people = states[:, ROVER + blocks[0].size :].reshape(n, -1, 4).astype(float)
    everywhere, deck = np.ones((n, 2, 5), dtype=bool), planar.Deck(20.0, task.map(0).half_width, WALKER_RADIUS, 2.0)

    def scanned(blocks, walkers, half_width):
        ranges = np.empty((n, BEAMS))
        scenes = planar.Scenes(blocks, everywhere, walkers)
        ids = np.arange(n)
        sensor = planar.RangeSensor(0.0, directions, half_width, 1e3, 0.0)
        planar.scan(ids, deck, scenes, sensor, task.state.poses, ranges)
        return NEAR / (NEAR + ranges)

    turn = deck.half_width - TURNING_MARGIN
    expected = [scanned(rows, people[:, :0, :2], deck.half_width)]
    expected += [
        scanned(rows[:, :0], people_after(torch.as_tensor(people), time, turn).numpy(), 900.0) for time in AHEAD
    ]
    found = features[:, ROVER:].reshape(n, 1 + len(AHEAD), BEAMS).swapaxes(0, 1)
    hit = np.array(expected) > 0.01  # the others leave the bridge by its ends
    assert hit[1:].any()
    assert np.abs(found - expected)[hit].max() < 1e-2


def test_people_are_predicted_to_turn_back_as_they_do():
    worlds = make_worlds(MOVING, 50, {"observation": "state", "dynamics": "kinematic", "blocks": 0})
    states, _ = worlds.reset(seed=1)
    now = torch.as_tensor(states[:, ROVER:]).reshape(50, -1, 4)
    task = worlds.task
    across = np.array([~task.map(i).pedestrians.along for i in range(50)])
    then = np.array([task.map(i).pedestrians.positions(1.6) for i in range(50)])
    predicted = people_after(now, 1.6, task.map(0).half_width - TURNING_MARGIN).numpy()
    assert across.any()
    assert np.abs(predicted - then)[across].max() < 1e-3
