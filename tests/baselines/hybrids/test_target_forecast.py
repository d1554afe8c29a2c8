import numpy as np
import pytest

from armctl.baselines.hybrids import target_forecast
from armctl.baselines.hybrids.target_forecast import KNOTS, SEEDS, WINDOW, ForecastingObserver, TargetForecast
from armctl.core.errors import AgentFileError
from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm
from armctl.tasks.reach.moving import TargetTrajectory

PERIOD = 0.04


@pytest.fixture(scope="module")
def model():
    return ArmModel(load_arm("ur5"))


def trajectory(rng):
    rates, phases = rng.uniform(1.0, 3.5, (3, 2)), rng.uniform(-np.pi, np.pi, (3, 2))
    return TargetTrajectory(np.array((0.4, 0.2, 0.5)), np.tile((0.09, 0.045), (3, 1)), rates, phases)


def velocity(target, time):
    return (target.positions(time + 0.001) - target.positions(time - 0.001)) / 0.002


def watch(observer, target, steps, noise, rng):
    """Let an observer of a resting arm read the target's `steps`, and return the time of the last one."""
    observer.reset()
    q = observer._model.home
    for step in range(steps):
        time = step * PERIOD
        read = target.positions(time), velocity(target, time)
        observer.read(observer._model.position(q), q, *(part + noise * rng.normal(size=3) for part in read))
        observer.send(q)
    return time


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_target_is_foreseen_better_than_by_its_acceleration(model, seed):
    rng, errors = np.random.default_rng(5), []
    steps = iter(range(10**6))
    observer = ForecastingObserver(TargetForecast(seed), model, PERIOD, lambda: next(steps))
    for noise in (0.0, 0.02):
        for _ in range(6):
            steps = iter(range(10**6))
            target = trajectory(rng)
            now = watch(observer, target, 90, noise, rng)
            times = np.array((0.0, 0.3, 0.7))
            truth = target.positions(now + times)
            by_acceleration = super(ForecastingObserver, observer).target_ahead(times)
            errors.append(
                [np.linalg.norm(each - truth, axis=1) for each in (observer.target_ahead(times), by_acceleration)]
            )
    exact, noisy = np.array(errors).reshape(2, 6, 2, 3).mean(axis=1)
    assert exact[0, 0] < 0.006
    assert exact[0, 2] < 0.4 * exact[1, 2]
    assert (noisy[0, 1:] < 0.5 * noisy[1, 1:]).all()


def test_between_knots_forecasts_are_cubic_with_their_derivative(model):
    observer = ForecastingObserver(TargetForecast(0), model, PERIOD, lambda: 0)
    cubic = np.polynomial.Polynomial((0.3, -0.2, 0.5, -0.4))
    observer._positions[:], observer._velocities[:] = cubic(KNOTS), cubic.deriv()(KNOTS)
    times = np.linspace(0.0, 1.0, 23)
    positions, velocities = observer._between_knots(times)
    np.testing.assert_allclose(positions, np.tile(cubic(times)[:, None], 3), atol=1e-12)
    np.testing.assert_allclose(velocities, np.tile(cubic.deriv()(times)[:, None], 3), atol=1e-12)


def test_late_decisions_leave_gaps_in_the_window(model):
    clock = iter((0, 3, 4))
    observer = ForecastingObserver(TargetForecast(0), model, PERIOD, lambda: next(clock))
    q = model.home
    for number in range(3):
        observer.read(model.position(q), q, np.full(3, float(number)), np.zeros(3))
        observer.send(q)
    np.testing.assert_array_equal(observer._window[0, :, -5:], [[0, 0, 0, 1, 2], [0] * 5, [1, 0, 0, 1, 1]])
    assert observer._window.shape == (3, 3, WINDOW)


def test_a_changed_network_is_refused(tmp_path, monkeypatch):
    for file in target_forecast.FOLDER.glob("target-0.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes() + b" ")
    monkeypatch.setattr(target_forecast, "FOLDER", tmp_path)
    with pytest.raises(AgentFileError, match="checksum"):
        TargetForecast(0)
