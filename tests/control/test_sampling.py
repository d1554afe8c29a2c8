"""Sampling MPC: textbook cases, properties of every plan, and rollouts against the laws that they roll out."""

import numpy as np
import pytest

from armctl.control.sampling import SamplingMpc, SamplingOptions, path_integral_weights
from armctl.control.sampling_rollouts import (
    ArmRollouts,
    ArmState,
    DriveCosts,
    DriveModel,
    ReachCosts,
    RoverRollouts,
    RoverState,
)
from armctl.control.streaming import follow
from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, ArmShapes, ImaginedArms
from armctl.kinematics.imagined import TOUCHED
from armctl.planning.cost_to_go import Lattice
from armctl.scene import BridgeMap

from ..arms import random_boxes

METHODS = ("predictive", "mppi", "cem")
PERIOD, HORIZON = 0.04, 12


def to_zero(target, actions):
    """Squared distance from a target, (n,)."""
    return ((actions - target) ** 2).sum(axis=(1, 2))


@pytest.mark.parametrize("method", METHODS)
def test_each_method_finds_the_minimum_of_a_parabola(method):
    options = SamplingOptions(method=method, samples=64, horizon=10, knots=4, noise=0.5, finest=0.02, iterations=30)
    target = np.column_stack((np.linspace(-0.5, 0.5, 10), np.linspace(0.3, 0.0, 10) ** 2))
    mpc = SamplingMpc(to_zero, [-1, -1], [1, 1], options)
    plan = mpc.plan(target, np.random.default_rng(0))
    assert plan.cost == pytest.approx(to_zero(target, plan.actions[None])[0])
    assert plan.cost < 0.01 * to_zero(target, np.zeros((1, 10, 2)))[0]


def test_the_mean_of_mppi_is_that_of_its_closed_form():
    """Gaussian noise and costs c u weigh like a Gaussian whose mean is moved by -noise^2 c / temperature."""
    rng, slope, noise, temperature = np.random.default_rng(0), np.array([1.0, -0.5]), 0.3, 2.0
    draws = noise * rng.standard_normal((200_000, 2))
    costs = draws @ slope
    mean = path_integral_weights(costs, temperature / costs.std()) @ draws
    np.testing.assert_allclose(mean, -(noise**2) * slope / temperature, atol=4e-3)


def test_temperatures_lead_from_the_cheapest_to_the_mean():
    costs = np.array([3.0, 1.0, 2.0, np.inf])
    np.testing.assert_allclose(path_integral_weights(costs, 1e-3), [0, 1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(path_integral_weights(costs, 1e6), [1 / 3, 1 / 3, 1 / 3, 0], atol=1e-5)
    np.testing.assert_allclose(path_integral_weights(np.full(4, 7.0), 0.1), 0.25)


@pytest.mark.parametrize("method", METHODS)
def test_no_plan_costs_more_than_the_last_one_or_a_guess(method):
    rng = np.random.default_rng(1)
    options = SamplingOptions(method=method, samples=8, horizon=6, knots=3, noise=2.0, iterations=2, elites=3)

    def rough(phase, actions):
        return np.sin(40 * actions + phase).sum(axis=(1, 2))

    mpc = SamplingMpc(rough, [-1] * 3, [2] * 3, options)
    for _ in range(20):
        phase, guesses = rng.uniform(0, 6), rng.uniform(-1, 2, (4, 6, 3))
        shifted = np.concatenate((mpc.actions[1:], mpc.actions[-1:]))
        plan = mpc.plan(phase, rng, guesses)
        assert plan.cost <= rough(phase, np.concatenate((shifted[None], guesses))).min() + 1e-12
        assert ((plan.actions >= -1) & (plan.actions <= 2)).all()
        np.testing.assert_array_equal(mpc.actions, plan.actions)


@pytest.mark.parametrize("method", METHODS)
def test_costs_that_are_no_numbers(method):
    options = SamplingOptions(method=method, samples=16, horizon=4, knots=2)
    rng = np.random.default_rng(0)
    half = SamplingMpc(lambda _, actions: np.where(actions[:, 0, 0] > 0, np.nan, -actions[:, 0, 0]), [-1], [1], options)
    half.reset([-1.0])
    plan = half.plan(None, rng)
    assert np.isfinite(plan.cost)
    assert plan.actions[0, 0] <= 0
    never = SamplingMpc(lambda _, actions: np.full(len(actions), np.nan), [-1], [1], options)
    never.reset([0.5])
    for failures in (1, 2):
        plan = never.plan(None, rng)
        assert plan.cost == np.inf
        np.testing.assert_array_equal(plan.actions, np.full((4, 1), 0.5))
        assert never.failures == failures


@pytest.mark.parametrize(("horizon", "knots"), [(1, 4), (5, 1), (2, 2), (3, 30), (20, 3)])
def test_any_number_of_knots(horizon, knots):
    options = SamplingOptions(horizon=horizon, knots=knots, samples=4)
    plan = SamplingMpc(to_zero, 0.0, 1.0, options).plan(1.0, np.random.default_rng(0))
    assert plan.actions.shape == (horizon, 1)


@pytest.mark.parametrize("bounds", [([1], [0]), ([0, 0], [1]), ([np.nan], [1])])
def test_bounds_that_do_not_fit_are_refused(bounds):
    with pytest.raises(ConfigurationError, match="lower <= upper"):
        SamplingMpc(to_zero, bounds[0], bounds[1], SamplingOptions())


@pytest.fixture(scope="module")
def shapes():
    return ArmShapes(ArmModel("ur5"))


def goals_around(model, rng, n, spread):
    steps = rng.uniform(-spread, spread, (n, HORIZON, model.dof)).cumsum(axis=1)
    return np.clip(model.home + steps, model.limits.lower, model.limits.upper)


def test_the_cost_of_reaching_is_that_of_the_drives_law(shapes):
    model, rng = shapes.model, np.random.default_rng(2)
    targets = model.position(model.home) + 0.2 + np.linspace(0, 0.1, HORIZON)[:, None]
    costs = ReachCosts(distance=2.0, final=10.0, touch=0.0, margin=0.0)
    candidates = goals_around(model, rng, 6, 0.05)
    state = ArmState(model.home, np.zeros(6), targets, np.zeros((0, 6)))
    actual = ArmRollouts(shapes, costs, 0.05, True, PERIOD)(state, candidates)
    for goals, cost in zip(candidates, actual, strict=True):
        q, velocity, expected = model.home, np.zeros(6), 0.0
        for goal, target in zip(goals, targets, strict=True):
            q, velocity = follow(model.limits, q, velocity, goal, PERIOD)
            distance = np.linalg.norm(model.position(q) - target)
            expected += float((distance > 0.05) + 2 * distance)
        assert cost == pytest.approx(expected + 10 * distance, abs=1e-9)


def test_a_candidate_touches_only_what_the_imagined_arm_touches(shapes):
    model, rng, n, price = shapes.model, np.random.default_rng(3), 200, 1e6
    boxes = random_boxes(rng, model, 3)
    candidates = goals_around(model, rng, n, 0.4)
    rollouts = ArmRollouts(shapes, ReachCosts(touch=price, margin=0.01), 0.0, False, PERIOD)
    rollouts.surround(boxes)
    state = ArmState(model.home, np.zeros(6), np.full((HORIZON, 3), 9.0), np.zeros((0, 6)))
    touched = rollouts(state, candidates) > price / 2
    imagined = ImaginedArms(shapes, n, 3, tolerance=0.0, period=PERIOD, margin=0.01)
    imagined.begin(np.arange(n), np.tile(model.home, (n, 1)), 0.0, np.full((n, 3), 9.0), np.tile(boxes.numbers, (n, 1)))
    for k in range(HORIZON):
        imagined.move(candidates[:, k])
    expected = imagined.states == TOUCHED
    assert 20 < expected.sum() < n - 20
    assert not (touched & ~expected).any()
    assert (touched == expected).mean() > 0.95


def test_the_way_to_a_target_is_measured_along_its_corners(shapes):
    model = shapes.model
    corner, end = model.home + np.array([[0.8, 0, 0, 0, 0, 0], [0.8, 0, 0, 0, 0, 1.6]])
    state = ArmState(model.home, np.zeros(6), np.full((HORIZON, 3), 9.0), np.array([corner, end]))
    rollouts = ArmRollouts(shapes, ReachCosts(distance=0.0), 0.0, False, PERIOD)
    still, passing = rollouts(state, np.stack([np.tile(q, (HORIZON, 1)) for q in (model.home, corner)]))
    whole = (model.cruise_time(model.home, corner) + model.cruise_time(corner, end)) / PERIOD
    assert still == pytest.approx(HORIZON + whole)
    assert passing == pytest.approx(HORIZON + model.cruise_time(corner, end) / PERIOD, abs=0.1)


BRIDGE = BridgeMap(20.0, 1.4, np.array([[10.0, 0.5, 0.0, 0.5, 0.5]]))
ROVER = DriveModel(
    max_velocity=(2.0, 2.5), max_acceleration=(4.0, 10.0), max_rim_speed=2.45, half_track=0.3, clearance=0.35,
    distance=0.7, period=0.1,
)  # fmt: skip
NOBODY = np.zeros((HORIZON + 1, 0, 2))


def rover_costs(motion, commands, people=NOBODY, **costs):
    lattice = Lattice(BRIDGE.length, BRIDGE.half_width)
    prices = DriveCosts(**{"turn_rate": 0.0, "final": 0.0} | costs)
    lengths = np.tile(19.0 - lattice.axes[0][:, None], (1, len(lattice.axes[1])))
    rollouts = RoverRollouts(ROVER, prices, BRIDGE, lengths, lattice.spacings)
    candidates = np.broadcast_to(commands, (1, HORIZON, 2))
    return rollouts(RoverState(np.array(motion, float), people), candidates)[0]


def test_a_rover_speeds_up_within_its_limits():
    speed, x, expected = 0.0, 1.0, 0.0
    for _ in range(HORIZON):
        faster = min(speed + 0.4, 2.0)
        x, speed = x + 0.05 * (speed + faster), faster
        expected += 19.0 - x
    assert rover_costs((1, -0.9, 0, 0, 0), (9.0, 0.0)) == pytest.approx(expected)
    assert rover_costs((1, -0.9, 0, 0, 0), (9.0, 0.0), final=3.0) == pytest.approx(expected + 3 * (19.0 - x))


def test_wheels_limit_a_rover_that_turns():
    turned = rover_costs((1, 0, 0, 2.0, 2.5), (2.0, 2.5), turn_rate=1.0) - rover_costs((1, 0, 0, 2.0, 2.5), (2.0, 2.5))
    slower = 2.5 / ((2.0 + 0.3 * 2.5) / 2.45)
    assert turned == pytest.approx(HORIZON * slower**2, rel=1e-6)


def test_what_is_too_near_costs_as_much_as_it_is_too_near():
    stand = (0.0, 0.0)
    free = rover_costs((5, 0, 0, 0, 0), stand)
    assert free == pytest.approx(HORIZON * 14.0)
    near_side = rover_costs((5, 1.2, 0, 0, 0), stand) - free
    assert near_side == pytest.approx(HORIZON * 300 * (0.35 - 0.2))
    near_block = rover_costs((9.3, 0.5, 0, 0, 0), stand) - HORIZON * 9.7
    assert near_block == pytest.approx(HORIZON * 300 * (0.35 - 0.2))
    in_block = rover_costs((10, 0.4, 0, 0, 0), stand) - HORIZON * 9.0
    assert in_block == pytest.approx(HORIZON * 300 * (0.35 + 0.4))
    passing = np.column_stack((np.full(HORIZON + 1, 5.0), np.linspace(-5, 5, HORIZON + 1)))[:, None]
    apart = np.minimum(np.abs(passing[1:, 0, 1]) - 0.7, 0.0)
    assert rover_costs((5, 0, 0, 0, 0), stand, passing) - free == pytest.approx(-300 * apart.sum())
