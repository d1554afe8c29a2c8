"""`benchmarks/arenas.py`, and the experts of `examples/arenas/`."""

import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import typer

ROOT = Path(__file__).parents[1]
EXPERTS = ROOT / "examples" / "arenas"
STEP = 0.05


@pytest.fixture
def arenas(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.setenv("COLUMNS", "300")
    yield runpy.run_path(str(ROOT / "benchmarks" / "arenas.py"))
    for name in ("printing", "other_processes"):
        sys.modules.pop(name, None)


def experts(name):
    return SimpleNamespace(**runpy.run_path(str(EXPERTS / f"{name}.py")))


def last_observation(env_id, expert, seed):
    env = gymnasium.make(env_id)
    observation, _ = env.reset(seed=seed)
    is_over = False
    while not is_over:
        action = expert.act(observation)
        assert env.action_space.contains(action.astype(np.float32))
        observation, _, terminated, truncated, _ = env.step(action)
        is_over = terminated or truncated
    return observation


@pytest.mark.parametrize("target", [(0.1, 0.1), (-0.19, 0.02), (0.05, -0.03), (0.0, 0.2)])
def test_inverse_kinematics_of_two_links(target):
    arms = experts("torque_arms")
    for first, elbow in arms.Reacher().solutions(np.array(target)):
        angles = np.array([first, first + elbow])
        tip = arms.LINKS @ np.column_stack((np.cos(angles), np.sin(angles)))
        assert tip == pytest.approx(target, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_reacher_reaches(seed):
    observation = last_observation("Reacher-v5", experts("torque_arms").Reacher(), seed)
    assert np.linalg.norm(observation[-2:]) < 0.01


def test_out_of_reach_is_as_near_as_possible():
    *_, solution = experts("torque_arms").Reacher().solutions(np.array([1.0, 0.0]))
    assert solution == pytest.approx([0, 0], abs=1e-9)


def test_pusher_moves_cylinders_towards_the_goal():
    env, nearer = gymnasium.make("Pusher-v5"), []
    for seed in range(4):
        observations = env.reset(seed=seed)[0], last_observation("Pusher-v5", experts("torque_arms").Pusher(), seed)
        before, after = (np.linalg.norm(observation[17:19] - observation[20:22]) for observation in observations)
        nearer.append(before - after)
    assert np.mean(nearer) > 0.02, nearer


class Table:
    """A hand that goes where it is told, and a cube without inertia, which it moves while it is beside it."""

    half = 0.025

    def __init__(self, rng, size):
        self.action_space = gymnasium.spaces.Box(-1, 1, (size,), np.float32)
        self.cube, self.goal = (np.append(rng.uniform(-0.15, 0.15, 2), 0.0) for _ in range(2))
        self.hand = np.array([0.0, 0.0, 0.12])

    def observation(self):
        return {"observation": self.hand.copy(), "achieved_goal": self.cube.copy(), "desired_goal": self.goal.copy()}

    def step(self, action):
        assert self.action_space.contains(action.astype(np.float32))
        for _ in range(10):
            self.hand += STEP * action[:3] / 10
            offset = self.cube - self.hand
            distance = np.linalg.norm(offset[:2])
            if abs(offset[2]) < self.half and 0 < distance < self.half:
                self.cube[:2] += offset[:2] * (self.half / distance - 1)


@pytest.mark.parametrize("size", [3, 4])
@pytest.mark.parametrize("name", ["FetchPush", "PandaPush"])
@pytest.mark.parametrize("seed", range(3))
def test_a_cube_is_pushed_to_the_goal(name, size, seed):
    table = Table(np.random.default_rng(seed), size)
    expert = getattr(experts("goal_experts"), name)(table)
    expert.reset()
    for _ in range(100):
        table.step(expert.act(table.observation()))
    assert np.linalg.norm(table.cube - table.goal) < 0.05


def test_the_hand_goes_straight_to_the_goal():
    table = Table(np.random.default_rng(0), 4)
    expert = experts("goal_experts").Reach(table)
    observation = {"achieved_goal": table.hand, "desired_goal": table.hand + np.array([0.02, -0.5, 0.0])}
    assert expert.act(observation) == pytest.approx([0.4, -1.0, 0.0, 0.0])


def test_an_unknown_arena_is_named(arenas):
    with pytest.raises(typer.BadParameter, match="fetch-reach"):
        arenas["main"]("fetch-reech")


def test_packages_and_policies_exist(arenas):
    for arena in arenas["ARENAS"].values():
        assert bool(arena.packages) == (":" in arena.env)
        for policy in arena.experts.values():
            file, _, name = policy.partition(":")
            assert not name or hasattr(experts(file.removesuffix(".py")), name)


@pytest.mark.slow
def test_an_agent_is_trained_and_played(arenas, capfd, tmp_path, monkeypatch):
    arena = arenas["Arena"]("Reacher-v5", {"ik_lqr": "torque_arms.py:Reacher"}, 100)
    monkeypatch.setitem(arenas["ARENAS"], "reacher", arena)
    arenas["main"]("reacher", episodes=5, folder=tmp_path)
    printed = capfd.readouterr().out
    rows = [line.split("|")[1].strip() for line in printed.splitlines() if line.startswith("|")]
    assert rows[2:] == ["ik_lqr", "sac[0]", "random"]
    assert "5 episodes of seed 300" in printed
    assert (tmp_path / "reacher-sac-0" / "agent.json").exists()
