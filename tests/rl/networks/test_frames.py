from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from armctl.agents import AgentCard, OnnxPolicy, load_agent, shapes
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.rl.algorithms import cloned_ppo, ppo, sac
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.encoder import Encoded
from armctl.rl.networks.frames import FrameFeatures, History
from armctl.rl.networks.view import view_of
from armctl.rl.run.training import Training
from armctl.rl.run.vector import EncodedVectorEnv, vec_env_of
from armctl.shaping import Shaped
from armctl.tasks import BridgeTask, ReachTask
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.training.learners import load_recipe

PREPARATION = f"{Path(__file__).parents[1] / 'preparations.py'}:NearestInColumns"
CAMERA = {"resolution": (8, 6), "max_episode_steps": 5}
JUDGED = {"validation_episodes": 3, "evaluation_episodes": 3}


@pytest.fixture
def prepared(monkeypatch):
    """Bridges whose learners see ranges in place of images."""
    spec = FeatureSpec("armctl.rl.networks.features:CombinedExtractor", prepare=PREPARATION)
    monkeypatch.setattr(BridgeTask, "learner_view", property(lambda task: LearnerView(features=spec)))


def observations_of(space, steps, worlds):
    """Random observations at each control step."""
    rng = np.random.default_rng(0)
    return [
        {name: rng.uniform(0, 9, (worlds, *part.shape)).astype(np.float32) for name, part in space.items()}
        if isinstance(space, gymnasium.spaces.Dict)
        else rng.uniform(-1, 1, (worlds, *space.shape)).astype(np.float32)
        for _ in range(steps)
    ]


def actor_with_frames(worlds, frames, gap):
    torch.manual_seed(0)
    view, space = view_of(worlds), worlds.single_observation_space
    history = History(view, space, frames, gap)
    features = FrameFeatures(history.space, view)
    last = torch.nn.Linear(features.features_dim, worlds.single_action_space.shape[0])
    torch.nn.init.uniform_(last.weight, -0.02, 0.02)  # actions within the limits tell observations apart
    network = torch.nn.Sequential(features, last)
    return Actor(Encoded(history, network), view.action_scale, space, history.memory)


def exported(actor, worlds, path):
    actor.export(path)
    card = AgentCard(
        name="a", learner="ppo", env="e", env_options={}, interface={}, training_steps=1,
        action_shape=list(worlds.single_action_space.shape),
        observation_shape=shapes(worlds.single_observation_space), memory=actor.memory, training_minutes=None,
        training_seed=0, learner_options={}, versions={}, sha256="",
    )  # fmt: skip
    return lambda: OnnxPolicy(path, card)


@pytest.mark.parametrize(("frames", "gap"), [(2, 1), (4, 3)])
def test_a_stack_is_the_last_observations_and_before_them_the_first(frames, gap):
    worlds = make_worlds("armctl/ArmReach-v0", 2)
    space = worlds.single_observation_space
    history = History(view_of(worlds), space, frames, gap)
    seen = [tensors(one) for one in observations_of(space, 12, 2)]
    memory = [torch.zeros(2, *shape) for shape in history.memory.values()]
    for t, now in enumerate(seen):
        stack, *memory = history(now, *memory)
        expected = [seen[max(0, t - age * gap)] for age in reversed(range(frames))]
        assert torch.equal(stack, torch.stack(expected, dim=1))


@pytest.mark.slow
@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", pytest.param("armctl/BridgeCross-v0", marks=pytest.mark.slow)])
def test_a_graph_with_memory_acts_as_the_network_in_any_number_of_worlds(env, tmp_path, prepared):
    worlds = make_worlds(env, 3, {"resolution": (8, 6)} if "Bridge" in env else {})
    actor = actor_with_frames(worlds, 3, 2)
    assert "past_image" not in actor.memory  # but ranges
    policy_of = exported(actor, worlds, tmp_path / "a.onnx")
    together, alone = policy_of(), [policy_of() for _ in range(3)]
    actions = []
    for t, now in enumerate(observations_of(worlds.single_observation_space, 9, 3)):
        if t == 5:
            for policy in (actor, together):
                policy.reset(np.array([1], dtype=np.int32))
            alone[1].reset(np.array([0], dtype=np.int32))
        actions.append(together.act(now))
        np.testing.assert_allclose(actions[-1], actor.act(now), atol=1e-5)
        for i, policy in enumerate(alone):
            one = {name: part[i : i + 1] for name, part in now.items()} if isinstance(now, dict) else now[i : i + 1]
            assert np.array_equal(policy.act(one)[0], actions[-1][i])
    fresh = policy_of()
    forgotten = [fresh.act(now) for now in observations_of(worlds.single_observation_space, 9, 3)[5:]]
    assert np.array_equal(np.array(forgotten)[:, 1], np.array(actions)[5:, 1])
    assert not np.array_equal(np.array(forgotten)[:, 0], np.array(actions)[5:, 0])


def test_an_actor_with_memory_begins_anew_for_another_number_of_worlds():
    actor = actor_with_frames(make_worlds("armctl/ArmReach-v0", 3), 2, 1)
    first, second = observations_of(make_worlds("armctl/ArmReach-v0", 1).single_observation_space, 2, 3)
    alone = actor.act(second[:2])
    actor.act(first)
    assert np.array_equal(actor.act(second[:2]), alone)
    actor.reset(np.arange(3, dtype=np.int32))  # of more worlds than it has acted in
    assert np.array_equal(actor.act(second[:2]), alone)


def test_worlds_show_stacks_that_do_not_cross_episodes(prepared):
    worlds = Shaped(make_worlds("armctl/BridgeCross-v0", 2, CAMERA, autoreset_mode="same_step"), "distance", gamma=0.9)
    view = view_of(worlds.unwrapped)
    history = History(view, worlds.single_observation_space, 3, 2)
    venv = EncodedVectorEnv(history, worlds, view)
    venv.seed(0)
    shown, seen = venv.reset(), []
    assert {name: space.shape for name, space in venv.observation_space.items()} == {"ranges": (3, 8), "motion": (3, 3)}
    for t in range(11):
        assert venv.observation_space.contains({name: part[0] for name, part in shown.items()})
        image = venv._observations["image"]
        seen = [*seen, image.min(axis=1)] if t % 5 else [image.min(axis=1)]
        expected = [seen[max(0, len(seen) - 1 - age)] for age in (4, 2, 0)]
        assert np.array_equal(shown["ranges"], np.stack(expected, axis=1))
        before = shown
        kept = {name: part.copy() for name, part in before.items()}
        shown, _, done, infos = venv.step(np.array([[0.3, 0.1], [0.9, -0.2]], dtype=np.float32))
        assert done.all() == (t % 5 == 4)
        for name, part in kept.items():
            assert np.array_equal(before[name], part)  # the learner may store it after the step
        for i in np.flatnonzero(done):
            last = infos[i]["terminal_observation"]
            assert venv.observation_space.contains(last)
            assert np.array_equal(last["ranges"][:2], [seen[-4][i], seen[-2][i]])
            assert not np.array_equal(last["ranges"][2], before["ranges"][i, 2])


def recipe(learner, **options):
    env_options = {"max_episode_steps": 10}
    return load_recipe(learner, "armctl/ArmReach-v0").changed(
        shaping=None, env_options=env_options, options={**JUDGED, "worlds": 4, **options}
    )


LEARNERS = {
    "ppo": (ppo.train, {"steps": 64, "rollout_length": 8, "batch_size": 32}),
    "sac": (sac.train, {"steps": 64, "random_steps": 16, "relabelled": 0, "gradient_steps": 1, "batch_size": 16}),
}


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS)
def test_agents_trained_with_frames_remember_and_resume(learner, tmp_path, request):
    train, options = LEARNERS[learner]
    chosen = recipe(learner, frames=3, frame_gap=2, evaluation_every=32, **options)
    card = train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert card.memory == {"past_observation": [4, 12], "begun": [1]}
    assert card.evaluation.episodes == 3
    load_agent(tmp_path / "run" / "agent.json", TaskVectorEnv(2, task=ReachTask))
    request.getfixturevalue("unexported")
    more = chosen.changed(options=chosen.options | {"steps": 96})
    assert train(more, out=tmp_path / "run", seed=0, resume=True, progress=False).training_steps == 96


def test_one_frame_is_no_memory(tmp_path, prepared):
    training = Training(recipe("ppo"), recipe("ppo").read_options(ppo.PpoOptions), tmp_path / "run", 0, False)
    model = ppo.load_or_make(training, training.options, PPO, lambda: ppo.vec_env_for(training, training.options))
    assert ppo.actor_of(model, training).memory == {}
    chosen = load_recipe("ppo", "armctl/BridgeCross-v0").changed(
        env_options=CAMERA, training_options={}, curriculum=[], options={"worlds": 2}
    )
    training = Training(chosen, chosen.read_options(ppo.PpoOptions), tmp_path / "run", 0, False)
    model = ppo.load_or_make(training, training.options, PPO, lambda: ppo.vec_env_for(training, training.options))
    actor = ppo.actor_of(model, training)
    assert actor.memory == {}
    assert model.observation_space["ranges"].shape == (1, 8)  # buffers hold what is prepared
    assert actor.act(training.held_out.reset(seed=0)[0]).shape == (100, 2)


@pytest.mark.parametrize(
    ("train", "changes", "says"),
    [
        (ppo.train, {"frame_gap": 2}, "set frames too"),
        (ppo.train, {"frames": 0}, "frames: .*greater than or equal to 1"),
        (cloned_ppo.train, {"frames": 2}, "leave the option frames out"),
    ],
)
def test_frames_where_they_have_no_meaning(train, changes, says, tmp_path):
    learner = train.__module__.rpartition(".")[2]
    with pytest.raises(ConfigurationError, match=says):
        train(recipe(learner, **changes), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


def test_pictures_of_bytes_are_not_stacked():
    worlds = make_worlds("armctl/BridgeCross-v0", 1, {"observation": "image", "image_format": "uint8"})
    with pytest.raises(ConfigurationError, match="32-bit floats"):
        History(view_of(worlds), worlds.single_observation_space, 2, 1)


def test_a_preparation_that_is_not_there(monkeypatch):
    spec = FeatureSpec("nearness", prepare="armctl.rl.networks.features:Nothing")
    monkeypatch.setattr(BridgeTask, "learner_view", property(lambda task: LearnerView(features=spec)))
    with pytest.raises(ConfigurationError, match="preparation"):
        view_of(make_worlds("armctl/BridgeCross-v0", 1))


def test_extractors_of_bare_observations_prepare_them(prepared):
    worlds = make_worlds("armctl/BridgeCross-v0", 1, CAMERA)
    view = view_of(worlds)
    (now,) = observations_of(worlds.single_observation_space, 1, 2)
    features = view.extractor(worlds.single_observation_space)(tensors(now))
    assert np.array_equal(features, np.concatenate((now["motion"], now["image"].min(axis=1)), axis=1))


@pytest.mark.parametrize("frames", [1, 3])
def test_worlds_show_features_that_do_not_learn(frames):
    """In place of the stacks that they are made of, the last ones of episodes too."""
    envs = [make_worlds("armctl/ArmReach-v0", 2, {"max_episode_steps": 4}, autoreset_mode="same_step") for _ in "ab"]
    view = view_of(envs[0], features="invariant")
    options = ppo.PpoOptions(frames=frames)
    stacks = EncodedVectorEnv(History(view, envs[0].single_observation_space, frames), envs[0], view)
    features, shows = FrameFeatures(stacks.observation_space, view), vec_env_of(envs[1], view, options)
    for venv in (stacks, shows):
        venv.seed(3)
    stack, shown = stacks.reset(), shows.reset()
    action = np.full((2, 6), 0.3, dtype=np.float32)
    for _ in range(6):
        assert np.array_equal(shown, features(torch.as_tensor(stack)))
        (stack, _, done, stack_infos), (shown, _, _, infos) = stacks.step(action), shows.step(action)
        for i in np.flatnonzero(done):
            last = torch.as_tensor(stack_infos[i]["terminal_observation"])[None]
            assert np.array_equal(infos[i]["terminal_observation"][None], features(last))


def test_worlds_do_not_show_features_that_learn():
    envs = make_worlds("armctl/ArmReachObstacles-v0", 1, {"solvable": False}, autoreset_mode="same_step")
    shows = vec_env_of(envs, view_of(envs, features="invariant"), ppo.PpoOptions())
    assert shows.observation_space == envs.single_observation_space
