from dataclasses import replace

import numpy as np
import pytest
import torch

from armctl.agents import read_card
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, ArmShapes, ImaginedArms
from armctl.kinematics.imagined import MOVING
from armctl.policies import make_policy
from armctl.rl.algorithms import plan_bc
from armctl.rl.data import solved_layouts
from armctl.rl.data.followed_plans import WAYPOINTS_APART, FollowedPlans, Following, follow, limited_moves, waypoints
from armctl.rl.data.solved_layouts import ObstacleLayoutSolver, make, read
from armctl.rl.run.training import Training
from armctl.robot_description import load_arm
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.obstacles import obstacles_observation
from armctl.training.learners import load_recipe

ENV = "armctl/ArmReachObstacles-v0"
HOW = Following(tolerance=0.05, largest_move=0.3, margin=0.02, noise=0.15, noise_share=0.5)
SMALL = {
    "steps": 6, "evaluation_every": 3, "layouts": 12, "parts": 2, "renewals": 1, "batch_size": 32,
    "hidden_units": 16, "validation_episodes": 4, "evaluation_episodes": 4,
}  # fmt: skip


@pytest.fixture(scope="module")
def shapes():
    return ArmShapes(ArmModel("ur5"))


@pytest.fixture(scope="module")
def layouts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("layouts")
    make(folder, 24, ObstacleLayoutSolver(load_arm("ur5"), 0.05, 3), progress=False)
    return read(folder)


def recipe(**options):
    return load_recipe("obstacles_plan_bc").changed(options=SMALL | options, env_options={"max_episode_steps": 10})


@pytest.mark.slow
def test_most_followers_arrive_without_noise(shapes, layouts):
    rows, n = np.arange(len(layouts)), len(layouts)
    states, positions, labels = follow(shapes, layouts, rows, np.random.default_rng(0), replace(HOW, noise_share=0.0))
    assert set(states) == set(rows)
    last = {int(row): label for row, label in zip(states, labels, strict=True)}
    tips = shapes.model.positions(np.array([last[row] for row in range(n)]))
    assert (np.linalg.norm(tips - layouts.targets, axis=1) < 0.06).mean() > 0.8
    assert abs(labels - positions).max() <= HOW.largest_move + 1e-6


@pytest.mark.slow
def test_noise_leads_off_the_ways(shapes, layouts):
    rows = np.arange(10)
    calm, noisy = (
        follow(shapes, layouts, rows, np.random.default_rng(0), replace(HOW, noise_share=share))[1] for share in (0, 1)
    )
    known = set(map(tuple, calm.tolist()))
    assert np.mean([tuple(q) in known for q in noisy.tolist()]) < 0.3  # limits of acceleration make beginnings alike


def test_waypoints_lie_on_the_way_and_near_to_each_other():
    way = np.array([[0.0, 0, 0], [1.0, -0.5, 0], [1.0, -0.5, 0.2]])
    points = waypoints(way)
    assert abs(np.diff(points, axis=0)).max() <= WAYPOINTS_APART + 1e-12
    assert all(any(np.allclose(corner, point) for point in points) for corner in way)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(lengths.sum(), np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_straight_moves_keep_joints_in_proportion(shapes):
    """Joints are off the straight motion by 3 % of its length at most; with moves in proportion, by twice as much."""
    rng, n, home = np.random.default_rng(0), 40, shapes.model.home
    goals = home + rng.uniform(-0.8, 0.8, (n, 6))
    off = {}
    for straight in (True, False):
        arms = ImaginedArms(shapes, n, 0, tolerance=0.0, period=CONTROL_PERIOD)
        arms.begin(np.arange(n), np.tile(home, (n, 1)), 0.0, np.full((n, 3), 9.0), np.zeros((n, 0, 7)))
        off[straight] = np.zeros(n)
        largest = np.zeros((n, 1))
        for _ in range(40):
            moves = goals - arms.positions
            largest = abs(moves).max(axis=1, keepdims=True)
            arms.move(arms.positions + limited_moves(moves, 0.15, shapes.model.limits if straight else None))
            whole, moved = goals - home, arms.positions - home
            share = (moved * whole).sum(axis=1, keepdims=True) / (whole**2).sum(axis=1, keepdims=True)
            off[straight] = np.maximum(off[straight], abs(moved - share * whole).max(axis=1))
        free = arms.states == MOVING
        assert free.sum() > 10
        assert largest[free].max() < 0.01
        off[straight] = off[straight][free] / np.linalg.norm(goals - home, axis=1)[free]
    assert off[True].max() < 0.03
    assert np.median(off[False]) > 2 * np.median(off[True])


@pytest.mark.parametrize("straight", [True, False])
def test_moves_are_limited_and_end_at_the_goal(shapes, straight):
    limits, rng = shapes.model.limits if straight else None, np.random.default_rng(0)
    far = limited_moves(rng.uniform(-2, 2, (50, 6)), 0.15, limits)
    np.testing.assert_allclose(abs(far).max(axis=1), 0.15)
    near = rng.uniform(-0.1, 0.1, (50, 6))
    np.testing.assert_allclose(abs(limited_moves(near, 0.15, limits)).max(axis=1), abs(near).max(axis=1))
    assert not limited_moves(np.zeros((2, 6)), 0.15, limits).any()


def test_imagined_observations_are_those_of_the_environment(shapes):
    worlds = make_worlds(ENV, 5, {})
    observations, _ = worlds.reset(seed=1)
    task = worlds.task
    seen = obstacles_observation(shapes.model, task.arm.joint_positions, task.state.target_position, task.state.boxes)
    np.testing.assert_allclose(seen, np.asarray(observations), atol=1e-5)
    worlds.close()


@pytest.mark.slow
def test_parts_are_followed_anew_one_after_the_other(shapes, layouts):
    examples = FollowedPlans(shapes, layouts, 3, HOW)
    first = examples.renew(0, np.random.default_rng(0))
    assert first == len(examples._examples[0][0])
    for number in (1, 2):
        examples.renew(number, np.random.default_rng(number))
    assert {row for rows, *_ in examples._examples.values() for row in rows} == set(range(len(layouts)))
    before = examples._examples[1][1]
    examples.renew(4, np.random.default_rng(4))
    assert not np.array_equal(examples._examples[1][1][:50], before[:50])
    observations, actions = examples.draw(np.random.default_rng(0), 7)
    assert observations.shape == (7, 89)
    assert actions.shape == (7, 6)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solved_layouts, "PART", 6)
        return folder, plan_bc.train(recipe(), out=folder, seed=0, progress=False)


@pytest.mark.slow
def test_a_training_gives_an_agent_and_its_card(trained):
    folder, card = trained
    assert (card.learner, card.gradient_steps, card.decisions) == ("plan_bc", 6, 0)
    assert card.teacher_queries > 100
    assert read_card(folder / "agent.json") == card
    worlds = make_worlds(ENV, 2, {})
    observations, _ = worlds.reset(seed=0)
    agent = make_policy(folder / "agent.json", worlds)
    assert agent.sees == "model"
    assert agent.act(observations).shape == (2, 6)
    worlds.close()


@pytest.mark.slow
def test_an_interrupted_training_resumes(tmp_path, monkeypatch, unexported):
    evaluate, calls = Training.evaluate, []

    def interrupted(training, actor, step):
        calls.append({name: value.clone() for name, value in actor.state_dict().items()})
        if len(calls) == 1:
            raise KeyboardInterrupt
        evaluate(training, actor, step)

    monkeypatch.setattr(Training, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        plan_bc.train(recipe(), out=tmp_path, seed=0, progress=False)
    made = (tmp_path / "layouts" / "part_0.npz").stat().st_mtime_ns
    card = plan_bc.train(recipe(), out=tmp_path, seed=0, resume=True, progress=False)
    assert card.gradient_steps == 6
    assert (tmp_path / "layouts" / "part_0.npz").stat().st_mtime_ns == made
    moved = [not torch.equal(calls[0][name], value) for name, value in calls[-1].items() if "boxes.0" in name]
    assert moved
    assert all(moved)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"env": "armctl/ArmReach-v0"}, "robot's geometry"),
        ({"env_options": {"control": "delta"}}, "control 'position'"),
        ({"teacher": "reach_ompl"}, "no teacher"),
        ({"shaping": "ompl"}, "rewards"),
    ],
)
def test_what_it_cannot_learn_from_is_refused(tmp_path, changes, says):
    with pytest.raises(ConfigurationError, match=says):
        plan_bc.train(recipe().changed(**changes), out=tmp_path / "new", seed=0, progress=False)
    assert not (tmp_path / "new").exists()
