from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.datasets.collect import collect
from armctl.datasets.demonstrations import demonstrate
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.policies import make_policy
from armctl.rl.algorithms.bc import BcOptions
from armctl.rl.algorithms.bc import train as clone
from armctl.rl.algorithms.cloned_ppo import train as train_cloned_ppo
from armctl.rl.algorithms.dagger import train as dagger
from armctl.rl.data.demonstrations import Examples, Teacher, examples_for
from armctl.rl.networks.actor import tensors
from armctl.rl.networks.view import view_of
from armctl.rollout import evaluate
from armctl.tasks import ReachTask
from armctl.training.learners import load_recipe
from tests.rl.small_trainings import SHORT, small

WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "ur5": ("armctl/ArmReach-v0", {}),
    "panda": ("armctl/ArmReach-v0", {"robot": "panda"}),
    "delta": ("armctl/ArmReach-v0", {"control": "delta"}),
    "velocity": ("armctl/ArmReach-v0", {"control": "velocity"}),
    "moving": ("armctl/ArmReachMoving-v0", {}),
    "pose": ("armctl/ArmPose-v0", {}),
    "obstacles": ("armctl/ArmReachObstacles-v0", {}),
    "bridge": ("armctl/BridgeCross-v0", {"resolution": (8, 6)}),
}


@pytest.fixture(scope="module")
def cloned(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "bc"
    recipe = small("reach_bc", demonstrations=40, steps=300, evaluation_every=150)
    return recipe, out, clone(recipe, out=out, seed=0, progress=False)


@pytest.mark.slow
def test_a_clone_is_far_better_than_chance(cloned):
    _, out, card = cloned
    assert (card.learner, card.teacher, card.training_steps) == ("bc", "reach_ik:prepared=false", 300)
    assert card.evaluation.success_rate > 0.4  # random actions: 0.015
    assert len(evaluate(str(out / "agent.json"), episodes=3)) == 3


@pytest.mark.slow
def test_cloning_is_reproducible_and_goes_on_where_it_was(cloned, tmp_path):
    recipe, _, card = cloned
    again = clone(recipe, out=tmp_path / "again", seed=0, progress=False)
    assert again.evaluation == card.evaluation
    longer = recipe.changed(options=recipe.options | {"steps": 350})
    assert clone(longer, out=tmp_path / "again", seed=0, resume=True, progress=False).training_steps == 350


@pytest.mark.slow
def test_a_dataset_teaches_as_the_teacher_does(cloned, tmp_path):
    recipe, _, card = cloned
    collect("reach_ik:prepared=false", episodes=40, out=tmp_path / "data", seed=10**9, worlds=40, env_options=SHORT)
    taught = recipe.changed(options=recipe.options | {"dataset": str(tmp_path / "data")})
    assert clone(taught, out=tmp_path / "run", seed=0, progress=False).evaluation == card.evaluation


def test_failures_are_not_cloned(tmp_path):
    collect("random", episodes=3, out=tmp_path / "data", env_options={"max_episode_steps": 2})
    with pytest.raises(ConfigurationError, match="none of 3 episodes"):
        clone(small("reach_bc", dataset=str(tmp_path / "data")), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


def test_a_dataset_cannot_be_disturbed(tmp_path):
    recipe = small("reach_bc", dataset=str(tmp_path / "data")).changed(
        training_options={"disturbances": {"noise": [0, 0.02]}}
    )
    with pytest.raises(ConfigurationError, match="training_options are for a teacher's episodes"):
        clone(recipe, out=tmp_path / "run", seed=0, progress=False)


def test_a_teacher_is_asked_in_disturbed_episodes():
    recipe = small("reach_bc").changed(training_options={"disturbances": {"noise": [0, 0.02]}})
    teacher = Teacher(SimpleNamespace(recipe=recipe, seed=0, shows_bars=False), 3)
    assert len(set(teacher.envs.disturbances["noise"].levels)) == 1  # before the first episode
    teacher.show(3, 0)
    assert len(set(teacher.envs.disturbances["noise"].levels)) == 3
    teacher.envs.close()


@pytest.mark.parametrize(("name", "train"), [("reach_bc", clone), ("reach_cloned_ppo", train_cloned_ppo)])
def test_a_missing_dataset_leaves_no_folder(name, train, tmp_path):
    with pytest.raises(ConfigurationError, match="no Minari dataset"):
        train(small(name, dataset=str(tmp_path / "nowhere")), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("train", [clone, dagger])
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"teacher": "reach_ki"}, "Did you mean 'reach_ik'"),
        ({"teacher": None}, "--teacher"),
        ({"teacher": "bridge_ompl"}, "cannot play this task"),
        ({"teacher": "nowhere:policy"}, "nowhere"),
        ({"shaping": "distance"}, "not learn from rewards"),
        ({"options": {"hindsite": 0.5}}, "Did you mean 'hindsight'"),
        ({"options": {"hindsight": 1.5}}, "hindsight"),
    ],
)
def test_mistakes_get_one_clear_error(train, changes, says, tmp_path):
    recipe = load_recipe("reach_bc" if train is clone else "reach_dagger")
    with pytest.raises(ConfigurationError, match=says):
        train(recipe.changed(**changes), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


def test_a_teacher_of_ones_own(unexported, tmp_path, monkeypatch):
    (tmp_path / "my_own_teacher.py").write_text(
        "import armctl\n\n\n@armctl.sees('model')\ndef mine(env):\n    return armctl.make_policy('reach_ik', env)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    recipe = small("reach_bc", demonstrations=3, steps=5, validation_episodes=2, evaluation_episodes=2).changed(
        teacher="my_own_teacher:mine"
    )
    assert clone(recipe, out=tmp_path / "run", seed=0, progress=False).teacher == "my_own_teacher:mine"


def _examples(hindsight, episodes=6, **options):
    env = make_worlds("armctl/ArmReach-v0", 3, options)
    shown = [episode for _, episode in demonstrate(make_policy("reach_ik", env), env, episodes, 0)]
    examples = Examples(env.task, hindsight)
    examples.add(shown)
    return examples, shown


def test_examples_without_hindsight_are_what_was_shown():
    examples, shown = _examples(0.0)
    pairs = {
        (tuple(seen), tuple(done.astype(np.float32)))
        for episode in shown
        for seen, done in zip(episode.observations[:-1], episode.actions, strict=True)
    }
    observations, actions = examples.draw(np.random.default_rng(0), 200)
    assert all((tuple(o), tuple(a)) in pairs for o, a in zip(observations.numpy(), actions.numpy(), strict=True))


def test_with_hindsight_the_action_brings_the_end_effector_to_the_target():
    from armctl.kinematics import ArmModel

    examples, shown = _examples(1.0)
    observations, actions = (part.numpy() for part in examples.draw(np.random.default_rng(0), 200))
    model = ArmModel(examples.task.arm.description)
    np.testing.assert_allclose(model.positions(actions.astype(float)), observations[:, 9:], atol=1e-4)
    started = {tuple(seen) for episode in shown for seen in episode.observations[:-1, :9]}
    assert all(tuple(row) in started for row in observations[:, :9])


def test_hindsight_moves_the_orientation_of_a_pose_too():
    from armctl.kinematics import ArmModel

    env = make_worlds("armctl/ArmPose-v0", 3, {})
    examples = Examples(env.task, 1.0)
    examples.add([episode for _, episode in demonstrate(make_policy("reach_ik", env), env, 6, 0)])
    observations, actions = (part.numpy() for part in examples.draw(np.random.default_rng(0), 50))
    model = ArmModel(env.task.arm.description)
    poses = np.array([model.pose(q) for q in actions.astype(float)])
    np.testing.assert_allclose(poses[:, :3, 3], observations[:, 9:12], atol=1e-4)
    axes = np.concatenate((poses[:, :3, 0], poses[:, :3, 1]), axis=1)
    np.testing.assert_allclose(axes, observations[:, 18:], atol=1e-4)


def test_hindsight_is_for_positions_and_targets_at_rest():
    for name, expected in (("ur5", 0.5), ("obstacles", 0.5), ("delta", 0.0), ("moving", 0.0), ("bridge", 0.0)):
        env, options = WORLDS[name]
        training = SimpleNamespace(held_out=make_worlds(env, 1, options))
        assert examples_for(training, BcOptions()).hindsight == expected


@pytest.mark.one_case
@pytest.mark.parametrize("name", WORLDS)
def test_the_inverse_of_the_scale_gives_the_network_s_action_back(name):
    env, options = WORLDS[name]
    worlds = make_worlds(env, 9, options)
    observations = tensors(worlds.reset(seed=0)[0])
    scale = view_of(worlds).action_scale
    raw = torch.rand(9, worlds.single_action_space.shape[0]) * 2 - 1
    torch.testing.assert_close(scale.inverse(observations, scale(observations, raw)), raw, atol=1e-4, rtol=0)
    far = scale(observations, raw) + 100
    assert (scale.inverse(observations, far) == 1).all()


def turned_world(observations, angle):
    """The same world, turned about the vertical by an angle, as its observation has it."""
    parts = {"tip": (0, 3), "target": (9, 12), "rest": (12, observations.shape[1])}
    turned = observations.copy()
    cos, sin = np.cos(angle), np.sin(angle)

    def turn(begin):
        x, y = observations[:, begin].copy(), observations[:, begin + 1].copy()
        turned[:, begin], turned[:, begin + 1] = cos * x - sin * y, sin * x + cos * y

    turn(parts["tip"][0])
    turn(parts["target"][0])
    turned[:, 3] += angle
    begin, end = parts["rest"]
    if end - begin == 3:
        turn(begin)
    if end - begin == 12:
        for axis in range(begin, end, 3):
            turn(axis)
        return turned
    for box in range(begin, end - 6, 7):
        there = observations[:, box + 3] > 0
        turn(box)
        turned[:, box + 6] += angle * there
    return turned


@pytest.mark.parametrize("name", ["ur5", "moving", "pose", "obstacles"])
def test_turned_features_do_not_change_when_the_world_is_turned(name):
    torch.manual_seed(0)
    env, options = WORLDS[name]
    worlds = make_worlds(env, 4, options)
    observations, _ = worlds.reset(seed=0)
    view = view_of(worlds, features="invariant")
    features = view.features(worlds.single_observation_space, **view.features_options)
    seen = features(torch.as_tensor(observations))
    assert seen.shape == (4, features.features_dim)
    torch.testing.assert_close(features(torch.as_tensor(turned_world(observations, 0.7))), seen, atol=1e-4, rtol=0)
    changed = observations.copy()
    changed[:, -1 if name == "moving" else 9] += 0.3
    assert (features(torch.as_tensor(changed)) - seen).abs().max() > 1e-3


def test_neither_the_order_of_boxes_nor_absent_ones_matter():
    torch.manual_seed(0)
    worlds = make_worlds("armctl/ArmReachObstacles-v0", 2)
    observations, _ = worlds.reset(seed=0)
    view = view_of(worlds, features="invariant")
    features = view.features(worlds.single_observation_space, **view.features_options)
    shuffled = observations.copy()
    shuffled[:, 12:] = observations[:, 12:].reshape(2, -1, 7)[:, ::-1].reshape(2, -1)
    torch.testing.assert_close(features(torch.as_tensor(shuffled)), features(torch.as_tensor(observations)))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10", "panda", "xarm7", "z1"])
def test_arms_whose_first_axis_is_vertical_are_seen_in_its_frame(robot):
    from armctl.rl.networks.features import BaseYawInvariantFeatures

    assert (
        view_of(TaskVectorEnv(1, task=ReachTask, robot=robot), features="invariant").features
        is BaseYawInvariantFeatures
    )


@pytest.mark.slow
def test_ppo_begins_with_the_clone(tmp_path):
    recipe = small(
        "reach_cloned_ppo", demonstrations=40, cloning_steps=400, critic_steps=512, steps=1536, worlds=32,
        evaluation_every=512,
    )  # fmt: skip
    card = train_cloned_ppo(recipe, out=tmp_path / "run", seed=0, progress=False)
    curve = (tmp_path / "run" / "curve.csv").read_text().splitlines()[1:]
    assert curve[0].startswith("0,")
    assert float(curve[0].split(",")[2]) >= 0.2
    assert card.evaluation.success_rate >= 0.05, "random actions reach 1 % of these targets"
