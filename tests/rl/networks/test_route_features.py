import numpy as np
import pytest
import torch

from armctl.envs import make_worlds
from armctl.planning import PathPlannerOptions, plan_path
from armctl.rl.networks import route_features
from armctl.rl.networks.route_features import BEARINGS, FARTHEST, LONGEST, RADII, RouteFeatures
from armctl.rl.networks.view import view_of
from armctl.tasks.bridge.observation import ROVER

from .exported import check_graph

ENV = "armctl/BarnCross-v0"
N = 12


@pytest.fixture(scope="module")
def fields():
    return make_worlds(ENV, N, {"observation": "state", "dynamics": "kinematic"})


@pytest.fixture
def features(fields):
    view = view_of(fields, features="model")
    assert view.features is RouteFeatures
    assert view.has_fixed_features(fields.single_observation_space)
    return view.extractor(fields.single_observation_space)


def blocks_in(states):
    return torch.as_tensor(states[:, ROVER:]).unflatten(1, (-1, 5))


def test_lengths_are_those_of_planned_paths_and_a_little_longer(fields, features):
    states, _ = fields.reset(seed=3)
    lengths, options = features.lengths(blocks_in(states)), PathPlannerOptions(clearance=0.36)
    start = torch.tensor([[1.0]]).expand(N, 1)
    from_start = features._at(lengths, start, 0 * start)[:, 0].numpy()
    planned = [plan_path(fields.task.map(i), (1.0, 0.0), fields.task.goal_x, options).length for i in range(N)]
    longer = from_start - planned
    assert longer.min() > -0.3
    assert longer.max() < 2.5
    assert np.median(longer) < 0.8


def test_each_open_cell_has_a_neighbour_nearer_to_the_goal_and_closed_ones_are_in_obstacles(fields, features):
    states, _ = fields.reset(seed=4)
    lengths = features.lengths(blocks_in(states)).numpy()
    padded = np.pad(lengths, ((0, 0), (1, 1), (1, 1)), constant_values=FARTHEST)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
    within = (lengths < FARTHEST - 1e-3) & (np.arange(lengths.shape[1]) < lengths.shape[1] - 1)[:, None]
    assert (windows.min(axis=(-2, -1)) < lengths)[within].all()
    centres = np.stack(np.meshgrid(features.x, features.y, indexing="ij"), axis=-1).reshape(-1, 2)
    for world in range(N):
        clearance = fields.task.map(world).clearance(centres).reshape(lengths.shape[1:])
        assert (lengths[world][clearance < 0.25] >= FARTHEST - 1e-3).all()


def test_of_places_around_the_rover_the_nearest_to_the_goal_has_zero(fields, features):
    states, _ = fields.reset(seed=5)
    around = features(torch.as_tensor(states))[:, -BEARINGS * len(RADII) :]
    assert (around.amin(dim=1) == 0).all()
    assert around.min() >= 0
    assert around.max() <= LONGEST
    ahead = around.unflatten(1, (len(RADII), BEARINGS))[:, -1].argmin(dim=1)
    assert ((ahead <= 4) | (ahead >= 12)).all()  # rovers start towards the goal


def test_features_of_a_field_do_not_depend_on_what_was_seen_before_or_beside(fields, features):
    first, second = (torch.as_tensor(fields.reset(seed=seed)[0]) for seed in (6, 7))
    mixed = torch.where((torch.arange(N) % 3 == 0)[:, None], second, first)
    fresh = view_of(fields, features="model").extractor(fields.single_observation_space)
    expected = torch.cat([fresh(mixed[i : i + 1]) for i in range(N)])
    features(first)
    torch.testing.assert_close(features(mixed), expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(features(mixed[:5]), expected[:5], atol=1e-5, rtol=1e-5)


@pytest.mark.slow
def test_a_graph_acts_like_the_network(features, tmp_path, monkeypatch):
    """With a tenth of the moves, of which each is some fifteen nodes to export, for rovers that are near the goal."""
    monkeypatch.setattr(route_features, "SWEEPS", 6)

    def near_the_goal(states):
        states[:, 0] = features.surroundings.goal_x - np.array([0.8, 1.1, 1.4])
        ways = features(torch.as_tensor(states))[:, -BEARINGS * len(RADII) :]
        assert ((ways > 0) & (ways < LONGEST)).float().mean() > 0.5
        return states

    worlds = make_worlds(ENV, 3, {"observation": "state", "dynamics": "kinematic"})
    check_graph(worlds, features, tmp_path, near_the_goal)
