import numpy as np
import pytest

from armctl.control.streaming import follow
from armctl.estimation.arm_observer import ArmObserver
from armctl.kinematics import ArmModel

MODEL = ArmModel("ur5")
PERIOD = 0.04
TARGET = np.array([0.4, 0.3, 0.5])


class SimulatedArm:
    """Drives whose commands arrive late, joints that a load takes off them, links of other lengths, noisy readings."""

    def __init__(self, delay=0, load=0.0, lengths=0.0, noise=0.0, seed=0):
        self.rng = np.random.default_rng(seed)
        self.position, self.velocity = MODEL.home.copy(), np.zeros(6)
        self.waiting, self.load, self.noise = [MODEL.home] * delay, load, noise
        self.lengths = self.rng.uniform(-lengths, lengths, 7)
        self.lengths[0] = 0.0

    @property
    def q(self):
        return self.position + self.load

    def tip_at(self, q):
        return (1 + self.lengths) @ MODEL.segments(q)

    def readings(self):
        return [
            values + self.noise * self.rng.normal(size=len(values)) for values in (self.tip_at(self.q), self.q, TARGET)
        ]

    def move(self, goal):
        self.waiting.append(goal)
        self.position, self.velocity = follow(MODEL.limits, self.position, self.velocity, self.waiting.pop(0), PERIOD)


def move(arm, observer, steps, spread=0.8):
    """Go to random positions near home, one after the other."""
    for step in range(steps):
        if step % 10 == 0:
            goal = MODEL.home + arm.rng.uniform(-spread, spread, 6)
        observer.read(*arm.readings())
        observer.send(goal)
        arm.move(goal)
    observer.read(*arm.readings())


def test_segments_sum_to_the_end_effector():
    rng = np.random.default_rng(0)
    for q in rng.uniform(-3, 3, (20, 6)):
        np.testing.assert_allclose(MODEL.segments(q).sum(axis=0), MODEL.position(q), atol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("delay", range(0, 9, 2))
def test_it_identifies_the_delay(delay, noise):
    for seed in range(5):
        arm, observer = SimulatedArm(delay, noise=noise, seed=seed), ArmObserver(MODEL, PERIOD)
        move(arm, observer, 12 + delay)
        assert observer.delay == delay


@pytest.mark.parametrize("delay", [0, 3])
def test_it_knows_the_end_effector_where_the_arm_has_not_been(delay):
    arm, observer = SimulatedArm(delay, lengths=0.2), ArmObserver(MODEL, PERIOD)
    move(arm, observer, 60)
    for q in MODEL.home + arm.rng.uniform(-1, 1, (20, 6)):
        missed = MODEL.position(q) - arm.tip_at(q)
        assert np.linalg.norm(missed) > 0.01
        np.testing.assert_allclose(MODEL.position(q) + observer.tip_offset(q), arm.tip_at(q), atol=2e-3)


def test_with_noise_it_knows_more_than_the_readings():
    errors = []
    for seed in range(10):
        arm, observer = SimulatedArm(noise=0.05, seed=seed), ArmObserver(MODEL, PERIOD)
        move(arm, observer, 40)
        errors.append([np.linalg.norm(observer.target - TARGET), np.linalg.norm(observer.joints - arm.q),
                       np.linalg.norm(observer.tip - arm.tip_at(arm.q))])  # fmt: skip
    target, joints, tip = np.sqrt(np.mean(np.square(errors), axis=0))
    assert target < 0.3 * 0.05 * np.sqrt(3)
    assert joints < 0.9 * 0.05 * np.sqrt(6)
    assert tip < 0.9 * 0.05 * np.sqrt(3)


@pytest.mark.parametrize("delay", [0, 4])
def test_commands_shifted_by_its_load_leave_no_offset(delay):
    """The textbook case of offset-free control: a constant disturbance, and zero error at rest."""
    load = np.array([0.0, 0.05, -0.04, 0.1, 0.02, 0.0])
    arm, observer = SimulatedArm(delay, load), ArmObserver(MODEL, PERIOD)
    goal = MODEL.home + 0.5
    for _ in range(500):
        observer.read(*arm.readings())
        command = goal - observer.load_offset
        observer.send(command)
        arm.move(command)
    np.testing.assert_allclose(arm.q, goal, atol=1e-4)
    np.testing.assert_allclose(observer.commanded, goal, atol=1e-3)


@pytest.mark.parametrize("delay", [0, 4])
def test_it_knows_where_the_joints_will_be_when_a_command_acts(delay):
    arm, observer = SimulatedArm(delay, load=0.01), ArmObserver(MODEL, PERIOD)
    move(arm, observer, 60)
    ahead, now = observer.joints_ahead, arm.q
    for goal in [*arm.waiting, arm.position][:delay]:
        arm.position, arm.velocity = follow(MODEL.limits, arm.position, arm.velocity, goal, PERIOD)
    np.testing.assert_allclose(ahead, arm.q, atol=5e-3)
    assert delay == 0 or np.abs(arm.q - now).max() > 0.05


@pytest.mark.parametrize("late", [2, 7])
def test_the_command_of_a_late_decision_acts_from_the_next_reading_on(late):
    arm, acting, step = SimulatedArm(), MODEL.home, 0
    observer = ArmObserver(MODEL, PERIOD, clock=lambda: step)
    for _ in range(12):
        observer.read(*arm.readings())
        np.testing.assert_allclose(observer.commanded, arm.position, atol=1e-9)
        np.testing.assert_allclose(observer.joints, arm.q, atol=1e-6)
        goal = MODEL.home + arm.rng.uniform(-0.8, 0.8, 6)
        observer.send(goal)
        for _ in range(late):
            arm.move(acting)
        acting, step = goal, step + late
    assert observer.delay == 0


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
def test_at_rest_it_measures_the_noise(noise):
    levels = []
    for seed in range(20):
        arm, observer = SimulatedArm(noise=noise, seed=seed), ArmObserver(MODEL, PERIOD)
        for _ in range(10):
            observer.read(*arm.readings())
            observer.send(MODEL.home)
            arm.move(MODEL.home)
        levels.append(observer.noise)
    np.testing.assert_allclose(np.mean(levels), noise, rtol=0.15, atol=1e-4)


def test_a_moving_target_is_predicted_over_the_delay():
    arm, observer = SimulatedArm(delay=4), ArmObserver(MODEL, PERIOD, moving=True)
    where = lambda time: TARGET + 0.1 * np.sin(2 * time) * np.ones(3)  # noqa: E731
    for step in range(60):
        tip, q, _ = arm.readings()
        velocity = 0.2 * np.cos(2 * step * PERIOD) * np.ones(3)
        observer.read(tip, q, where(step * PERIOD), velocity)
        goal = MODEL.home + 0.5 * np.sin(step / 5)
        observer.send(goal)
        arm.move(goal)
    assert observer.delay == 4
    ahead = np.array([0.0, 0.08])
    np.testing.assert_allclose(observer.target_ahead(ahead), [where((59 + 4) * PERIOD + t) for t in ahead], atol=3e-3)
    np.testing.assert_allclose(observer.target_velocity_ahead(), 0.2 * np.cos(2 * 63 * PERIOD), atol=0.03)


@pytest.mark.parametrize("moving", [False, True])
def test_no_readings_harm_and_resets_forget(moving):
    rng, observer = np.random.default_rng(0), ArmObserver(MODEL, PERIOD, moving)
    values = [np.nan, np.inf, 1e6, 0.0, -3.0]
    velocity = np.zeros(3) if moving else None
    for _ in range(100):
        tip, joints, target = (rng.choice(values, size) for size in (3, 6, 3))
        observer.read(tip, joints, target, velocity)
        observer.send(MODEL.home + rng.normal(size=6))
        believed = (observer.joints, observer.tip, observer.target, observer.commanded, observer.load_offset)
        assert all(np.isfinite(each).all() for each in believed)
    observer.reset()
    fresh = ArmObserver(MODEL, PERIOD, moving)
    for each in (observer, fresh):
        each.read(MODEL.position(MODEL.home), MODEL.home, TARGET, velocity)
    np.testing.assert_array_equal(observer.tip, fresh.tip)
    np.testing.assert_array_equal(observer.target_ahead(np.arange(3.0)), fresh.target_ahead(np.arange(3.0)))


@pytest.mark.parametrize("noise", [0.001, 0.005, 0.02])
def test_noise_of_an_arm_that_has_not_moved_yet_is_no_change_of_its_links(noise):
    for seed in range(10):
        arm, observer = SimulatedArm(noise=noise, seed=seed), ArmObserver(MODEL, PERIOD, moving=True)
        for _ in range(12):
            tip, q, target = arm.readings()
            observer.read(tip, q, target, noise * arm.rng.normal(size=3))
            observer.send(MODEL.home)
            assert np.abs(observer.length_errors).max() < 1
