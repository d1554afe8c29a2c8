import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from armctl.envs import TaskVectorEnv
from armctl.kernels.edges import NEAR_START
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, MinimumTimePose
from armctl.rl.data import solved_layouts
from armctl.rl.data.followed_plans import EncodedPlans, FollowedPlans, Following, follow
from armctl.rl.data.solved_scenes import ATTEMPTS, FREE, INSIDE, LARGEST_TURN, SceneSolver
from armctl.rl.networks.actor import EncodedActor
from armctl.rl.networks.view import view_of
from armctl.tasks import ReachScenesTask
from armctl.tasks.reach import ReachScenesOptions, read_boxes
from armctl.tasks.reach.motion_bench_maker import LAST_OF_TRAINING, ROBOTS, shipped_problems

OPTIONS = ReachScenesOptions(scenes="box,table_under_pick")
HOW = Following(
    tolerance=0.02, largest_move=0.15, margin=0.02, noise=0.1, noise_share=0.0, straight=True, max_steps=150
)


@pytest.fixture(scope="module")
def model():
    return ArmModel(ROBOTS[0])


@pytest.fixture(scope="module")
def solver(model):
    return SceneSolver(model.description, OPTIONS, 3)


@pytest.fixture(scope="module")
def layouts(solver, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solved_layouts, "PART", 5)
        solved_layouts.make(folder, 10, solver, progress=False)
    return solved_layouts.read(folder)


def test_only_training_problems_are_drawn(solver):
    problems = shipped_problems(ROBOTS[0])
    assert (problems.numbers[solver._rows] <= LAST_OF_TRAINING).all()
    assert problems.feasible[solver._rows].all()


def test_a_scene_is_a_problem_turned_and_shifted_as_a_whole(solver, model, monkeypatch):
    problems = shipped_problems(ROBOTS[0])
    monkeypatch.setattr(solver, "_rows", solver._rows[5:6])
    row = solver._rows[0]
    start, target, boxes = solver._draw(np.random.default_rng(0))
    known, pose = problems.boxes[row, : problems.counts[row]], model.pose(problems.goals[row].astype(float))
    turn = boxes[0, 6] - known[0, 6]
    assert 0 < abs(turn) <= LARGEST_TURN
    np.testing.assert_allclose(boxes[:, 3:6], known[:, 3:6], atol=1e-6)
    places = np.vstack((known[:, :3], pose[:3, 3]))
    moved = np.vstack((boxes[:, :3], target[:3]))
    apart, apart_before = (np.linalg.norm(of[:, None] - of[None], axis=-1) for of in (moved, places))
    np.testing.assert_allclose(apart, apart_before, atol=1e-5)
    np.testing.assert_allclose([target[5], target[8]], pose[2, :2], atol=1e-9)  # turned about the vertical
    assert np.isclose(start[0] - problems.starts[row, 0], 0, atol=1e-6) or np.isclose(
        start[0] - problems.starts[row, 0], turn, atol=1e-5
    )


def test_ways_are_free_and_lead_into_the_pose(layouts, model):
    search = MinimumTimePose(model, OPTIONS.lever)
    assert len(layouts) >= 7
    for row in range(len(layouts)):
        way, boxes, target = layouts.way(row), read_boxes(layouts.boxes[row], 8), layouts.targets[row].astype(float)
        miss = search.place(way[-1]) - search.centre(target[:3], target[3:])
        assert np.linalg.norm(miss) <= INSIDE * OPTIONS.tolerance + 1e-5
        assert model.within_limits(way).all()
        checker = EdgeChecker(ArmShapes(model), boxes, 0.4 * FREE, way[0])
        assert all(checker.is_edge_free(a, b) for a, b in itertools.pairwise(way))


def test_ways_end_in_the_free_posture_that_is_nearest_to_home(solver, model):
    nearest = []
    for row in solver._rows[:20]:
        solver._rows, rows = solver._rows[solver._rows == row], solver._rows
        start, target, boxes = solver._draw(np.random.default_rng(int(row)))
        solver._rows = rows
        place = solver._search.centre(target[:3], target[3:])
        goals = solver._goals(start, place, read_boxes(boxes, 8))
        distances = [np.linalg.norm(goal - model.home) for goal in goals]
        assert distances == sorted(distances)
        nearest.append(len(goals))
        assert all(np.linalg.norm(solver._search.place(goal) - place) < solver._tolerance + 1e-4 for goal in goals)
    assert max(nearest) > 1


def test_most_ways_are_near_only_to_what_is_near_at_their_ends(layouts, model):
    wide = []
    for row in range(len(layouts)):
        way = layouts.way(row)
        checker = EdgeChecker(ArmShapes(model), read_boxes(layouts.boxes[row], 8), 0.9 * ATTEMPTS[0][0], way[-1])
        checker.relax(way[0], 0.9 * NEAR_START)
        wide.append(all(checker.is_edge_free(a, b) for a, b in itertools.pairwise(way[::-1])))
    assert np.mean(wide) >= 0.6


@pytest.mark.slow
def test_followers_arrive_in_poses_and_some_begin_late(layouts, model):
    shapes, rows = ArmShapes(model), np.arange(len(layouts))
    states, positions, labels = follow(shapes, layouts, rows, np.random.default_rng(0), HOW)
    last = {int(row): label for row, label in zip(states, labels, strict=True)}
    ends = np.array([layouts.way(row)[-1] for row in rows])
    assert (abs(np.array([last[row] for row in rows]) - ends).max(axis=1) < 0.05).mean() > 0.8
    assert abs(labels - positions).max() <= HOW.largest_move + 1e-6
    late = follow(shapes, layouts, rows, np.random.default_rng(0), replace(HOW, late_share=1.0))[0]
    assert len(late) < len(states)
    examples = FollowedPlans(shapes, layouts, 1, HOW)
    examples.renew(0, np.random.default_rng(0))
    observations, actions = examples.draw(np.random.default_rng(0), 7)
    assert observations.shape == (7, 192)
    assert actions.shape == (7, 6)


def test_a_part_is_followed_again_with_other_noise_and_drawn_as_often_as_the_others(layouts, model):
    examples = FollowedPlans(ArmShapes(model), layouts, 2, replace(HOW, noise_share=0.5))
    first = [examples.renew(part, np.random.default_rng(part)) for part in range(2)]
    before = examples.draw(np.random.default_rng(0), 5)[0]
    assert abs(examples.renew(2, np.random.default_rng(2)) - first[0]) < first[0]
    observations, actions = examples.draw(np.random.default_rng(0), 4000)
    assert not np.array_equal(observations[:5], before)
    of_first = np.isin(observations[:, 9], layouts.targets[::2, 0])
    counts = [len(part[0]) for part in examples._examples.values()]
    assert abs(of_first.mean() - counts[0] / sum(counts)) < 0.04
    assert abs(actions - observations[:, 3:9]).max() <= HOW.largest_move + 1e-5


@pytest.mark.slow
def test_encoded_examples_are_those_of_states(layouts, model):
    worlds = TaskVectorEnv(1, task=ReachScenesTask)
    view, space = view_of(worlds, features="model"), worlds.single_observation_space
    features = view.extractor(space)
    actor = EncodedActor(
        torch.nn.Sequential(features, torch.nn.Linear(features.features_dim, 6)), view.action_scale, space
    )
    plain, encoded = (
        FollowedPlans(ArmShapes(model), layouts, 1, HOW),
        EncodedPlans(ArmShapes(model), layouts, 1, HOW, actor),
    )
    assert plain.renew(0, np.random.default_rng(0)) == encoded.renew(0, np.random.default_rng(0))
    expected = actor.encoded(*plain.draw(np.random.default_rng(1), 50))
    for found, wanted in zip(encoded.draw(np.random.default_rng(1), 50), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-2)


def test_what_scenes_depend_on_is_known(solver):
    assert solver.identity["scenes"] == OPTIONS.scenes
    assert solver.identity["attempts"] == [list(attempt) for attempt in ATTEMPTS]
