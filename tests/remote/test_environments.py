"""Environments of another Python play the same episodes as here, and whatever goes wrong there is told."""

import sys

import numpy as np
import pandas as pd
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.study import compare

pytestmark = pytest.mark.slow  # interpreters are started
MAZE = """
import os
import gymnasium, numpy as np
from gymnasium import spaces

print("a chatty environment")

class Maze(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}
    observation_space = spaces.Dict({
        "place": spaces.Box(-1, 1, (2,)), "pair": spaces.Tuple([spaces.Discrete(3), spaces.Box(0, 1, (1,))]),
    })
    action_space = spaces.Box(-1, 1, (2,))
    dt, max_episode_steps = 0.1, 40

    def __init__(self, size=1.0, render_mode=None):
        self.size, self.render_mode = size, render_mode

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.uniform(-1, 1, 2).astype(np.float32), 0
        return self.observed(), {"where": object()}

    def observed(self):
        return {"place": self.place.copy(), "pair": (1, np.zeros(1, np.float32))}

    def step(self, action):
        self.place = np.clip(self.place + 0.2 * action, -1, 1).astype(np.float32)
        self.steps += 1
        distance = float(np.linalg.norm(self.place))
        return self.observed(), -distance, distance < 0.15, self.steps >= 40, {"is_success": distance < 0.15}

    def render(self):
        return np.full((32, 32, 3), self.steps, np.uint8)

class Dies(Maze):
    def step(self, action):
        if self.steps == 3:
            os._exit(1)
        return super().step(action)

class Errs(Maze):
    def step(self, action):
        assert self.steps < 3
        return super().step(action)

class Graph(Maze):
    observation_space = spaces.Text(5)

class Seedless(Maze):
    def reset(self):
        return super().reset()
"""


def home(observation):
    return -observation["place"]


@pytest.fixture
def maze(tmp_path, monkeypatch):
    (tmp_path / "maze.py").write_text(MAZE)
    monkeypatch.chdir(tmp_path)
    return lambda name: f"python={sys.executable}:maze.py:{name}"


def test_the_same_episodes_with_any_number_of_worlds(maze):
    frames = []
    for env, worlds in [("maze.py:Maze", 1), (maze("Maze"), 1), (maze("Maze"), 3)]:
        played = compare(home, env, episodes=6, worlds=worlds, env_options={"size": 2.0})
        assert not played.failures
        frames.append(played.episodes[["return", "length", "outcome", "success"]])
    pd.testing.assert_frame_equal(frames[0], frames[1])
    pd.testing.assert_frame_equal(frames[0], frames[2])


def test_its_facts_and_its_pictures(maze):
    worlds = make_worlds(maze("Maze"), 2, render_mode="rgb_array")
    worlds.reset(seed=3)
    worlds.step(np.zeros((2, 2)))
    assert worlds.task.control_period == 0.1
    assert worlds.metadata["render_fps"] == 20
    assert worlds.max_episode_steps == 40
    pictures = worlds.render()
    assert [picture.shape for picture in pictures] == [(32, 32, 3)] * 2
    assert (pictures[0] == 1).all()
    worlds.close()


def test_ids_of_gymnasium_with_their_time_limit():
    worlds = make_worlds(f"python={sys.executable}:gymnasium:Pendulum-v1", 1)
    assert worlds.max_episode_steps == 200
    worlds.close()


@pytest.mark.parametrize(
    ("name", "says"), [("Dies", "has closed the connection"), ("Errs", 'AssertionError: "assert self.steps < 3"')]
)
def test_an_environment_that_fails_ends_its_policy(maze, name, says):
    played = compare({"home": home}, maze(name), episodes=2)
    assert says in played.failures["home"]


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("Labyrinth", {}, "Labyrinth"),
        ("Maze", {"colour": 3}, "colour"),
        ("Graph", {}, "not Text"),
        ("Seedless", {}, "seed"),
    ],
)
def test_what_cannot_be_made_is_told(maze, name, options, says):
    with pytest.raises(ConfigurationError, match=says):
        make_worlds(maze(name), 1, options)
