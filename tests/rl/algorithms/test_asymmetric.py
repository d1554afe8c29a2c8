import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms import cloned_ppo, ppo
from armctl.rl.algorithms.asymmetric import STATE, Shares
from armctl.rl.networks.view import view_of
from armctl.rl.run.training import Training
from armctl.training.learners import Recipe, load_recipe

BRIDGE = "armctl/BridgeCross-v0"
CAMERA = {"resolution": (8, 6), "max_episode_steps": 5}
SMALL = {
    "steps": 32, "worlds": 2, "rollout_length": 8, "batch_size": 8, "evaluation_every": 16, "validation_episodes": 2,
    "evaluation_episodes": 2, "privileged_critic": True, "features": "none",
}  # fmt: skip


def recipe(env=BRIDGE, env_options=CAMERA, **options):
    return Recipe(name="ppo", learner="ppo", env=env, env_options=env_options, options=SMALL | options)


def untrained(chosen, out):
    training = Training(chosen, chosen.read_options(ppo.PpoOptions), out, 0, False)
    return training, ppo.load_or_make(
        training, training.options, PPO, lambda: ppo.vec_env_for(training, training.options)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "memory"),
    [({}, {}), ({"frames": 3, "frame_gap": 2}, {"past_image": [4, 6, 8], "past_motion": [4, 3], "begun": [1]})],
)
def test_the_agent_is_without_the_state(options, memory, tmp_path, request):
    chosen = recipe(**options)
    card = ppo.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert (card.observation_shape, card.memory) == ({"image": [6, 8], "motion": [3]}, memory)
    worlds = make_worlds(BRIDGE, 3, CAMERA)
    agent = load_agent(tmp_path / "run" / "agent.json", worlds)
    observations, _ = worlds.reset(seed=0)
    model = PPO.load(tmp_path / "run" / "checkpoints" / f"{card.best_after}.zip", device="cpu")
    frames = model.observation_space["image"].shape[0]
    shown = {name: np.repeat(part[:, None], frames, axis=1) for name, part in observations.items()}
    raw, _ = model.predict({**shown, STATE: np.zeros((3, *model.observation_space[STATE].shape))}, deterministic=True)
    (slow, right), (fast, left) = worlds.task.action_range
    low, high = np.array((slow, right)), np.array((fast, left))
    np.testing.assert_allclose(agent.act(observations), (low + high) / 2 + (high - low) / 2 * raw, atol=1e-5)
    request.getfixturevalue("unexported")
    more = chosen.changed(options=chosen.options | {"steps": 48})
    assert ppo.train(more, out=tmp_path / "run", seed=0, resume=True, progress=False).training_steps == 48


def test_the_critic_sees_the_state_alone_and_the_actor_does_not(tmp_path):
    _, model = untrained(recipe(), tmp_path / "run")
    shown = model.env.reset()
    seen = {name: torch.as_tensor(part) for name, part in shown.items()}

    def judged(**changes):
        observed = {name: part + changes.get(name, 0.0) for name, part in seen.items()}
        with torch.no_grad():
            return model.policy.predict_values(observed), model.policy.get_distribution(observed).mode()

    value, action = judged()
    another_value, same_action = judged(**{STATE: 1.0})
    same_value, another_action = judged(image=1.0, motion=1.0)
    assert torch.equal(action, same_action)
    assert torch.equal(value, same_value)
    assert not torch.allclose(value, another_value)
    assert not torch.allclose(action, another_action)


def test_the_critic_sees_a_state_as_an_agent_of_the_state_does(tmp_path):
    _, model = untrained(recipe(), tmp_path / "run")
    worlds = make_worlds(BRIDGE, 2, {"observation": "state"})
    states, _ = worlds.reset(seed=[0, 1])
    view = view_of(worlds)
    scans = view.features(worlds.single_observation_space, **view.features_options)
    model.env.seed(0)
    found = model.policy.vf_features_extractor({STATE: torch.as_tensor(model.env.reset()[STATE])})
    torch.testing.assert_close(found, scans(torch.as_tensor(states)))


def test_numbers_of_a_state_without_features_are_shares_of_their_bounds():
    shares = Shares(
        gymnasium.spaces.Box(np.array([-4, -1, -np.inf, -3], np.float32), np.array([4, 2, np.inf, 0], np.float32))
    )
    found = shares(torch.tensor([[2.0, -1.0, 7.0, -3.0]]))
    torch.testing.assert_close(found, torch.tensor([[0.5, -0.5, 7.0, -3.0]]))


def test_the_state_shown_is_that_of_the_worlds_and_in_the_end_the_last_one(tmp_path):
    training, model = untrained(recipe(), tmp_path / "run")
    venv = model.env
    venv.seed(3)
    truth = make_worlds(BRIDGE, 2, {"observation": "state", "max_episode_steps": 5}, autoreset_mode="same_step")
    states, _ = truth.reset(seed=[3, 4])
    view = view_of(truth)
    scans = view.features(truth.single_observation_space, **view.features_options)
    shown = venv.reset()
    action = np.array([[0.4, 0.2], [0.8, -0.1]], dtype=np.float32)
    for t in range(7):
        np.testing.assert_allclose(shown[STATE], scans(torch.as_tensor(states)), atol=1e-6)
        assert all(venv.observation_space.contains({name: part[i] for name, part in shown.items()}) for i in range(2))
        shown, _, done, infos = venv.step(action)
        states, *_, truths = truth.step(training.view.action_scale({}, torch.as_tensor(action)).numpy())
        assert done.all() == (t == 4)
        for i in np.flatnonzero(done):
            last = scans(torch.as_tensor(truths["final_obs"][i : i + 1]))[0]
            np.testing.assert_allclose(infos[i]["terminal_observation"][STATE], last, atol=1e-6)
            assert not np.array_equal(truths["final_obs"][i], states[i])


@pytest.mark.slow
def test_a_clone_may_go_on_with_a_privileged_critic(tmp_path, unexported):
    small = {**SMALL, "cloning_steps": 3, "critic_steps": 16, "demonstrations": 2, "hidden_units": 8}
    chosen = load_recipe("cloned_ppo", BRIDGE).changed(
        teacher="bridge_ompl", shaping=None, env_options={"resolution": (8, 6)}, options=small
    )
    card = cloned_ppo.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert (card.training_steps, card.observation_shape) == (32, {"image": [6, 8], "motion": [3]})


def test_an_observation_of_one_array(tmp_path):
    training, model = untrained(recipe(env_options=CAMERA | {"observation": "image"}), tmp_path / "run")
    shown = model.env.reset()
    assert {name: part.shape for name, part in shown.items()} == {"observation": (2, 1, 6, 8), STATE: (2, 54)}
    actor = ppo.actor_of(model, training)
    expected, _ = model.predict(shown, deterministic=True)
    actions = training.view.action_scale({}, torch.as_tensor(expected))
    np.testing.assert_allclose(actor.act(shown["observation"][:, 0]), actions, atol=1e-6)


def test_a_task_that_does_not_say_its_state(tmp_path):
    with pytest.raises(ConfigurationError, match=r"ReachTask does not say .*leave privileged_critic out"):
        ppo.train(recipe("armctl/ArmReach-v0", {}), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()
