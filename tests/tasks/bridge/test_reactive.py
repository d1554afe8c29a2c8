"""Pedestrians who give way: properties of the social force, and what tasks and experts make of them."""

from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.robots.rover import RADIUS
from armctl.scene import NO_PEDESTRIANS, BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.pedestrians import on_lines_like
from armctl.tasks.bridge.reactive import MAX_ASIDE, PERSONAL_SPACE, ReactivePedestrians, social_force

from .worlds import MOVING

TICKS = 5
PLANAR: dict[str, Any] = {"dynamics": "kinematic", "observation": "state"}


def walkers(start, end, speed=1.0, max_y=1.1):
    """One pedestrian on a line."""
    first, last = np.array([[[start]], [[end]]], dtype=float)
    lines = PedestrianTrajectories(first, last, np.full((1, 1), speed), np.zeros((1, 1)), 0.25)
    return ReactivePedestrians(lines, max_y)


def walk(people, seconds, rover, speed=0.0):
    """Positions of pedestrians at all ticks, while a rover stands at a pose or comes on from it."""
    places, pose = [], np.array([rover], dtype=float)
    for step in range(round(seconds / 0.1)):
        times = 0.1 * step + np.linspace(0, 0.1, TICKS + 1)[:, None]
        places.append(people.walk(times, pose, np.array([speed])))
        pose[:, :2] += 0.1 * speed * np.array((np.cos(pose[0, 2]), np.sin(pose[0, 2])))
    return np.concatenate(places)


def played(policy_action=(0.0, 0.0), steps=100, n=4, seed=5, **options):
    """States (steps, n, k) of worlds whose rovers are all commanded alike."""
    env: Any = make_worlds(MOVING, n, {**PLANAR, **options}, autoreset_mode="disabled")
    env.reset(seed=seed)
    return np.array([env.step(np.tile(policy_action, (n, 1)))[0] for _ in range(steps)]), env


@pytest.mark.one_case
@pytest.mark.parametrize("speed", [0.3, 1.2])
@pytest.mark.parametrize("y", [0.0, 0.1, -0.4, 0.5])
@pytest.mark.parametrize("way", [((-3, 0), (3, 0)), ((0, -1.1), (0, 1.1))])
def test_they_never_touch_a_rover_that_stands(speed, y, way):
    people = walkers(way[0], way[1], speed)
    rover = (0.1, y, 0.3)
    distances = np.linalg.norm(walk(people, 20, rover) - np.array(rover[:2]), axis=-1)
    begun = np.linalg.norm(np.array(way[0]) - np.array(rover[:2]))
    assert distances.min() >= np.minimum(begun, RADIUS + 0.25 + PERSONAL_SPACE) - 1e-9


def test_they_stop_before_a_rover_in_their_lane_and_walk_on_when_it_has_gone():
    people = walkers((-3, 0), (3, 0))
    places = walk(people, 10, (0.0, 0.0, 0.0))
    assert -1.2 < places[-1, 0, 0, 0] < -RADIUS - 0.25
    np.testing.assert_allclose(people.velocities(np.array([10.0])), 0, atol=0.05)
    assert walk(people, 10, (50.0, 0.0, 0.0))[:, 0, 0, 0].max() > 2


def test_they_step_aside_and_return_to_their_line():
    people = walkers((-3, 0), (3, 0))
    places = walk(people, 7, (0.0, -0.5, 0.0))
    assert places[..., 0].max() > 1
    assert 0.1 < places[..., 1].max() <= MAX_ASIDE
    later = walk(people, 20, (50.0, 0.0, 0.0))
    assert abs(later[-1, 0, 0, 1]) < 0.01


def test_they_stay_before_the_barriers():
    people = walkers((-3, 1.0), (3, 1.0))
    assert walk(people, 7, (0.0, 0.4, 0.0))[..., 1].max() <= 1.1 + 1e-12


def test_whoever_is_in_the_way_of_a_rover_that_comes_is_out_of_it_in_time():
    hindered = walk(walkers((0.2, 0.1), (0.2, 1.1), 0.5), 3, (-4.0, 0.0, 0.0), speed=1.0)
    assert (hindered[..., 1] > 0.1).any()
    assert np.linalg.norm(hindered[..., 0, :] - np.array((-4.0, 0.0)), axis=-1).min() > 0.5


def test_the_force_repels_is_symmetric_and_ends():
    heading, radii = np.array([[(1.0, 0.0)]]), np.array([0.5, 0.5])

    def force(offset, velocity=(0.0, 0.0)):
        places, velocities = np.array([[(0.0, 0.0), offset]]), np.array([[(1.0, 0.0), velocity]])
        return social_force(places, velocities, radii, heading)[0, 0]

    assert force((1.0, 0.0))[0] < 0
    np.testing.assert_allclose(force((1.0, 0.5)) * (1, -1), force((1.0, -0.5)))
    np.testing.assert_allclose(force((-1.0, 0.0)), -0.5 * force((1.0, 0.0)))  # behind
    np.testing.assert_array_equal(force((2.6, 0.0)), 0)
    assert np.linalg.norm(force((2.6, 0.0), (-1.0, 0.0))) > 0  # it comes
    for extreme in ((0.0, 0.0), (1e-12, 0.0), (0.5, 0.0)):
        assert np.isfinite(force(extreme)).all()


def test_without_anyone_near_they_walk_as_scripted_bit_for_bit():
    kinds = ("scripted", "reactive")
    scripted, reactive = (played(pedestrians=kind, walkers=1, steps=60, n=3)[0] for kind in kinds)
    np.testing.assert_array_equal(scripted, reactive)


def test_episodes_repeat_and_do_not_depend_on_the_number_of_worlds():
    options = {"pedestrians": "reactive", **PLANAR}
    many, one = (make_worlds(MOVING, n, options, autoreset_mode="next_step") for n in (4, 1))
    many.reset(seed=[3, 4, 5, 6])
    observed, alone = many.reset(seed=[3, 4, 5, 6])[0], one.reset(seed=5)[0]
    for _ in range(150):
        np.testing.assert_array_equal(observed[2], alone[0])
        observed, alone = many.step(np.tile((1.2, 0.05), (4, 1)))[0], one.step([[1.2, 0.05]])[0]


def test_what_is_observed_moves_as_it_says():
    states, env = played((0.7, 0.0), steps=60, pedestrians="reactive", n=6, blocks=0)
    assert env.single_observation_space.contains(states[-1, 0])
    people = states[:, :, 6:].reshape(60, 6, 3, 4).astype(float)
    moved, velocities = np.diff(people[..., :2], axis=0) / 0.1, people[1:, ..., 2:]
    assert np.median(np.abs(moved - velocities)) < 1e-3
    assert np.quantile(np.abs(moved - velocities), 0.95) < 0.2
    assert (np.linalg.norm(velocities, axis=-1) < 1.7).all()


def test_maps_have_them_where_they_are_and_cannot_be_used_to_move_them():
    _, env = played((0.7, 0.0), steps=60, pedestrians="reactive")
    task = env.task
    people = [task.map(world).pedestrians for world in range(4)]
    expected = task.state_observation()[:, -12:].reshape(4, 3, 4)[..., :2]
    present = [one.positions(time) for one, time in zip(people, task.state.time, strict=True)]
    np.testing.assert_allclose(present, expected, atol=1e-5)
    people[0].start[:] += 9
    np.testing.assert_allclose(task.map(0).pedestrians.positions(task.state.time[0]), expected[0], atol=1e-5)
    assert isinstance(task.preview("pedestrians", 0), PedestrianTrajectories)
    np.testing.assert_array_equal(task.preview("pedestrians", 0).phase, task.map(0).pedestrians.phase)


def test_clearance_is_from_where_they_were():
    _, env = played((0.7, 0.0), steps=40, pedestrians="reactive", n=2, walkers=1, blocks=0)
    anywhere = np.tile((9.0, 0.0, 0.0), (40, 1))
    clearance = env.task.min_clearance(0, anywhere)
    assert clearance <= env.task._people._closest[0] - RADIUS + 1e-12
    assert np.isfinite(clearance)


def test_another_kind_is_refused():
    with pytest.raises(ConfigurationError, match="pedestrians"):
        make_worlds(MOVING, 1, {"pedestrians": "polite"})


def test_a_map_without_pedestrians_stays_so():
    people = ReactivePedestrians(on_lines_like(NO_PEDESTRIANS, 1), 1.0)
    bridge = BridgeMap(20.0, 1.4, np.zeros((0, 5)))
    assert len(people.on(bridge, 0).pedestrians.speed) == 0
    assert people.walk(np.zeros((3, 1)), np.zeros((1, 3)), np.zeros(1)).shape == (2, 1, 0, 2)
