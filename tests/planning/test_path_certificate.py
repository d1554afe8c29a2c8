import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.planning import ArmPlanner, ArmPlannerOptions, PathCertificate, PathCertificateOptions
from armctl.scene import NO_BOXES, Boxes

from ..capsule_world import CapsuleWorld
from .test_arm_planner import TOLERANCE, Case, densely


@pytest.fixture(scope="module")
def ur5():
    return Case("ur5")


@pytest.mark.parametrize("robot", ["ur5", "panda"])
def test_certified_paths_are_free_in_mujoco_and_end_at_the_target(robot):
    case = Case(robot)
    certificate = PathCertificate(case.model)
    paths = 0
    for layout in case.layouts(6):
        path = certificate.path(case.model.home, layout.target, layout.boxes)
        if not len(path):
            continue
        paths += 1
        world = CapsuleWorld(case.model, layout.boxes)
        np.testing.assert_array_equal(path[0], case.model.home)
        np.testing.assert_allclose(case.model.position(path[-1]), layout.target, atol=1e-4)
        assert case.model.within_limits(path).all()
        assert min(world.distance(q) for q in densely(path)) > 0
    assert paths >= 5


def test_an_answer_depends_on_the_layout_alone(ur5):
    layouts = ur5.layouts(8, seed=2)
    certificate = PathCertificate(ur5.model)
    forward = [certificate.path(ur5.model.home, one.target, one.boxes) for one in layouts]
    for layout, path in reversed(list(zip(layouts, forward, strict=True))):
        ur5.plan(layout)
        other = PathCertificate(ur5.model)
        np.testing.assert_array_equal(other.path(ur5.model.home, layout.target, layout.boxes), path)


def test_certificate_and_expert_do_not_follow_each_other(ur5):
    """With a budget of nothing, either fails where the other succeeds."""
    layout = next(layout for layout in ur5.layouts(20, seed=3) if ur5.plan(layout).searched)
    query = ur5.model.home, layout.target
    starved = PathCertificate(ur5.model, PathCertificateOptions(checks=0))
    assert not len(starved.path(*query, layout.boxes))
    assert ur5.plan(layout).solved
    hasty = ArmPlanner(ur5.model, ArmPlannerOptions(checks=0, direct=0))
    assert not hasty.plan(*query, TOLERANCE, layout.boxes).solved
    assert len(PathCertificate(ur5.model).path(*query, layout.boxes))


def test_a_path_is_certified_to_given_configurations(ur5):
    certificate, goals = PathCertificate(ur5.model), ur5.model.random_configurations(np.random.default_rng(0), 20)
    path = certificate.path_to(goals, ur5.model.home, NO_BOXES)
    np.testing.assert_array_equal(path[0], ur5.model.home)
    assert np.abs(goals - path[-1]).max(axis=1).min() < 1e-9
    assert not len(certificate.path_to([], ur5.model.home, NO_BOXES))


def test_there_is_no_path_into_a_closed_box_or_out_of_reach(ur5):
    certificate, target = PathCertificate(ur5.model, PathCertificateOptions(checks=2000)), np.array((0.5, 0.2, 0.4))
    assert len(certificate.path(ur5.model.home, target, NO_BOXES))
    walls = target + 0.12 * np.vstack((np.eye(3), -np.eye(3)))
    halves = np.where(np.tile(np.eye(3), (2, 1)) > 0, 0.01, 0.13)
    assert not len(certificate.path(ur5.model.home, target, Boxes(walls, halves, np.zeros(6))))
    assert not len(certificate.path(ur5.model.home, np.array((5.0, 0, 0)), NO_BOXES))


@pytest.mark.parametrize("options", [{"clearance": 0}, {"goals": 0}, {"checks": -1}, {"stride": 0}])
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError):
        PathCertificateOptions(**options)
