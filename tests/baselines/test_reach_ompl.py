import itertools
from typing import Any

import numpy as np
import pytest

from armctl.control.streaming import follow
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.planning import ArmPlan, ArmPlanner, PathCertificateOptions
from armctl.policies import make_policy
from armctl.rollout import evaluate
from armctl.tasks.reach import read_boxes

OBSTACLES = "armctl/ArmReachObstacles-v0"
UNPREPARED = "reach_ompl:prepared=false"
JOINTS = slice(3, 9)


@pytest.fixture(scope="module")
def model():
    return ArmModel("ur5")


@pytest.fixture(scope="module")
def played():
    """An expert's episodes: observations and labels of the worlds that still play, (n, ...) at each control step."""
    worlds = make_worlds(OBSTACLES, 20)
    policy = make_policy(UNPREPARED, worlds)
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


@pytest.mark.slow
@pytest.mark.parametrize("shift", [0.05, 0.3])
def test_labels_go_by_the_observed_joints(model, played, shift):
    """Asked where somebody else has taken the joints, the label starts from there, and is safe too."""
    worlds = make_worlds(OBSTACLES, 20)
    policy = make_policy(UNPREPARED, worlds)
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
    policy = make_policy(UNPREPARED, worlds)
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
    policy: Any = make_policy(UNPREPARED, worlds)
    controllers = policy.controllers
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


def test_a_query_that_failed_is_not_repeated(monkeypatch):
    """Each further plan from the same joints differs in its options, and the next ones have less clearance."""
    asked = []

    def fail(self, *arguments):
        asked.append((self.options, *(np.asarray(one).tobytes() for one in arguments[:2])))
        return ArmPlan(np.zeros((0, 6)), np.inf, np.inf, np.nan, True, 6000, 0.0)

    monkeypatch.setattr(ArmPlanner, "plan", fail)
    worlds = make_worlds(OBSTACLES, 1)
    policy = make_policy("reach_ompl", worlds)
    observation, _ = worlds.reset(seed=31)
    for _ in range(40):
        policy.act(observation)
    assert len(asked) == len(set(asked)) > 3
    clearances = [options.clearance for options, *_ in asked]
    assert clearances == sorted(clearances, reverse=True)
    assert clearances[-1] == PathCertificateOptions().clearance


@pytest.mark.parametrize(("seed", "episode"), [(0, 443), (0, 454), (2026, 48), (2026, 380)])
def test_it_reaches_where_it_touched_or_stood_still(seed, episode):
    """At full speed, joints that lagged behind the drives touched; or a plan that had failed was asked for again."""
    worlds = make_worlds(OBSTACLES, 1)
    policy = make_policy("reach_ompl", worlds)
    observation, _ = worlds.reset(seed=[seed], options={"episode": np.array([episode])})
    policy.reset(np.zeros(1, dtype=np.int32))
    over = np.zeros(1, dtype=bool)
    while not over.any():
        observation, _, terminated, truncated, info = worlds.step(policy.act(observation))
        over = terminated | truncated
    assert terminated.all()
    assert not any(touched.any() for touched in info["contacts"].values())


@pytest.mark.slow
def test_joints_that_are_off_their_drives_stop_freely(model, played):
    """Drives that stop freely are not enough: from the joints as observed, the same motion touches nothing either."""
    worlds = make_worlds(OBSTACLES, 20)
    policy: Any = make_policy(UNPREPARED, worlds)
    controllers = policy.controllers
    rng, limits, safe = np.random.default_rng(0), model.limits, []
    policy.act(played[0][0])
    for observations, _, playing in played[1:16]:
        for i in np.flatnonzero(playing):
            q = observations[i, JOINTS].astype(float)
            position, velocity = q + rng.uniform(-0.05, 0.05, 6), rng.uniform(-1.5, 1.5, 6)
            controllers[i]._drives = position, velocity
            label = controllers[i].act(observations[i])
            among, now, speed, free = model.among(read_boxes(observations[i, 12:].astype(float))), q, velocity, True
            if not controllers[i]._stops_freely(q, position, velocity, q):
                continue  # too late for any command
            for _ in range(20):
                now, speed = follow(limits, now, speed, label - position + q, 0.04)
                free = free and among.is_free(now)
            safe.append(free)
    assert len(safe) > 50
    assert all(safe)


@pytest.mark.slow
def test_jerk_limited_paths_are_smoother_and_free(sized):
    n = sized(6, 20)

    def results(policy, **options):
        return evaluate(policy, OBSTACLES, episodes=n, seed=100, worlds=n, env_options=options, lower_bound_steps=False)

    smooth, plain = results("reach_ompl:jerk_limited=true", control="velocity"), results("reach_ompl")
    for played in (smooth, plain):
        assert (played.outcome == "reached").mean() >= 0.95
    assert smooth.joint_jerk_rms.mean() < 0.75 * plain.joint_jerk_rms.mean()
    assert smooth.tip_jerk_max.mean() < 0.75 * plain.tip_jerk_max.mean()


@pytest.mark.slow
@pytest.mark.parametrize("disturbances", [{"noise": 0.05}, {"pushes": 40}])
def test_an_arm_that_leaves_its_trajectory_goes_on_by_sight(disturbances):
    options = {"control": "velocity", "disturbances": disturbances}
    policy = "reach_ompl:jerk_limited=true"
    played = evaluate(policy, OBSTACLES, episodes=6, seed=100, worlds=6, env_options=options, lower_bound_steps=False)
    assert (played.outcome == "reached").sum() >= 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("disturbances", "unprepared", "prepared"),
    [({}, 20, 20), ({"noise": 0.05}, 5, 16), ({"delay": 8}, 17, 19), ({"mismatch": 0.1}, 13, 17)],
)
def test_it_is_prepared_for_noise_delay_and_links_of_other_lengths(disturbances, unprepared, prepared):
    """Of 20 episodes, it reaches so many at least, and without estimates so few at most, unless nothing disturbs."""
    successes = [
        evaluate(
            policy, OBSTACLES, episodes=20, seed=302, worlds=20, env_options={"disturbances": disturbances},
            lower_bound_steps=False,
        ).success.sum()
        for policy in (UNPREPARED, "reach_ompl")
    ]  # fmt: skip
    assert successes[1] >= prepared
    assert successes[0] <= unprepared or not disturbances


def test_it_waits_for_boxes_that_are_noisy_and_begins_at_once_if_they_are_not():
    for noise, waits in ((0.0, False), (0.05, True)):
        worlds = make_worlds(OBSTACLES, 1, options={"disturbances": {"noise": noise}})
        policy: Any = make_policy("reach_ompl", worlds)
        observation, _ = worlds.reset(seed=31)
        action = policy.act(observation)
        assert (len(policy.controllers[0]._path) == 0) == waits
        assert np.allclose(action, observation[:, JOINTS], atol=0.2) or not waits
