import json
from functools import cache

import gymnasium
import numpy as np
import pytest
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv, VecTransposeImage

from armctl.agents import read_card
from armctl.rl.export import sb3_file
from tests.command_line import armctl
from tests.rl.sb3_models import LSTM, SMALL, check_acts_alike, exported, make, normalised, observations, register

register()
SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "env", "name", "options"),
    [
        pytest.param(PPO, "Pendulum-v1", "ppo", {}, marks=SLOW),
        (PPO, "CartPole-v1", "ppo", {}),
        pytest.param(
            PPO, "Pendulum-v1", "ppo", {"use_sde": True, "policy_kwargs": {"squash_output": True}}, marks=SLOW
        ),
        pytest.param(A2C, "CartPole-v1", "a2c", {}, marks=SLOW),
        (SAC, "Pendulum-v1", "sac", SMALL),
        pytest.param(SAC, "Pendulum-v1", "sac", SMALL | {"use_sde": True}, marks=SLOW),
        pytest.param(TD3, "Pendulum-v1", "td3", SMALL, marks=SLOW),
        pytest.param(DDPG, "Pendulum-v1", "ddpg", SMALL, marks=SLOW),
        pytest.param(TQC, "Pendulum-v1", "tqc", SMALL, marks=SLOW),
        pytest.param(DQN, "sb3/vector-choice-v0", "dqn", SMALL, marks=SLOW),
        pytest.param(PPO, "armctl/ArmReach-v0", "ppo", {}, marks=SLOW),
    ],
)
def test_an_agent_acts_as_its_model(kind, env, name, options, tmp_path):
    model = make(kind, env, **options)
    card, load = exported(model, env, tmp_path)
    assert (card.learner, card.env, card.training_seed, card.training_minutes) == (f"sb3-{name}", env, 0, None)
    assert card.conversion.observations == 1000
    assert card.conversion.largest_difference <= 1e-5
    assert card.learner_options["gamma"] == 0.99
    check_acts_alike(model, load(4), env)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seen", "done", "policy", "options"),
    [
        pytest.param("image", "choice", "CnnPolicy", {}, marks=SLOW),
        ("parts", "push", "MultiInputPolicy", {}),
        pytest.param("number", "choices", "MlpPolicy", {}, marks=SLOW),
        pytest.param("numbers", "switches", "MlpPolicy", {}, marks=SLOW),
        pytest.param("bits", "table", "MlpPolicy", {}, marks=SLOW),
        pytest.param("double", "exact", "MlpPolicy", {}, marks=SLOW),
    ],
)
def test_any_observations_and_actions(seen, done, policy, options, tmp_path):
    env = f"sb3/{seen}-{done}-v0"
    model = make(PPO, env, policy, **options)
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(3), env, n=3, steps=40)


@SLOW
def test_squashed_actions_in_double_precision(tmp_path):
    model = make(SAC, "sb3/double-exact-v0", **SMALL)
    _, load = exported(model, "sb3/double-exact-v0", tmp_path)
    check_acts_alike(model, load(3), "sb3/double-exact-v0", n=3)


RECURRENT = {
    "two LSTMs": LSTM,
    "shared": LSTM | {"shared_lstm": True, "enable_critic_lstm": False},
    "actor's only": LSTM | {"enable_critic_lstm": False},
    "two layers": LSTM | {"n_lstm_layers": 2},
}


@pytest.fixture(scope="module")
def recurrent(tmp_path_factory):
    """A recurrent model, its card, and how to load its agent, of a variant: each is exported once."""

    @cache
    def of(variant):
        model = make(RecurrentPPO, "sb3/vector-push-v0", "MlpLstmPolicy", policy_kwargs=RECURRENT[variant])
        return model, *exported(model, "sb3/vector-push-v0", tmp_path_factory.mktemp("recurrent"))

    return of


@pytest.mark.slow
@pytest.mark.parametrize(
    "variant", ["two LSTMs", *(pytest.param(name, marks=SLOW) for name in ("shared", "actor's only", "two layers"))]
)
def test_a_recurrent_agent_remembers_and_forgets(variant, recurrent):
    model, card, load = recurrent(variant)
    layers = RECURRENT[variant].get("n_lstm_layers", 1)
    assert card.memory == {"lstm_hidden": [layers, 16], "lstm_cell": [layers, 16]}
    check_acts_alike(model, load(4), "sb3/vector-push-v0")


@SLOW
def test_a_recurrent_agent_of_parts_and_choices(tmp_path):
    model = make(RecurrentPPO, "sb3/two-choices-v0", "MultiInputLstmPolicy", policy_kwargs=LSTM)
    _, load = exported(model, "sb3/two-choices-v0", tmp_path)
    check_acts_alike(model, load(4), "sb3/two-choices-v0")


@pytest.mark.slow
def test_a_world_remembers_the_same_whatever_the_number_of_worlds(recurrent):
    _, _, load = recurrent("two LSTMs")
    shown, began = observations("sb3/vector-push-v0", 30, 9)
    shown[15], began[17] = shown[15], began[17] | (np.arange(9) % 2 == 0)
    played = {}
    for n in (1, 2, 3, 5, 8, 9):
        agent, actions = load(n), []
        for seen, starts in zip(shown, began, strict=True):
            agent.reset(np.flatnonzero(starts[:n]).astype(np.int32))
            actions.append(agent.act(seen[:n]))
        played[n] = np.array(actions)
    for n, acted in played.items():
        np.testing.assert_array_equal(acted, played[9][:, :n])
    assert not np.array_equal(load(1).act(shown[1][:1]), played[1][1]), "what it remembers matters"


@pytest.mark.slow
def test_an_agent_that_is_reset_acts_as_a_new_one(recurrent):
    _, _, load = recurrent("two LSTMs")
    shown, _ = observations("sb3/vector-push-v0", 4, 2)
    used = load(2)
    for seen in shown:
        used.act(seen)
    used.reset(np.array([1], dtype=np.int32))
    now, fresh = used.act(shown[0]), load(2).act(shown[0])
    np.testing.assert_array_equal(now[1], fresh[1])
    assert not np.array_equal(now[0], fresh[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "given"),
    [("vecnormalize.pkl", []), pytest.param("other.pkl", ["--vecnormalize", "other.pkl"], marks=SLOW)],
)
def test_normalised_observations(name, given, tmp_path):
    venv = normalised("Pendulum-v1", tmp_path, name, clip_obs=1.0)
    model = make(PPO, venv)
    card, load = exported(model, "Pendulum-v1", tmp_path, *given)
    assert card.conversion.normalisation == name
    check_acts_alike(model, load(4), "Pendulum-v1", venv.normalize_obs)


@SLOW
def test_parts_that_are_normalised_and_parts_that_are_not(tmp_path):
    venv = normalised("sb3/two-push-v0", tmp_path, norm_obs_keys=["place"])
    model = make(SAC, venv, "MultiInputPolicy", **SMALL)
    _, load = exported(model, "sb3/two-push-v0", tmp_path)
    check_acts_alike(model, load(3), "sb3/two-push-v0", venv.normalize_obs, n=3)


@SLOW
def test_a_recurrent_agent_of_normalised_observations(tmp_path):
    venv = normalised("Pendulum-v1", tmp_path, "vec_normalize.pkl")
    model = make(RecurrentPPO, venv, "MlpLstmPolicy", policy_kwargs=LSTM)
    _, load = exported(model, "Pendulum-v1", tmp_path)
    check_acts_alike(model, load(4), "Pendulum-v1", venv.normalize_obs)


@SLOW
def test_normalised_images(tmp_path):
    env = "sb3/image-push-v0"
    venv = normalised(env, tmp_path)
    model = make(PPO, venv, policy_kwargs={"normalize_images": False})
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(2), env, venv.normalize_obs, n=2, steps=30)


@SLOW
def test_without_statistics_that_lie_beside_it(tmp_path):
    normalised("Pendulum-v1", tmp_path)
    model = make(PPO, "Pendulum-v1")
    card, load = exported(model, "Pendulum-v1", tmp_path, "--vecnormalize", "none")
    assert card.conversion.normalisation is None
    check_acts_alike(model, load(4), "Pendulum-v1")


@pytest.mark.parametrize(
    "beside",
    ["vecnormalize.pkl", "vec_normalize.pkl", "rl_vecnormalize_500_steps.pkl", "rl_500_steps/vecnormalize.pkl"],
)
def test_where_statistics_are_looked_for(beside, tmp_path):
    model = tmp_path / "rl_500_steps.zip"
    assert sb3_file.normalisation_beside(model) is None
    (tmp_path / beside).parent.mkdir(exist_ok=True)
    (tmp_path / beside).touch()
    assert sb3_file.normalisation_beside(model) == tmp_path / beside


@SLOW
def test_a_trained_model_and_what_its_card_says(tmp_path):
    model = TQC(
        "MlpPolicy", "Pendulum-v1", seed=3, learning_starts=50, policy_kwargs={"net_arch": [16]}, buffer_size=500
    )
    model.learn(120)
    card, load = exported(model, "Pendulum-v1", tmp_path)
    assert (card.name, card.training_steps, card.training_seed, card.interface) == ("agent", 120, 3, {})
    assert card.learner_options["policy_kwargs"]["net_arch"] == [16]
    assert card.learner_options["top_quantiles_to_drop_per_net"] == 2
    assert card.conversion.saved_with.startswith("stable-baselines3 2.")
    check_acts_alike(model, load(4), "Pendulum-v1")
    assert "/" not in json.dumps([card.versions, card.learner_options]), "no paths"


@pytest.mark.slow
def test_the_environment_s_options_are_on_the_card(tmp_path):
    env, options = "armctl/ArmReach-v0", ["--set", "robot=ur10", "--set", "max_episode_steps=9"]
    make(PPO, gymnasium.make(env, robot="ur10")).save(tmp_path / "model.zip")
    done = armctl("export", "model.zip", "--env", env, *options, "--trust", cwd=tmp_path)
    card = read_card(tmp_path / "model.json")
    assert card.env_options == {"robot": "ur10", "max_episode_steps": 9}
    assert card.interface["robot"] == "ur10"
    assert " ".join(options) in done.stdout
    options[1] = "robot=panda"
    refused = armctl("export", "model.zip", "--env", env, *options, "--trust", "--overwrite", cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert "trained with" in refused.stderr


@SLOW
def test_channels_may_have_been_first_already(tmp_path):
    env = "sb3/image-choice-v0"
    model = make(DQN, VecTransposeImage(DummyVecEnv([lambda: gymnasium.make(env)])), "CnnPolicy", **SMALL)
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(2), env, n=2, steps=30)
