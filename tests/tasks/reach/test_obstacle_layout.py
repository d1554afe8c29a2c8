import time

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, Workspace
from armctl.tasks.reach import obstacle_layout
from armctl.tasks.reach.obstacle_layout import HOME_MARGIN, MAX_OBSTACLES, TARGET_MARGIN, sample_layout

TOLERANCE = 0.05


@pytest.fixture(scope="module", params=["ur5", "ur3"])
def workspace(request):
    return Workspace(ArmModel(request.param))


def layouts(workspace, count, seed=0):
    rng = np.random.default_rng(seed)
    return [sample_layout(rng, workspace, TOLERANCE) for _ in range(count)]


def test_nothing_is_near_the_arm_at_home_or_the_target(workspace):
    model, scale = workspace.model, workspace.radius
    for layout in layouts(workspace, 100):
        assert len(layout.boxes) <= MAX_OBSTACLES
        assert model.box_distances(model.home, layout.boxes).min(initial=1) >= HOME_MARGIN * scale
        assert layout.boxes.distances(layout.target).min(initial=1) >= TOLERANCE + TARGET_MARGIN * scale
        assert layout.target[2] >= TOLERANCE


def test_the_arm_can_be_at_every_target(workspace):
    for layout in layouts(workspace, 50, seed=1):
        among = workspace.model.among(layout.boxes)
        assert any(among.is_free(q) for q in workspace.ik.free_configurations(layout.target))


def test_the_soonest_straight_motion_often_collides(workspace):
    model, blocked = workspace.model, 0
    drawn = layouts(workspace, 100, seed=2)
    for layout in drawn:
        goals = np.array(list(workspace.ik.free_configurations(layout.target)))
        goals = workspace.model.nearest_turn(goals, model.home)
        goal, among = goals[np.argmin(model.min_time(model.home, goals))], model.among(layout.boxes)
        blocked += not all(among.is_free(q) for q in np.linspace(model.home, goal, 80))
    assert blocked >= 40


def test_layouts_differ_and_have_all_kinds_of_obstacles(workspace):
    drawn = layouts(workspace, 60, seed=3)
    assert len({len(layout.boxes) for layout in drawn}) >= 5
    sizes = np.vstack([layout.boxes.half_sizes for layout in drawn]) / workspace.radius
    posts = np.isclose(sizes[:, 0], obstacle_layout.POST_HALF_WIDTH) & np.isclose(
        sizes[:, 1], obstacle_layout.POST_HALF_WIDTH
    )
    boards = np.isclose(sizes, obstacle_layout.BOARD_HALF_THICKNESS).any(axis=1)
    assert posts.sum() > 20
    assert boards.sum() > 10
    assert (~posts & ~boards).sum() > 60


def test_the_same_generator_draws_the_same_layout(workspace):
    for first, second in zip(layouts(workspace, 5, seed=4), layouts(workspace, 5, seed=4), strict=True):
        np.testing.assert_array_equal(first.target, second.target)
        for part in ("centres", "half_sizes", "yaws"):
            np.testing.assert_array_equal(getattr(first.boxes, part), getattr(second.boxes, part))


def test_drawing_is_quick(workspace):
    begin = time.process_time()
    layouts(workspace, 50, seed=5)
    assert (time.process_time() - begin) / 50 <= 0.02


def test_an_arm_without_room_anywhere_is_refused(workspace, monkeypatch):
    monkeypatch.setattr(obstacle_layout, "ATTEMPTS", 3)
    monkeypatch.setattr(obstacle_layout, "GOAL_MARGIN", 5.0)
    with pytest.raises(ConfigurationError, match="3 layouts"):
        sample_layout(np.random.default_rng(0), workspace, TOLERANCE)
