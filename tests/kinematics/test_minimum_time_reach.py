import numpy as np
import pytest
from scipy.optimize import minimize

from armctl.kinematics import THOROUGH, ArmModel, Ik, MinimumTimeReach, Workspace

from ..kernels.joint_profiles import max_displacement, trapezoidal_displacement

RADIUS = 0.05


class Arm:
    """A model with all that its touches are measured against."""

    def __init__(self, name):
        self.model = ArmModel(name)
        self.touch, self.ik, self.workspace = MinimumTimeReach(self.model), Ik(self.model), Workspace(self.model)

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

    def way_is_free(self, start, command, time):
        """Whether the joints touch nothing on their way to what is commanded, until `time`."""
        times = np.linspace(0, time, 200)[:, None]
        return all(
            self.model.is_free(start + moved)
            for moved in trapezoidal_displacement(times, command - start, self.model.limits)
        )


@pytest.fixture(scope="module", params=["ur3", "ur5", "ur10"])
def arm(request):
    return Arm(request.param)


def test_touches_lie_in_the_sphere_within_limits_at_their_time(arm):
    for start, centre in arm.cases(25):
        touch = arm.touch.find(start, centre, RADIUS)
        assert np.linalg.norm(arm.model.position(touch.q) - centre) <= RADIUS + 1e-9
        assert arm.model.within_limits(touch.q)
        assert touch.time == pytest.approx(arm.model.min_time(start, touch.q), abs=1e-9)


def test_a_way_called_free_is_free(arm):
    touches = [(start, arm.touch.find(start, centre, RADIUS)) for start, centre in arm.cases(25)]
    free = [(start, touch.command, touch.time) for start, touch in touches if touch.collision_free]
    assert len(free) >= 20
    assert all(arm.way_is_free(*way) for way in free)


@pytest.mark.one_case
@pytest.mark.parametrize("at_home", [True, False])
def test_is_as_soon_as_the_best_of_many_free_ways_to_the_centre(arm, at_home):
    ratios = []
    for start, centre in arm.cases(12, at_home):
        touch = arm.touch.find(start, centre, RADIUS)
        plain = arm.ik.position(centre, start, count=24).solutions
        times = [float(arm.model.min_time(start, q)) for q in plain]
        if free := [time for q, time in zip(plain, times, strict=True) if arm.way_is_free(start, q, time)]:
            assert touch.collision_free
            ratios.append(touch.time / min(free))
    assert len(ratios) > 9
    assert np.median(ratios) <= 0.95
    assert np.quantile(ratios, 1 if at_home else 0.9) <= 1.05


def test_joints_commanded_so_are_in_the_sphere_in_time(arm):
    for start, centre in arm.cases(20, at_home=True):
        touch = arm.touch.find(start, centre, RADIUS)
        moved = trapezoidal_displacement(np.array([touch.time]), touch.command - start, arm.model.limits)
        late = np.abs(touch.q - start) - np.abs(moved)
        assert late.max() < 1e-6


@pytest.mark.slow
def test_no_general_solver_finds_a_sooner_touch(arm):
    thorough = MinimumTimeReach(arm.model, THOROUGH)
    rng = np.random.default_rng(0)
    for start, centre in arm.cases(3, at_home=True):
        bound = thorough.min_time(start, centre, RADIUS)
        others = [
            solved_by_slsqp(arm.model, start, centre, start + rng.uniform(-1, 1, arm.model.dof)) for _ in range(5)
        ]
        assert bound <= 1.02 * min(others)


def solved_by_slsqp(model, start, centre, guess):
    """Least time into the sphere by SciPy's general solver, infinite if it fails."""

    def reach(time):
        return max_displacement(np.maximum(time, 1e-6), 0.0, model.limits)[0]

    constraints = [
        {"type": "ineq", "fun": lambda x: RADIUS**2 - np.sum((model.position(x[:-1]) - centre) ** 2)},
        {"type": "ineq", "fun": lambda x: reach(x[-1]) - (x[:-1] - start)},
        {"type": "ineq", "fun": lambda x: reach(x[-1]) + (x[:-1] - start)},
    ]
    found = minimize(  # type: ignore[call-overload]
        lambda x: x[-1],
        np.append(guess, model.min_time(start, guess)),
        constraints=constraints,
        bounds=[*zip(model.limits.lower, model.limits.upper, strict=True), (0, None)],
        method="SLSQP",
    )
    inside = np.linalg.norm(model.position(found.x[:-1]) - centre) <= RADIUS + 1e-6
    return model.min_time(start, found.x[:-1]) if inside else np.inf


def test_an_arm_on_its_way_is_there_sooner(arm):
    for start, centre in arm.cases(10, at_home=True):
        touch = arm.touch.find(start, centre, RADIUS)
        velocity = 0.5 * arm.model.limits.velocity * np.sign(touch.q - start)
        assert arm.touch.min_time(start, centre, RADIUS, velocity) < touch.time


def test_larger_spheres_are_touched_sooner(arm):
    times = [
        [arm.touch.find(arm.model.home, centre, radius).time for radius in (0.01, 0.05, 0.1)]
        for _, centre in arm.cases(12, at_home=True)
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
            assert touch.time <= 2 * np.pi / arm.model.limits.velocity.min() + 0.3


@pytest.mark.parametrize("centre", [[5, 0, 0.5], [0, 0, 9], [np.nan, 0, 0.5]])
def test_spheres_out_of_reach_give_none(arm, centre):
    assert arm.touch.find(arm.model.home, np.array(centre, dtype=float), RADIUS) is None


def test_same_arguments_same_touch(arm):
    other = MinimumTimeReach(arm.model)
    for start, centre in arm.cases(10):
        start_before, centre_before = start.copy(), centre.copy()
        touches = [touch.find(start, centre, RADIUS) for touch in (arm.touch, arm.touch, other)]
        assert len({(*touch.q, touch.time, touch.collision_free) for touch in touches}) == 1
        np.testing.assert_array_equal(start, start_before)
        np.testing.assert_array_equal(centre, centre_before)
