"""Bridges without physics are near enough to those with it."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds

MOVING = "armctl/BridgeCrossMoving-v0"


def worlds(n, **options):
    return make_worlds(MOVING, n, options, autoreset_mode="disabled")


@pytest.fixture(scope="module")
def both():
    """Poses and odometry of sixteen drives of 2 s, by the same commands, with physics and without."""
    poses, motions = [], []
    for dynamics in ("physics", "kinematic"):
        env = worlds(16, observation="state", dynamics=dynamics)
        env.reset(seed=5)
        rng = np.random.default_rng(1)
        for step in range(20):
            if step % 8 == 0:
                commands = rng.uniform([0.2, -0.5], [1.6, 0.5], (16, 2))
            env.step(commands)
            poses.append(env.task.state.poses)
            motions.append(env.task.observation_parts()["motion"])
    return np.array(poses).reshape(2, 20, 16, 3), np.array(motions).reshape(2, 20, 16, 3)


def test_rovers_get_to_the_same_places(both):
    poses, _ = both
    assert (np.median(np.abs(poses[0] - poses[1]), axis=(0, 1)) < (0.05, 0.05, 0.06)).all()


def test_they_sense_the_same_motion(both):
    _, motions = both
    assert (np.median(np.abs(motions[0] - motions[1]), axis=(0, 1)) < (0.05, 0.1, 0.1)).all()


def test_episodes_repeat_and_do_not_depend_on_the_number_of_worlds():
    many, one = (worlds(n, dynamics="kinematic", observation="state") for n in (5, 1))
    for _ in range(2):
        observed, alone = many.reset(seed=[3, 4, 5, 6, 7])[0], one.reset(seed=6)[0]
        for _ in range(30):
            assert np.array_equal(observed[3], alone[0])
            observed, alone = many.step(np.tile((1.5, 0.2), (5, 1)))[0], one.step([[1.5, 0.2]])[0]


def play(env, command, limit=300):
    env.reset(seed=0)
    for _ in range(limit):
        *_, infos = env.step(np.tile(command, (env.num_envs, 1)))
        if env.outcomes[infos["outcome_id"][0]] != "running":
            return env.outcomes[infos["outcome_id"][0]], infos["reward_terms"]
    return "running", {}


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["physics", "kinematic"])
def test_outcomes_are_those_of_physics(dynamics):
    empty = {"blocks": 0, "walkers": 0, "observation": "state", "dynamics": dynamics}
    crossed, earned = play(worlds(1, **empty, missing_barriers=0), (1.5, 0.0))
    assert (crossed, earned["goal"]) == ("crossed", 100)
    assert play(worlds(1, **empty, missing_barriers=0), (1.0, 0.5))[0] == "collided"
    assert play(worlds(1, **empty, missing_barriers=6), (1.2, 0.15))[0] == "fell"
    assert play(worlds(1, **empty), (-1.5, 0.0))[0] == "fell"


def test_pictures_show_where_the_rover_is():
    env: Any = gymnasium.make_vec(MOVING, num_envs=1, dynamics="kinematic", observation="state")
    env.reset(seed=1)
    for _ in range(10):
        env.step([[1.5, 0.3]])
    data = env.task.simulation.data(0)
    assert np.allclose(data.body("rover/base").xpos[:2], env.task.state.poses[0, :2])
    walkers = [data.body(f"walker_{i}").xpos[:2] for i in range(3)]
    assert np.allclose(walkers, env.task.map(0).pedestrians.positions(1.0))


@pytest.mark.parametrize(
    "options",
    [
        {"dynamics": "kinematic"},
        {"dynamics": "kinematic", "observation": "image"},
        {"observation": "ranges"},
        {"dynamics": "kinematic", "observation": "state", "disturbances": {"payload": 5.0}},
        {"dynamics": "quantum"},
    ],
)
def test_what_is_impossible_without_physics_is_refused(options):
    with pytest.raises(ConfigurationError):
        worlds(1, **options)
