"""DAgger in imagination: what its arms show, the labels of inverse kinematics, and what it refuses."""

import numpy as np
import pytest
import torch

from armctl.agents import read_card
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmShapes, EdgeChecker, MinimumTimePose
from armctl.policies import make_policy
from armctl.rl.algorithms import imagined_dagger
from armctl.rl.data.imagined_reaching import ImaginedReaching, Imagining
from armctl.rl.run.training import Training
from armctl.scene import NO_BOXES
from armctl.training.learners import load_recipe

HOW = Imagining(arms=8, memory=30, max_steps=20, margin=0.0, noise=0.1, noise_share=0.5)
SMALL = {
    "steps": 6, "evaluation_every": 3, "targets": 10, "worlds": 4, "arms": 4, "memory": 100, "batch_size": 16,
    "hidden_units": 16, "validation_episodes": 4, "evaluation_episodes": 4,
}  # fmt: skip


class Idle:
    """A student that stays where it is."""

    def act(self, observations):
        return observations[:, 3:9]


class Clone:
    """A student that follows the labels of a state, as if it had learned them exactly."""

    def __init__(self, examples):
        self.examples = examples

    def act(self, observations):
        count, arms = self.examples._count, len(observations)
        return self.examples._labels[(count - arms + np.arange(arms)) % HOW.memory]


@pytest.fixture(scope="module", params=["ArmPose-v0", "ArmReach-v0"])
def worlds(request):
    envs = make_worlds(f"armctl/{request.param}", 16, {})
    yield envs, envs.reset(seed=7)[0]
    envs.close()


def test_imagined_observations_are_those_of_the_environment(worlds):
    envs, observations = worlds
    examples = ImaginedReaching(envs.task, observations, HOW)
    examples.advance(Idle(), np.random.default_rng(0))
    seen, _ = examples.draw(np.random.default_rng(0), 40)
    for row in seen.numpy():
        assert np.abs(observations - row).max(axis=1).min() < 1e-5


def test_labels_are_at_the_target_and_lead_there(worlds):
    envs, observations = worlds
    examples = ImaginedReaching(envs.task, observations, HOW)
    student, rng, distances = Clone(examples), np.random.default_rng(0), []
    for _ in range(60):
        examples.advance(student, rng)
        slots = (examples._count - HOW.arms + np.arange(HOW.arms)) % HOW.memory
        at_labels = examples._search.places(examples._labels[slots].astype(float))
        np.testing.assert_allclose(at_labels, examples._targets[examples._rows], atol=1e-4)
        offsets = np.linalg.norm(examples._places - examples._targets[examples._rows], axis=1)
        distances.append(offsets.min())
    assert np.mean(np.array(distances) < envs.task.options.tolerance) > 0.1  # arms arrive, in spite of noise


def test_a_label_is_the_earliest_that_a_free_straight_motion_reaches():
    envs = make_worlds("armctl/ArmPose-v0", 16, {})
    examples = ImaginedReaching(envs.task, envs.reset(seed=3)[0], HOW)
    examples.advance(Idle(), np.random.default_rng(0))
    model = examples._model
    shapes = ArmShapes(model)
    for arm in range(HOW.arms):
        position, label = examples._arms.positions[arm], examples._labels[arm]
        goals = model.nearest_turn(examples._goals[examples._rows[arm]], position)
        goals = goals[np.isfinite(goals[:, 0])]
        times = model.cruise_time(position, goals)
        checker = EdgeChecker(shapes, NO_BOXES, 1e-9, position)
        free = np.array([checker.is_edge_free(position, goal) for goal in goals])
        earliest = goals[np.argmin(np.where(free, times, times + 100 * free.any()))]
        np.testing.assert_allclose(label, earliest, atol=1e-5)
    envs.close()


def test_the_latest_states_are_remembered(worlds):
    envs, observations = worlds
    examples, rng = ImaginedReaching(envs.task, observations, HOW), np.random.default_rng(0)
    assert examples.advance(Idle(), rng) == HOW.arms
    first = {tuple(row) for row in examples.draw(rng, 200)[0].numpy()}
    assert len(first) <= HOW.arms
    for _ in range(4):
        examples.advance(Idle(), rng)
    assert examples._count == 5 * HOW.arms
    observations, labels = examples.draw(rng, 500)
    assert observations.dtype == labels.dtype == torch.float32
    assert HOW.arms < len({tuple(row) for row in observations.numpy()}) <= HOW.memory


def recipe(**changes):
    return load_recipe("pose_dagger").changed(options=SMALL, env_options={"max_episode_steps": 5}).changed(**changes)


@pytest.mark.slow
def test_a_training_gives_an_agent_and_resumes(tmp_path, monkeypatch):
    evaluate, steps = Training.evaluate, []

    def interrupted(training, actor, step):
        steps.append(step)
        if len(steps) == 1:
            raise KeyboardInterrupt
        evaluate(training, actor, step)

    monkeypatch.setattr(Training, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        imagined_dagger.train(recipe(), out=tmp_path, seed=0, progress=False)
    card = imagined_dagger.train(recipe(), out=tmp_path, seed=0, resume=True, progress=False)
    assert (card.learner, card.gradient_steps, card.decisions) == ("imagined_dagger", 6, 0)
    assert 6 * 4 <= card.teacher_queries <= 8 * 4
    assert read_card(tmp_path / "agent.json") == card
    envs = make_worlds("armctl/ArmPose-v0", 2, {})
    agent = make_policy(tmp_path / "agent.json", envs)
    assert agent.sees == "observation"
    assert agent.act(envs.reset(seed=0)[0]).shape == (2, 6)
    envs.close()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"env": "armctl/ArmReachMoving-v0"}, "'paper' of ArmReach-v0 and ArmPose-v0"),
        ({"env": "armctl/ArmReachObstacles-v0"}, "'paper' of ArmReach-v0 and ArmPose-v0"),
        ({"env": "armctl/ArmLift-v0"}, "'paper' of ArmReach-v0 and ArmPose-v0"),
        ({"env_options": {"control": "delta"}}, "control 'position'"),
        ({"env_options": {"observation": "full"}}, "observation 'paper'"),
        ({"options": {"features": "none"}}, "features = 'invariant'"),
        ({"options": {"targets": 0}}, "targets"),
        ({"teacher": "reach_ik"}, "no teacher"),
        ({"shaping": "ik"}, "rewards"),
    ],
)
def test_what_it_cannot_learn_from_is_refused(tmp_path, changes, says):
    with pytest.raises(ConfigurationError, match=says):
        imagined_dagger.train(recipe(**changes), out=tmp_path / "new", seed=0, progress=False)
    assert not (tmp_path / "new").exists()


def test_its_search_for_poses_is_that_of_the_task():
    envs = make_worlds("armctl/ArmPose-v0", 1, {"angle_tolerance": 20.0})
    examples = ImaginedReaching(envs.task, envs.reset(seed=0)[0], HOW)
    assert isinstance(examples._search, MinimumTimePose)
    assert examples._search.lever == envs.task.lever
    envs.close()
