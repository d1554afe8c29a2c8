"""Ranges of depth images, against those of networks and of the sensor without physics."""

import gymnasium
import numpy as np
import pytest
import torch

from armctl.estimation.depth_ranges import DepthCamera
from armctl.rl.networks.bridge_ranges import ColumnRanges
from armctl.robots.rover import CAMERA, CAMERA_AHEAD, CAMERA_PITCH
from armctl.tasks.bridge.observation import camera_pitch, column_directions

CAMERA_AT_REST = DepthCamera(height=32, width=48, field_of_view=110.0, farthest=10.0, pitch=CAMERA_PITCH)


@pytest.fixture(scope="module")
def drive():
    """Images of a drive on two bridges, in which the rover speeds up, turns and brakes."""
    env = gymnasium.make_vec("armctl/BridgeCross-v0", num_envs=2, autoreset_mode="disabled")
    first, commands = env.reset(seed=103)[0], (*[(1.5, 0.3)] * 8, *[(0.0, 0.0)] * 4)
    return env, [first, *(env.step(np.tile(command, (2, 1)))[0] for command in commands)]


def test_the_camera_is_where_the_model_has_it(drive):
    task = drive[0].unwrapped.task
    assert camera_pitch(task.simulation.model) == pytest.approx(CAMERA_PITCH, abs=1e-4)
    assert task.simulation.model.camera(CAMERA).pos[0] == CAMERA_AHEAD
    directions = CAMERA_AT_REST.directions
    np.testing.assert_allclose(directions, column_directions(task.options, CAMERA_PITCH), atol=1e-12)


def test_ranges_are_those_that_networks_compute(drive):
    env, observations = drive
    networks = ColumnRanges(env.single_observation_space, 110.0, 10.0, CAMERA_PITCH)
    for observed in observations:
        expected = networks({name: torch.tensor(values) for name, values in observed.items()})["ranges"].numpy()
        np.testing.assert_allclose([CAMERA_AT_REST.ranges(image) for image in observed["image"]], expected, rtol=1e-3)


@pytest.mark.parametrize("image", [np.zeros((32, 48)), np.full((32, 48), 10.0), np.full((32, 48), np.nan)])
def test_images_of_nothing_have_ranges_within_bounds(image):
    ranges = CAMERA_AT_REST.ranges(image)
    assert ranges.shape == (48,)
    assert not ((ranges < 0) | (ranges > 10)).any()
