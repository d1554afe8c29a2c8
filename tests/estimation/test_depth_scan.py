"""What stands in depth images, against the truth of the simulation."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.estimation.depth_ranges import DepthCamera
from armctl.estimation.depth_scan import CameraMount, DepthScanner
from armctl.robots.rover import CAMERA, CAMERA_AHEAD, CAMERA_PITCH

MOUNT = CameraMount(CAMERA_AHEAD, above=0.302, lift=0.31)


@pytest.fixture(scope="module")
def scanner():
    return DepthScanner(DepthCamera(32, 48, 110.0, 10.0, CAMERA_PITCH), MOUNT)


@pytest.fixture(scope="module")
def drive():
    """Poses, pitches, maps and images of drives on two bridges with people, in which the rover speeds up and brakes."""
    env: Any = gymnasium.make_vec("armctl/BridgeCrossMoving-v0", num_envs=2, autoreset_mode="disabled")
    observations, _ = env.reset(seed=103)
    task, records = env.unwrapped.task, []
    rotations = task.simulation.array("cam_xmat")[:, task.simulation.model.camera(CAMERA).id]
    for command in (*[(1.8, 0.4)] * 8, *[(0.0, 0.0)] * 4):
        observations, *_ = env.step(np.tile(command, (2, 1)))
        for i in range(2):
            people = task.map(i).pedestrians.positions(task.state.time[i])
            pitch = float(np.arcsin(rotations[i, 8]))
            records.append((task.state.poses[i], pitch, task.map(i), people, observations["image"][i]))
    return records


def in_world(points, pose):
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + points @ np.array(((cos, sin), (-sin, cos)))


@pytest.mark.parametrize(("noise", "tolerance", "pitch_tolerance"), [(0.0, 0.15, 0.015), (0.1, 0.3, 0.03)])
def test_points_are_on_what_stands_there_and_the_pitch_is_the_cameras(
    scanner, drive, noise, tolerance, pitch_tolerance
):
    rng = np.random.default_rng(0)
    for pose, pitch, bridge, people, image in drive:
        scan = scanner.scan(np.clip(image + noise * rng.standard_normal(image.shape), 0, 10))
        assert scan.pitch == pytest.approx(pitch, abs=pitch_tolerance)
        assert scan.noise == pytest.approx(noise, abs=0.05)
        points = in_world(scan.standing[np.isfinite(scan.standing[:, 0])], pose)
        to_people = np.linalg.norm(points[:, None] - people, axis=-1).min(axis=1) - 0.25
        distances = np.minimum(np.abs(bridge.clearance(points)), np.abs(to_people))
        assert len(points) > 20
        assert np.quantile(distances, 0.9) < tolerance


def test_only_people_are_tall(scanner, drive):
    count = 0
    for pose, _, _, people, image in drive:
        tall = in_world(scanner.scan(image).tall, pose)
        tall = tall[np.isfinite(tall[:, 0])]
        count += len(tall)
        assert (np.abs(np.linalg.norm(tall[:, None] - people, axis=-1).min(axis=1, initial=9) - 0.25) < 0.1).all()
    assert count > 20


def test_lost_images_are_none_and_images_of_nothing_are_free(scanner):
    assert scanner.scan(np.zeros((32, 48))) is None
    assert scanner.scan(np.full((32, 48), np.nan)) is None
    nothing = scanner.scan(np.full((32, 48), 10.0))
    assert np.isnan(nothing.standing).all()
    assert np.isnan(nothing.tall).all()
    np.testing.assert_allclose(nothing.free, 9.7)


def test_pixels_without_a_number_do_not_matter(scanner, drive):
    image = drive[-1][-1].copy()
    whole = scanner.scan(image)
    image[::7, ::5] = np.nan
    np.testing.assert_allclose(scanner.scan(image).free, whole.free, atol=0.2)


def test_ranges_of_painted_images_are_those_without_noise(scanner, drive):
    rng, errors, noisy_errors = np.random.default_rng(1), [], []
    for *_, image in drive:
        noisy = np.clip(image + 0.05 * rng.standard_normal(image.shape), 0, 10)
        truth = scanner.camera.ranges(image)
        errors.append(scanner.camera.ranges(scanner.painted(noisy, scanner.scan(noisy))) - truth)
        noisy_errors.append(scanner.camera.ranges(noisy) - truth)
    assert np.quantile(np.abs(errors), 0.9) < 0.25
    assert np.quantile(np.abs(noisy_errors), 0.9) > 1.0
