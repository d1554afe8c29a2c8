import numpy as np
import pytest

from armctl.kinematics import ArmModel, Ik, SoonestTouch, Workspace

RADIUS = 0.05


class Arm:
    """A model with all that its touches are measured against."""

    def __init__(self, name):
        self.model = ArmModel(name)
        self.touch, self.ik, self.workspace = SoonestTouch(self.model), Ik(self.model), Workspace(self.model)

    def free_start(self, rng):
        low, high = np.maximum(self.model.limits.lower, -np.pi), np.minimum(self.model.limits.upper, np.pi)
        while not self.model.is_free(q := rng.uniform(low, high)):
            pass
        return q

    def cases(self, count, at_home=False):
        """Starts, and the centres of spheres within reach."""
        rng = np.random.default_rng(0)
        for _ in range(count):
            yield self.model.home if at_home else self.free_start(rng), self.workspace.sample(rng, RADIUS)

    def way_is_free(self, start, goal, spacing=0.01):
        """Whether the joints, each at full speed from start to goal, touch nothing on the way."""
        velocity = self.model.limits.velocity
        times = np.arange(0, self.model.least_time(start, goal) + spacing, spacing / velocity.max())
        steps = [np.clip(goal - start, -velocity * time, velocity * time) for time in times]
        return all(self.model.is_free(start + step) for step in steps)


@pytest.fixture(scope="module", params=["ur3", "ur5", "ur10"])
def arm(request):
    return Arm(request.param)


def test_touches_lie_in_the_sphere_within_limits_at_their_time(arm):
    for start, centre in arm.cases(60):
        touch = arm.touch.find(start, centre, RADIUS)
        assert np.linalg.norm(arm.model.position(touch.q) - centre) <= RADIUS + 1e-9
        assert arm.model.within_limits(touch.q)
        assert touch.time == pytest.approx(arm.model.least_time(start, touch.q), abs=1e-9)


def test_a_way_called_free_is_free(arm):
    touches = [(start, arm.touch.find(start, centre, RADIUS)) for start, centre in arm.cases(60)]
    free = [(start, touch.q) for start, touch in touches if touch.free]
    assert len(free) >= 50
    assert all(arm.way_is_free(*way) for way in free)


@pytest.mark.parametrize("at_home", [True, False])
def test_is_as_soon_as_the_best_of_many_free_ways_to_the_centre(arm, at_home):
    ratios = []
    for start, centre in arm.cases(25, at_home):
        touch = arm.touch.find(start, centre, RADIUS)
        plain = arm.ik.position(centre, start, count=24).solutions
        if free := [q for q in plain if arm.way_is_free(start, q)]:
            assert touch.free
            ratios.append(touch.time / arm.model.least_time(start, np.array(free)).min())
    assert len(ratios) > 20
    assert np.median(ratios) <= 0.95
    assert np.quantile(ratios, 1 if at_home else 0.9) <= 1.05


def test_larger_spheres_are_touched_sooner(arm):
    times = [
        [arm.touch.find(arm.model.home, centre, radius).time for radius in (0.01, 0.05, 0.1)]
        for _, centre in arm.cases(20, at_home=True)
    ]
    small, medium, large = np.transpose(times)
    assert np.mean(medium <= small) >= 0.9
    assert np.mean(large <= medium) >= 0.9


def test_being_there_already_takes_hardly_any_time(arm):
    rng = np.random.default_rng(0)
    for _ in range(50):
        start = arm.free_start(rng)
        direction = rng.normal(size=3)
        offset = 0.9 * RADIUS * rng.uniform() * direction / np.linalg.norm(direction)
        assert arm.touch.find(start, arm.model.position(start) + offset, RADIUS).time <= 0.01


def test_starts_at_a_joint_limit(arm):
    for limit in (arm.model.limits.lower, arm.model.limits.upper):
        start = arm.model.home.copy()
        start[[0, 3, 4, 5]] = limit[[0, 3, 4, 5]]
        for _, centre in arm.cases(10):
            touch = arm.touch.find(start, centre, RADIUS)
            assert arm.model.within_limits(touch.q)
            assert touch.time <= 2 * np.pi / arm.model.limits.velocity.min()


@pytest.mark.parametrize("centre", [[5, 0, 0.5], [0, 0, 9], [np.nan, 0, 0.5]])
def test_spheres_out_of_reach_give_none(arm, centre):
    assert arm.touch.find(arm.model.home, np.array(centre, dtype=float), RADIUS) is None


def test_same_arguments_same_touch(arm):
    other = SoonestTouch(arm.model)
    for start, centre in arm.cases(10):
        start_before, centre_before = start.copy(), centre.copy()
        touches = [touch.find(start, centre, RADIUS) for touch in (arm.touch, arm.touch, other)]
        assert len({(*touch.q, touch.time, touch.free) for touch in touches}) == 1
        np.testing.assert_array_equal(start, start_before)
        np.testing.assert_array_equal(centre, centre_before)
