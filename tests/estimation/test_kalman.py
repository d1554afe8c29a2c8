import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, solve_discrete_are

from armctl.core.errors import ConfigurationError
from armctl.estimation.kalman import (
    EstimationOptions,
    KalmanFilter,
    LinearModel,
    constant_acceleration,
    constant_velocity,
)

PERIOD = 0.04
TRACKED = constant_velocity(3, PERIOD, 0.5, 0.02)
IDENTIFYING = EstimationOptions(noise_memory=200)


def textbook(model, mean, covariance, control, reading):
    """Kalman's equations as every book has them: one period and its reading, all of it there."""
    mean, covariance = model.transition @ mean + control, model.transition @ covariance @ model.transition.T
    covariance = covariance + model.process_noise
    seen = model.observation[np.isfinite(reading)]
    noise = model.reading_noise[np.ix_(np.isfinite(reading), np.isfinite(reading))]
    gain = covariance @ seen.T @ np.linalg.inv(seen @ covariance @ seen.T + noise)
    mean = mean + gain @ (reading[np.isfinite(reading)] - seen @ mean)
    return mean, (np.eye(len(mean)) - gain @ seen) @ covariance


def random_model(rng, states, readings):
    square = rng.normal(size=(states, states))
    noise, process = rng.normal(size=(readings, readings)), rng.normal(size=(states, states))
    return LinearModel(
        0.9 * square / np.abs(np.linalg.eigvals(square)).max(), process @ process.T + 0.1 * np.eye(states),
        rng.normal(size=(readings, states)), noise @ noise.T + 0.1 * np.eye(readings), rng.normal(size=(states, 2)),
    )  # fmt: skip


def simulate(model, rng, steps, scale=1.0, mean=None):
    """Yield states and readings of a system."""
    x = np.zeros(len(model.transition)) if mean is None else mean
    for _ in range(steps):
        x = model.transition @ x + rng.multivariate_normal(np.zeros(len(x)), model.process_noise, method="eigh")
        noise = rng.multivariate_normal(np.zeros(len(model.observation)), scale * model.reading_noise, method="eigh")
        yield x, model.observation @ x + noise


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 4), st.integers(1, 3))
def test_it_is_the_textbook_filter_for_each_of_the_batch_and_skips_missing_readings(seed, states, readings):
    rng = np.random.default_rng(seed)
    model = random_model(rng, states, readings)
    filters = KalmanFilter(model, 3, EstimationOptions(gate=1.0, initial_deviation=2.0))
    expected = [(np.zeros(states), 4.0 * np.eye(states)) for _ in range(3)]
    for _ in range(6):
        u, z = rng.normal(size=(3, 2)), rng.normal(size=(3, readings))
        z[rng.random(z.shape) < 0.3] = np.nan
        filters.predict(u)
        present = filters.update(z)
        expected = [textbook(model, *belief, model.control @ u[i], z[i]) for i, belief in enumerate(expected)]
        np.testing.assert_array_equal(present, np.isfinite(z).any(axis=1))
        np.testing.assert_allclose(filters.mean, [mean for mean, _ in expected], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(filters.covariance, [p for _, p in expected], rtol=1e-7, atol=1e-9)


def test_it_is_the_filter_of_filterpy():
    from filterpy import kalman

    rng = np.random.default_rng(0)
    model = random_model(rng, 3, 2)
    peer = kalman.KalmanFilter(3, 2, 2)
    peer.F, peer.Q, peer.H, peer.R, peer.B = (
        model.transition, model.process_noise, model.observation, model.reading_noise, model.control,
    )  # fmt: skip
    peer.P = 1e6 * np.eye(3)
    filters = KalmanFilter(model, options=EstimationOptions(gate=1.0))
    for _ in range(30):
        u, z = rng.normal(size=2), rng.normal(size=2)
        peer.predict(u[:, None])
        peer.update(z)
        filters.predict(u[None])
        filters.update(z[None])
        np.testing.assert_allclose(filters.mean[0], peer.x[:, 0], rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(filters.covariance[0], peer.P, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("model", [TRACKED, constant_acceleration(2, PERIOD, 3.0, 0.01)])
def test_its_covariance_becomes_that_of_the_riccati_equation(model):
    filters = KalmanFilter(model)
    for _ in range(400):
        filters.predict()
        steady = filters.covariance[0].copy()
        filters.update(np.zeros((1, len(model.observation))))
    expected = solve_discrete_are(model.transition.T, model.observation.T, model.process_noise, model.reading_noise)
    np.testing.assert_allclose(steady, expected, rtol=1e-6, atol=1e-10)


def test_models_of_several_axes_are_those_of_one_each():
    single, double = constant_velocity(1, 0.1, 2.0, 0.3), constant_velocity(2, 0.1, 2.0, 0.3)
    order = [0, 2, 1, 3]  # by axis instead of by derivative
    for name in ("transition", "process_noise"):
        one = getattr(single, name)
        np.testing.assert_allclose(getattr(double, name)[np.ix_(order, order)], block_diag(one, one))
    np.testing.assert_allclose(single.transition, np.array([[1, 0.1], [0, 1]]))
    np.testing.assert_allclose(single.process_noise, 4.0 * np.outer([0.005, 0.1], [0.005, 0.1]))
    third = np.array([[1, 0.1, 0.005], [0, 1, 0.1], [0, 0, 1]])
    np.testing.assert_allclose(constant_acceleration(1, 0.1, 1.0, 1.0).transition, third)


def test_errors_are_as_large_as_their_covariances_say():
    rng, errors = np.random.default_rng(1), []
    for _ in range(100):
        filters = KalmanFilter(TRACKED)
        states, readings = zip(*simulate(TRACKED, rng, 30, mean=rng.normal(size=6)), strict=True)
        for z in readings:
            filters.predict()
            filters.update(z[None])
        error = filters.mean[0] - states[-1]
        errors.append(error @ np.linalg.solve(filters.covariance[0], error))
    assert 6 * 0.8 < np.mean(errors) < 6 * 1.2  # chi-square of 6 degrees: 4 standard deviations of the mean


@pytest.mark.one_case
@pytest.mark.parametrize("scale", [0.0, 0.01, 1.0, 25.0])
def test_it_identifies_the_scale_of_the_noise(scale):
    rng, filters = np.random.default_rng(2), KalmanFilter(TRACKED, 20, IDENTIFYING)
    worlds = [simulate(TRACKED, rng, 150, scale) for _ in range(20)]
    for _ in range(150):
        filters.predict()
        filters.update([z for _, z in map(next, worlds)])
    assert np.median(filters.noise_scale) == pytest.approx(scale, rel=0.25, abs=0.02)


def test_a_filter_told_of_a_tenth_of_the_noise_soon_estimates_as_well_as_one_that_knows():
    rng, told = np.random.default_rng(3), constant_velocity(3, PERIOD, 0.5, 0.002)
    filters, knowing = KalmanFilter(told, options=IDENTIFYING), KalmanFilter(TRACKED)
    errors = []
    for x, z in simulate(TRACKED, rng, 400):
        for each in (filters, knowing):
            each.predict()
            each.update(z[None])
        errors.append([np.linalg.norm(each.mean[0, :3] - x[:3]) for each in (filters, knowing)])
    adaptive, optimal = np.sqrt(np.mean(np.square(errors[10:]), axis=0))
    assert adaptive < 1.15 * optimal


def test_single_outliers_are_left_out_and_a_jump_is_believed_in_the_end():
    filters = KalmanFilter(TRACKED, options=EstimationOptions(max_rejections=3))
    for step in range(60):
        filters.predict()
        accepted = filters.update(np.full((1, 3), 50.0 if step in (20, 30) else 0.1))[0]
        assert accepted == (step not in (20, 30))
        np.testing.assert_allclose(filters.mean[0, :3], 0.1, atol=1e-3)
    rejected = 0
    while not filters.update(np.full((1, 3), 5.0))[0]:
        filters.predict()
        rejected += 1
    assert rejected == 3
    np.testing.assert_allclose(filters.mean[0, :3], 5.0, atol=1e-3)


@pytest.mark.parametrize("options", [EstimationOptions(), IDENTIFYING])
def test_no_readings_harm_and_resets_are_of_some_filters(options):
    rng, filters = np.random.default_rng(4), KalmanFilter(TRACKED, 2, options)
    hostile = [np.nan, np.inf, -np.inf, 1e300, 0.0, -1e12]
    for _ in range(300):
        filters.predict()
        filters.update(rng.choice(hostile, (2, 3)))
        assert np.isfinite(filters.mean).all()
        assert np.isfinite(filters.covariance).all()
        assert (filters.noise_scale > 0).all()
    last = filters.mean[1].copy(), filters.covariance[1].copy()
    filters.reset(np.arange(6.0), np.eye(6), ids=np.array([0]))
    fresh = KalmanFilter(TRACKED, 1, options)
    fresh.reset(np.arange(6.0), np.eye(6))
    np.testing.assert_array_equal(filters.mean[1], last[0])
    np.testing.assert_array_equal(filters.covariance[1], last[1])
    for each in (fresh, filters):
        each.predict()
        each.update(np.full((each.count, 3), 0.3))
    np.testing.assert_array_equal(filters.mean[0], fresh.mean[0])


def test_wrong_shapes_and_numbers_are_refused():
    filters = KalmanFilter(TRACKED, 2)
    with pytest.raises(ConfigurationError, match="z should be an array"):
        filters.update(np.zeros(3))
    with pytest.raises(ConfigurationError, match="u should be an array"):
        filters.predict(np.full((2, 6), np.nan))
    with pytest.raises(ConfigurationError, match="observation should be an array"):
        LinearModel(np.eye(2), np.eye(2), np.ones((1, 3)), np.eye(1))
    with pytest.raises(ConfigurationError, match="positive diagonal"):
        LinearModel(np.eye(2), np.eye(2), np.ones((1, 2)), np.zeros((1, 1)))
