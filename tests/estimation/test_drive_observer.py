import math

import numpy as np
import pytest

from armctl.estimation.drive_observer import NEW_SHARE, DriveObserver, DriveObserverOptions, DriveResponse

OPTIONS = DriveObserverOptions()
NOMINAL = (OPTIONS.acceleration, OPTIONS.max_command)


class Drives:
    """Robots with their own accelerations, largest velocities, gains and delay."""

    def __init__(self, n, acceleration=OPTIONS.acceleration, speed=(2.0, 3.0), gain=OPTIONS.gain, delay=0):
        self.states, self._line = np.zeros((n, 5)), [np.zeros((n, 2))] * delay
        self._acceleration, self._speed, self._gain = acceleration, speed, gain

    def step(self, commands):
        self._line = [*self._line, commands]
        target = np.clip(np.array(self._gain) * self._line.pop(0), -np.array(self._speed), self._speed)
        reach = OPTIONS.period * np.array(self._acceleration)
        old = self.states[:, 3:]
        new = old + np.clip(target - old, -reach, reach)
        distance = OPTIONS.period * ((1 - NEW_SHARE) * old[:, 0] + NEW_SHARE * new[:, 0])
        x, y, yaw = self.states[:, :3].T
        pose = x + distance * np.cos(yaw), y + distance * np.sin(yaw), yaw + OPTIONS.period * new[:, 1]
        self.states = np.column_stack((*pose, new))


def drive(drives, velocities, noise=0.0, rng=None):
    """Drive at desired velocities (t, n, 2); return the observer, the states and the predictions."""
    observer, states, predictions = DriveObserver(len(drives.states)), [], []
    for desired in velocities:
        states.append(drives.states)
        readings = drives.states + (noise * rng.standard_normal(drives.states.shape) if noise else 0.0)
        predictions.append(observer.observe(readings, noisy=noise > 0))
        drives.step(observer.command(desired))
    return observer, np.array(states), np.array(predictions)


def journey(rng, steps, n):
    """Return velocities that speed up, and then change every half a second."""
    turns = np.repeat(rng.uniform(-1.5, 1.5, (steps // 5 + 1, n, 1)), 5, axis=0)[:steps]
    speeds = np.repeat(rng.uniform(0.5, 1.8, (steps // 5 + 1, n, 1)), 5, axis=0)[:steps]
    return np.concatenate((speeds, turns), axis=-1)


def test_the_law_is_the_one_that_its_page_tells():
    rng = np.random.default_rng(0)
    drives, commands = Drives(4), rng.uniform(-1, 1, (4, 2))
    response = DriveResponse.nominal((4,), OPTIONS)
    for _ in range(5):
        ahead = response.law(drives.states, commands)
        drives.step(commands)
        np.testing.assert_allclose(ahead, drives.states, atol=1e-12)


@pytest.mark.parametrize("delay", range(6))
@pytest.mark.parametrize("acceleration", [OPTIONS.acceleration, (2.2, 8.0)])
def test_it_predicts_where_commands_will_act_whatever_the_delay_and_the_drives(delay, acceleration):
    observer, states, predictions = drive(
        Drives(8, acceleration, delay=delay), journey(np.random.default_rng(delay), 80, 8)
    )
    assert (observer.delay == delay).mean() >= 7 / 8
    errors = np.linalg.norm(predictions[40 : 80 - delay, :, :2] - states[40 + delay :, :, :2], axis=-1)
    assert np.median(errors) < 0.03
    assert np.quantile(errors, 0.9) < 0.12


def test_it_learns_what_weak_drives_can_do():
    velocities = np.concatenate((np.tile((1.5, 0.0), (10, 3, 1)), np.tile((1.0, 1.5), (10, 3, 1))))
    observer, _, _ = drive(Drives(3, (2.0, 8.0), (2.0, 0.25)), velocities)
    np.testing.assert_allclose(observer.response.acceleration[:, 0], 2.0, rtol=0.35)
    np.testing.assert_allclose(observer.response.speed[:, 1], 0.25, rtol=0.25)


def test_nominal_drives_stay_nominal():
    observer, _, _ = drive(Drives(8), journey(np.random.default_rng(1), 100, 8))
    for found, nominal in zip((observer.response.acceleration, observer.response.speed), NOMINAL, strict=True):
        np.testing.assert_allclose(found, np.tile(nominal, (8, 1)))
    assert np.abs(observer.response.offset).max() < 1e-9


def test_other_wheels_cause_no_offset():
    """As in offset-free model predictive control: a constant disturbance of the gain has no effect in the end."""
    desired = np.tile((1.0, 0.4), (60, 2, 1))
    _, states, _ = drive(Drives(2, gain=(1.1, 0.9)), desired)
    reference = np.array(OPTIONS.gain) * desired[0]
    np.testing.assert_allclose(states[-1, :, 3:], reference, atol=0.01)


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_noise_is_filtered(noise):
    rng = np.random.default_rng(2)
    observer, states, predictions = drive(Drives(20), journey(rng, 80, 20), noise, rng)
    assert (observer.delay == 0).all()
    deviations = np.sqrt(((predictions - states)[20:] ** 2).mean(axis=(0, 1)))
    assert (deviations[:3] < 0.5 * noise).all()
    assert (deviations[3:] < 0.85 * noise).all()


@pytest.mark.parametrize("delay", [1, 3, 5])
def test_a_delay_among_noise_leaves_no_offsets(delay):
    rng = np.random.default_rng(4)
    observer, states, predictions = drive(Drives(20, delay=delay), np.tile((1.5, 2.0), (30, 20, 1)), 0.05, rng)
    known = observer.delay == delay
    assert known.mean() >= 0.9
    assert np.abs(observer.response.offset[known]).max() < 0.06
    deviations = np.sqrt(((predictions[:-delay] - states[delay:])[-10:, known, :2] ** 2).mean(axis=(0, 1)))
    assert (deviations < 0.05).all()


def test_a_turn_that_comes_late_is_seen_through_noise():
    rng = np.random.default_rng(5)
    observer, drives = DriveObserver(20), Drives(20)
    for step in range(15):
        ahead = observer.observe(drives.states + 0.05 * rng.standard_normal((20, 5)), noisy=True)
        if step > 4:
            assert abs((ahead - drives.states)[:, 2].mean()) < 0.03
        observer.command(np.tile((1.5, 2.5), (20, 1)))
        drives.step(np.tile((1.5, 2.5 if step else 0.3), (20, 1)))


def test_missing_readings_and_turns_beyond_pi_spoil_nothing():
    observer, drives = DriveObserver(2), Drives(2)
    for step in range(60):
        states = drives.states.copy()
        states[:, 2] = (states[:, 2] + math.pi) % (2 * math.pi) - math.pi
        if step == 30:
            states[1] = np.nan
        ahead = observer.observe(states, noisy=True)
        if step > 5:
            off = ahead[0, 2] - drives.states[0, 2]
            assert abs((off + math.pi) % (2 * math.pi) - math.pi) < 0.05
            assert np.isfinite(ahead[0]).all()
        drives.step(observer.command(np.tile((0.5, 1.0), (2, 1))))
    assert np.isfinite(observer.response.offset).all()
    assert np.isfinite(ahead).all()


def test_each_robot_is_observed_alone_and_forgotten_alone():
    rng = np.random.default_rng(3)
    velocities = journey(rng, 40, 3)
    together, _, predictions = drive(Drives(3, (3.0, 9.0), delay=2), velocities)
    for i in range(3):
        _, _, alone = drive(Drives(1, (3.0, 9.0), delay=2), velocities[:, [i]])
        np.testing.assert_array_equal(predictions[:, [i]], alone)
    together.reset(np.array([1]))
    together.observe(np.zeros((3, 5)))
    assert together.delay.tolist() == [2, 0, 2]
    np.testing.assert_array_equal(together.response.acceleration[1], OPTIONS.acceleration)


def test_nothing_of_a_forgotten_robot_is_left_in_what_is_filtered():
    rng = np.random.default_rng(4)
    used, new = DriveObserver(1), DriveObserver(1)
    drives = Drives(1, (3.0, 9.0))
    for velocities in journey(rng, 40, 1):
        used.observe(drives.states + rng.normal(0, 0.05, (1, 5)), noisy=True)
        drives.step(used.command(velocities))
    used.reset(np.array([0]))
    for velocities in journey(rng, 5, 1):
        states = rng.normal(0, 0.05, (1, 5))
        np.testing.assert_array_equal(used.observe(states, noisy=True), new.observe(states, noisy=True))
        np.testing.assert_array_equal(used.command(velocities), new.command(velocities))
