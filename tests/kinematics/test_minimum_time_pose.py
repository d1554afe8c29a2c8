import numpy as np
import pytest
from scipy.optimize import least_squares

from armctl.kinematics import ArmModel, MinimumTimePose, Workspace

LEVER, RADIUS = 0.115, 0.018
"""m/rad and m."""


@pytest.fixture(scope="module")
def search():
    return MinimumTimePose(ArmModel("ur5"), LEVER)


def targets(search, count, seed=0):
    workspace, rng = Workspace(search.model), np.random.default_rng(seed)
    return [search.place(workspace.sample_pose(rng, 0.02)[1]) for _ in range(count)]


def test_the_jacobian_of_places_is_that_of_finite_differences(search):
    for q in search.model.random_configurations(np.random.default_rng(0), 5):
        differences = [(search.place(q + step) - search.place(q - step)) / 2e-6 for step in 1e-6 * np.eye(6)]
        np.testing.assert_allclose(search.place_jacobian(q), np.transpose(differences), atol=1e-7)


def test_a_place_gives_its_pose_back_and_axes_may_be_inexact(search):
    q = search.model.random_configurations(np.random.default_rng(1), 1)[0]
    place = search.place(q)
    np.testing.assert_allclose(search.pose(place), search.model.pose(q), atol=1e-12)
    np.testing.assert_allclose(search.centre(place[:3], 3.0 * place[3:9]), place, atol=1e-12)


def test_the_closest_configuration_of_a_pose_is_the_branch_nearest_to_where_the_arm_is(search):
    for q, near in search.model.random_configurations(np.random.default_rng(2), 40).reshape(20, 2, 6):
        branches = search.configurations(near, search.place(q))
        distances = np.abs(branches - near).max(axis=1)
        np.testing.assert_array_equal(search.closest(search.place(q), near), branches[distances.argmin()])


def test_poses_around_one_are_shifted_within_the_radius_and_keep_the_orientation(search):
    home = search.model.home
    for centre in targets(search, 5):
        around = search.around(centre, RADIUS)
        shifts = np.linalg.norm(around - centre, axis=1)
        assert len(around) == 12
        assert shifts.max() == pytest.approx(RADIUS)
        assert shifts.min() > 0
        np.testing.assert_allclose((around - centre).mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_array_equal(around[:, 3:], np.tile(centre[3:], (len(around), 1)))
        for place in around:
            for q in search.configurations(home, place):
                np.testing.assert_allclose(search.place(q), place, atol=1e-5)


def test_goals_are_in_the_ball_and_no_later_than_the_branches(search):
    home = search.model.home
    for centre in targets(search, 20):
        goal = search.find(home, centre, RADIUS)
        branches = search.at_centre(home, centre)
        assert np.linalg.norm(search.place(goal.q) - centre) <= RADIUS
        assert goal.collision_free
        assert goal.time <= search.model.min_time(home, branches[0]) + 0.02


def test_least_times_agree_with_bisection_by_bounded_least_squares(search):
    """Within a time, each joint reaches an interval, in which a configuration of the ball exists or does not."""
    model, home = search.model, search.model.home
    limits = model.limits

    def missed(q, centre):
        return search.place(q) - centre

    def jacobian(q, centre):
        return search.place_jacobian(q)

    for centre in targets(search, 3):
        times = []
        for branch in search._guesses(home, centre):
            low_time, high_time = 0.0, float(model.min_time(home, branch))
            for _ in range(10):
                time = (low_time + high_time) / 2
                ramp = np.minimum(time, limits.velocity / limits.acceleration)
                travel = limits.acceleration * ramp**2 / 2 + limits.velocity * (time - ramp) + 1e-9
                low, high = np.maximum(home - travel, limits.lower), np.minimum(home + travel, limits.upper)
                best = least_squares(
                    missed, np.clip(branch, low, high), jacobian, bounds=(low, high), max_nfev=30, args=(centre,)
                )
                is_inside = np.linalg.norm(best.fun) <= RADIUS
                low_time, high_time = (low_time, time) if is_inside else (time, high_time)
            times.append(high_time)
        assert search.min_time(home, centre, RADIUS) == pytest.approx(min(times), abs=0.02)


def test_times_of_many_arms_are_upper_bounds_that_become_zero(search):
    home, centres = search.model.home, np.array(targets(search, 20))
    goals = np.full((20, 8, 6), np.nan)
    for row, centre in zip(goals, centres, strict=True):
        branches = search._guesses(home, centre)
        row[: len(branches)] = branches
    still = np.zeros((20, 6))
    times = search.times(np.tile(home, (20, 1)), still, centres, RADIUS, goals)
    bounds = np.array([search.min_time(home, centre, RADIUS) for centre in centres])
    assert (times >= bounds - 0.02).all()
    assert np.median(times - bounds) < 0.03
    np.testing.assert_array_equal(search.times(goals[:, 0].copy(), still, centres, RADIUS, goals), 0.0)
