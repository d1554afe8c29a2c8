import itertools

import numpy as np
import pytest

from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.policies import make_policy
from armctl.tasks.reach import read_boxes

OBSTACLES = "armctl/ArmReachObstacles-v0"
JOINTS = slice(3, 9)


@pytest.fixture(scope="module")
def model():
    return ArmModel("ur5")


@pytest.fixture(scope="module")
def played():
    """An expert's episodes: observations and labels of the worlds that still play, (n, ...) at each control step."""
    worlds = make_worlds(OBSTACLES, 20)
    policy = make_policy("reach_ompl", worlds)
    observations, _ = worlds.reset(seed=31)
    policy.reset(np.arange(20, dtype=np.int32))
    steps, playing = [], np.ones(20, dtype=bool)
    while playing.any():
        labels = policy.act(observations)
        steps.append((observations.copy(), labels.copy(), playing.copy()))
        observations, _, terminated, truncated, _ = worlds.step(labels)
        playing &= ~(terminated | truncated)
    return steps


def is_safe(model, observation, label):
    """Whether the straight motion from the observed joints to a label touches nothing, at 60 configurations."""
    among = model.among(read_boxes(observation[12:].astype(float)))
    q = observation[JOINTS].astype(float)
    return all(among.is_free(one) for one in np.linspace(q, label, 60))


def test_it_is_as_fast_as_what_it_sees_allows(played):
    assert len(played) < 60
    assert sum(playing.sum() for _, _, playing in played) / 20 < 24  # 29 steps when it followed its plan by the clock


def test_labels_are_safe_and_near(model, played):
    for observations, labels, playing in played:
        for i in np.flatnonzero(playing):
            assert is_safe(model, observations[i], labels[i])
            assert np.abs(labels[i] - observations[i, JOINTS]).max() <= 0.5 + 1e-6


def test_labels_change_little_from_one_step_to_the_next(played):
    for (_, before, _), (_, after, playing) in itertools.pairwise(played):
        assert np.abs(after - before)[playing].max(initial=0.0) < 0.7


@pytest.mark.parametrize("shift", [0.05, 0.3])
def test_labels_go_by_the_observed_joints(model, played, shift):
    """Asked where somebody else has taken the joints, the label starts from there, and is safe too."""
    worlds = make_worlds(OBSTACLES, 20)
    policy = make_policy("reach_ompl", worlds)
    policy.reset(np.arange(20, dtype=np.int32))
    rng, safe, moved = np.random.default_rng(0), [], []
    for observations, labels, playing in played[:12]:
        shifted = observations.copy()
        shifted[:, JOINTS] += rng.uniform(-shift, shift, (20, 6)).astype(np.float32)
        asked = policy.act(shifted)
        for i in np.flatnonzero(playing):
            among = model.among(read_boxes(shifted[i, 12:].astype(float)))
            if among.is_free(shifted[i, JOINTS].astype(float)):
                safe.append(is_safe(model, shifted[i], asked[i]))
                moved.append(np.abs(asked[i] - labels[i]).max() > shift / 10)
    assert len(safe) > 100
    assert all(safe)
    assert np.mean(moved) > 0.9


def test_joints_that_are_in_a_box_stay(model, played):
    observations, _, _ = played[0]
    worlds = make_worlds(OBSTACLES, 20)
    policy = make_policy("reach_ompl", worlds)
    policy.reset(np.arange(20, dtype=np.int32))
    hostile = observations.copy()
    rng = np.random.default_rng(1)
    for i in range(20):
        among = model.among(read_boxes(hostile[i, 12:].astype(float)))
        hostile[i, JOINTS] = next(q for q in rng.uniform(-2, 2, (1000, 6)) if not among.is_free(q))
    for seen in (hostile, observations, hostile):  # as the first observation, and in the middle of an episode
        asked = policy.act(seen)
        assert np.isfinite(asked).all()
    np.testing.assert_allclose(asked, hostile[:, JOINTS], atol=1e-6)


def test_a_plan_is_made_again_where_nothing_of_it_is_in_sight(model, played):
    observations, _, _ = played[0]
    worlds = make_worlds(OBSTACLES, 20)
    controllers = (policy := make_policy("reach_ompl", worlds)).controllers
    policy.act(observations)
    before = [one._path.copy() for one in controllers]
    away = observations.copy()
    away[:, JOINTS] = np.array([np.pi, -0.5, -1.0, -1.5, 0.5, 0.0])
    for _ in range(8):
        asked = policy.act(away)
    again = 0
    for i, one in enumerate(controllers):
        boxes = read_boxes(away[i, 12:].astype(float))
        q = away[i, JOINTS].astype(float)
        if not model.among(boxes).is_free(q):
            continue
        assert is_safe(model, away[i], asked[i])
        sees_old = EdgeChecker(ArmShapes(model), boxes, 0.001, q).farthest_goal(before[i], q) is not None
        again += not sees_old and len(one._path) > 0
        assert sees_old or not np.array_equal(one._path, before[i])
    assert again > 0
