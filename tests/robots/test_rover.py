import numpy as np
import pytest

from armctl.robots.rover import MAX_VELOCITY, MAX_WHEEL_SPEED, TRACK, WHEEL_RADIUS, Rover, wheel_speeds
from armctl.simulation import Simulation
from armctl.tasks.bridge.world import build_bridge_world


@pytest.fixture(scope="module")
def deck():
    return build_bridge_world(60.0, 20.0, 0, (), 0.002, 4, (8, 8), 90.0)


def drive(deck, commands, seconds=2.0):
    """The rover after driving from the start with each of the commands (n, 2)."""
    simulation = Simulation(deck, len(commands))
    rover = Rover(simulation)
    simulation.reset()
    simulation.refresh()
    rover.command(np.array(commands, dtype=float))
    simulation.step(round(seconds / deck.opt.timestep))
    return rover


def test_it_weighs_and_rolls_like_a_jackal(deck):
    assert deck.body_subtreemass[deck.body("rover/base").id] == pytest.approx(18.4, abs=0.2)
    assert 2 * deck.geom("rover/base").size[0] == pytest.approx(0.508)


@pytest.mark.parametrize("speed", [-0.3, 0.3, 1.0, 2.0])
def test_straight_ahead_it_drives_as_fast_as_told(deck, speed):
    rover = drive(deck, [(speed, 0.0)])
    assert rover.velocities[0, 0] == pytest.approx(speed, abs=0.07)
    assert rover.poses[0, 0] - 1.0 == pytest.approx(2.0 * speed, abs=0.06 + 0.2 * abs(speed))
    np.testing.assert_allclose(rover.poses[0, 1:], 0.0, atol=0.02)


@pytest.mark.parametrize("rate", [-2.0, -1.0, 1.0, 2.0])
def test_it_turns_on_the_spot_by_skidding(deck, rate):
    rover = drive(deck, [(0.0, rate)])
    np.testing.assert_allclose(rover.poses[0, :2], (1.0, 0.0), atol=0.05)
    assert rover.velocities[0, 1] == pytest.approx(rate, rel=0.25)
    rolling = WHEEL_RADIUS * wheel_speeds(np.array([[0.0, rate]]))[0, 1] / (TRACK / 2)
    assert abs(rover.velocities[0, 1]) < 0.8 * abs(rolling)


def test_left_and_right_are_alike(deck):
    rover = drive(deck, [(1.0, 0.8), (1.0, -0.8)])
    np.testing.assert_allclose(rover.poses[0] * (1, -1, -1), rover.poses[1], atol=0.02)
    assert rover.poses[0, 2] > 0.5


def test_odometry_and_gyro_tell_the_motion_as_far_as_wheels_and_gyros_can(deck):
    rover = drive(deck, [(1.0, 0.0), (0.0, 1.5), (0.8, -0.8), (0.0, 0.0)])
    np.testing.assert_allclose(rover.gyro[:, 2], rover.velocities[:, 1], atol=0.03)
    np.testing.assert_allclose(rover.odometry, [(1.0, 0.0), (0.0, 1.5), (0.8, -0.8), (0.0, 0.0)], atol=0.1)


def test_commands_are_clipped_and_wheels_keep_their_limit_and_the_curve():
    commands = np.random.default_rng(0).uniform(-1.2, 1.2, (500, 2)) * MAX_VELOCITY
    speeds = wheel_speeds(commands)
    assert np.abs(speeds).max() <= MAX_WHEEL_SPEED * (1 + 1e-12)
    np.testing.assert_array_equal(speeds[:, :2], speeds[:, 2:])
    back = np.stack((speeds[:, :2].sum(axis=1), speeds[:, 1] - speeds[:, 0]), axis=1)
    wanted = np.stack((commands[:, 0] * 2, commands[:, 1] * TRACK * 1.6), axis=1) / WHEEL_RADIUS
    scale = (back * wanted).sum(axis=1) / (wanted * wanted).sum(axis=1)
    np.testing.assert_allclose(back, wanted * scale[:, None], atol=1e-9)
    assert (scale <= 1 + 1e-12).all()
    assert scale.min() < 0.99


def test_it_stops_and_stands_still(deck):
    simulation = Simulation(deck, 1)
    rover = Rover(simulation)
    simulation.reset()
    simulation.refresh()
    rover.command(np.array([[2.0, 0.0]]))
    simulation.step(500)
    rover.command(np.zeros((1, 2)))
    simulation.step(500)
    before = rover.poses.copy()
    simulation.step(1000)
    np.testing.assert_allclose(rover.poses, before, atol=1e-4)
