import numpy as np
import pytest

from armctl.control import PursuitOptions, RegulatedPurePursuit
from armctl.core.errors import ConfigurationError
from armctl.planning import plan_path
from armctl.tasks.bridge.layout import sample_layout

PERIOD = 0.1


def drive(path, turning=1.0, pose=(0.0, 0.0, 0.0), limit=600):
    """Poses of a unicycle that turns by a share of what it is told, until it is at the path's end."""
    pursuit, pose, speed = RegulatedPurePursuit(path), np.array(pose, dtype=float), 0.0
    poses, speeds = [pose.copy()], []
    for _ in range(limit):
        linear, angular = pursuit.command(pose, speed)
        for _ in range(10):
            speed += np.clip(linear - speed, -0.04, 0.04)  # 4 m/s^2
            pose[2] += turning * angular * PERIOD / 10
            pose[:2] += speed * PERIOD / 10 * np.array((np.cos(pose[2]), np.sin(pose[2])))
        poses.append(pose.copy())
        speeds.append(speed)
        if pursuit.progress >= pursuit.path.length:
            return np.array(poses), np.array(speeds), pursuit
    raise AssertionError("it did not arrive")


def deviation(poses, path):
    """Largest distance of the poses from the path, which goes on straight, m."""
    path = np.vstack((path, path[-1] + (path[-1] - path[-2]) / np.linalg.norm(path[-1] - path[-2])))
    starts, ways = path[:-1], np.diff(path, axis=0)
    offset = poses[:, None, :2] - starts
    share = np.clip((offset * ways).sum(axis=-1) / (ways * ways).sum(axis=-1), 0, 1)
    return np.linalg.norm(offset - share[..., None] * ways, axis=-1).min(axis=1).max()


@pytest.mark.one_case
@pytest.mark.parametrize("turning", [0.8, 1.0, 1.1])
def test_planned_paths_are_kept_to_at_speed(turning):
    rng, averages = np.random.default_rng(0), []
    for _ in range(15):
        path = plan_path(sample_layout(rng, 20.0, 4.0, 7, 0, 1).map, (1.0, 0.0), 19.0).path
        poses, speeds, _ = drive(path, turning, (1.0, 0.0, 0.0))
        assert deviation(poses, path) < 0.08
        averages.append(speeds.mean())
    assert np.mean(averages) > 1.6


def test_it_turns_on_the_spot_when_the_path_lies_behind():
    pursuit = RegulatedPurePursuit([(0, 0), (-5, 0.1)])
    linear, angular = pursuit.command((0, 0, 0), 0.0)
    assert linear == 0
    assert angular > 1
    path = np.array([(0.0, 0.0), (-5.0, 0.1)])
    poses, _, _ = drive(path)
    assert deviation(poses, path) < 0.1


def test_curves_are_driven_slower_and_limits_kept():
    options = PursuitOptions()
    rng = np.random.default_rng(1)
    for _ in range(200):
        pursuit = RegulatedPurePursuit(np.cumsum(rng.normal(0, 0.5, (10, 2)), axis=0))
        linear, angular = pursuit.command((*rng.normal(0, 1, 2), rng.uniform(-9, 9)), rng.uniform(0, 2))
        assert 0 <= linear <= options.max_speed + 1e-9
        assert abs(angular) <= options.max_turn_rate + 1e-9
    straight = RegulatedPurePursuit([(0, 0), (9, 0)]).command((0, 0, 0), 1.0)
    bent = RegulatedPurePursuit([(0, 0), (0.2, 0), (0.4, 0.5), (0.4, 3)]).command((0, 0, 0), 1.0)
    assert straight == (options.max_speed, 0.0)
    assert bent[0] < 0.8 * straight[0]


def test_left_and_right_are_alike():
    path = np.array([(0, 0), (1, 0.3), (2, -0.4), (4, 0)])
    left = RegulatedPurePursuit(path).command((0.1, 0.05, 0.2), 1.0)
    right = RegulatedPurePursuit(path * (1, -1)).command((0.1, -0.05, -0.2), 1.0)
    assert left == pytest.approx((right[0], -right[1]))


def test_progress_never_goes_back_nor_jumps_to_a_later_part_nearby():
    there_and_back = RegulatedPurePursuit([(0, 0), (5, 0), (5, 0.2), (0, 0.2)])
    for x in (0.5, 1.0, 0.2, 0.4, 1.5):
        before = there_and_back.progress
        there_and_back.command((x, 0.15, 0.0), 1.0)
        assert before <= there_and_back.progress <= 2
    assert there_and_back.progress == pytest.approx(1.5, abs=0.03)


def test_points_along_the_path_and_beyond():
    pursuit = RegulatedPurePursuit([(0, 0), (3, 4), (3, 10)])
    assert pursuit.path.length == pytest.approx(11)
    np.testing.assert_allclose(
        pursuit.path.points_at([0, 2.5, 5, 8, 11, 13]), [(0, 0), (1.5, 2), (3, 4), (3, 7), (3, 10), (3, 12)]
    )
    assert pursuit.path.points_at(np.zeros((2, 3))).shape == (2, 3, 2)


def test_repeated_points_are_no_obstacle():
    pursuit = RegulatedPurePursuit([(0, 0), (0, 0), (1, 0), (1, 0), (2, 0)])
    assert pursuit.path.length == pytest.approx(2)
    assert np.isfinite(pursuit.command((0, 0, 0), 0.0)).all()


@pytest.mark.parametrize(
    "path", [[], [(0, 0)], [(0, 0), (0, 0)], [(0, 0), (np.nan, 1)], [(0, 0, 0), (1, 1, 1)], np.zeros(4)]
)
def test_unusable_paths_are_refused(path):
    with pytest.raises(ConfigurationError, match="path"):
        RegulatedPurePursuit(path)
